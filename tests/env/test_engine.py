"""The physics that training steps, against MuJoCo C."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from quadwalk.env.actuation import gains
from quadwalk.env.config import EnvConfig
from quadwalk.env.physics import Physics, place_geoms, simulate
from quadwalk.env.quadruped import QuadrupedEnv
from quadwalk.robot.quadruped import load_quadruped

STEPS = 200


def controlled_torques(env: QuadrupedEnv) -> tuple[np.ndarray, np.ndarray]:
    """A robot in MuJoCo C stepping in place: torques applied, and the states they led through."""
    model, data = env.mj_model, mujoco.MjData(env.mj_model)
    data.qpos[:] = env.robot.home
    data.qpos[2] += 0.03  # dropped, so that contacts begin
    data.qvel[:6] = np.random.default_rng(0).uniform(-0.2, 0.2, 6)
    phase = np.pi * np.array([0, 1, 1, 0])
    torques, states = [], [np.r_[data.qpos, data.qvel]]
    for k in range(STEPS):
        lift = np.maximum(np.sin(2 * np.pi * 2.5 * k * model.opt.timestep + phase), 0.0)
        target = env.robot.home_joints.reshape(4, 3) + np.stack([0 * lift, lift, -2 * lift], 1) / 8
        torque = 80 * (target.ravel() - data.qpos[7:]) - 2 * data.qvel[6:]
        data.ctrl[:] = torque = np.clip(torque, -env.robot.effort, env.robot.effort)
        mujoco.mj_step(model, data)
        torques.append(torque)
        states.append(np.r_[data.qpos, data.qvel])
    return np.array(torques), np.array(states)


# Largest difference in the trunk's position (m), in rotation and joints (rad), in speeds (m/s and
# rad/s). Solved to the end, what differs is single precision (measured: 6e-6, 5e-5, 2e-4; in double
# precision 7e-15, 3e-14, 2e-13). Cut off after one iteration, as training does, the engines' line
# searches stop at different points of the same problem (measured: 8e-3, 7e-2, 1.7).
@pytest.mark.parametrize(
    ("iterations", "line_search", "position", "angle", "speed"),
    [(10, 20, 5e-5, 5e-4, 2e-3), (1, 5, 2e-2, 0.15, 3.0)],
    ids=["converged", "training"],
)
def test_mjx_and_mujoco_agree_for_200_steps(iterations, line_search, position, angle, speed):
    config = EnvConfig(solver_iterations=iterations, line_search_iterations=line_search)
    env = QuadrupedEnv(load_quadruped(), config)
    torques, expected = controlled_torques(env)

    def step(data: mjx.Data, torque: jax.Array) -> tuple[mjx.Data, jax.Array]:
        data = mjx.step(env.model, data.replace(ctrl=torque))
        return data, jnp.concatenate([data.qpos, data.qvel])

    start = mjx.make_data(env.model).replace(
        qpos=jnp.asarray(expected[0, :19]), qvel=jnp.asarray(expected[0, 19:])
    )
    _, found = jax.jit(lambda d, t: jax.lax.scan(step, d, t))(start, jnp.asarray(torques))
    error = np.abs(np.asarray(found) - expected[1:])
    # It must have been a test: the robot moved, and feet left and met the floor.
    assert np.ptp(expected[:, 7:19], axis=0).max() > 0.1
    assert error[:, :3].max() < position
    assert error[:, 3:19].max() < angle
    assert error[:, 19:].max() < speed


def test_a_control_step_is_its_physics_steps_one_by_one(env):
    """`simulate` carries little from step to step; MuJoCo C, which carries all, must agree."""
    config = EnvConfig()
    robot, model = env.robot, env.mj_model
    data = mujoco.MjData(model)
    data.qpos[:] = robot.home
    data.qpos[7:] += 0.1
    data.qvel[:] = np.random.default_rng(1).uniform(-1, 1, 18)
    start = Physics(*(jnp.asarray(x, jnp.float32) for x in (data.qpos, data.qvel, np.zeros(18))))
    target = robot.home_joints - 0.05
    physics, effort = jax.jit(lambda p: simulate(env.model, robot, config, p, target))(start)

    energy, mean = 0.0, np.zeros(12)
    for _ in range(config.substeps):
        qd = data.qvel[6:].copy()
        kp, kd = gains(robot, config.actuation)
        torque = kp * (target - data.qpos[7:]) - kd * qd
        line = robot.effort * np.clip(1 - np.sign(torque) * qd / robot.velocity, 0, 1)
        data.ctrl[:] = np.clip(torque, -line, line)
        data.qfrc_applied[6:] = -robot.friction * np.tanh(qd / 0.1)
        energy += np.maximum(data.ctrl * qd, 0).sum() * config.physics_dt
        mean += data.ctrl / config.substeps
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(physics.qpos, data.qpos, atol=1e-4)
    np.testing.assert_allclose(physics.qvel, data.qvel, atol=2e-2)
    np.testing.assert_allclose(effort.torque, mean, atol=2e-2)
    np.testing.assert_allclose(effort.energy, energy, rtol=1e-3)


def test_shapes_are_placed_where_mujoco_places_them(env):
    rng = np.random.default_rng(2)
    data = mujoco.MjData(env.mj_model)
    data.qpos[:] = env.robot.home + rng.uniform(-0.3, 0.3, 19)
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    mujoco.mj_kinematics(env.mj_model, data)
    position, rotation = jax.jit(lambda q: place_geoms(env.model, q))(jnp.asarray(data.qpos))
    np.testing.assert_allclose(position, data.geom_xpos, atol=1e-5)
    np.testing.assert_allclose(rotation, data.geom_xmat.reshape(-1, 3, 3), atol=1e-5)
