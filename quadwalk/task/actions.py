"""Action maps: what an action in [-1, 1] means, as joint targets for the joint controller."""

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.settings.terms import ActionMap
from quadwalk.task.reflections import JOINTS, mirrors
from quadwalk.task.robot_arrays import RobotArrays


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
    reach = np.tile([hip, thigh, calf], 4)
    return jnp.clip(robot.home_joints + reach * action, robot.lower, robot.upper)


ABOUT_HOME = ActionMap(about_home, {"hip": 0.3, "thigh": 0.9, "calf": 0.9})
