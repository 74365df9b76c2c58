"""The start in any pose, and an episode that nothing but the time limit ends."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.state import is_standing
from quadwalk.evaluation.load import LoadedRun
from quadwalk.evaluation.suites.standing import (
    SECONDS,
    check_standing,
    make_standing_points,
    measure_standing,
    print_standing,
)
from quadwalk.learn.acting import Policy
from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.robot.scene import find_lowest_point
from quadwalk.runs.directory import Run
from quadwalk.tasks import getup
from tests.physics.reference import place_robot
from tests.robot import zoo

STARTS = 500


@pytest.fixture(scope="module")
def rising(quadruped) -> QuadrupedEnv:
    return QuadrupedEnv(quadruped, dataclasses.replace(getup.TASK.env, episode_seconds=0.06))


def started(env: QuadrupedEnv, count: int):
    return jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(0), count))


@pytest.fixture(scope="module")
def starts(rising):
    return started(rising, STARTS)


def test_all_orientations_are_alike(starts):
    """Check that the place where a rotation takes an axis is uniform over the sphere.

    Then each coordinate is uniform over -1 to 1.
    """
    quats = np.asarray(starts.pipeline_state.qpos[:, 3:7], float)
    np.testing.assert_allclose(np.linalg.norm(quats, axis=1), 1.0, atol=1e-6)
    turns = Rotation.from_quat(quats, scalar_first=True).as_matrix()
    for coordinate in turns.reshape(-1, 9).T:
        assert stats.kstest(coordinate, "uniform", (-1, 2)).pvalue > 1e-3
    np.testing.assert_allclose(turns.mean(axis=0), 0.0, atol=0.12)


def check_lowest(env: QuadrupedEnv, qpos: np.ndarray) -> None:
    """Assert that in each pose (n, 19) the lowest shape is just on the floor, by MuJoCo."""
    model = env.mj_model
    shapes = np.flatnonzero((model.geom_bodyid > 0) & (model.geom_group == 3))
    for pose in qpos:
        data = place_robot(model, pose)
        lowest = min(find_lowest_point(model, data, int(shape)) for shape in shapes)
        assert lowest == pytest.approx(0.0, abs=1e-5)


def test_a_start_has_its_lowest_part_on_the_floor_and_joints_within_their_limits(rising, starts):
    qpos = np.asarray(starts.pipeline_state.qpos)
    check_lowest(rising, qpos[:100])
    assert np.all((qpos[:, 7:] >= rising.robot.lower) & (qpos[:, 7:] <= rising.robot.upper))


@zoo.repeat_for(zoo.QUADRUPEDS, "go1", "go2", "a1_", "anymal_c", "solo12")
def test_other_robots_start_so_too(urdf):
    env = QuadrupedEnv(load_quadruped(urdf, Options(meshes=False)), getup.TASK.env)
    check_lowest(env, np.asarray(started(env, 20).pipeline_state.qpos))


def test_only_the_time_limit_ends_an_episode_and_what_is_not_finite(rising, starts):
    step = jax.jit(jax.vmap(rising.step))
    state = jax.tree.map(lambda x: x[:16], starts)
    up = state.pipeline_state.qpos[:, 3:7]
    assert np.ptp(1 - 2 * (up[:, 1] ** 2 + up[:, 2] ** 2)) > 1.5  # upright to upside down
    idle = jnp.zeros((16, 12))
    ended = []
    for k in range(3):
        state = step(state, idle.at[0].set(jnp.nan if k == 1 else 0.0))
        ended.append([rising.ends[end] for end in np.asarray(state.info["end"])])
        assert np.isfinite(np.asarray(state.obs)).all()
        assert np.isfinite(np.asarray(state.reward)).all()
        assert not state.metrics["fell"].any()
    assert ended[0] == ["running"] * 16
    assert ended[1] == ["nan"] + ["running"] * 15
    assert ended[2][1:] == ["time limit"] * 15


def test_a_step_tells_who_stands_as_the_evaluation_does(rising):
    home = np.asarray(rising.robot.home)
    tilted, low = home.copy(), home.copy()
    tilted[3:7] = Rotation.from_euler("x", 19, degrees=True).as_quat(scalar_first=True)
    low[2] *= 0.84
    poses = np.stack([home, tilted, low])
    stands = jax.vmap(lambda qpos: is_standing(rising.robot, qpos))(jnp.asarray(poses))
    assert stands.tolist() == [True, False, False]
    long = (1 + round(max(SECONDS) / 0.02), 1)
    assert [check_standing(rising, np.tile(pose[:7], long))[1] for pose in poses] == stands.tolist()
    assert "standing" in jax.eval_shape(rising.reset, jax.random.PRNGKey(0)).metrics


def test_the_policy_sees_what_a_real_robot_measures(rising):
    names = {name.partition("[")[0] for name in rising.sensors.names}
    kinds = ("angular_velocity", "gravity", "joint_pos", "joint_vel", "last_action")
    assert all(name.startswith(kinds) for name in names)
    assert len(names) == 3 + 3 + 3 * 12


def test_it_stands_where_it_is_high_and_upright_at_the_time(rising):
    home = np.r_[rising.robot.home[:7]]
    poses = np.tile(home, (1 + round(max(SECONDS) / 0.02), 1))
    assert check_standing(rising, poses) == (True, True, True)
    assert check_standing(rising, poses[:200]) == (True, True, False)  # it ended after 4 s
    low, tilted = poses.copy(), poses.copy()
    low[120:, 2] *= 0.84
    tilted[:120, 3:7] = Rotation.from_euler("x", 19, degrees=True).as_quat(scalar_first=True)
    assert check_standing(rising, low) == (True, False, False)
    assert check_standing(rising, tilted) == (False, True, True)


def test_a_policy_is_judged_in_mujoco_under_every_condition(
    quadruped, tmp_path, capsys, monkeypatch
):
    config = dataclasses.replace(getup.TASK.env, episode_seconds=0.1)
    env = QuadrupedEnv(quadruped, config, "mujoco")
    act = jax.tree_util.Partial(lambda obs: 0.0 * obs[..., :12])
    policy = Policy(act, getup.TASK, quadruped.joints, env.policy_size, 0)
    results = measure_standing(LoadedRun(Run(tmp_path), tmp_path, policy, env, "0"), 2, 0)
    names = list(make_standing_points(env))
    assert names[3] == "+5.1 kg"
    assert [each["name"] for each in results["conditions"]] == names
    assert {each["standing_6s"] for each in results["conditions"]} == {0.0}  # it ended long before
    monkeypatch.setenv("COLUMNS", "120")
    print_standing(results)
    output = capsys.readouterr().out
    assert all(name in output for name in names)
