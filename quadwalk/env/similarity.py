"""A robot as one of a standard size, so that the same numbers mean the same to all bodies.

With legs f times as long at the same Froude number, lengths are f times as long and times sqrt(f)
times; gravity, and forces over weight, stay (Alexander and Jayes 1983). Joints are standard joints
(`RobotConstants.to_standard`): what they do to the foot counts, not which way they turn.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.state import EnvState, RobotConstants, Scalar, Step, Strides
from quadwalk.physics.motor import PhysicsState

MASS = 20.0  # kg, of a robot of standard size; it is the unit of what is added to the trunk
_PLACE = np.r_[np.ones(3), np.zeros(16)]  # of a pose, what is a length


def resize_robot(robot: RobotConstants, leg: float) -> RobotConstants:
    """Return the constants of a robot that stands on legs of `leg`, m."""
    factor = leg / robot.leg
    home = robot.home * (1.0 + _PLACE * (factor - 1.0))
    return replace(robot, home=home, standard_leg=leg)


def resize_state(robot: RobotConstants, state: EnvState, leg: float) -> EnvState:
    """Return the state of `robot` as one of `resize_robot(robot, leg)`.

    Its `frames` stay: they are observations, which are of that size already.
    """
    factor = leg / robot.leg
    faster = factor**0.5
    velocity = state.qvel[3:] / faster
    joints = robot.to_standard(velocity[3:])
    qvel = jnp.concatenate([state.qvel[:3] * faster, velocity[:3], joints])
    command = state.command
    if command is not None:
        command = command._replace(
            velocity=_resize_command(command.velocity, faster),
            reached=None if command.reached is None else command.reached * faster,
        )
    conditions = state.conditions
    if conditions is not None:
        variation = conditions.variation
        if variation is not None:
            variation = variation._replace(
                trunk_mass=variation.trunk_mass * (MASS / robot.mass),
                trunk_center=variation.trunk_center * factor,
            )
        conditions = conditions._replace(variation=variation, push=conditions.push * faster)
    return state._replace(
        physics=PhysicsState(_resize_pose(robot, state.qpos, factor), qvel),
        command=command,
        conditions=conditions,
        strides=_resize_strides(state.strides, factor),
    )


def resize_step(robot: RobotConstants, step: Step, leg: float) -> Step:
    """Return a control step of `robot` as one of `resize_robot(robot, leg)`."""
    factor = leg / robot.leg
    faster = factor**0.5
    joints = robot.to_standard(step.qvel[6:]) / faster
    return step._replace(
        dt=step.dt * faster,
        start=_resize_pose(robot, step.start, factor),
        qpos=_resize_pose(robot, step.qpos, factor),
        qvel=jnp.concatenate([step.qvel[:3] * faster, step.qvel[3:6] / faster, joints]),
        power=step.power * faster,
        command=_resize_command(step.command, faster),
        start_soles=step.start_soles * factor,
        soles=step.soles * factor,
        lowest=step.lowest * factor,
        ground=None if step.ground is None else step.ground * factor,
        strides=_resize_strides(step.strides, factor),
    )


def _resize_pose(robot: RobotConstants, qpos: jax.Array, factor: Scalar) -> jax.Array:
    """Return the pose (19,), lengths by `factor`, with standard joints about the home pose."""
    joints = robot.home_joints + robot.to_standard(qpos[7:] - robot.home_joints)
    return jnp.concatenate([qpos[:3] * factor, qpos[3:7], joints])


def _resize_strides(strides: Strides | None, factor: Scalar) -> Strides | None:
    """Return strides, lengths by `factor` and times by its root."""
    if strides is None:
        return None
    faster = factor**0.5
    return Strides(strides.time * faster, strides.peak * factor, strides.yaw_rate_error / faster)


def _resize_command(command: jax.Array, faster: Scalar) -> jax.Array:
    """Return a velocity command (3,) with velocities `faster` times as large."""
    return jnp.concatenate([command[:2] * faster, command[2:] / faster])
