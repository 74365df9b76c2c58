"""The reward desk in a real browser, with a training that is made up."""

import json
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from quadwalk.web import site
from quadwalk.web.serve import PageServer, serve_page
from tests.web.browser import PROGRAM, Browser, open_browser, wait_until

if PROGRAM is None:
    pytest.skip("there is no chromium: apt-get install chromium", allow_module_level=True)

ENERGY = "env.reward.energy.scale"
SLIDER = "document.querySelector('#desk section input[type=range]')"
FIELD = "document.querySelector('#desk section input[type=number]')"


class Training:
    """A made-up training: what its page hears of it, and what the page asks of it."""

    def __init__(self, server: PageServer) -> None:
        self.heard: list[dict[str, Any]] = []
        self.values = {ENERGY: -0.2, "env.reward.follow.scale": 1.0}
        self.changes: list[dict[str, Any]] = []
        self.iteration = 0
        self._server, self._is_over = server, threading.Event()
        server.on_message = self.answer
        self._thread = threading.Thread(target=self.run)

    def __enter__(self) -> "Training":
        self.send_state()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()

    def send(self, message: dict[str, Any]) -> None:
        self._server.forward(json.dumps(message))

    def run(self) -> None:
        """Send an iteration each quarter of a second."""
        while not self._is_over.wait(0.25):
            self.iteration += 1
            row = {"train/speed": 0.1 * self.iteration, "train/reward": 0.5}
            shares = {"energy": -0.1, "follow": 0.4}
            steps = 1000 * self.iteration
            count = {"iteration": self.iteration, "steps": steps, "seconds": steps / 4000}
            self.send({"type": "iteration", **count, "shares": shares, "row": row})

    def send_state(self) -> None:
        start = {ENERGY: -0.2, "env.reward.follow.scale": 1.0}
        numbers = [
            {"name": name, "term": name.split(".")[2], "group": "reward", "label": "scale"}
            | {"value": value, "start": start[name], "low": None, "high": None}
            | {"unit": "", "help": "Power over weight."}
            for name, value in self.values.items()
        ]
        state = {"iteration": self.iteration, "steps": 1000 * self.iteration, "total": 10**6}
        state |= {"state": "training", "numbers": numbers, "changes": self.changes}
        available = [{"term": "drag", "help": "Speed of feet on the ground."}]
        state |= {"available": available, "can_undo": bool(self.changes)}
        self.send({"type": "desk", **state})

    def answer(self, text: str) -> None:
        message = json.loads(text)
        self.heard.append(message)
        count = {"iteration": self.iteration, "steps": 1000 * self.iteration}
        if message["type"] == "set":
            name, new = message["name"], message["value"]
            self.changes.append({**count, "name": name, "old": self.values[name], "new": new})
            self.values[name] = new
        elif message["type"] == "undo":
            change = self.changes.pop()
            self.values[change["name"]] = change["old"]
        elif message["type"] == "save":
            answer = {"kind": "task", "text": "TASK = ...", "file": f"/tmp/{message['file']}"}
            self.send({"type": "text", **answer})
        elif message["type"] == "add":
            self.send({"type": "note", "text": "drag cannot be added", "error": True})
        self.send_state()


@pytest.fixture(scope="module")
def training(loaded_runs, vendor_files) -> Iterator[tuple[Training, str]]:
    """Yield a training with the policies of `walk`, and the address of its page."""
    files = site.make_site([site.make_dog(loaded_runs["walk"])], None, live=True)
    after = files["walk.policy.json"]
    files |= {"desk/before.policy.json": after, "desk/after.policy.json": after}
    with serve_page("127.0.0.1", 8370) as server:
        server.set_files(files)
        with Training(server) as training:
            yield training, server.url


@pytest.fixture(scope="module")
def browser(training) -> Iterator[Browser]:
    with open_browser(training[1]) as browser:
        browser.resize(800, 400)  # few pixels, but wide enough for the desk to be open
        browser.ask("Emulation.setFocusEmulationEnabled", enabled=True)  # else nothing blurs
        assert wait_until(lambda: browser.evaluate(f"{SLIDER} !== null"))
        assert wait_until(lambda: browser.evaluate("globalThis.quadwalk?.simulation?.time > 0.1"))
        yield browser


