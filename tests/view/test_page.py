"""The page without a browser: what its panel is set to is what the robot suffers."""

import asyncio
import html
import io
import itertools
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator

import numpy as np
import pytest
from markdown_it import MarkdownIt
from rich.console import Console

from quadwalk.errors import UsageError
from quadwalk.runs.directory import Run
from quadwalk.view.choices import LAST
from tests.view.browser import wait
from tests.view.conftest import write_policy

pytest.importorskip("mjviser", reason="mjviser is not installed: pip install 'quadwalk[view]'")

import viser
from msgspec import msgpack
from websockets.sync.client import connect

from quadwalk.view.page import Page
from quadwalk.view.server import serving, url_of


@pytest.fixture(scope="module")
def page(runs) -> Iterator[Page]:
    """A page that no browser has opened."""
    with serving("127.0.0.1", 8300, Console(quiet=True)) as server:
        yield Page(server, Run(runs / "dog"), runs)


def press(page: Page, *names: str) -> None:
    """Trigger the commands of these names, as their keys do, and have the page answer."""
    commands = {each.label: each for each in page._server.gui._command_handle_from_uuid.values()}
    for name in names:
        for callback in commands[name]._impl.trigger_cb:
            asyncio.run(callback(None))
    page.run_for(0.05)


def test_the_sliders_command_the_robot(page):
    page.panel.command[0].value = 0.7
    page.panel.command[2].value = -0.4
    page.run_for(0.05)
    assert page.live.command == pytest.approx([0.7, 0.0, -0.4])


def test_keys_change_the_command_by_a_tenth_of_its_range(page):
    for slider in page.panel.command:
        slider.value = 0.0
    press(page, *["forward: more"] * 3, "to the left: less", "turn left: more")
    assert page.live.command == pytest.approx([0.45, -0.05, 0.1])
    assert [slider.value for slider in page.panel.command] == pytest.approx([0.45, -0.05, 0.1])
    press(page, *["forward: more"] * 20)
    assert page.live.command[0] == pytest.approx(1.5)  # and no more than was trained on
    press(page, "stop")
    assert not page.live.command.any()


def test_the_other_sliders_take_effect_at_once(page):
    values = {"friction": 0.4, "payload": 2.0, "strength": 80.0, "latency": 20.0, "noise": 1.5}
    for name, value in values.items():
        page.panel._settings[name].value = value
    page.run_for(0.05)
    settings = page.live.settings
    assert (settings.friction, settings.payload, settings.noise) == (0.4, 2.0, 1.5)
    assert settings.strength == pytest.approx(0.8)
    assert settings.latency == pytest.approx(0.02)
    assert np.all(page.live.model.geom_friction[:, 0] == np.float32(0.4))


def test_a_pause_holds_the_robot_and_a_push_moves_it(page):
    page.live.reset()
    press(page, "play or pause")
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
    press(page, "reset")
    assert page.live.data.qpos == pytest.approx(page.live.env.robot.home)
    press(page, "play or pause")


def test_the_page_says_when_time_is_not_kept(page, monkeypatch):
    page.pace.restart()
    page.run_for(1.2)
    slow = page.live.step

    def slower() -> None:
        slow()
        time.sleep(0.05)

    monkeypatch.setattr(page.live, "step", slower)
    page.run_for(3.0)
    assert "not in real time" in page.status()
    assert 0.05 < page.pace.reached < 0.4  # 0.02 s in 0.05 and more


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
    assert (page.run.name, page.label) == ("hare", LAST)
    assert page.panel.command == []  # it takes none
    assert "hare" in page.status()
    choose(page, "run", "cat")
    assert page.run.name == "cat"
    assert len(page.panel.command) == 3


def test_a_runs_name_is_shown_as_it_is(page, monkeypatch, tmp_path):
    name = "<script>x</script> **a** [b](c) {d} _e_ `f` & \\ !"
    monkeypatch.setattr(page, "run", Run(tmp_path / name.replace("/", "\\")))
    shown = MarkdownIt("commonmark").render(page.status())
    assert f"<strong>{html.escape(page.run.name)}</strong>" in shown


CAMERA = {
    "type": "ViewerCameraMessage",
    **dict.fromkeys(("position", "look_at", "up_direction"), (0.0, 0.0, 1.0)),
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    **dict.fromkeys(("fov", "near", "far"), 1.0),
    **dict.fromkeys(("image_height", "image_width"), 100),
}


def test_messages_that_are_none_leave_the_page_as_it_was(page, capfd, caplog):
    url = f"ws://127.0.0.1:{page._server.get_port()}"
    controls = page._server.gui._gui_input_handle_from_uuid
    odd = ("no such choice", float("nan"), 1e300, [], None)
    updates = [
        {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
        for uuid in controls
        for value in odd
    ]
    messages = [msgpack.encode(m) for m in ({"type": "None"}, [1], *updates)]
    for message in ("text", b"\xff", b"", *messages):
        with connect(url, subprotocols=[f"viser-v{viser.__version__}"]) as client:
            client.send(msgpack.encode(CAMERA))
            client.send(message)
            page.run_for(0.02)
    before = page.live.steps
    page.playing = True
    page.run_for(0.5)
    assert page.live.steps > before
    assert np.isfinite(page.live.data.qpos).all()
    assert capfd.readouterr() == ("", "")
    assert not caplog.records


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere 127.0.0.2 is no address")
def test_it_listens_on_this_machine_alone(page):
    """A server of all addresses would answer at every one that begins with 127."""
    port = page._server.get_port()
    socket.create_connection(("127.0.0.1", port), timeout=5.0).close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", port), timeout=5.0)


_TRAINER = """
import sys
from pathlib import Path
from quadwalk.progress.watch import show_page
with show_page(Path(sys.argv[1]), lambda line: print(line, flush=True)):
    sys.stdin.read()
"""


def listens(url: str) -> bool:
    try:
        urllib.request.urlopen(url, timeout=5.0).close()
    except OSError:
        return False
    return True


@pytest.mark.parametrize("killed", [False, True])
def test_a_training_shows_its_page_in_a_process_that_ends_with_it(runs, killed):
    command = [sys.executable, "-c", _TRAINER, str(runs / "dog")]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as trainer:
        assert trainer.stdin is not None
        assert trainer.stdout is not None
        (line,) = itertools.islice((line for line in trainer.stdout if "drive it at" in line), 1)
        url = line.partition("drive it at ")[2].split()[0]
        with urllib.request.urlopen(url, timeout=30.0) as answer:
            assert answer.status == 200
        if killed:
            trainer.kill()
        else:
            trainer.stdin.close()
        trainer.wait(30.0)
    assert wait(lambda: not listens(url))


def test_a_host_of_ipv6_is_a_url_with_brackets():
    assert url_of("::1", 8080) == "http://[::1]:8080"
    assert url_of("127.0.0.1", 8081) == "http://localhost:8081"


@pytest.mark.parametrize("host", ["no-such-host.invalid", "192.0.2.1", "", "a b", "\0", "x" * 300])
def test_a_host_that_is_not_this_machine_is_told_at_once(host):
    with (
        pytest.raises(UsageError, match=r"^--host is .*; expected an address of this machine$"),
        serving(host, 8300, Console(quiet=True)),
    ):
        pass


def test_a_port_that_is_taken_is_said():
    said = io.StringIO()
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with serving("127.0.0.1", port, Console(file=said, width=200)) as server:
            free = server.get_port()
    assert free != port
    first, second = said.getvalue().splitlines()
    assert first == f"port {port} is taken, so the page is at port {free}"
    assert f":{free} " in second
