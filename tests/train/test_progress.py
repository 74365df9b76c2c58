import io
import math
import os
import pty
import re
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from quadwalk.train.progress import display as module
from quadwalk.train.progress import text, view
from quadwalk.train.progress.display import Progress
from quadwalk.train.progress.state import State

FIGURES = {
    "train/speed": 2.5,
    "train/fall_rate": 0.031,
    "train/reward": 12.0,
    "train/reward/forward": 8.0,
    "train/reward/energy": -0.5,
}


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


@pytest.fixture(autouse=True)
def _a_capable_terminal(monkeypatch):
    for name, value in (("TERM", "xterm-256color"), ("COLUMNS", "100"), ("LINES", "40")):
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("NO_COLOR", raising=False)


def train(stream, quiet=False, updates=3, **figures):
    with Progress(3000, quiet=quiet, stream=stream) as progress:
        progress.phase("compiling", 30)
        progress.phase("training")
        for index in range(1, updates + 1):
            progress.update(1000 * index, FIGURES | figures, 2.0 * index)
        progress.message("something [odd] happened")
        progress.phase("saving")
    progress.end("see runs/a")
    return stream.getvalue()


def visible(output):
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", output)


def test_plain_lines_are_ascii_and_say_everything():
    lines = train(io.StringIO()).splitlines()
    assert lines[0] == "[ 0:00] compiling (about 30 s)"
    assert lines[1] == "[ 0:00] training"
    assert "33 %  1.0k/3.0k steps  500 steps/s  0:04 left" in lines[2]
    assert "reward 12.0  speed 2.50 m/s  falls 3.1 %" in lines[2]
    assert "100 %" in lines[3]  # the second came too soon, the last is always shown
    assert lines[4] == "[ 0:00] something [odd] happened"
    assert lines[-1] == "see runs/a"
    assert "\n".join(lines).isascii()


def test_plain_lines_show_an_evaluation_when_it_comes():
    stream = io.StringIO()
    with Progress(10_000, stream=stream) as progress:
        progress.update(1000, FIGURES, 1.0)
        progress.update(2000, FIGURES | {"eval/speed": 3.05, "eval/fall_rate": 0.0}, 2.0)
        progress.update(3000, FIGURES, 3.0)
    assert len(stream.getvalue().splitlines()) == 2
    assert "tested 3.05 m/s, 0.0 % falls" in stream.getvalue()


def test_a_long_phase_gives_a_sign_of_life(monkeypatch):
    monkeypatch.setattr(module, "_HEARTBEAT_SECONDS", 0.5)
    stream = io.StringIO()
    with Progress(10, stream=stream) as progress:
        progress.phase("compiling")
        time.sleep(1.2)
    assert "compiling goes on, 1 s so far" in stream.getvalue()


def test_quiet_is_quiet_until_the_end():
    assert train(io.StringIO(), quiet=True) == "see runs/a\n"
    assert train(Terminal(), quiet=True) == "see runs/a\n"


def test_the_live_view_shows_everything():
    output = visible(train(Terminal()))
    for part in ("compiling (about 30 s)", "✓ compiling", "training", "100 %", "3.0k of 3.0k"):
        assert part in output
    for part in ("2.50 m/s", "3.1 % of episodes", "12.0", "forward", "8.00 ■■■■■■■■", "-0.50 ■ "):
        assert part in output
    assert "something [odd] happened" in output
    assert output.endswith("see runs/a\n")


@pytest.mark.parametrize("error", [None, KeyboardInterrupt, ValueError])
def test_the_terminal_is_restored(error):
    stream, before = Terminal(), threading.active_count()
    stdout = sys.stdout
    try:
        with Progress(10, stream=stream) as progress:
            progress.phase("training")
            if error:
                raise error
    except (KeyboardInterrupt, ValueError):
        pass
    hidden, shown = stream.getvalue().rfind("\x1b[?25l"), stream.getvalue().rfind("\x1b[?25h")
    assert shown > hidden >= 0
    assert ("■ stopped" in visible(stream.getvalue())) == bool(error)
    deadline = time.monotonic() + 5
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() == before
    assert sys.stdout is stdout


@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, None, "text", np.float32("nan")])
def test_numbers_that_are_none_are_dashes(stream, value):
    output = visible(train(stream(), **dict.fromkeys(FIGURES, value)))
    assert re.search(r"speed +- m/s", output)
    assert "nan" not in output.lower()
    assert "inf" not in output.lower()


def test_nan_states_are_shown_when_there_are_any():
    assert "NaN states 3" in train(io.StringIO(), **{"train/nan": 3})
    assert "NaN" not in train(io.StringIO(), **{"train/nan": 0})
    assert re.search(r"NaN +3 states", visible(train(Terminal(), **{"train/nan": 3})))


def test_missing_figures_are_no_error():
    for stream in (io.StringIO(), Terminal()):
        with Progress(0, stream=stream) as progress:
            progress.update(0, {}, 0.0)
            progress.update(5, {}, 0.0)
        assert "nan" not in stream.getvalue()


@pytest.mark.parametrize("width", [1, 10, 24, 40, 80, 200])
def test_no_line_is_wider_than_the_terminal(width):
    state = State(10_000_000, 0)
    state.begin("training", None)
    many = {f"train/reward/a_rather_long_name_{index}": -index for index in range(9)}
    state.update(
        5_000_000, {**FIGURES, **many, "train/nan": 5, "eval/speed": 1.0, "eval/fall_rate": 0.5}, 60
    )
    stream = io.StringIO()
    console = Console(file=stream, width=width)
    for part in (view.figures(state, width), view.terms(state.terms(), width)):
        console.print(part)
    if width >= 24:
        console.print(view.bar(state, width))
    assert max(len(line) for line in stream.getvalue().splitlines()) <= width


