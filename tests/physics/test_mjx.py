"""The training model in MJX, and the control step of both engines, against MuJoCo C."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from quadwalk.physics import fast, mjx_engine
from quadwalk.physics.mjx_engine import Physics
from quadwalk.physics.motor import gains
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.task.config import EnvConfig
from quadwalk.task.env import QuadrupedEnv


# Largest difference in the trunk's position (m), in rotation and joints (rad), in speeds (m/s and
# rad/s). Solved to the end, what differs is single precision (measured: 6e-6, 5e-5, 2e-4; in double
# precision 7e-15, 3e-14, 2e-13). Cut off after one iteration, as training does, the engines' line
# searches stop at different points of the same problem (measured: 8e-3, 7e-2, 1.7).
@pytest.mark.parametrize(
    ("iterations", "line_search", "position", "angle", "speed"),
    [(10, 20, 5e-5, 5e-4, 2e-3), (1, 5, 2e-2, 0.15, 3.0)],
    ids=["converged", "training"],
)
def test_mjx_and_mujoco_agree_for_200_steps(
    stepping_in_place, iterations, line_search, position, angle, speed
):
    config = EnvConfig(solver_iterations=iterations, line_search_iterations=line_search)
    env = QuadrupedEnv(load_quadruped(), config)
    torques, expected = stepping_in_place(env)

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


@pytest.mark.parametrize(
    ("engine", "contacts"), [("ours", "feet"), ("mjx", "feet"), ("mjx", "body")]
)
def test_a_control_step_is_its_physics_steps_one_by_one(env, engine, contacts):
    """`simulate` carries little from step to step; MuJoCo C, which carries all, must agree."""
    # Solved to the end.
    config = EnvConfig(solver_iterations=8, line_search_iterations=10, contacts=contacts)
    env = QuadrupedEnv(env.quadruped, config)
    robot, model = env.robot, env.quadruped.training_model(config.physics_dt, 100, 50, contacts)
    target = robot.home_joints - 0.05
    data = mujoco.MjData(model)
    data.qpos[:] = robot.home
    data.qpos[7:] += 0.1
    if contacts == "body":  # on its belly, its front knees, and its hind feet
        data.qpos[2] = 0.055
        data.qpos[7:] = np.repeat([[0.0, -1.43, -2.7], [0.0, 2.5, -2.75]], 2, axis=0).flat
    data.qvel[:] = np.random.default_rng(1).uniform(-1, 1, 18)
    start = Physics(*(jnp.asarray(x, jnp.float32) for x in (data.qpos, data.qvel, np.zeros(18))))
    simulate = {
        "ours": lambda p: fast.simulate(env.legged, robot, config, p, target),
        "mjx": lambda p: mjx_engine.simulate(env.model, robot, config, p, target),
    }[engine]
    after, effort = jax.jit(simulate)(start)

    energy, mean, touched = 0.0, np.zeros(12), set()
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
        touched |= set(data.contact.geom.flat)
    assert all(touched & set(spheres) for spheres in robot.contact_geoms)
    np.testing.assert_allclose(after.qpos, data.qpos, atol=1e-4)
    np.testing.assert_allclose(after.qvel, data.qvel, atol=2e-2)
    np.testing.assert_allclose(effort.torque, mean, atol=2e-2)
    np.testing.assert_allclose(effort.energy, energy, rtol=1e-3)
