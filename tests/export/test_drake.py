"""An exported robot and its policy in Drake: its own reader of URDF and its own dynamics agree."""

import json

import numpy as np
import pytest

from benchmarks.simulators import Condition, DrakeRobot, MujocoRobot, load_controller, run_episode
from quadwalk.export.bundle import load_flat
from quadwalk.export.check import compute_stages, describe_first_difference
from quadwalk.export.cli import main
from quadwalk.runs.directory import find_ready

pytest.importorskip("pydrake", reason="Drake is not installed")

LOADED = Condition(friction=0.5, load=5.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("drake")
    main(["run", "-o", str(out)])
    return out


@pytest.fixture(scope="module")
def controller(folder):
    return load_controller(folder).Controller(folder / "policy.onnx")


@pytest.fixture(scope="module")
def start(controller):
    return np.array(json.loads(controller.about["start_qpos"]))


def anywhere(start, rng):
    """Return a state in the air and in motion, upright or not."""
    q, v = start.copy(), rng.normal(size=18)
    q[2] = 2.0
    q[3:7] = rng.normal(size=4)
    q[3:7] /= np.linalg.norm(q[3:7])
    q[7:] += rng.uniform(-0.1, 0.1, 12)
    return q, v


@pytest.mark.parametrize("condition", [Condition(), LOADED])
def test_the_robot_has_the_same_dynamics_in_both(folder, controller, start, condition):
    """Compare a flight with torques: masses, inertia, armature, damping, gravity, axes, order."""
    robots = [kind(folder, controller.about, condition) for kind in (DrakeRobot, MujocoRobot)]
    rng = np.random.default_rng(0)
    q, v = anywhere(start, rng)
    for robot in robots:
        robot.set_state(q, v)
        np.testing.assert_allclose(np.concatenate(robot.get_state()), np.r_[q, v], atol=1e-12)
    for _ in range(50):
        torque = rng.normal(size=12)
        for robot in robots:
            robot.step(torque)
    drake_state, mujoco_state = (robot.get_state() for robot in robots)
    np.testing.assert_allclose(drake_state[0], mujoco_state[0], atol=3e-4)
    np.testing.assert_allclose(drake_state[1], mujoco_state[1], atol=2e-3)
    assert not any(robot.lies() for robot in robots)


def test_it_stands_as_heavy_and_as_high_in_both(folder, controller, start):
    heights = []
    for kind in (DrakeRobot, MujocoRobot):
        robot = kind(folder, controller.about, LOADED)
        robot.set_state(start, np.zeros(18))
        for _ in range(500):
            robot.step(controller.compute_torque(controller.home, *robot.get_state()))
        q, v = robot.get_state()
        assert np.abs(v).max() < 0.1
        heights.append(q[2])
        q[2] -= 0.3
        robot.set_state(q, v)
        robot.step(np.zeros(12))
        assert robot.lies()
    assert abs(heights[0] - heights[1]) < 3e-3
    assert max(heights) < start[2] - 0.01  # the joints give way to the load


def test_in_drake_the_policy_sees_and_does_what_it_does_here(folder, controller, start):
    robot = DrakeRobot(folder, controller.about, Condition())
    episode = run_episode(
        robot, controller, Condition(), (start, np.zeros(18)), np.zeros((50, 3)), 0
    )
    assert not episode.fell
    assert episode.qpos[-1, 0] - episode.qpos[0, 0] > 1.0  # runs
    names = ("obs", "action", "target")
    columns = {name: getattr(episode, name) for name in names}
    columns |= {"qpos": episode.qpos[:-1], "qvel": episode.qvel[:-1], "command": np.zeros((50, 3))}
    stages = compute_stages(load_flat(find_ready("runs", "run", "run"), "last"), columns)
    assert describe_first_difference(stages[:3]) == ""
    assert describe_first_difference(stages).split(", ")[1] == "physics"  # which are Drake's
