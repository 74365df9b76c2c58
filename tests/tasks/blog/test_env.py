"""The blog post's task, against its formulas in NumPy, number by number."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.state import EnvState
from quadwalk.physics.motor import Effort, PhysicsState, compute_motor_torque
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.tasks import blog

STATES = 2000
LOWER = np.tile([-1.2217, -1.0, -2.77507], 4)
UPPER = np.tile([1.2217, 1.0, -0.645772], 4)
START = np.tile([0.0, np.pi / 4, -np.pi / 2], 4)


@pytest.fixture(scope="module")
def env() -> QuadrupedEnv:
    return QuadrupedEnv(load_quadruped(), blog.TASK.env)


@pytest.fixture(scope="module")
def first(env):
    """Return the state of a fresh episode."""
    return jax.jit(env.reset)(jax.random.PRNGKey(4))


@pytest.fixture(scope="module")
def step(env):
    return jax.jit(env.step)


def rotation(quat: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (n, 3, 3) of unit quaternions (n, 4), wxyz."""
    w, x, y, z = quat.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)


def roll_pitch_yaw(quat: np.ndarray) -> np.ndarray:
    """Return roll, pitch and yaw (n, 3), rad, of the rotation Rz(yaw) Ry(pitch) Rx(roll)."""
    turn = rotation(quat)
    roll = np.arctan2(turn[:, 2, 1], turn[:, 2, 2])
    yaw = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    return np.stack([roll, -np.arcsin(turn[:, 2, 0]), yaw], axis=1)


