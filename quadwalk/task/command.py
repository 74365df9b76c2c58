"""The velocity that the robot is told to have."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.task.config import CommandConfig

# Folded into the key of an episode's start, for the keys of its commands.
_COMMANDS = 0x636D64


class Command(NamedTuple):
    """What one episode is told."""

    # (3,) m/s forward and to the left, in the frame of the heading; rad/s of turning to the left
    velocity: jax.Array
    key: jax.Array  # of all commands of the episode


def first_command(config: CommandConfig, key: jax.Array) -> Command:
    """What an episode begun with `key` is told first."""
    own = jax.random.fold_in(key, _COMMANDS)
    return Command(draw(config, own), own)


def next_command(config: CommandConfig, before: Command, steps: jax.Array, period: int) -> Command:
    """The command after `steps` control steps of an episode: a new one every `period` steps."""
    new = draw(config, jax.random.fold_in(before.key, steps))
    return before._replace(velocity=jnp.where(steps % period == 0, new, before.velocity))


def draw(config: CommandConfig, key: jax.Array) -> jax.Array:
    """A command (3,): uniform in its ranges, or, for `config.standing` of all keys, zero."""
    drawn = jax.random.uniform(key, (4,))
    low, high = np.array([config.forward, config.sideways, config.turning], np.float32).T
    return jnp.where(drawn[3] < config.standing, 0.0, low + drawn[:3] * (high - low))


def velocity_of(command: Command | None) -> jax.Array:
    """The velocity commanded (3,), zero where nothing is."""
    return jnp.zeros(3) if command is None else command.velocity
