"""Where a robot is driven, and what is said when it cannot be: one line."""

import dataclasses
import importlib.util
import sys

import mujoco
import numpy as np
import pytest

from quadwalk.cli.shell import suggest_install
from quadwalk.errors import UsageError, UserError
from quadwalk.learn.loop import train
from quadwalk.tasks import walk
from quadwalk.view.show import ViewConfig, drive, main, no_window
from quadwalk.view.traces import Traces
from quadwalk.view.window import Keys, draw_overlay

NO_SCREEN = "neither DISPLAY nor WAYLAND_DISPLAY is set"


@pytest.fixture
def no_screen(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def without_the_extra(no_screen, monkeypatch):
    """No mjviser, and no screen."""
    known = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "mjviser" else known(name)
    )


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a screen")
def test_without_the_extra_one_line_says_which(without_the_extra, runs):
    with pytest.raises(UserError) as caught:
        main(["dog", f"--runs={runs}"], "quadwalk view")
    assert str(caught.value) == (
        f"there is no window ({NO_SCREEN}), and a page needs mjviser, which is not installed: "
        f"{suggest_install('view')}"
    )


def test_training_says_so_before_it_begins(without_the_extra, tmp_path):
    with pytest.raises(UserError, match=r"^--watch needs mjviser, .* -m pip install .*\[view\]'$"):
        train(dataclasses.replace(walk.TASK, watch=True, runs=tmp_path / "runs"))
    assert not (tmp_path / "runs").exists()


def test_a_run_that_is_not_there_and_a_port_that_is_none(runs):
    with pytest.raises(UsageError, match="no run 'nobody'"):
        drive(ViewConfig("nobody", runs=runs))
    with pytest.raises(UsageError, match="--port is 70000; expected 0 to 65535"):
        ViewConfig(port=70000)


def test_the_windows_keys_command_the_robot(fresh):
    keys = Keys(fresh)
    for key in (265, 265, 263, 267):  # up, up, left, PageDown
        keys.press(key)
    assert not fresh.command.any()  # not from the window's thread
    keys.answer()
    assert fresh.command == pytest.approx([0.3, -0.05, 0.1])
    keys.press(32)
    keys.press(269)  # space, End
    keys.answer()
    assert not keys.playing
    assert not fresh.command.any()


def test_the_windows_overlay_is_path_velocity_and_command(fresh):
    fresh.command[:] = 1.0, 0.0, 0.0
    fresh.data.qvel[0] = 2.0
    traces = Traces(fresh.env.stepping.control_dt)
    for _ in range(30):
        fresh.step()
        traces.add(fresh)
    fresh.data.qvel[:3] = 2.0, 0.0, 0.0
    scene = mujoco.MjvScene(fresh.model, maxgeom=1000)
    draw_overlay(scene, fresh, traces)
    drawn = [scene.geoms[k] for k in range(scene.ngeom)]
    arrows = [geom for geom in drawn if geom.type == mujoco.mjtGeom.mjGEOM_ARROW]
    assert len(arrows) == 2
    does, told = (geom.mat[:, 2] * geom.size[2] for geom in arrows)
    assert does == pytest.approx([2.0 * np.linalg.norm(told), 0.0, 0.0], abs=1e-5)
    ahead = np.array([np.cos(fresh.heading), np.sin(fresh.heading), 0.0])
    assert told == pytest.approx(ahead * np.linalg.norm(told), abs=1e-5)
    assert len(drawn) == 2 + len(traces.path)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a screen")
@pytest.mark.parametrize(
    ("variables", "reason"),
    [
        ({}, NO_SCREEN),
        ({"DISPLAY": ":0", "MUJOCO_GL": "osmesa"}, "MUJOCO_GL is osmesa, which has no window"),
        ({"DISPLAY": ":4567"}, "display :4567"),
    ],
)
def test_without_a_screen_one_line_says_why(no_screen, monkeypatch, variables, reason):
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    line = no_window()
    assert line is not None
    assert reason in line
    assert "\n" not in line
