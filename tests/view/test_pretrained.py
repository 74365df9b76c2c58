"""The policies that come with the package: found where there is no run yet, small, and able."""

from pathlib import Path

import numpy as np
import pytest

from quadwalk.errors import UsageError
from quadwalk.evaluation.load import load_run
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run, find_any_run, find_ready, get_results_folder
from quadwalk.view.choices import LAST, getup_of, open_run
from quadwalk.view.live import LiveRobot


def test_they_are_found_where_there_is_no_other(tmp_path):
    assert find_ready(tmp_path, "latest", "walk").path == PRETRAINED / "walk"
    assert find_any_run(tmp_path, "run").path == PRETRAINED / "run"
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "policy.npz").touch()
    assert find_any_run(tmp_path, "run").path == tmp_path / "run"
    assert find_ready(tmp_path, "latest", "walk").path == tmp_path / "run"
    for name in ("fly", "", "..", "../pretrained"):
        with pytest.raises(UsageError):
            find_any_run(tmp_path, name)


def test_nothing_is_written_to_them(tmp_path, monkeypatch):
    monkeypatch.chdir(PRETRAINED.parent)
    for name in ("walk", "run"):
        for path in (PRETRAINED / name, Path("pretrained") / name):
            assert get_results_folder(tmp_path, Run(path)) == tmp_path / "pretrained" / name
    assert get_results_folder(tmp_path, Run(tmp_path / "walk")) == tmp_path / "walk"


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [("walk", 0.6, 1.4), ("drive", 0.7, 1.3), ("rough", 0.6, 1.4), ("run", 3.0, 7.0)],
)
def test_each_goes_where_it_is_told(name, least, most):
    run = Run(PRETRAINED / name)
    assert sum(file.stat().st_size for file in run.path.iterdir()) < 1_000_000
    robot = LiveRobot(load_run(run, 10.0, engine="mujoco"))
    robot.command[:] = 1.0, 0.0, 0.0
    speeds = []
    for _ in range(200):
        robot.step()
        speeds.append(robot.velocity[0])
        assert not robot.fell
    assert least < np.mean(speeds[-50:]) < most


@pytest.mark.parametrize("kind", ["stairs_up", "blocks"])
def test_rough_climbs_what_is_chosen(kind):
    robot = LiveRobot(load_run(Run(PRETRAINED / "rough"), 10.0, engine="mujoco"))
    terrain = robot.env.terrain
    robot.tile = terrain.tiles.index(terrain.tile(kind, 1))  # difficulty 0.5
    robot.reset()
    robot.command[:] = 0.7, 0.0, 0.0
    first, heights = robot.data.qpos[:2].copy(), []
    for _ in range(250):
        robot.step()
        heights.append(terrain.field.height_at(robot.data.qpos[:2]))
        assert not robot.fell
    assert np.linalg.norm(robot.data.qpos[:2] - first) > 2.0
    assert np.ptp(heights) > 0.04


def test_what_is_thrown_over_gets_up_and_drives_on():
    loaded = open_run(Run(PRETRAINED / "drive"), LAST)
    robot = LiveRobot(loaded, getup=getup_of(loaded, Run(PRETRAINED / "getup")))
    robot.command[:] = 2.0, 0.0, 0.0
    modes, speeds = [], []
    for step in range(400):
        if step == 100:
            robot.throw()
        robot.step()
        modes.append(robot.rising)
        speeds.append(robot.velocity[0])
    fell, stood = modes.index(True), 400 - modes[::-1].index(True)
    assert 100 <= fell < stood <= 300
    assert 1.5 < np.mean(speeds[-50:]) < 2.5
