"""The desk: numbers that change while a training runs, what is kept of it, and what undoes it."""

import contextlib
import json
import queue
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import toy
from websockets.sync.client import ClientConnection, connect

from quadwalk.errors import UsageError
from quadwalk.learn.acting import load_policy
from quadwalk.learn.flags import parse_config
from quadwalk.learn.loop import train
from quadwalk.learn.recipe import format_flags, format_task
from quadwalk.runs.changes import change_number, list_standing, read_changes
from quadwalk.runs.directory import Run, list_checkpoints
from quadwalk.runs.log import read_metrics
from quadwalk.runs.resume import read_config
from quadwalk.settings.serialize import change_settings
from quadwalk.settings.terms import Reward
from quadwalk.task_files import load_task
from quadwalk.terms import rewards
from quadwalk.web.serve import SOCKET, PageServer, serve_page
from tests.web.browser import wait_until

ITERATIONS = 12
OFTEN = "--checkpoint-steps=128"  # after every second iteration
SCALE, ENERGY = "env.reward.forward.scale", "env.reward.energy.scale"


def write_set(name: str, value: Any) -> dict[str, Any]:
    return {"type": "set", "name": name, "value": value}


class FakePage:
    """A page that sends messages after iterations, and keeps what it gets."""

    def __init__(self, script: dict[int, list[dict[str, Any]]]) -> None:
        self.script = dict(script)
        self.sent: list[dict[str, Any]] = []
        self.messages: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()

    def send(self, message: dict[str, Any]) -> None:
        self.sent.append(json.loads(json.dumps(message, allow_nan=False)))
        if message["type"] == "iteration":
            for reply in self.script.pop(message["iteration"], []):
                self.messages.put(reply)

    def get(self, kind: str) -> list[dict[str, Any]]:
        return [message for message in self.sent if message["type"] == kind]

    def get_errors(self) -> list[str]:
        return [note["text"] for note in self.get("note") if note["error"]]


class ServedPage:
    """A page's process as a training has it, for the browsers that a server has."""

    def __init__(self, server: PageServer) -> None:
        self.messages: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._server = server
        server.on_message = lambda text: self.messages.put(json.loads(text))

    def send(self, message: dict[str, Any]) -> None:
        self._server.forward(json.dumps(message))


def train_at_desk(arguments: list[str], script: Any = None, **options: Any) -> FakePage:
    """Train the toy; return the page, which sends a script's messages after iterations."""
    page = FakePage(script or {})
    train_with_page(page, [*arguments, *([] if script is None else ["--desk"])], **options)
    return page


def train_with_page(page: FakePage | ServedPage, arguments: list[str], **options: Any) -> None:
    """Train the toy with this page, which `--desk` shows."""

    @contextlib.contextmanager
    def show_page(path: Path, say: Any) -> Iterator[FakePage | ServedPage]:
        yield page

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("quadwalk.learn.prepare.QuadrupedEnv", toy.DeskToy)
        patch.setattr("quadwalk.learn.loop.check_watch", lambda: None)
        patch.setattr("quadwalk.learn.loop.show_page", show_page)
        train(*parse_config(arguments), **options)


@pytest.fixture
def use_desk(tmp_path, flags) -> Callable[..., FakePage]:
    """Train the run `name` with a page that sends a script's messages after iterations."""

    def use(name: str, script: Any = None, *more: str, **options: Any) -> FakePage:
        arguments = flags(tmp_path, name, ITERATIONS, OFTEN, *more)
        return train_at_desk(arguments, script, **options)

    return use


@pytest.fixture(scope="module")
def plain(tmp_path_factory, flags) -> Path:
    """Return the run of a desk at which nothing was changed."""
    runs = tmp_path_factory.mktemp("plain")
    train_at_desk(flags(runs, "plain", ITERATIONS, OFTEN), {})
    return runs / "plain"


@pytest.fixture(scope="module")
def changed_run(tmp_path_factory, flags) -> tuple[Path, FakePage]:
    """Return a run in which a reward changed its sign after three iterations, and its page."""
    runs = tmp_path_factory.mktemp("turned")
    page = train_at_desk(flags(runs, "turned", ITERATIONS, OFTEN), {3: [write_set(SCALE, -1.0)]})
    return runs / "turned", page


