"""The page without a browser: what its panel is set to is what the robot suffers."""

import asyncio
import socket
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator

import numpy as np
import pytest
from rich.console import Console

from quadwalk.train.progress.watch import watched
from quadwalk.train.runs.directory import Run
from quadwalk.view.choices import NEWEST
from tests.view.conftest import write_policy

pytest.importorskip("mjviser", reason="mjviser is not installed: pip install 'quadwalk[view]'")

from quadwalk.view.page import Page
from quadwalk.view.server import serving


@pytest.fixture(scope="module")
def page(runs) -> Iterator[Page]:
    """A page that no browser has opened."""
    with serving("127.0.0.1", 8300, Console(quiet=True)) as server:
        yield Page(server, Run(runs / "dog"), runs)


def press(page: Page, name: str) -> None:
    """Trigger the command of this name, as its key does."""
    commands = page._server.gui._command_handle_from_uuid.values()
    (command,) = [command for command in commands if command.label == name]
    for callback in command._impl.trigger_cb:
        asyncio.run(callback(None))


def answered(page: Page) -> None:
    page.run_for(0.05)


def test_the_sliders_command_the_robot(page):
    page.panel.command[0].value = 0.7
    page.panel.command[2].value = -0.4
    answered(page)
    assert page.live.command == pytest.approx([0.7, 0.0, -0.4])


def test_keys_change_the_command_by_a_tenth_of_its_range(page):
    for slider in page.panel.command:
        slider.value = 0.0
    for _ in range(3):
        press(page, "forward: more")
    press(page, "to the left: less")
    press(page, "turn left: more")
    answered(page)
    assert page.live.command == pytest.approx([0.45, -0.05, 0.1])
    assert [slider.value for slider in page.panel.command] == pytest.approx([0.45, -0.05, 0.1])
    for _ in range(20):
        press(page, "forward: more")
    answered(page)
    assert page.live.command[0] == pytest.approx(1.5)  # and no more than was trained on
    press(page, "stop")
    answered(page)
    assert not page.live.command.any()


def test_the_other_sliders_take_effect_at_once(page):
    values = {"friction": 0.4, "payload": 2.0, "strength": 80.0, "latency": 20.0, "noise": 1.5}
    for name, value in values.items():
        page.panel._settings[name].value = value
    answered(page)
    settings = page.live.settings
    assert (settings.friction, settings.payload, settings.noise) == (0.4, 2.0, 1.5)
    assert settings.strength == pytest.approx(0.8)
    assert settings.latency == pytest.approx(0.02)
    assert np.all(page.live.model.geom_friction[:, 0] == np.float32(0.4))


def test_a_pause_holds_the_robot_and_a_push_moves_it(page):
    page.live.reset()
    press(page, "play or pause")
    answered(page)
    still = page.live.data.qpos.copy()
    before = page.live.velocity
    page.panel._push("right")
    page.run_for(0.2)
    assert np.array_equal(page.live.data.qpos, still)
    assert page.live.velocity - before == pytest.approx([0.0, -1.0, 0.0])
    assert "paused" in page.status()
    press(page, "play or pause")
    page.run_for(0.3)
    assert page.live.data.qpos[1] < still[1] - 0.02


def test_reset_stands_it_up(page):
    press(page, "play or pause")
    answered(page)
    press(page, "reset")
    answered(page)
    assert page.live.data.qpos == pytest.approx(page.live.env.robot.home)
    press(page, "play or pause")
    answered(page)


def test_the_page_says_when_time_is_not_kept(page):
    page.pace.restart()
    page.run_for(1.2)
    slow = page.live.step

    def slower() -> None:
        slow()
        time.sleep(0.05)

    page.live.step = slower
    try:
        page.run_for(3.0)
        assert "not in real time" in page.status()
        assert 0.05 < page.pace.reached < 0.4  # 0.02 s in 0.05 and more
    finally:
        del page.live.step


def test_slow_motion(page):
    page.live.reset()
    page.pace.restart()
    page.pace.speed = 0.25
    page.run_for(1.0)
    assert page.live.time == pytest.approx(0.25, abs=0.1)
    page.pace.speed = 1.0


def test_a_policy_that_training_wrote_drives_on(page, walk_env):
    """In the place of the file that is driven, as `train.py --watch` does."""
    before = page.live
    write_policy(page.run.policy, walk_env, seed=9)
    page.run_for(1.5)
    assert page.live is before  # it is not stopped
    assert page.live.policy.steps == 9
    assert "9 steps of training" in page.status()
    write_policy(page.run.policy, walk_env, seed=3)


def choose(page: Page, label: str, text: str) -> None:
    """Choose `text` in the dropdown called `label`."""
    handles = page._server.gui._gui_input_handle_from_uuid.values()
    (dropdown,) = [handle for handle in handles if handle._impl.props.label == label]
    dropdown.value = text
    page.run_for(0.3)


def test_another_policy_and_another_run(page):
    choose(page, "policy", "3 steps")
    assert (page.label, page.live.policy.steps) == ("3 steps", 3)
    choose(page, "run", "hare")
    assert (page.run.name, page.label) == ("hare", NEWEST)
    assert page.panel.command == []  # it takes none
    assert "hare" in page.status()
    choose(page, "run", "cat")
    assert page.run.name == "cat"
    assert len(page.panel.command) == 3


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere 127.0.0.2 is no address")
def test_it_listens_on_this_machine_alone(page):
    """A server of all addresses would answer at every one that begins with 127."""
    port = page._server.get_port()
    socket.create_connection(("127.0.0.1", port), timeout=5.0).close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", port), timeout=5.0)


def test_a_training_shows_its_page_in_a_process_of_its_own(runs):
    said: list[str] = []
    with watched(Run(runs / "dog"), said.append):
        end = time.monotonic() + 60.0
        while not any("drive it at" in line for line in said) and time.monotonic() < end:
            time.sleep(0.1)
        (line,) = [line for line in said if "drive it at" in line]
        url = line.partition("drive it at ")[2].split()[0]
        with urllib.request.urlopen(url, timeout=30.0) as answer:
            assert answer.status == 200
    with pytest.raises(urllib.error.URLError):  # it ends with the training
        urllib.request.urlopen(url, timeout=5.0)
