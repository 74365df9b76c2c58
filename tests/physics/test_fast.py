"""Training's own physics against MuJoCo C, the same problem solved by other code."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from quadwalk.physics.mjx_engine import Physics
from quadwalk.physics.robot_arrays import robot_arrays

from quadwalk.physics.batching import BATCH, robots_last
from quadwalk.physics.fast import acceleration, heights, integrate, simulate, soles
from quadwalk.physics.model import legged
from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.robot.scene import lowest_point
from quadwalk.robot.validate import UrdfError
from quadwalk.task.config import EnvConfig

STATES = 40


def random_states(quadruped, model, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """qpos, qvel and joint torques of robots in the air, on their feet, and bent past limits."""
    qpos = np.tile(quadruped.home, (STATES, 1))
    qpos[:, 2] *= rng.uniform(0.8, 1.3, STATES)
    qpos[:, 3:7] += 0.15 * rng.normal(size=(STATES, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    qpos[:, 7:] += 0.5 * rng.normal(size=(STATES, 12))
    return qpos, rng.normal(size=(STATES, 18)), 10 * rng.normal(size=(STATES, 12))


def lying_states(quadruped, model, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of robots lowered until any of their spheres but the upper four is in the floor."""
    qpos, qvel, torque = random_states(quadruped, model, rng)
    qpos[:, 3:7] += 0.3 * rng.normal(size=(STATES, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    qpos[:, 7:] += 0.8 * rng.normal(size=(STATES, 12))
    spheres = np.concatenate(robot_arrays(quadruped, model).contact_geoms)
    data = mujoco.MjData(model)
    for q in qpos:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        bottoms = np.sort(data.geom_xpos[spheres, 2] - model.geom_size[spheres, 0])
        q[2] -= bottoms[rng.integers(8)] + rng.uniform(0.0, 0.01)
    return qpos, qvel, torque


def check_accelerations(quadruped, contacts="feet", states=random_states) -> None:
    """In double precision, solved to the end: the same accelerations."""
    model = quadruped.training_model(0.004, 100, 50, contacts)
    model.opt.tolerance = 1e-14
    qpos, qvel, torque = states(quadruped, model, np.random.default_rng(0))
    data = mujoco.MjData(model)
    kinds = robot_arrays(quadruped, model).contact_geoms
    expected, rows, limits, together = [], [], [], set()
    for q, v, t in zip(qpos, qvel, torque, strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, 0
        data.qfrc_applied[6:] = t
        mujoco.mj_forward(model, data)
        expected.append(data.qacc.copy())
        rows.append(data.nefc)
        limits.append(np.sum(data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT))
        together |= {tuple(leg) for leg in np.isin(kinds, data.contact.geom).T}
    assert contacts == "feet" or max(limits) > 1
    assert len(together) == 2 ** len(kinds)  # foot, knee and corner of a leg, in all combinations
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


def test_accelerations_are_those_of_mujoco_where_knees_and_trunk_touch():
    check_accelerations(load_quadruped(), "body", lying_states)


def test_accelerations_of_other_quadrupeds(reference_urdf):
    check_accelerations(load_quadruped(reference_urdf))
    check_accelerations(load_quadruped(reference_urdf), "body", lying_states)


def test_accelerations_of_pybullets_quadrupeds(pybullet_urdf):
    try:
        quadruped = load_quadruped(pybullet_urdf, Options(meshes=False))
    except UrdfError as error:
        pytest.skip(f"no such quadruped: {error}")
    check_accelerations(quadruped)


def check_course(env, torques: np.ndarray, expected: np.ndarray) -> None:
    """Single precision: the states `expected` (n + 1, 37) that torques (n, 12) lead through."""
    start = Physics(
        *(jnp.asarray(x)[:, None] for x in (*np.split(expected[0], [19]), np.zeros(18)))
    )

    def step(state: Physics, torque: jax.Array) -> tuple[Physics, jax.Array]:
        found = acceleration(env.legged, state, torque[:, None], 10, 10)
        state = integrate(state, found, env.config.physics_dt)
        return state, jnp.concatenate([state.qpos[:, 0], state.qvel[:, 0]])

    start = jax.tree.map(lambda x: x.astype(jnp.float32), start)
    _, found = jax.jit(lambda s, t: jax.lax.scan(step, s, t))(start, jnp.asarray(torques))
    error = np.abs(np.asarray(found) - expected[1:])
    assert len(error) == 200
    assert error[:, :3].max() < 5e-5
    assert error[:, 3:19].max() < 5e-4
    assert error[:, 19:].max() < 2e-3


# Measured: 1e-5 m, 4e-5 rad, 5e-4 m/s or rad/s.
def test_200_steps_are_those_of_mujoco(env, stepping_in_place):
    model = env.quadruped.training_model(0.004, iterations=100, ls_iterations=50)
    torques, expected = stepping_in_place(env, model)
    assert np.ptp(expected[:, 7:19], axis=0).max() > 0.1
    check_course(env, torques, expected)


def drop(env, model: mujoco.MjModel) -> tuple[np.ndarray, set[int]]:
    """States of a limp robot, standing to lying, in MuJoCo C, and which geoms touched."""
    data = mujoco.MjData(model)
    touched: set[int] = set()
    data.qpos[:] = env.robot.home
    data.qvel[:6] = np.random.default_rng(0).uniform(-0.2, 0.2, 6)
    states = [np.r_[data.qpos, data.qvel]]
    for _ in range(round(0.8 / model.opt.timestep)):
        mujoco.mj_step(model, data)
        states.append(np.r_[data.qpos, data.qvel])
        touched |= set(data.contact.geom.flat)
    return np.array(states), touched


# Measured: 1e-7 m, 6e-6 rad, 2e-4 m/s or rad/s.
def test_a_limp_robot_drops_to_its_belly_as_in_mujoco(body_env):
    model = body_env.quadruped.training_model(0.004, 100, 50, "body")
    states, touched = drop(body_env, model)
    for spheres in body_env.robot.contact_geoms:
        assert touched & set(spheres)
    assert np.abs(states[-1, 19:25]).max() < 1e-2  # the trunk is at rest
    check_course(body_env, np.zeros((200, 12)), states)


def test_a_belly_rests_where_that_of_the_full_model_does(body_env):
    quadruped = body_env.quadruped
    training = quadruped.training_model(0.004, 100, 50, "body")
    ours, full = (drop(body_env, model)[0][-1] for model in (training, quadruped.full_model()))
    assert full[2] == pytest.approx(0.056, abs=1e-3)  # half of the trunk's height
    assert ours[2] == pytest.approx(full[2], abs=1e-3)
    assert min(ours[3], full[3]) > 0.99


def test_knees_and_corners_are_not_measured_as_shapes(env, body_env):
    qpos = jnp.asarray(env.robot.home).at[2].set(0.1)
    for ours, theirs in zip(heights(env.legged, qpos), heights(body_env.legged, qpos), strict=True):
        np.testing.assert_array_equal(ours, theirs)


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
