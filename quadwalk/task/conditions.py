"""What an episode can suffer beside a changed robot: late targets, pushes, noisy sensors."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from quadwalk.physics.motor import Physics

PUSH_PERIOD = 5.0  # s: one push in each


class Conditions(NamedTuple):
    """The conditions of one episode.

    - delay: a joint target is obeyed this many physics steps after the observation that it is the
      answer to; until the first is, the home pose is held.
    - push: m/s, by which the trunk's velocity along world y, sideways to the run, changes in an
      instant, once in every `PUSH_PERIOD`, at a time and to a side that `key` draws.
    - noise: level of the Gaussian noise, independent in every step and number, that is added to
      the observation; the task says what level 1 is.
    """

    delay: jax.Array  # () int32
    push: jax.Array  # ()
    noise: jax.Array  # ()
    targets: jax.Array  # (n, 12) joint targets, the newest first, as many as the delay needs
    key: jax.Array  # of the episode's noise and pushes


def first_conditions(
    home: jax.Array, delay: jax.Array, push: jax.Array, noise: jax.Array, key: jax.Array, kept: int
) -> Conditions:
    """Those of an episode's start, holding the joints at `home` (12,), with `kept` targets."""
    return Conditions(delay, push, noise, jnp.tile(home, (kept, 1)), key)


def targets_needed(delay: int, substeps: int) -> int:
    """How many joint targets, the newest included, a delay of so many physics steps needs."""
    return 1 + -(-delay // substeps)


def delayed(
    conditions: Conditions, target: jax.Array, substeps: int
) -> tuple[Conditions, jax.Array]:
    """The targets (substeps, 12) obeyed in each physics step, when `target` (12,) is the newest."""
    targets = jnp.concatenate([target[None], conditions.targets[:-1]])
    # Of how many control steps ago: those begun within the last `delay` physics steps.
    late = conditions.delay - jnp.arange(substeps) + substeps - 1
    return conditions._replace(targets=targets), targets[jnp.maximum(late, 0) // substeps]


def pushed(conditions: Conditions, physics: Physics, steps: jax.Array, dt: float) -> Physics:
    """`physics` after the push of control step `steps` of the episode, if it has one."""
    _, key = jax.random.split(conditions.key)
    kick = conditions.push * side_of_push(key, steps, dt)
    return physics._replace(qvel=physics.qvel.at[1].add(kick))


def side_of_push(key: jax.Array, steps: jax.Array, dt: float) -> jax.Array:
    """1 or -1 in the control step of a push to the left or right, else 0."""
    period = max(round(PUSH_PERIOD / dt), 1)
    when, side = jax.random.split(jax.random.fold_in(key, steps // period))
    now = steps % period == jax.random.randint(when, (), 0, period)
    return jnp.where(now, jax.random.rademacher(side, (), jnp.float32), 0.0)


def sensed(
    conditions: Conditions, seen: jax.Array, scale: ArrayLike, steps: jax.Array
) -> jax.Array:
    """`seen` (n,) with the noise of control step `steps`, `scale` (n,) being level 1."""
    key, _ = jax.random.split(conditions.key)
    noise = jax.random.normal(jax.random.fold_in(key, steps), seen.shape)
    return seen + conditions.noise * scale * noise