def move_slider(browser: Browser, position: float) -> None:
    """Move the first slider, as a pointer does."""
    browser.evaluate(f"{SLIDER}.value = {position}; {SLIDER}.dispatchEvent(new Event('input'))")


def test_a_slider_changes_the_training_and_undo_takes_it_back(browser, training):
    heard = training[0].heard
    move_slider(browser, -0.53)
    message = {"type": "set", "name": ENERGY, "value": -0.1}
    assert wait_until(lambda: message in heard)
    assert wait_until(lambda: "energy.scale -0.2 to -0.1" in browser.text())
    assert browser.evaluate(f"{FIELD}.value") == "-0.1"
    browser.evaluate("document.getElementById('desk-undo').click()")
    assert wait_until(lambda: {"type": "undo"} in heard)
    assert wait_until(lambda: browser.evaluate(f"{FIELD}.value") == "-0.2")


def test_a_field_is_not_overwritten_while_one_types(browser, training):
    browser.evaluate(f"{FIELD}.focus(); {FIELD}.value = '-0.7'")
    training[0].answer(json.dumps({"type": "set", "name": ENERGY, "value": -3.0}))
    assert wait_until(lambda: "energy.scale -0.2 to -3" in browser.text())
    assert browser.evaluate(f"{FIELD}.value") == "-0.7"
    browser.evaluate(f"{FIELD}.blur()")
    assert wait_until(lambda: browser.evaluate(f"{FIELD}.value") == "-3")


def test_shares_and_what_is_left_are_shown(browser):
    assert wait_until(lambda: "-0.100" in browser.text())
    width = "document.querySelector('#desk .share i').style.width"
    assert browser.evaluate(width) == "12.5%"  # a quarter of the largest, on half the bar
    assert wait_until(lambda: "steps/s" in browser.text())


def test_a_lost_connection_comes_back(browser, training):
    browser.evaluate("quadwalk.server.socket.close()")
    assert wait_until(lambda: browser.evaluate("quadwalk.server.socket.readyState === 1"))
    iteration = training[0].iteration
    expression = (
        "Number(document.getElementById('desk-state').innerText.match(/iteration (\\d+)/)[1])"
    )
    assert wait_until(lambda: browser.evaluate(expression) > iteration)
    assert "has ended" not in browser.text()


def test_two_policies_are_compared_from_one_start(browser, training):
    browser.evaluate("document.getElementById('desk-compare').click()")
    assert wait_until(lambda: browser.evaluate("quadwalk.rival?.time > 0.2"))
    # One policy twice moves as one: both had the same start and the same commands.
    places = "quadwalk.robots.map(robot => Array.from(robot.data.qpos))"
    first, second = browser.evaluate(places)
    assert first == second
    browser.evaluate("document.getElementById('comparison-end').click()")
    assert wait_until(lambda: browser.evaluate("quadwalk.rival === null"))
    hidden = "document.getElementById('comparison').hidden"
    assert wait_until(lambda: browser.evaluate(hidden))


def test_a_task_is_saved_and_an_error_is_a_line(browser, training):
    browser.evaluate("document.getElementById('desk-file').value = 'tall.py'")
    browser.evaluate("document.getElementById('desk-save').click()")
    assert wait_until(lambda: "saved as /tmp/tall.py" in browser.text())
    assert {"type": "save", "file": "tall.py"} in training[0].heard
    browser.evaluate(
        "document.getElementById('desk-add').value = 'drag';"
        "document.getElementById('desk-add').dispatchEvent(new Event('change'))"
    )
    assert wait_until(lambda: "drag cannot be added" in browser.text())
    assert browser.evaluate("document.getElementById('desk-note').className") == "error"


def test_the_desk_is_beside_the_picture_and_folded_on_a_phone(browser, training):
    edges = "[picture.getBoundingClientRect().right, desk.getBoundingClientRect().left]"
    right, left = browser.evaluate(edges)
    assert right <= left
    browser.resize(390, 780, mobile=True)
    browser.ask("Page.navigate", url=training[1])
    assert wait_until(lambda: browser.evaluate("document.getElementById('desk')?.open === false"))