def test_a_changed_reward_counts_in_the_next_iteration(plain, changed_run):
    run, page = changed_run
    before, after = read_metrics(Run(plain)), read_metrics(Run(run))
    np.testing.assert_equal(after[:3], before[:3])
    column = "train/reward/forward"
    assert after[3][column] == -before[3][column] != 0.0
    assert after[4]["train/speed"] != before[4]["train/speed"]
    shares = page.get("iteration")[3]["shares"]
    assert shares["forward"] == after[3][column]
    assert sum(shares.values()) == pytest.approx(after[3]["train/reward"], abs=1e-5)
    number = next(n for n in page.get("desk")[-1]["numbers"] if n["name"] == SCALE)
    assert (number["value"], number["start"], number["group"]) == (-1.0, 1.0, "reward")
    states = [message["state"] for message in page.get("desk")]
    assert states[0] == "training"
    assert states[-1] == "ended"


def test_what_a_policy_was_trained_with_is_kept_with_it(changed_run):
    run = Run(changed_run[0])
    policy = load_policy(run.policy)
    assert policy.changed == {"env.reward.forward": {"start": 1.0, "now": -1.0}}
    assert policy.config.env.reward["forward"].scale == -1.0
    assert read_config(run).env.reward["forward"].scale == 1.0
    (change,) = read_changes(run)
    assert (change.iteration, change.steps, change.name) == (3, 192, SCALE)
    assert (change.old, change.new) == (1.0, -1.0)


def test_a_session_is_repeated_bit_for_bit(use_desk, tmp_path, same_result):
    script = {
        0: [],
        2: [write_set(ENERGY, -2.0), write_set(ENERGY, -3.0)],
        4: [write_set(SCALE, 0.5), {"type": "add", "term": "crossed"}],
        6: [write_set("env.reward.crossed.scale", 0.3)],
        7: [{"type": "undo"}],
        8: [{"type": "total", "value": 64 * (ITERATIONS + 2)}],
    }
    use_desk("session", script)
    use_desk("again", None, f"--replay={tmp_path / 'session'}")
    same_result(tmp_path / "again", tmp_path / "session")
    rows = read_metrics(Run(tmp_path / "again"))
    assert len(rows) == ITERATIONS + 2
    assert "train/reward/crossed" not in rows[3]
    assert "train/reward/crossed" in rows[4]
    standing = list_standing(read_changes(Run(tmp_path / "session")))
    assert standing == read_changes(Run(tmp_path / "again"))
    assert [change.name.split(".")[2:] for change in standing] == [
        ["energy", "scale"], ["energy", "scale"], ["forward", "scale"], ["crossed"], [],
    ]  # fmt: skip


@pytest.mark.parametrize("change", [write_set(SCALE, -1.0), {"type": "add", "term": "crossed"}])
def test_an_undone_change_has_never_been(use_desk, plain, tmp_path, same_result, change):
    page = use_desk("undone", {4: [change], 7: [{"type": "undo"}]})
    same_result(tmp_path / "undone", plain)
    assert [change.undo for change in read_changes(Run(tmp_path / "undone"))] == [False, True]
    assert not page.get("desk")[-1]["can_undo"]
    assert not page.get("desk")[-1]["changes"]


LATE = {3: [write_set(SCALE, -1.0)], 4: [{"type": "add", "term": "crossed"}]}


@pytest.fixture(scope="module")
def whole(tmp_path_factory, flags) -> Path:
    """Return the run of a session that changes a number and adds a term."""
    runs = tmp_path_factory.mktemp("whole")
    train_at_desk(flags(runs, "whole", ITERATIONS, OFTEN), LATE)
    return runs / "whole"


class KilledError(BaseException):
    """An error that ends a training without anything being saved."""


@pytest.mark.parametrize("is_lost", [False, True], ids=["after the change", "before it"])
def test_a_killed_session_resumes_with_its_changes(use_desk, whole, tmp_path, same_result, is_lost):
    def kill(row: dict[str, float]) -> None:
        if row["steps"] == 64 * 7:
            raise KilledError

    with pytest.raises(KilledError):
        use_desk("killed", LATE, watch=kill)
    run = Run(tmp_path / "killed")
    last = run.locate_checkpoint(192 if is_lost else 384)
    for path in list_checkpoints(run):
        if path.name > last.name:
            path.unlink()
    assert list_checkpoints(run)[-1] == last
    train_at_desk([f"--runs={tmp_path}", "--resume=killed"])
    # Checkpoints, of which the best is one, are others where one is lost.
    same_result(run.path, whole, best=not is_lost)
    assert read_changes(run) == read_changes(Run(whole))


