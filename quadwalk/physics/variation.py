"""How one robot differs from another of its kind, and its floor from another floor."""

from typing import NamedTuple, TypeAlias

import jax
import numpy as np

from quadwalk.physics.motor import Motor

Numbers: TypeAlias = jax.Array | np.ndarray


class Variation(NamedTuple):
    """What a robot's constants are changed to, or by; numbers, or as given.

    The constraint solver's estimate of inverse inertia (MuJoCo's invweight0), which sets how soft
    contacts are, stays that of the unchanged robot.
    """

    friction: Numbers  # sliding friction of floor and robot
    trunk_mass: Numbers  # kg, added to the trunk in its centre of mass
    trunk_centre: Numbers  # (3,) m, by which that centre is shifted, trunk frame
    link_mass: Numbers  # (12,) factors of the legs' masses and inertias, in the joints' order
    strength: Numbers  # factor of the motors' torque
    kp: Numbers  # factor of the joint controller's position gain
    kd: Numbers  # factor of its velocity gain
    joint_friction: Numbers  # factor
    damping: Numbers  # factor
    armature: Numbers  # factor


def vary_motor(motor: Motor, variation: Variation) -> Motor:
    """`motor` of a robot that differs by `variation`."""
    friction = motor.friction
    return motor._replace(
        kp=motor.kp * variation.kp,
        kd=motor.kd * variation.kd,
        strength=motor.strength * variation.strength,
        friction=None if friction is None else friction * variation.joint_friction,
    )