@pytest.fixture(scope="module")
def states() -> tuple[np.ndarray, ...]:
    """Draw states in single precision, as wild as can be.

    They are qpos before a step, and qpos and qvel after it.
    """
    rng = np.random.default_rng(0)
    qpos = np.empty((STATES, 19))
    qpos[:, :2] = rng.uniform(-5, 5, (STATES, 2))
    qpos[:, 2] = rng.uniform(0.0, 0.5, STATES)
    quat = rng.normal(size=(STATES, 4))
    quat[: STATES // 2] += [6, 0, 0, 0]  # half of them not far from upright
    qpos[:, 3:7] = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    qpos[:, 7:] = rng.uniform(LOWER, UPPER, (STATES, 12))
    before = qpos.copy()
    before[:, 0] -= rng.uniform(-0.02, 0.02, STATES)
    before[:, 7:] -= rng.uniform(-0.1, 0.1, (STATES, 12))
    qvel = rng.uniform(-10, 10, (STATES, 18))
    arrays = tuple(x.astype(np.float32) for x in (before, qpos, qvel))
    # Away from where the angles are not determined, or single precision might decide otherwise.
    angles = np.abs(roll_pitch_yaw(arrays[1][:, 3:7].astype(float)))
    sound = angles[:, 1] < 1.5
    for edge in (np.pi / 4, np.pi / 2):
        sound &= (np.abs(angles[:, :2] - edge) > 1e-4).all(axis=1)
    sound &= np.abs(arrays[1][:, 2] - 0.05) > 1e-4
    assert sound.mean() > 0.95
    return tuple(x[sound] for x in arrays)


@pytest.fixture(scope="module")
def concluded(env, states):
    """Return the states that the environment makes of those steps."""

    def one(before, qpos, qvel):
        state = EnvState(PhysicsState(before, qvel), jnp.zeros(12), jnp.int32(10))
        nothing = Effort(jnp.zeros(12), jnp.zeros(()))
        after = EnvState(PhysicsState(qpos, qvel), jnp.zeros(12), jnp.int32(11))
        return env.evaluate_step(state, after, nothing, jnp.ones((), bool))

    return jax.jit(jax.vmap(one))(*states)


def test_the_observation(env, states, concluded):
    _, qpos, qvel = (x.astype(float) for x in states)
    spin = np.einsum("nij,nj->ni", rotation(qpos[:, 3:7]), qvel[:, 3:6])  # MuJoCo's is the body's
    expected = np.concatenate(
        [qpos[:, :3], qpos[:, [4, 5, 6, 3]], qvel[:, :3], spin, qpos[:, 7:], qvel[:, 6:]], axis=1
    )
    assert expected.shape[1] == env.observation_size == 37
    np.testing.assert_allclose(concluded.obs, expected, atol=2e-5)
    names = env.sensors.names
    assert len(set(names)) == 37
    assert [names.index(f"world_orientation_{i}") for i in "xyzw"] == [3, 4, 5, 6]
    assert names[13:25] == tuple(f"joint_pos_{joint}" for joint in env.quadruped.joints)


def test_each_reward_and_their_sum(states, concluded):
    before, qpos, _ = (x.astype(float) for x in states)
    angles = np.abs(roll_pitch_yaw(qpos[:, 3:7]))
    expected = {
        "progress": 50 * (qpos[:, 0] - before[:, 0]),
        "inclined": -10.0 * ((angles[:, 0] > np.pi / 4) | (angles[:, 1] > np.pi / 4)),
        "heading": -0.01 * angles[:, 2],
        "movement": -0.01 * np.abs(qpos[:, 7:] - before[:, 7:]).sum(axis=1),
    }
    assert 0.2 < (expected["inclined"] < 0).mean() < 0.8
    raw = {
        name.removeprefix("reward/"): np.asarray(value)
        for name, value in concluded.metrics.items()
        if name.startswith("reward/")
    }
    assert raw.keys() == expected.keys()
    for name, scale in {
        "progress": 50,
        "inclined": -10,
        "heading": -0.01,
        "movement": -0.01,
    }.items():
        np.testing.assert_allclose(scale * raw[name], expected[name], atol=5e-5, err_msg=name)
    np.testing.assert_allclose(concluded.reward, sum(expected.values()), atol=1e-4)


def test_an_episode_ends_where_the_post_ends_it(env, states, concluded):
    qpos = states[1].astype(float)
    angles = np.abs(roll_pitch_yaw(qpos[:, 3:7]))
    tipped = (angles[:, :2] > np.pi / 2).any(axis=1)
    low = qpos[:, 2] < 0.05
    expected = np.where(tipped, "tipped", np.where(low, "low", "running"))
    # Whatever else is so: most of them have knees or the trunk under the floor.
    assert min((expected == end).mean() for end in ("tipped", "low", "running")) > 0.05
    assert [env.ends[i] for i in np.asarray(concluded.info["end"])] == expected.tolist()
    np.testing.assert_array_equal(concluded.done, tipped | low)


def test_an_action_is_a_place_in_the_joints_range_not_far_from_the_joint(env, states):
    rng = np.random.default_rng(1)
    action = rng.uniform(-1, 1, (len(states[1]), 12)).astype(np.float32)
    action[:2] = [[-1.0], [1.0]]
    q = states[1][:, 7:]
    targets = jax.vmap(lambda a, q: env.config.action(env.robot, a, q))(action, q)
    goals = LOWER + (action.astype(float) + 1) / 2 * (UPPER - LOWER)
    q = q.astype(float)
    expected = np.where(goals > q + 0.5, q + 0.5, np.where(goals < q - 0.5, q - 0.5, goals))
    for share in ((goals > q + 0.5).mean(), (goals < q - 0.5).mean()):
        assert share > 0.1
    np.testing.assert_allclose(targets, expected, atol=1e-6)


def test_motors_draw_a_joint_to_the_posts_speed_within_its_torque(env):
    rng = np.random.default_rng(2)
    q, qd = rng.uniform(-1, 1, (2, 500, 12))
    target = q + rng.uniform(-0.5, 0.5, (500, 12))
    torque = compute_motor_torque(env.motor, target, q, qd)
    kd = env.motor.kd
    goal_speed = 0.1 * (target - q) * 240  # a tenth of the way, in a step of 1/240 s
    expected = np.clip(kd * (goal_speed - qd), -44.4, 44.4)
    assert 0.1 < (np.abs(expected) == 44.4).mean() < 0.9
    np.testing.assert_allclose(torque, expected, atol=1e-4)


def test_both_models_have_the_tasks_gravity_and_torque(env):
    for model in (env.mj_model, env.quadruped.make_full_model()):
        assert model.opt.gravity.tolist() == [0, 0, -9.8]
        data = mujoco.MjData(model)
        data.ctrl[:] = 100.0
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qfrc_actuator[6:], 44.4)
    assert env.robot.weight == pytest.approx(9.8 * env.mj_model.body_mass.sum())


def test_every_episode_starts_from_the_posts_pose(env, first):
    other = jax.jit(env.reset)(jax.random.PRNGKey(5))
    expected = np.array([0, 0, 0.4, 1, 0, 0, 0, *START], np.float32)
    for state in (first, other):
        physics = state.pipeline_state.physics
        np.testing.assert_array_equal(physics.qpos, expected)
        np.testing.assert_array_equal(physics.qvel, np.zeros(18))
        np.testing.assert_array_equal(
            state.obs, np.r_[expected[:3], 0, 0, 0, 1, np.zeros(6), expected[7:], np.zeros(12)]
        )