def test_rate_and_time_left_are_recent_and_from_the_start_of_this_process():
    state = State(100_000, 50_000)
    assert math.isnan(state.rate)
    state.update(51_000, {}, 10.0)
    assert state.rate == pytest.approx(100)
    for index in range(1, 21):
        state.update(51_000 + 1000 * index, {}, 10.0 + index)
    assert state.rate == pytest.approx(1000)
    assert state.seconds_left == pytest.approx(29.0)


class Broken(io.StringIO):
    def __init__(self, terminal):
        super().__init__()
        self._terminal = terminal

    encoding = "utf-8"

    def isatty(self):
        return self._terminal

    def write(self, _):
        raise self.error

    def flush(self):
        raise self.error


@pytest.mark.parametrize("error", [BrokenPipeError(), OSError(5, "I/O error"), ValueError()])
@pytest.mark.parametrize("terminal", [False, True])
@pytest.mark.filterwarnings("error")
def test_a_closed_output_does_not_end_the_training(monkeypatch, terminal, error):
    monkeypatch.setattr(Broken, "error", error, raising=False)
    train(Broken(terminal))


@pytest.mark.parametrize(("encoding", "term"), [("ascii", "xterm"), ("utf-8", "dumb")])
def test_a_simple_terminal_gets_plain_lines(monkeypatch, encoding, term):
    monkeypatch.setenv("TERM", term)
    stream = Terminal()
    monkeypatch.setattr(Terminal, "encoding", encoding)
    assert train(stream).startswith("[ 0:00] compiling")
    assert "\x1b" not in stream.getvalue()


def test_it_shows_at_once_on_a_real_terminal():
    program = (
        "from quadwalk.train.progress.display import Progress\n"
        "import time\n"
        "with Progress(10) as p:\n"
        "    p.phase('loading'); time.sleep(30)\n"
    )
    master, slave = pty.openpty()
    started = time.monotonic()
    child = subprocess.Popen([sys.executable, "-c", program], stdout=slave, stderr=slave)
    os.close(slave)
    try:
        output = b""
        while b"loading" not in output:
            output += os.read(master, 1000)
        assert time.monotonic() - started < 5
    finally:
        child.kill()
        child.wait()
        os.close(master)


def test_the_import_brings_in_nothing_heavy():
    program = (
        "import sys, quadwalk.train.progress.display; "
        "sys.exit(bool({'jax', 'numpy', 'matplotlib'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@given(st.lists(st.floats(), max_size=200), st.integers(0, 60))
def test_a_sparkline_fits_and_never_fails(values, width):
    line = text.sparkline(values, width)
    assert len(line) == min(width, len(values))
    assert set(line) <= set(" ▁▂▃▄▅▆▇█")


def test_a_sparkline_shows_the_course():
    assert text.sparkline([0, 1, 2, 3, 4, 5, 6, 7], 8) == "▁▂▃▄▅▆▇█"
    assert text.sparkline([0, 0, 7, 7], 2) == "▁█"
    assert text.sparkline([-1, 0, 1], 3) == "▁▅█"
    assert text.sparkline([1, math.nan, 1], 3) == "█ █"
    assert text.sparkline([0, 0], 2) == "▁▁"


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (text.number(12.44), "12.4"),
        (text.number(-0.031), "-0.031"),
        (text.number(0), "0.000"),
        (text.number(1e-9), "1e-09"),
        (text.number(math.nan), "-"),
        (text.percent(0.0312), "3.1 %"),
        (text.percent(math.inf), "-"),
        (text.quantity(950), "950"),
        (text.quantity(999.6), "1.0k"),
        (text.quantity(52_140), "52.1k"),
        (text.quantity(4_100_000), "4.1M"),
        (text.quantity(2e9), "2.0G"),
        (text.duration(59.6), "1:00"),
        (text.duration(751), "12:31"),
        (text.duration(3723), "1:02:03"),
        (text.duration(math.nan), "-"),
        (text.spent(0.44), "0.4 s"),
        (text.spent(31.4), "31 s"),
        (text.spent(125), "2:05"),
    ],
)
def test_numbers_read_well(shown, expected):
    assert shown == expected


@given(st.floats())
def test_every_number_has_a_short_text(value):
    for show in (text.number, text.percent, text.quantity):
        assert show(value)
    assert len(text.number(value)) <= 7


def test_the_bar_and_the_time_left_follow_whichever_ends_first(monkeypatch):
    clock = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: clock)
    state = State(10_000, 0, ends=160.0)
    state.begin("loading", None)
    clock = 110.0
    assert state.seconds_left == pytest.approx(50.0)  # the steps' rate is not known yet
    state.begin("training", None)
    state.update(1000, {}, 5.0)  # 200 steps/s: 45 s more
    assert state.seconds_left == pytest.approx(45.0)
    assert state.fraction == pytest.approx(0.1)
    clock = 130.0
    state.update(2000, {}, 25.0)  # 80 steps/s: 100 s more, and 30 s to the limit
    assert state.seconds_left == pytest.approx(30.0)
    assert state.fraction == pytest.approx(0.5)
    clock = 170.0
    assert state.seconds_left == 0.0
    assert state.fraction == 1.0
