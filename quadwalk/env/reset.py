"""Fresh, varied starts."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from quadwalk.env.robot_arrays import RobotArrays
from quadwalk.physics.fast import compute_lowest_points
from quadwalk.physics.model import Model
from quadwalk.physics.motor import PhysicsState
from quadwalk.physics.rotation import from_euler
from quadwalk.robot.quadruped import Quadruped
from quadwalk.robot.scene import find_lowest_point
from quadwalk.settings.environment import ResetConfig
from quadwalk.terrain.terrain import Terrain


def fresh_start(robot: RobotArrays, config: ResetConfig, key: jax.Array) -> PhysicsState:
    """A start near the home pose or `config.pose`, with the lowest foot just on the floor.

    Tumbled, it is in any orientation, with the lowest part just on the floor.
    """
    drawn = jax.random.uniform(key, (35,), minval=-1.0, maxval=1.0)
    pose, joints, velocity, speed = jnp.split(drawn, [4, 16, 22])

    qpos = jnp.asarray(robot.home, jnp.float32)
    qpos = qpos.at[1].set(config.offset * pose[0])
    quat = from_euler(config.tilt * pose[1], config.tilt * pose[2], config.yaw * pose[3])
    if config.tumbled:
        quat = jax.random.normal(jax.random.fold_in(key, 3), (4,))  # none of `QuadrupedEnv.reset`'s
        quat = quat / jnp.linalg.norm(quat)
    qpos = qpos.at[3:7].set(quat)
    middle = robot.home_joints if config.pose is None else np.tile(config.pose, 4)
    angles = jnp.clip(middle + config.joints * joints, robot.lower, robot.upper)
    qpos = qpos.at[7:].set(angles)
    if config.height is None:
        lowest = _lowest(robot.geometry, qpos, feet=not config.tumbled)
        qpos = qpos.at[2].add(-lowest)
    else:
        qpos = qpos.at[2].set(config.height)

    qvel = jnp.zeros(18).at[:6].set(config.velocity * velocity)
    qvel = qvel.at[0].add(config.forward * (speed[12] + 1.0) / 2.0)
    qvel = qvel.at[6:].set(config.joint_velocity * speed[:12])
    return PhysicsState(qpos, qvel)


def nominal_start(model: mujoco.MjModel, quadruped: Quadruped, config: ResetConfig) -> np.ndarray:
    """qpos (19,) of a start without its random part: the pose that all are drawn around.

    `model` is one of the quadruped. By MuJoCo, so that nothing has to be compiled.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    if config.pose is not None:
        data.qpos[7:] = np.clip(np.tile(config.pose, 4), quadruped.lower, quadruped.upper)
    mujoco.mj_kinematics(model, data)
    lowest = min(find_lowest_point(model, data, model.geom(name).id) for name in quadruped.feet)
    data.qpos[2] = data.qpos[2] - lowest if config.height is None else config.height
    return data.qpos.copy()


def on_tile(
    model: Model, terrain: Terrain, start: PhysicsState, tile: jax.Array, key: jax.Array
) -> PhysicsState:
    """A start from the flat floor, somewhere where episodes of tile `tile` () int32 start.

    As high above the ground as it was above the floor, by the lowest part of the robot.
    """
    starts, spreads = (
        jnp.asarray([getattr(place, name) for place in terrain.tiles], jnp.float32)
        for name in ("start", "spread")
    )
    place = starts[tile] + spreads[tile] * jax.random.uniform(key, (2,), minval=-1.0, maxval=1.0)
    level = model._replace(ground=None)
    qpos = start.qpos.at[:2].add(place)
    raised = _lowest(level, start.qpos) - _lowest(model, qpos)
    return start._replace(qpos=qpos.at[2].add(raised))


def _lowest(model: Model, qpos: jax.Array, feet: bool = False) -> jax.Array:
    """How far the robot's lowest part, or lowest foot, is above the ground, m."""
    soles, others = compute_lowest_points(model, qpos)
    lowest = jnp.min(soles[:, 2])
    return lowest if feet else jnp.minimum(lowest, jnp.min(others))
