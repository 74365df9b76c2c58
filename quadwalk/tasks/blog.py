"""blog: run ahead as in the blog post that this project started from, in PyBullet.

1000 control steps of one physics step each, from the same start, rewarded for the way made along
x. Its action map, observations, rewards and terminations are its own and stand here.
"""

import math
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env import observations
from quadwalk.env.reflections import AXIAL, JOINTS, SCALAR, VECTOR, mirrors
from quadwalk.env.state import EnvState, RobotConstants, Step
from quadwalk.physics.motor import MotorConfig
from quadwalk.physics.rotation import rotate
from quadwalk.robot.mirror import Mirror, RobotMirror
from quadwalk.settings.environment import NO_COMMAND, NO_RANDOMIZATION, EnvConfig, ResetConfig
from quadwalk.settings.terms import ActionMap, Observation, Reward, Termination
from quadwalk.settings.training import PPO, TrainConfig

# Joint targets at action -1 and 1, rad.
BOUNDS = {
    "hip_low": -1.2217,
    "hip_high": 1.2217,
    "thigh_low": -1.0,
    "thigh_high": 1.0,
    "calf_low": -2.77507,
    "calf_high": -0.645772,
}


def _between_bounds_mirrored(robot: RobotMirror, params: dict[str, Any]) -> Mirror | None:
    """Where a joint turns the other way, bounds that are not one another's opposite do not fit."""
    middles = [params[f"{part}_low"] + params[f"{part}_high"] for part in ("hip", "thigh", "calf")]
    fits = (robot.joints.sign > 0) | (np.abs(np.tile(middles, 4)) < 1e-6)
    return robot.joints if fits.all() else None


@mirrors(_between_bounds_mirrored)
def between_bounds(
    robot: RobotConstants,
    action: jax.Array,
    joints: jax.Array,
    *,
    hip_low: float,
    hip_high: float,
    thigh_low: float,
    thigh_high: float,
    calf_low: float,
    calf_high: float,
    step_limit: float,
) -> jax.Array:
    """Targets (12,), rad: actions -1 to 1 go from the low to the high bound of each kind of joint.

    Each is at most `step_limit`, rad, from the joint's present angle in `joints` (12,).
    """
    lower = np.tile([hip_low, thigh_low, calf_low], 4)
    upper = np.tile([hip_high, thigh_high, calf_high], 4)
    target = lower + (action + 1.0) / 2.0 * (upper - lower)
    return jnp.clip(target, joints - step_limit, joints + step_limit)