def test_the_first_step_is_rewarded_from_the_start(first, step):
    state = step(first, jnp.full(12, 0.5))
    qpos = np.asarray(state.pipeline_state.physics.qpos, float)
    yaw = roll_pitch_yaw(qpos[None, 3:7])[0, 2]
    joint_travel = np.abs(qpos[7:] - START).sum()
    assert joint_travel > 0.01
    assert state.reward == pytest.approx(
        50 * qpos[0] - 0.01 * abs(yaw) - 0.01 * joint_travel, abs=1e-5
    )


def test_an_episode_has_1000_steps_of_one_physics_step(env, first):
    assert (env.config.episode_steps, env.config.substeps) == (1000, 1)
    assert env.config.physics_dt == 1 / 240
    hold = jnp.asarray(2 * (START - LOWER) / (UPPER - LOWER) - 1)

    def run(state, _):
        state = env.step(state, hold)
        return state, (state.done, state.pipeline_state.physics.qvel)

    state, (done, qvel) = jax.jit(lambda s: jax.lax.scan(run, s, None, length=1000))(first)
    assert np.flatnonzero(done).tolist() == [999]
    assert env.ends[int(state.info["end"])] == "time limit"
    assert state.info["truncation"] == 1.0
    # It stands still after the drop: the controller's gains are none that it cannot hold.
    assert np.abs(qvel[500:]).max() < 0.05
    assert state.pipeline_state.physics.qpos[2] > 0.33


@pytest.mark.parametrize(
    ("quat", "expected"),
    [
        ((0.5, 0.5, 0.5, 0.5), (np.pi / 2, 0.0, np.pi / 2)),
        # Straight up and down, roll is 0 and yaw is whatever else there is, within two turns.
        ((1.0, 0.0, 1.0, 0.0), (0.0, np.pi / 2, 0.0)),
        ((0.5, 0.5, 0.5, -0.5), (0.0, np.pi / 2, -np.pi / 2)),
        ((-0.5, -0.5, -0.5, 0.5), (0.0, np.pi / 2, 1.5 * np.pi)),
        ((-0.5, -0.5, 0.5, -0.5), (0.0, -np.pi / 2, -1.5 * np.pi)),
    ],
)
def test_euler_angles_where_pitch_is_a_right_angle(quat, expected):
    np.testing.assert_allclose(
        blog.compute_euler_angles(jnp.asarray(quat) / np.linalg.norm(quat)), expected, atol=1e-5
    )


def test_euler_angles_of_random_rotations_are_scipys():
    quat = np.random.default_rng(0).normal(size=(3000, 4))
    quat = (quat / np.linalg.norm(quat, axis=1, keepdims=True)).astype(np.float32)
    expected = Rotation.from_quat(quat, scalar_first=True).as_euler("xyz")
    angles = np.asarray(jax.vmap(blog.compute_euler_angles)(quat))
    steep = np.abs(np.sin(expected[:, 1])) > 0.99  # of whose angles less digits are left
    assert 10 < steep.sum() < 100
    np.testing.assert_allclose(angles[~steep], expected[~steep], atol=1e-5)
    np.testing.assert_allclose(angles[steep], expected[steep], atol=2e-3)


@pytest.mark.parametrize(
    ("roll", "degrees", "heading", "expected"),
    [
        (0.5, 89.5, -1.0, (0.5, 1.5621, -1.0)),
        (0.5, 89.8, -1.0, (0.0, 1.5708, -1.5017)),
        (3.0, 89.8, 2.5, (0.0, 1.5708, -0.5005)),
        (-2.0, -89.5, 0.7, (-2.0, -1.5621, 0.7)),
        (-2.0, -89.8, 0.7, (0.0, -1.5708, -1.3032)),
    ],
)
def test_euler_angles_near_a_right_angle_of_pitch_are_pybullets(roll, degrees, heading, expected):
    """Compare with getEulerFromQuaternion of PyBullet 3.2.7.

    It gives a roll of 0 where the pitch is within 0.26 degrees of a right angle.
    """
    turn = Rotation.from_euler("xyz", [roll, np.radians(degrees), heading])
    quat = turn.as_quat(scalar_first=True).astype(np.float32)
    np.testing.assert_allclose(blog.compute_euler_angles(jnp.asarray(quat)), expected, atol=2e-4)
