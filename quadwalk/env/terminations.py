"""Terminations: how an episode ends by a fall, each a pure function of one control step.

To add one, write such a function, in a file of your own or here, and name it in a task. One here
needs a name in `quadwalk/settings/registry.py`.
`"tipped": Termination(tipped, {"angle": 1.0})`.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.state import EnvState, RobotConstants, Step
from quadwalk.settings.environment import EnvConfig
from quadwalk.settings.terms import Termination
from quadwalk.terrain.terrain import Terrain

RUNNING, TIME_LIMIT, FIRST_FALL = 0, 1, 2  # places in `list_ends`


def tipped(robot: RobotConstants, step: Step, *, angle: float) -> jax.Array:
    """The trunk's z axis is more than `angle`, rad, from the world's."""
    _, x, y, _ = step.qpos[3:7]
    upright = 1.0 - 2.0 * (x * x + y * y)  # cosine of that angle
    return upright < (jnp.cos(angle) if isinstance(angle, jax.Array) else np.cos(angle))


def low(robot: RobotConstants, step: Step, *, share: float) -> jax.Array:
    """The trunk's origin is lower above ground than `share` of its height in the home pose."""
    return step.height < share * robot.home_height


def touched(robot: RobotConstants, step: Step, *, clearance: float) -> jax.Array:
    """A part other than a foot is lower than `clearance`, m, above the ground."""
    return jnp.min(step.lowest) < clearance


def trunk_touched(robot: RobotConstants, step: Step, *, clearance: float) -> jax.Array:
    """The trunk is lower than `clearance`, m, above the ground; knees and shins may touch."""
    return step.lowest[0] < clearance


FALLS = {
    "tipped": Termination(tipped, {"angle": 1.0}),
    "low": Termination(low, {"share": 0.45}),
    "touched": Termination(touched, {"clearance": 0.0}),
}
# On uneven ground knees and shins may touch: at the edge of a stair they must.
TRUNK_FALLS = {
    "tipped": FALLS["tipped"],
    "low": Termination(low, {"share": 0.35}),
    "trunk_touched": Termination(trunk_touched, {"clearance": 0.0}),
}


def find_falls(terms: dict[str, Termination], robot: RobotConstants, step: Step) -> jax.Array:
    """Return which of the terminations hold, (n,) bool."""
    holds = [term.compute(f"termination {name!r}", robot, step) for name, term in terms.items()]
    return jnp.stack([jnp.zeros((), bool), *holds])[1:]


def list_ends(terms: dict[str, Termination]) -> tuple[str, ...]:
    """Return the names of an episode's ends, in the order of `find_end`'s numbers."""
    return ("running", "time limit", *terms, "nan")


def find_end(
    config: EnvConfig, terrain: Terrain | None, state: EnvState, falls: jax.Array, sane: jax.Array
) -> jax.Array:
    """Return how the episode ended in the step to `state`, () int32, a place in `list_ends`.

    `falls` are those of `find_falls`; numbers that are not `sane`, () bool, come before all.
    """
    end = jnp.where(state.steps >= config.episode_steps, TIME_LIMIT, RUNNING)
    if terrain is not None:  # no failure either
        end = jnp.where(is_off_ground(config, terrain, state), TIME_LIMIT, end)
    if config.termination:
        end = jnp.where(jnp.any(falls) & sane, FIRST_FALL + jnp.argmax(falls), end)
    last = len(list_ends(config.termination)) - 1
    return jnp.where(sane, end, last).astype(jnp.int32)


def is_off_ground(config: EnvConfig, terrain: Terrain, state: EnvState) -> jax.Array:
    """Return True, () bool, where the trunk is off the ground of its episode.

    That is beyond half of the level border around all tiles or, if confined, beyond its own tile.
    """
    field, edge = terrain.field, config.ground.border / 2
    low: Any = np.array(field.origin) + edge
    high: Any = low + np.array(field.size) - 2 * edge
    if config.ground.confined:
        tiles = terrain.tiles
        middle = jnp.asarray([tile.middle for tile in tiles], jnp.float32)[state.tile]
        half = np.array(tiles[0].size) / 2
        low, high = middle - half, middle + half
    return jnp.any((state.qpos[:2] < low) | (state.qpos[:2] > high))