@mirrors(VECTOR)
def world_position(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Position of the trunk (3,), m."""
    return state.qpos[:3]


@mirrors(AXIAL, SCALAR)
def world_orientation(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Orientation of the trunk (4,), a quaternion xyzw."""
    return state.qpos[3:7][jnp.array([1, 2, 3, 0])]


@mirrors(VECTOR)
def world_velocity(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Linear velocity of the trunk (3,), world frame, m/s."""
    return state.qvel[:3]


@mirrors(AXIAL)
def world_angular_velocity(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Angular velocity of the trunk (3,), world frame, rad/s."""
    return rotate(state.qpos[3:7], state.qvel[3:6])


@mirrors(JOINTS)
def joint_angles(robot: RobotConstants, state: EnvState) -> jax.Array:
    """Joint angles (12,), rad."""
    return state.qpos[7:]


def compute_euler_angles(quat: jax.Array) -> jax.Array:
    """Return roll, pitch and yaw (3,), rad, of `quat` (4,), wxyz, Rz(yaw) Ry(pitch) Rx(roll).

    They are those of PyBullet's getEulerFromQuaternion, with pitch from -pi/2 to pi/2. Within 0.26
    degrees of either end only roll and yaw together are determined: roll is 0 and yaw within 2 pi.
    """
    w, x, y, z = quat
    sine = 2.0 * (w * y - x * z)
    general = jnp.stack(
        [
            jnp.arctan2(2.0 * (y * z + w * x), w * w - x * x - y * y + z * z),
            jnp.arcsin(jnp.clip(sine, -1.0, 1.0)),
            jnp.arctan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z),
        ]
    )
    up = jnp.sign(sine)
    vertical = jnp.stack([0.0 * w, up * (jnp.pi / 2), 2.0 * jnp.arctan2(-up * x, up * y)])
    return jnp.where(jnp.abs(sine) < 0.99999, general, vertical)


def progress(robot: RobotConstants, step: Step) -> jax.Array:
    """Distance along world x in the step, m."""
    return step.qpos[0] - step.start[0]


def inclined(robot: RobotConstants, step: Step) -> jax.Array:
    """1 while roll or pitch is beyond 45 degrees."""
    roll_and_pitch = compute_euler_angles(step.qpos[3:7])[:2]
    return (jnp.max(jnp.abs(roll_and_pitch)) > jnp.pi / 4).astype(jnp.float32)


def heading(robot: RobotConstants, step: Step) -> jax.Array:
    """Size of the angle between the heading and world x, rad, from 0 to pi."""
    return jnp.abs(compute_euler_angles(step.qpos[3:7])[2])


def movement(robot: RobotConstants, step: Step) -> jax.Array:
    """Sum over all joints of how far each moved in the step, rad.

    In the first step of an episode it counts from the pose of the reset. The post's own code counts
    from the joints' last pose of the episode before.
    """
    return jnp.sum(jnp.abs(step.qpos[7:] - step.start[7:]))


def rolled_or_pitched(robot: RobotConstants, step: Step, *, angle: float) -> jax.Array:
    """Roll or pitch is beyond `angle`, rad."""
    return jnp.max(jnp.abs(compute_euler_angles(step.qpos[3:7])[:2])) > angle


def below(robot: RobotConstants, step: Step, *, height: float) -> jax.Array:
    """The trunk's origin is lower than `height`, m."""
    return step.qpos[2] < height


TASK = TrainConfig(
    task="blog",
    suite="course",
    steps=10_000_000,
    checkpoint_steps=1_000_000,
    envs=1024,
    env=EnvConfig(
        engine="fast",
        gravity=9.8,
        physics_dt=1.0 / 240.0,
        substeps=1,
        solver_iterations=4,
        line_search_iterations=1,
        contacts="body",
        episode_seconds=1000.0 / 240.0,
        # PyBullet's position control gives a joint, within one of its steps of 1/240 s, the speed
        # that takes it a tenth of the way to its target in a step, 24/s times the error, with all
        # the torque that this takes up to a limit. Gains kp = 24 kd draw a joint to the same
        # speed, and the closer the larger kd is. What remains of a difference: under a load that
        # PyBullet's joint does not notice, this one is slower by load / kd and comes to rest
        # load / kp off its target. kd is the largest whole one that is stable: on random targets
        # and without a limit of torque the joints' speeds are bounded up to kd 6.5, and no longer
        # at 7.5. By the inertia that a joint of the AlienGo has with its legs in the air, 6.9 is
        # the end.
        motor=MotorConfig(kp=144.0, kd=6.0, effort=44.4, speed_limit=False, joint_friction=False),
        action=ActionMap(between_bounds, {**BOUNDS, "step_limit": 0.5}),
        observation={
            "world_position": Observation(world_position, noise=0.05),
            # A quaternion's parts change by half an angle.
            "world_orientation": Observation(
                world_orientation, labels=("x", "y", "z", "w"), noise=0.025
            ),
            "world_velocity": Observation(world_velocity, noise=0.1),
            "world_angular_velocity": Observation(world_angular_velocity, noise=0.2),
            "joint_pos": Observation(joint_angles, noise=0.01),
            "joint_vel": Observation(observations.joint_velocities, noise=1.5),
        },
        critic={},
        reward={
            "progress": Reward(progress, scale=50.0),
            "inclined": Reward(inclined, scale=-10.0),
            "heading": Reward(heading, scale=-0.01),
            "movement": Reward(movement, scale=-0.01),
        },
        termination={
            "tipped": Termination(rolled_or_pitched, {"angle": math.pi / 2}),
            "low": Termination(below, {"height": 0.05}),
        },
        reset=ResetConfig(
            pose=(0.0, math.pi / 4, -math.pi / 2),
            height=0.4,
            yaw=0.0,
            tilt=0.0,
            offset=0.0,
            joints=0.0,
            velocity=0.0,
            joint_velocity=0.0,
            forward=0.0,
        ),
        command=NO_COMMAND,
        randomization=NO_RANDOMIZATION,
    ),
    # At 240 steps a second what an action brings shows many steps later.
    ppo=replace(PPO, unroll=32, discount=0.99, gae_lambda=0.98, entropy=0.0, final_entropy=0.0),
)
