"""The page computes what the exported scripts compute, and drives as MuJoCo C does."""

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from benchmarks.shared import find_example_robots
from quadwalk.export.controller import Controller, read_list, to_matrix
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run
from quadwalk.settings.training import OtherRobotConfig
from quadwalk.web import site
from quadwalk.web.actor import PythonActor
from quadwalk.web.robots import load, make_dog

STEPS = 1000
SPEEDS = ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.5, 0.0, 0.0], [1.5, 0.0, 1.0], [-0.8, 0.0, 0.0])


def locate_robot(folder: Path, name: str) -> dict[str, str]:
    """Return the files of a robot and its policy, for a job of run_policy.mjs."""
    return {
        "robot": str(folder / f"{name}.xml"),
        "policy": str(folder / site.make_policy_name(name)),
    }


class Drive:
    """A robot in MuJoCo C, driven by the export's controller.py, as run_policy.py does it."""

    def __init__(self, folder: Path, name: str) -> None:
        self.controller = Controller(folder / f"{name}.onnx")
        metadata = self.controller.about
        self.model = mujoco.MjModel.from_xml_path(str(folder / f"{name}.xml"))
        self.model.opt.timestep = 0.002
        self.model.dof_frictionloss[:] = 0.0
        self.data = mujoco.MjData(self.model)
        self.start = np.array(read_list(metadata["start_qpos"]), float)
        self.substeps = round(float(metadata["control_period"]) / 0.002)

    def reset(self, joints: np.ndarray) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.start
        self.data.qpos[7:] += joints
        self.controller.restart()

    def step(self, command: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Make a control step; return the state before it and its joint targets."""
        data = self.data
        before = data.qpos.copy(), data.qvel.copy()
        targets = self.controller.compute_targets(*before, np.array(command))
        for _ in range(self.substeps):
            data.qfrc_applied[6:] = self.controller.compute_torque(targets, data.qpos, data.qvel)
            mujoco.mj_step(self.model, data)
        return *before, targets


def compute_velocity(data: mujoco.MjData) -> np.ndarray:
    """Return forward and lateral velocity, m/s, and yaw rate, rad/s."""
    turn = to_matrix(data.qpos[3:7])
    heading = np.arctan2(turn[1, 0], turn[0, 0])
    cos, sin = np.cos(heading), np.sin(heading)
    x, y = data.qvel[:2]
    return np.array([cos * x + sin * y, cos * y - sin * x, turn[2] @ data.qvel[3:6]])


@pytest.mark.parametrize("name", ["drive", "getup", "run", "walk"])
def test_observations_and_targets_are_those_of_the_exported_controller(name, robot_files, run_node):
    drive = Drive(robot_files, name)
    rng = np.random.default_rng(3)
    drive.reset(rng.uniform(-0.2, 0.2, 12))
    states: list[dict[str, Any]] = []
    expected = []
    for step in range(STEPS):
        if step % 50 == 0:
            command = rng.uniform([-0.5, -0.3, -1.0], [2.0, 0.3, 1.0]).tolist()
        qpos, qvel, targets = drive.step(command)
        states.append({"qpos": qpos.tolist(), "qvel": qvel.tolist(), "command": command})
        expected.append((drive.controller.obs, targets))
    answers = run_node({**locate_robot(robot_files, name), "states": states})
    for answer, (obs, targets) in zip(answers, expected, strict=True):
        np.testing.assert_allclose(answer["obs"], obs, atol=1e-5)
        np.testing.assert_allclose(answer["targets"], targets, atol=1e-5)


def test_it_drives_at_the_speeds_of_mujoco_c(robot_files, run_node):
    steps, settle = 250, 100
    episodes = [{"steps": steps, "settle": settle, "command": command} for command in SPEEDS]
    job = locate_robot(robot_files, "drive")
    answers = run_node({**job, "episodes": episodes})
    drive = Drive(robot_files, "drive")
    for command, answer in zip(SPEEDS, answers, strict=True):
        drive.reset(np.zeros(12))
        velocities = []
        for _ in range(steps):
            drive.step(command)
            velocities.append(compute_velocity(drive.data))
        expected = np.mean(velocities[settle:], axis=0)
        np.testing.assert_allclose(answer["velocity"], expected, rtol=0.03, atol=0.02)
        assert not answer["fell"]
        assert answer["events"] == []
    weight = drive.model.body_mass.sum() * 9.81
    assert answers[0]["forces"] == pytest.approx(weight, rel=0.02)
    assert answers[0]["contacts"] == [True] * 4


def test_walk_stands_on_all_feet(robot_files, run_node):
    episodes = [{"steps": 250, "settle": 100, "command": [0.0, 0.0, 0.0]}]
    [answer] = run_node({**locate_robot(robot_files, "walk"), "episodes": episodes})
    assert answer["contacts"] == [True] * 4


def test_it_starts_from_many_poses(robot_files, run_node):
    rng = np.random.default_rng(5)
    job = locate_robot(robot_files, "drive")
    starts = [
        {"steps": 100, "settle": 50, "command": [1.0, 0, 0], "joints": joints.tolist()}
        for joints in rng.uniform(-0.15, 0.15, (32, 12))
    ]
    answers = run_node({**job, "episodes": starts})
    assert not any(answer["fell"] for answer in answers)


@pytest.mark.parametrize(("speed", "seconds"), [(0.0, 4.0), (2.0, 5.0)])
def test_thrown_over_it_stands_within_four_seconds_and_drives_on(
    speed, seconds, robot_files, run_node
):
    getup = locate_robot(robot_files, "getup")["policy"]
    job = {**locate_robot(robot_files, "drive"), "getup": getup}

    def throw(after: float) -> Any:
        """Return results of throws at several moments of a stride, measured for half a second."""
        steps = round(after / 0.02)
        throws = [
            {
                "steps": at + steps,
                "settle": at + steps - 25,
                "command": [speed, 0, 0],
                "throwAt": at,
            }
            for at in range(50, 70, 2)
        ]
        return run_node({**job, "episodes": throws})

    for result in throw(4.0):
        assert result["rising"] > 10
        assert result["isStanding"]
        assert result["events"] == []
    for result in throw(seconds):
        assert result["velocity"][0] == pytest.approx(speed, abs=0.1)
        assert result["isStanding"]
        assert result["events"] == []


def test_the_robot_of_a_file_is_thrown_over_gets_up_and_drives_on(tmp_path, run_node):
    """Check policies of many bodies on a Go2, which they were not trained on."""
    file = find_example_robots() / "go2_description/urdf/go2.urdf"
    loaded = load(Run(PRETRAINED / "universal"), "last", OtherRobotConfig(urdf=file).find())
    site.write_folder(make_dog(loaded, None).files, tmp_path)
    getup = tmp_path / site.make_policy_name("universal.getup")
    job = {**locate_robot(tmp_path, "universal"), "getup": str(getup)}
    throws = [
        {"steps": at + 250, "settle": at + 225, "command": [1.0, 0, 0], "throwAt": at}
        for at in range(44, 60, 4)
    ]
    for result in run_node({**job, "episodes": throws}):
        assert result["rising"] > 10
        assert result["isStanding"]
        assert result["velocity"][0] == pytest.approx(1.0, abs=0.15)
        assert result["events"] == []


def test_it_climbs_stairs_that_it_sees(robot_files, run_node):
    terrain = json.loads((robot_files / "terrain.json").read_text())
    kinds = [(tile["kind"], tile["difficulty"]) for tile in terrain["tiles"]]
    tile = kinds.index(("stairs_up", 0.4))
    job = locate_robot(robot_files, "rough")
    episodes = [{"steps": 250, "settle": 50, "command": [0.8, 0, 0], "tile": tile}]
    job |= {"terrain": str(robot_files / "terrain.json")}
    (answer,) = run_node({**job, "episodes": episodes})
    start = terrain["tiles"][tile]["start"]
    assert not answer["fell"]
    assert answer["place"][0] - start[0] > 2.0
    assert answer["place"][2] > 0.3  # m: it is out of the pit, whose floor is at -0.66


def test_a_policy_acts_in_python_as_it_does_in_the_exported_controller(loaded_runs, robot_files):
    actor = PythonActor(loaded_runs["walk"])
    drive = Drive(robot_files, "walk")
    for _ in range(2):  # the second time from the start again
        drive.reset(np.zeros(12))
        for step in range(30):
            command = [1.0, 0.0, 0.3] if step < 15 else [0.2, 0.1, 0.0]
            qpos, qvel, targets = drive.step(command)
            answer = actor(0.02 * step, qpos.tolist(), qvel.tolist(), command)
            np.testing.assert_allclose(answer, targets, atol=1e-4)