def test_a_session_killed_by_the_system_keeps_its_change(
    processes, use_desk, flags, tmp_path, same_result
):
    use_desk("whole", None, on_iteration=toy.turn_round)
    arguments = flags(tmp_path, "killed", ITERATIONS, OFTEN)
    process = processes.Process(target=toy.train_until_killed, args=arguments)
    process.start()
    process.join(200)
    assert process.exitcode == -9
    assert list_checkpoints(Run(tmp_path / "killed"))[-1].name == "step_000000000384.npz"
    train_at_desk([f"--runs={tmp_path}", "--resume=killed"])
    same_result(tmp_path / "killed", tmp_path / "whole")
    policy = load_policy(tmp_path / "killed" / "policy.npz")
    assert policy.config.env.reward["forward"].scale == -1.0


def open_browser_socket(server: PageServer) -> ClientConnection:
    """Open the websocket that a page in a browser opens; it keeps all that it gets."""
    url = server.url.replace("http", "ws") + SOCKET
    return connect(url, additional_headers={"Origin": server.url}, max_queue=None)


def read_scales(browser: ClientConnection) -> list[float]:
    """Return the reward's scale in each state of the desk that a browser got, to the last."""
    scales: list[float] = []
    while True:
        message = json.loads(browser.recv(10))
        if message["type"] == "desk":
            scales += [n["value"] for n in message["numbers"] if n["name"] == SCALE]
            if message["state"] == "ended":
                return scales


def test_two_pages_show_one_desk_and_the_last_change_holds(flags, tmp_path):
    with (
        serve_page("127.0.0.1", 8430) as server,
        open_browser_socket(server) as first,
        open_browser_socket(server) as second,
    ):
        page = ServedPage(server)
        changes = {128: (first, 2.0), 256: (second, 3.0), 320: (first, 4.0)}

        def change(row: dict[str, float]) -> None:
            if row["steps"] in changes:
                browser, value = changes[row["steps"]]
                browser.send(json.dumps(write_set(SCALE, value)))
                assert wait_until(lambda: not page.messages.empty())

        train_with_page(page, flags(tmp_path, "shared", 6, "--desk"), watch=change)
        scales = [read_scales(browser) for browser in (first, second)]
    assert scales == [[1.0, 2.0, 3.0, 4.0, 4.0]] * 2
    assert [change.new for change in read_changes(Run(tmp_path / "shared"))] == [2.0, 3.0, 4.0]


def test_what_cannot_be_is_a_line_and_changes_nothing(use_desk, plain, tmp_path, same_result):
    bad = {
        (SCALE, "x"): "expected a number",
        (SCALE, None): "expected a number",
        (SCALE, True): "expected a number",
        (SCALE, float("nan")): "expected a finite number",
        (SCALE, 1e300): "expected at most",
        ("env.randomization.friction.0", -1.0): "0 to 100",
        ("env.randomization.friction.0", 90.0): "the lower first",
        ("env.reward.forwart.scale", 1.0): "did you mean 'env.reward.forward.scale'",
        ("env.gravity", 1.0): "no number 'env.gravity' at the desk",
    }
    odd = [
        {"type": "add", "term": "nothing"}, {"type": "add", "term": "energy"},
        {"type": "add", "term": "trot"}, {"type": "undo"}, {"type": "total", "value": 1},
        {"type": "save", "file": "../a.py"},
    ]  # fmt: skip
    script = {2: [write_set(*pair) for pair in bad], 3: [*odd, {"type": "huh"}, {}]}
    page = use_desk("bad", script)
    errors = page.get_errors()
    assert len(errors) == len(bad) + len(odd)
    for error, expected in zip(errors, bad.values(), strict=False):
        assert expected in error
    assert "'trot' does not give a number" in errors[len(bad) + 2]
    same_result(tmp_path / "bad", plain)
    assert not read_changes(Run(tmp_path / "bad"))


def test_a_training_pauses_goes_on_and_stops(use_desk, tmp_path):
    script = {
        3: [{"type": "pause"}, write_set(SCALE, 2.0), {"type": "go"}],
        5: [{"type": "stop"}],
    }
    page = use_desk("paused", script)
    states = [message["state"] for message in page.get("desk")]
    assert states == ["training", "paused", "paused", "training", "training", "ended"]
    assert read_metrics(Run(tmp_path / "paused"))[-1]["steps"] == 64 * 5


