"""Terminations: how an episode ends by a fall, each a pure function of one control step.

To add one, write such a function, here or in a file of your own, and name it in a task:
`"tipped": Termination(tipped, {"angle": 1.0})`.
"""

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.settings.terms import Termination
from quadwalk.task.robot_arrays import RobotArrays
from quadwalk.task.state import Step


def tipped(robot: RobotArrays, step: Step, *, angle: float) -> jax.Array:
    """The trunk's z axis is more than `angle`, rad, from the world's."""
    _, x, y, _ = step.qpos[3:7]
    upright = 1.0 - 2.0 * (x * x + y * y)  # cosine of that angle
    return upright < np.cos(angle)


def low(robot: RobotArrays, step: Step, *, share: float) -> jax.Array:
    """The trunk's origin is lower above ground than `share` of its height in the home pose."""
    return step.height < share * robot.home_height


def touched(robot: RobotArrays, step: Step, *, clearance: float) -> jax.Array:
    """A part other than a foot is lower than `clearance`, m, above the ground."""
    return jnp.min(step.lowest) < clearance


def trunk_touched(robot: RobotArrays, step: Step, *, clearance: float) -> jax.Array:
    """The trunk is lower than `clearance`, m, above the ground; knees and shins may touch."""
    return step.lowest[0] < clearance


FALLS = {
    "tipped": Termination(tipped, {"angle": 1.0}),
    "low": Termination(low, {"share": 0.45}),
    "touched": Termination(touched, {"clearance": 0.0}),
}
# On uneven ground knees and shins may touch: at the edge of a stair they are bound to.
TRUNK_FALLS = {
    "tipped": FALLS["tipped"],
    "low": Termination(low, {"share": 0.35}),
    "trunk_touched": Termination(trunk_touched, {"clearance": 0.0}),
}


def terminations(ways: dict[str, Termination], robot: RobotArrays, step: Step) -> jax.Array:
    """Whether each of the ways to fall holds, (n,) bool."""
    holds = [way.value(f"termination {name!r}", robot, step) for name, way in ways.items()]
    return jnp.stack([jnp.zeros((), bool), *holds])[1:]
