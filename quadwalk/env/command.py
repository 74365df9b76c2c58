"""The velocity command of an episode, and when it changes."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from quadwalk.settings.environment import CommandConfig

# Folded into the key of an episode's start, for the keys of its commands.
_COMMANDS = 0x636D64
# Share of the acceleration that friction bears which a turn may need.
GRIP_USED = 0.5


class Command(NamedTuple):
    """The velocity command of one episode."""

    velocity: jax.Array  # (3,) forward and lateral m/s, in the frame of the heading; yaw rate rad/s
    key: jax.Array  # of all commands of the episode
    until: jax.Array | None = None  # () int32, control steps; None: changes are regular
    # (2,) m/s, on its way from the last command to this one; None: it is there at once
    reached: jax.Array | None = None


def first_command(
    config: CommandConfig, key: jax.Array, dt: float, grip: ArrayLike = np.inf
) -> Command:
    """The first command of an episode begun with `key`, in steps of `dt` s; `grip` as in `draw`."""
    own = jax.random.fold_in(key, _COMMANDS)
    until = None if config.soonest is None else _until(config, own, dt)
    reached = None if config.acceleration is None else jnp.zeros(2)
    return Command(draw(config, own, grip), own, until, reached)


def next_command(
    config: CommandConfig, before: Command, steps: jax.Array, dt: float, grip: ArrayLike = np.inf
) -> Command:
    """The command after `steps` control steps of an episode, of `dt` s each."""
    key = jax.random.fold_in(before.key, steps)
    new = draw(config, key, grip)
    if before.reached is not None:
        assert config.acceleration is not None
        way = before.velocity[:2] - before.reached
        share = config.acceleration * dt / jnp.maximum(jnp.linalg.norm(way), 1e-6)
        before = before._replace(reached=before.reached + jnp.minimum(share, 1.0) * way)
    if before.until is None:
        period = max(round(config.seconds / dt), 1)
        return before._replace(velocity=jnp.where(steps % period == 0, new, before.velocity))
    due = steps >= before.until
    until = jnp.where(due, steps + _until(config, key, dt), before.until)
    return before._replace(velocity=jnp.where(due, new, before.velocity), until=until)


def _until(config: CommandConfig, key: jax.Array, dt: float) -> jax.Array:
    """Control steps () int32 that a command holds, drawn with `key`."""
    assert config.soonest is not None
    low, high = (max(round(seconds / dt), 1) for seconds in (config.soonest, config.seconds))
    return jax.random.randint(jax.random.fold_in(key, 1), (), low, high + 1)


def draw(config: CommandConfig, key: jax.Array, grip: ArrayLike = np.inf) -> jax.Array:
    """A command (3,): uniform in ranges widened by the margin, then within what friction bears.

    For `config.standing` of all keys it is zero, for `config.straight` of them forward alone, for
    `config.spot` to turn on the spot.
    `grip`, m/s^2, is the acceleration that friction bears.
    """
    drawn = jax.random.uniform(key, (4,))
    low, high = np.array([config.forward, config.lateral, config.yaw_rate], np.float32).T
    command = low + ((1.0 + config.margin) * (drawn[:3] - 0.5) + 0.5) * (high - low)
    if config.spot:
        turns = (drawn[3] >= config.standing) & (drawn[3] < config.standing + config.spot)
        command = command.at[:2].multiply(~turns)
    speed = jnp.abs(command[0])
    if config.lateral_until is not None:
        command = command.at[1].multiply(jnp.maximum(1.0 - speed / config.lateral_until, 0.0))
    if config.turning is not None:
        fastest = (1.0 + config.margin) * np.abs(config.yaw_rate).max()
        share = _yaw_rate(config, speed, grip) / fastest
        command = command.at[2].multiply(jnp.minimum(share, 1.0))
    command = jnp.where(drawn[3] < 1.0 - config.straight, command, command.at[1:].set(0.0))
    return jnp.where(drawn[3] < config.standing, 0.0, command)


def counted(
    config: CommandConfig, command: Command, speed: jax.Array, grip: ArrayLike
) -> jax.Array:
    """What rewards count of `command` (3,), for a robot at `speed`, m/s; `grip` as in `draw`.

    The velocity on its way there, and no more yaw rate than friction bears at the robot's speed.
    At a run, a command to stop and turn is one to brake first.
    """
    found = command.velocity
    if command.reached is not None:
        found = found.at[:2].set(command.reached)
    if config.turning is not None:
        most = _yaw_rate(config, speed, grip)
        found = found.at[2].set(jnp.clip(found[2], -most, most))
    return found


def _yaw_rate(config: CommandConfig, speed: jax.Array, grip: ArrayLike) -> jax.Array:
    """The largest yaw rate at `speed`, m/s, in rad/s; `grip` as in `draw`."""
    assert config.turning is not None
    most = (1.0 + config.margin) * jnp.minimum(config.turning, GRIP_USED * grip)
    return most / jnp.maximum(speed, 1e-6)
