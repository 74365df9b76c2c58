"""What the policy sees."""

import jax
import jax.numpy as jnp

from quadwalk.physics.robot_arrays import RobotArrays
from quadwalk.physics.rotation import rotate, rotate_inverse, yaw
from quadwalk.task.config import EnvConfig

OFFSET_RANGE = 1.0  # m: how far from its line the robot can tell its distance to it
_XYZ = ("x", "y", "z")


def observe(
    robot: RobotArrays,
    config: EnvConfig,
    qpos: jax.Array,
    qvel: jax.Array,
    action: jax.Array,
    command: jax.Array,
) -> jax.Array:
    """The observation (n,), float32; its parts, in order, are named by `observation_names`.

    "body", (47,) or (48,): trunk velocity (body frame, m/s), angular velocity (body frame, rad/s),
    the direction of gravity (body frame, unit), heading (rad) and offset from the line y = 0 (m,
    clipped) or, in place of these two, the command (3,), joint positions from home (rad), joint
    velocities (rad/s), the last action.

    "world", (37,), the blog post's: trunk position (m), orientation (quaternion xyzw), velocity
    (world frame, m/s), angular velocity (world frame, rad/s), joint positions (rad), joint
    velocities (rad/s).
    """
    quat = qpos[3:7]
    if config.observation == "world":
        return jnp.concatenate(
            [
                qpos[:3],
                quat[jnp.array([1, 2, 3, 0])],
                qvel[:3],
                rotate(quat, qvel[3:6]),
                qpos[7:],
                qvel[6:],
            ]
        )
    line = (yaw(quat)[None], jnp.clip(qpos[1], -OFFSET_RANGE, OFFSET_RANGE)[None])
    return jnp.concatenate(
        [
            rotate_inverse(quat, qvel[:3]),
            qvel[3:6],
            rotate_inverse(quat, jnp.array([0.0, 0.0, -1.0])),
            *((command,) if config.command.given else line),
            qpos[7:] - robot.home_joints,
            qvel[6:],
            action,
        ]
    )


def observation_names(config: EnvConfig, joints: tuple[str, ...]) -> tuple[str, ...]:
    """One name for each number of the observation, of a robot with these 12 joints."""
    if config.observation == "world":
        return (
            *(f"world_position_{i}" for i in _XYZ),
            *(f"world_orientation_{i}" for i in (*_XYZ, "w")),
            *(f"world_velocity_{i}" for i in _XYZ),
            *(f"world_angular_velocity_{i}" for i in _XYZ),
            *(f"position_{name}" for name in joints),
            *(f"speed_{name}" for name in joints),
        )
    commands = ("command_forward", "command_sideways", "command_turning")
    return (
        *(f"velocity_{i}" for i in _XYZ),
        *(f"angular_velocity_{i}" for i in _XYZ),
        *(f"gravity_{i}" for i in _XYZ),
        *(commands if config.command.given else ("heading", "offset")),
        *(f"position_{name}" for name in joints),
        *(f"speed_{name}" for name in joints),
        *(f"last_action_{name}" for name in joints),
    )
