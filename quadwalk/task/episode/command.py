"""The velocity command: what an episode is told, and when it changes."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.settings.environment import CommandConfig

# Folded into the key of an episode's start, for the keys of its commands.
_COMMANDS = 0x636D64


class Command(NamedTuple):
    """The velocity command of one episode."""

    velocity: jax.Array  # (3,) forward and lateral m/s, in the frame of the heading; yaw rate rad/s
    key: jax.Array  # of all commands of the episode


def first_command(config: CommandConfig, key: jax.Array) -> Command:
    """The first command of an episode begun with `key`."""
    own = jax.random.fold_in(key, _COMMANDS)
    return Command(draw(config, own), own)


def next_command(config: CommandConfig, before: Command, steps: jax.Array, period: int) -> Command:
    """The command after `steps` control steps of an episode: a new one every `period` steps."""
    new = draw(config, jax.random.fold_in(before.key, steps))
    return before._replace(velocity=jnp.where(steps % period == 0, new, before.velocity))


def draw(config: CommandConfig, key: jax.Array) -> jax.Array:
    """A command (3,): uniform in its ranges.

    For `config.standing` of all keys it is zero, for `config.straight` of them forward alone.
    """
    drawn = jax.random.uniform(key, (4,))
    low, high = np.array([config.forward, config.lateral, config.yaw_rate], np.float32).T
    command = low + drawn[:3] * (high - low)
    command = jnp.where(drawn[3] < 1.0 - config.straight, command, command.at[1:].set(0.0))
    return jnp.where(drawn[3] < config.standing, 0.0, command)
