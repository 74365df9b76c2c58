"""Training's own physics against MuJoCo C, the same problem solved by other code."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from quadwalk.env.batches import BATCH, robots_last
from quadwalk.env.config import EnvConfig
from quadwalk.env.legged import legged
from quadwalk.env.legged_physics import acceleration, heights, integrate, simulate, soles
from quadwalk.env.physics import Physics
from quadwalk.env.robot import robot_arrays
from quadwalk.robot.home import lowest_point
from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.robot.validate import UrdfError

STATES = 40


def random_states(quadruped, model, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """qpos, qvel and joint torques of robots in the air, on their feet, and bent past limits."""
    qpos = np.tile(quadruped.home, (STATES, 1))
    qpos[:, 2] *= rng.uniform(0.8, 1.3, STATES)
    qpos[:, 3:7] += 0.15 * rng.normal(size=(STATES, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    qpos[:, 7:] += 0.5 * rng.normal(size=(STATES, 12))
    return qpos, rng.normal(size=(STATES, 18)), 10 * rng.normal(size=(STATES, 12))


def check_accelerations(quadruped) -> None:
    """In double precision, solved to the end: the same accelerations."""
    model = quadruped.training_model(0.004, iterations=100, ls_iterations=50)
    model.opt.tolerance = 1e-14
    qpos, qvel, torque = random_states(quadruped, model, np.random.default_rng(0))
    data = mujoco.MjData(model)
    expected, rows = [], []
    for q, v, t in zip(qpos, qvel, torque, strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, 0
        data.qfrc_applied[6:] = t
        mujoco.mj_forward(model, data)
        expected.append(data.qacc.copy())
        rows.append(data.nefc)
    assert min(rows) == 0 or np.ptp(rows) > 8  # from few constraints to many
    with jax.enable_x64(True):
        constants = legged(model, robot_arrays(quadruped, model))
        state = Physics(*(jnp.asarray(x.T) for x in (qpos, qvel, np.zeros((STATES, 18)))))
        found = jax.jit(lambda s, t: acceleration(constants, s, t, 30, 20))(state, torque.T)
    expected = np.array(expected)
    error = np.abs(np.asarray(found).T - expected).max(axis=1) / np.abs(expected).max(axis=1)
    assert error.max() < 1e-9, error


def test_accelerations_are_those_of_mujoco():
    check_accelerations(load_quadruped())


def test_accelerations_of_other_quadrupeds(reference_urdf):
    check_accelerations(load_quadruped(reference_urdf))


def test_accelerations_of_pybullets_quadrupeds(pybullet_urdf):
    try:
        quadruped = load_quadruped(pybullet_urdf, Options(meshes=False))
    except UrdfError as error:
        pytest.skip(f"no such quadruped: {error}")
    check_accelerations(quadruped)


# In single precision; measured: 1e-5 m, 4e-5 rad, 5e-4 m/s or rad/s.
def test_200_steps_are_those_of_mujoco(env, stepping_in_place):
    model = env.quadruped.training_model(0.004, iterations=100, ls_iterations=50)
    torques, expected = stepping_in_place(env, model)
    start = Physics(
        *(jnp.asarray(x)[:, None] for x in (*np.split(expected[0], [19]), np.zeros(18)))
    )

    def step(state: Physics, torque: jax.Array) -> tuple[Physics, jax.Array]:
        found = acceleration(env.legged, state, torque[:, None], 10, 10)
        state = integrate(state, found, model.opt.timestep)
        return state, jnp.concatenate([state.qpos[:, 0], state.qvel[:, 0]])

    start = jax.tree.map(lambda x: x.astype(jnp.float32), start)
    _, found = jax.jit(lambda s, t: jax.lax.scan(step, s, t))(start, jnp.asarray(torques))
    error = np.abs(np.asarray(found) - expected[1:])
    assert len(error) == 200
    assert np.ptp(expected[:, 7:19], axis=0).max() > 0.1
    assert error[:, :3].max() < 5e-5
    assert error[:, 3:19].max() < 5e-4
    assert error[:, 19:].max() < 2e-3


def test_heights_are_those_of_the_placed_shapes(env):
    model, robot = env.mj_model, env.robot
    data = mujoco.MjData(model)
    rng = np.random.default_rng(2)
    compiled = jax.jit(lambda q: (*heights(env.legged, q), soles(env.legged, q)))
    for _ in range(5):
        data.qpos[:] = robot.home + rng.uniform(-0.3, 0.3, 19)
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        mujoco.mj_kinematics(model, data)
        feet, lowest, points = compiled(jnp.asarray(data.qpos, jnp.float32))
        np.testing.assert_allclose(
            feet, data.geom_xpos[robot.foot_geoms, 2] - robot.foot_radius, atol=1e-6
        )
        touching = data.geom_xpos[robot.foot_geoms] - robot.foot_radius[:, None] * [0, 0, 1]
        np.testing.assert_allclose(points, touching, atol=1e-6)
        expected = min(lowest_point(model, data, int(geom)) for geom in robot.shell_geoms)
        assert float(lowest) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("robots", [3, BATCH, 2 * BATCH + 5])
def test_a_batch_is_its_robots_one_by_one(robots):
    """However many there are, cut into whatever batches."""
    numbers = jnp.arange(2.0 * robots).reshape(robots, 2)
    function = robots_last(lambda x, y: {"sum": x[0] + y * x[1], "turned": x[::-1]})
    found = jax.jit(jax.vmap(function, in_axes=(0, None)))(numbers, 3.0)
    np.testing.assert_array_equal(found["sum"], numbers[:, 0] + 3 * numbers[:, 1])
    np.testing.assert_array_equal(found["turned"], numbers[:, ::-1])
    one = function(numbers[1], 3.0)
    assert (one["sum"], one["turned"].tolist()) == (found["sum"][1], found["turned"][1].tolist())


def test_a_robot_that_is_not_finite_leaves_the_others_alone(env):
    home = Physics(*(jnp.asarray(x, jnp.float32) for x in (env.robot.home, *np.zeros((2, 18)))))
    batch = jax.tree.map(lambda x: jnp.tile(x, (3, 1)), home)
    target = jnp.tile(jnp.asarray(env.robot.home_joints, jnp.float32), (3, 1))
    control = jax.jit(
        jax.vmap(lambda p, t: simulate(env.legged, env.robot, EnvConfig(), p, t)[0].qpos)
    )
    sound = control(batch, target)
    for first in (jnp.nan, jnp.inf):
        ill = batch._replace(qpos=batch.qpos.at[0, 7].set(first).at[1, 2].set(first))
        np.testing.assert_array_equal(control(ill, target)[2], sound[2])
