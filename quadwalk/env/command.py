"""The velocity command of an episode, and when it changes."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from quadwalk.env.state import Command
from quadwalk.settings.environment import CommandConfig, is_on

# Folded into the key of an episode's start, for the keys of its commands.
_COMMANDS = 0x636D64
# Share of the acceleration that friction can give which a turn may need.
GRIP_USED = 0.5
# Slow commands are this share of one drawn as the others.
SLOW_FACTOR = 0.2


def start_command(
    config: CommandConfig,
    key: jax.Array,
    dt: float,
    grip: ArrayLike = np.inf,
    scale: Any = None,
) -> Command:
    """Return the first command of an episode that starts with `key`, with control steps of `dt` s.

    `grip` and `scale` are those of `sample_velocity`.
    """
    key = jax.random.fold_in(key, _COMMANDS)
    until = None if config.soonest is None else _sample_hold(config, key, dt)
    reached = None if config.acceleration is None else jnp.zeros(2)
    return Command(sample_velocity(config, key, grip, scale), key, until, reached)


def advance_command(
    config: CommandConfig,
    command: Command,
    steps: jax.Array,
    dt: float,
    grip: ArrayLike = np.inf,
    scale: Any = None,
) -> Command:
    """Return the command after `steps` control steps of an episode, of `dt` s each."""
    key = jax.random.fold_in(command.key, steps)
    velocity = sample_velocity(config, key, grip, scale)
    if command.reached is not None:
        assert config.acceleration is not None
        way = command.velocity[:2] - command.reached
        share = config.acceleration * dt / jnp.maximum(jnp.linalg.norm(way), 1e-6)
        command = command._replace(reached=command.reached + jnp.minimum(share, 1.0) * way)
    if command.until is None:
        is_due = steps % max(round(config.seconds / dt), 1) == 0
    else:
        is_due = steps >= command.until
        until = jnp.where(is_due, steps + _sample_hold(config, key, dt), command.until)
        command = command._replace(until=until)
    return command._replace(velocity=jnp.where(is_due, velocity, command.velocity))


def _sample_hold(config: CommandConfig, key: jax.Array, dt: float) -> jax.Array:
    """Return the control steps () int32 that a command holds."""
    assert config.soonest is not None
    low, high = (max(round(seconds / dt), 1) for seconds in (config.soonest, config.seconds))
    return jax.random.randint(jax.random.fold_in(key, 1), (), low, high + 1)


def sample_velocity(
    config: CommandConfig, key: jax.Array, grip: ArrayLike = np.inf, scale: Any = None
) -> jax.Array:
    """Return a command (3,), uniform in ranges widened by the margin, then limited by friction.

    For `config.standing` of all keys it is zero, for `config.straight` of them forward alone, for
    `config.spot` to turn on the spot, for `config.slow` a fifth of what is drawn. It is zero too
    where it is below `config.still`. `grip`, m/s^2, is the acceleration that friction can give.
    `scale` (3,) are factors for another body, see `CommandConfig.compute_scale`; None: there is
    none.
    """
    shares = jax.random.uniform(key, (4,))
    low, high = _to_array([config.forward, config.lateral, config.yaw_rate]).T
    command = low + ((1.0 + config.margin) * (shares[:3] - 0.5) + 0.5) * (high - low)
    if is_on(config.spot):
        turns = (shares[3] >= config.standing) & (shares[3] < config.standing + config.spot)
        command = command.at[:2].multiply(~turns)
    speed = jnp.abs(command[0])
    if config.lateral_until is not None:
        command = command.at[1].multiply(jnp.maximum(1.0 - speed / config.lateral_until, 0.0))
    if config.turning is not None:
        fastest = (1.0 + config.margin) * abs(_to_array(config.yaw_rate, float)).max()
        share = _compute_max_yaw_rate(config, speed, grip) / fastest
        command = command.at[2].multiply(jnp.minimum(share, 1.0))
    command = jnp.where(shares[3] < 1.0 - config.straight, command, command.at[1:].set(0.0))
    if is_on(config.slow):
        last = 1.0 - config.straight
        is_slow = (shares[3] >= last - config.slow) & (shares[3] < last)
        command = jnp.where(is_slow, SLOW_FACTOR * command, command)
    if is_on(config.still):
        fastest = jnp.maximum(jnp.linalg.norm(command[:2]), jnp.abs(command[2]))
        command = jnp.where(fastest < config.still, 0.0, command)
    command = jnp.where(shares[3] < config.standing, 0.0, command)
    return command if scale is None else scale * command


def _to_array(numbers: Any, dtype: Any = np.float32) -> Any:
    """Return numbers as an array: of JAX where some are arguments of a program, else of NumPy."""
    is_argument = any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(numbers))
    return jnp.array(numbers) if is_argument else np.array(numbers, dtype)


def compute_target_velocity(
    config: CommandConfig, command: Command, speed: jax.Array, grip: ArrayLike
) -> jax.Array:
    """Return the velocity (3,) that rewards compare a robot at `speed`, m/s, with.

    It is the velocity on its way to the command, with no more yaw rate than friction allows at the
    robot's speed: at a run, a command to stop and turn is one to brake first. `grip` is that of
    `sample_velocity`.
    """
    velocity = command.velocity
    if command.reached is not None:
        velocity = velocity.at[:2].set(command.reached)
    if config.turning is not None:
        fastest = _compute_max_yaw_rate(config, speed, grip)
        velocity = velocity.at[2].set(jnp.clip(velocity[2], -fastest, fastest))
    return velocity


def _compute_max_yaw_rate(config: CommandConfig, speed: jax.Array, grip: ArrayLike) -> jax.Array:
    """Return the largest yaw rate at `speed`, m/s, in rad/s."""
    assert config.turning is not None
    acceleration = (1.0 + config.margin) * jnp.minimum(config.turning, GRIP_USED * grip)
    return acceleration / jnp.maximum(speed, 1e-6)