def test_weights_that_are_lost_undo_the_change(use_desk, plain, tmp_path, same_result):
    page = use_desk("lost", {4: [write_set("env.reward.diagonal.height", 0.0)]})
    (error,) = page.get_errors()
    assert "no longer finite" in error
    same_result(tmp_path / "lost", plain)


def test_a_notebook_changes_numbers_by_a_function(use_desk, tmp_path):
    iterations = []

    def look(iteration):
        iterations.append(iteration)
        return {"env.reward.forward": -2.0} if iteration.iteration == 2 else None

    use_desk("notebook", None, on_iteration=look)
    assert [each.steps for each in iterations] == [64 * (k + 1) for k in range(ITERATIONS)]
    assert [each.scales["forward"] for each in iterations[:4]] == [1.0, 1.0, -2.0, -2.0]
    assert iterations[2].numbers[SCALE] == -2.0
    assert iterations[0].row["steps"] == 64
    assert len(read_changes(Run(tmp_path / "notebook"))) == 1


def test_a_run_without_a_desk_cannot_be_repeated(flags, train, tmp_path):
    train(*flags(tmp_path, "a", 1))
    assert not Run(tmp_path / "a").desk.exists()
    with pytest.raises(UsageError, match="expected a run trained with --desk"):
        parse_config([f"--runs={tmp_path}", "--replay=a"])


def make_changed(config):
    """Return a task with numbers of each group changed, and a term added."""
    for name, value in {
        "env.reward.energy.scale": -1e-5,
        "env.reward.diagonal.height": 0.07,
        "env.termination.tipped.angle": 0.9,
        "env.randomization.friction.1": 1.5,
    }.items():
        config = change_number(config, name, value)
    return change_settings(config, {"steps": 40_000_000, "ppo.symmetric": False})


def add_term(config):
    term = Reward(rewards.crossed, {"margin": 0.02}, scale=-0.5)
    return change_settings(config, {"env.reward.crossed": term})


def test_a_command_line_trains_the_same(tmp_path):
    config = make_changed(load_task("run"))
    line = format_flags(config, Run(tmp_path))
    words = line.partition(" run ")[2].split()
    again, _ = parse_config(["run", *words])
    assert (again.env, again.ppo, again.steps) == (config.env, config.ppo, config.steps)
    with pytest.raises(Exception, match="crossed was added: save a task file"):
        format_flags(add_term(config), Run(tmp_path))


def test_a_task_file_trains_the_same(tmp_path):
    config = add_term(make_changed(load_task("run")))
    path = tmp_path / "better.py"
    path.write_text(format_task(config, Run(tmp_path), "better"))
    again = load_task(path)
    assert (again.env, again.ppo, again.steps) == (config.env, config.ppo, config.steps)
    assert again.task == "better"


def test_a_task_file_of_ones_own_is_saved_with_its_functions(tmp_path):
    source = Path(__file__).parents[2] / "docs" / "extend.md"
    code = source.read_text().partition("```python\n")[2].partition("```")[0]
    run = Run(tmp_path / "run")
    run.path.mkdir()
    (run.path / "task.py").write_text(code)
    config = add_term(change_number(load_task(run.path / "task.py"), "env.reward.bounce.most", 1.5))
    path = tmp_path / "higher.py"
    path.write_text(format_task(config, run, "higher"))
    again = load_task(path)
    assert again.env.reward["bounce"].params == {"most": 1.5}
    assert again.env.reward["crossed"] == config.env.reward["crossed"]
    assert again.task == "higher"


def test_a_saved_task_trains_with_equal_numbers(use_desk, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = use_desk("first", {2: [write_set(SCALE, 0.5), {"type": "save", "file": "mine.py"}]})
    (text,) = page.get("text")
    assert (text["kind"], text["file"]) == ("task", str(tmp_path / "mine.py"))
    assert text["text"] == Path("mine.py").read_text()
    config, _ = parse_config(["mine.py", f"--runs={tmp_path}"])
    trained = load_policy(Run(tmp_path / "first").policy).config
    assert config.env.reward["forward"].scale == 0.5
    assert (config.env, config.ppo, config.steps) == (trained.env, trained.ppo, trained.steps)
