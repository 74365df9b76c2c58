"""Action maps: what an action in [-1, 1] means, as joint targets for the joint controller."""

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.reflections import JOINTS, mirrors
from quadwalk.env.robot_arrays import RobotArrays
from quadwalk.settings.terms import ActionMap


@mirrors(JOINTS)
def about_home(
    robot: RobotArrays,
    action: jax.Array,
    joints: jax.Array,
    *,
    hip: float,
    thigh: float,
    calf: float,
) -> jax.Array:
    """Targets (12,), rad, about the home pose and within the joints' limits.

    Action 1 moves a hip's target by `hip`, a thigh's by `thigh`, a calf's by `calf`, rad.
    """
    return _about_home(robot, action, np.tile([hip, thigh, calf], 4))


@mirrors(JOINTS)
def feet_alike(
    robot: RobotArrays,
    action: jax.Array,
    joints: jax.Array,
    *,
    hip: float,
    thigh: float,
    calf: float,
) -> jax.Array:
    """`about_home`, with a thigh's reach more by the calf's where the knee is ahead.

    Of two legs whose knees point either way and whose feet are alike, the thighs' angles differ by
    the calf's. So one's foot goes wherever the other's does.
    """
    reach = np.tile([hip, thigh, calf], (4, 1))
    reach[robot.knees_ahead, 1] += calf
    return _about_home(robot, action, reach.ravel())


def _about_home(robot: RobotArrays, action: jax.Array, reach: np.ndarray) -> jax.Array:
    return jnp.clip(robot.home_joints + reach * action, robot.lower, robot.upper)


ABOUT_HOME = ActionMap(about_home, {"hip": 0.3, "thigh": 0.9, "calf": 0.9})
