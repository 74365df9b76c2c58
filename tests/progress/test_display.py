"""The display of a training while it runs, on a terminal and elsewhere."""

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

from quadwalk.progress import display as module
from quadwalk.progress import text
from quadwalk.progress.display import Progress

FIGURES = {
    "eval/speed": 2.5,
    "eval/fall_rate": 0.031,
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


@pytest.fixture
def clock(monkeypatch):
    """Stop the clock; return a list whose one element is its time, in s."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def train(stream, quiet=False, clock=None, **figures):
    with Progress(3000, quiet=quiet, stream=stream) as progress:
        progress.show_phase("compiling", 30)
        progress.show_phase("training")
        for steps in (1000, 2000, 3000):
            progress.update(steps, FIGURES | figures)
            if clock:
                clock[0] += 2.0
        progress.say("something [odd] happened")
        progress.show_phase("saving")
    progress.end("see runs/a")
    return stream.getvalue()


def strip_codes(output):
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", output)


def test_plain_lines_are_ascii_and_say_everything(clock):
    lines = train(io.StringIO(), clock=clock).splitlines()
    assert lines[:2] == ["[ 0:00] compiling (about 30 s)", "[ 0:00] training"]
    figures = "reward 12.0  speed 2.50 m/s  falls 3.1 %"
    # The pace is not known yet, the second comes too soon, and the last is always shown.
    assert lines[2] == f"[ 0:00]  33 %  1.0k/3.0k steps  - steps/s  - left  {figures}"
    assert lines[3] == f"[ 0:04] 100 %  3.0k/3.0k steps  500 steps/s  0:00 left  {figures}"
    assert lines[4:] == ["[ 0:06] something [odd] happened", "[ 0:06] saving", "see runs/a"]
    assert "\n".join(lines).isascii()


def test_plain_lines_of_figures_come_every_few_seconds(clock):
    stream = io.StringIO()
    with Progress(10**9, stream=stream) as progress:
        for step in range(20):
            progress.show_phase("training")
            progress.update(step, FIGURES)
            progress.show_phase("saving")
            clock[0] += 1.0
    lines = [line for line in stream.getvalue().splitlines() if " left " in line]
    assert [line[:7] for line in lines] == ["[ 0:00]", "[ 0:05]", "[ 0:10]", "[ 0:15]"]
    assert stream.getvalue().count("training") == 1


def test_a_long_phase_gives_a_sign_of_life(monkeypatch):
    monkeypatch.setattr(module, "_HEARTBEAT_SECONDS", 0.05)
    stream = io.StringIO()
    with Progress(10, stream=stream) as progress:
        progress.show_phase("compiling")
        while "compiling continues, 0 s so far" not in stream.getvalue():
            time.sleep(0.01)


def test_quiet_is_quiet_until_the_end():
    assert train(io.StringIO(), quiet=True) == "see runs/a\n"
    assert train(Terminal(), quiet=True) == "see runs/a\n"


def test_the_live_view_shows_everything():
    output = strip_codes(train(Terminal()))
    for part in ("compiling (about 30 s)", "✓ compiling", "training", "100%", "3.0k/3.0k"):
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
            progress.show_phase("training")
            if error:
                raise error
    except (KeyboardInterrupt, ValueError):
        pass
    hidden, shown = stream.getvalue().rfind("\x1b[?25l"), stream.getvalue().rfind("\x1b[?25h")
    assert shown > hidden >= 0
    assert ("■ stopped" in strip_codes(stream.getvalue())) == bool(error)
    deadline = time.monotonic() + 5
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() == before
    assert sys.stdout is stdout


@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
def test_numbers_that_are_none_are_dashes(stream):
    values = (math.nan, math.inf, -math.inf, None, "text")
    figures = dict(zip(FIGURES, values, strict=True))
    output = strip_codes(train(stream(), **figures, **{"train/nan": np.float32("nan")}))
    for figure in (r"speed +- m/s", r"falls +-", r"reward +-"):
        assert re.search(figure, output)
    assert "nan" not in output.lower()
    assert "inf" not in output.lower()


@pytest.mark.parametrize("stopped", [False, True])
def test_a_training_that_was_stopped_is_not_said_to_be_done(stopped):
    stream = Terminal()
    with Progress(100, stream=stream) as progress:
        progress.show_phase("training")
        progress.update(54, FIGURES)
        progress.stopped = stopped
    last = strip_codes(stream.getvalue()).splitlines()
    assert any("stopped" in line and "54%" in line for line in last) == stopped
    assert any("done" in line for line in last) != stopped


@pytest.mark.parametrize(
    ("figures", "plain", "live"),
    [
        (
            {"eval/speed": -0.03, "eval/velocity_error": 0.25},  # no mean speed over commands
            "  velocity error 0.25 m/s  falls",
            r"error +0\.25 m/s off the command +█",
        ),
        ({"eval/standing": 0.5}, "standing 50.0 % of the time", r"standing +50\.0 % of the time"),
        ({"train/nan": 3}, "NaN states 3", r"NaN +3 states"),
        (
            {"train/level/stairs_up": 2.5, "train/level/flat": 7.0},
            "levels stairs_up 2.50, flat 7.00",
            r"stairs_up +2\.50 ■■■ ",
        ),
    ],
)
def test_figures_of_some_tasks_are_shown_where_there_are_any(figures, plain, live):
    assert plain in train(io.StringIO(), **figures)
    assert plain not in train(io.StringIO())
    output = strip_codes(train(Terminal(), **figures))
    assert re.search(live, output)
    assert "-0.03" not in output
    assert not re.search(live, strip_codes(train(Terminal())))


def test_its_colors_can_be_read_on_white_and_on_black():
    output = train(Terminal())
    codes = {code for codes in re.findall(r"\x1b\[([\d;]+)m", output) for code in codes.split(";")}
    assert "32" in codes  # green
    assert not {"33", "36", "93", "96", "37", "97"} & codes  # yellow, cyan, white


@pytest.mark.parametrize("width", [2, 10, 24, 40, 80, 200])
def test_no_line_is_wider_than_the_terminal(monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    stream = Terminal()
    many = {f"train/reward/a_rather_long_name_{index}": -index for index in range(9)}
    with Progress(10_000_000, stream=stream) as progress:
        progress.show_phase("compiling", 25)
        progress.show_phase("training")
        for steps in range(0, 9_000_000, 1_000_000):
            progress.update(steps, {**FIGURES, **many, "train/nan": 5})
    lines = re.split(r"[\r\n]+", strip_codes(stream.getvalue()))
    assert len(lines) > 20
    assert max(map(len, lines)) <= width


def test_rate_and_time_left_are_recent_and_from_the_start_of_this_process(clock):
    stream = io.StringIO()
    with Progress(100_000, stream=stream) as progress:
        progress.show_phase("training")
        for seconds, steps in ((10, 51_000), (10, 52_000), (10, 53_000)):  # 50,000 were there
            clock[0] += seconds
            progress.update(steps, {})
        assert " 53 %  53.0k/100k steps  100 steps/s  7:50 left" in stream.getvalue()
        for _ in range(40):
            clock[0] += 1
            progress.update(steps := steps + 1000, {})
    assert " 93 %  93.0k/100k steps  1.0k steps/s  0:07 left" in stream.getvalue()


def test_the_bar_and_the_time_left_follow_whichever_ends_first(clock):
    stream = io.StringIO()
    with Progress(100_000, stream=stream, ends=clock[0] + 60) as progress:
        progress.show_phase("training")
        for seconds, steps in ((0, 20_000), (5, 40_000), (5, 60_000)):  # 4000 a second: 10 s more
            clock[0] += seconds
            progress.update(steps, {})
        assert " 60 %  60.0k/100k steps  4.0k steps/s  0:10 left" in stream.getvalue()
        for _ in range(40):  # 400 a second: 100,000 would take 60 s more, and there are 10
            clock[0] += 1
            progress.update(steps := steps + 400, {})
    assert " 95 %  76.0k/100k steps  400 steps/s  0:10 left" in stream.getvalue()


@pytest.mark.parametrize("error", [BrokenPipeError(), OSError(5, "I/O error"), ValueError()])
@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
@pytest.mark.filterwarnings("error")
def test_a_closed_output_does_not_end_the_training(stream, error):
    def refuse(*_):
        raise error

    train(type("Broken", (stream,), {"write": refuse, "flush": refuse})())


@pytest.mark.parametrize(("encoding", "term"), [("ascii", "xterm"), ("utf-8", "dumb")])
def test_a_simple_terminal_gets_plain_lines(monkeypatch, encoding, term):
    monkeypatch.setenv("TERM", term)
    stream = Terminal()
    monkeypatch.setattr(Terminal, "encoding", encoding)
    assert train(stream).startswith("[ 0:00] compiling")
    assert "\x1b" not in stream.getvalue()


def test_it_shows_at_once_on_a_real_terminal():
    program = (
        "from quadwalk.progress.display import Progress\n"
        "with Progress(10) as progress:\n"
        "    progress.show_phase('loading'); input()\n"
    )
    master, slave = pty.openpty()
    pipes = {"stdin": subprocess.PIPE, "stdout": slave, "stderr": slave}
    with subprocess.Popen([sys.executable, "-c", program], **pipes) as child:
        os.close(slave)
        output = b""
        while b"loading" not in output:
            output += os.read(master, 1000)
        child.kill()
    os.close(master)


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("progress.display", "{'jax', 'numpy', 'matplotlib'}"),
        ("learn.loop", "{'matplotlib'}"),
    ],
)
def test_what_is_heavy_waits_until_it_is_needed(module, heavy):
    program = f"import sys, quadwalk.{module}; sys.exit(bool({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@given(st.lists(st.floats(), max_size=200), st.integers(0, 60))
def test_a_sparkline_fits_and_never_fails(values, width):
    line = text.draw_sparkline(values, width)
    assert len(line) == min(width, len(values))
    assert set(line) <= set(" ▁▂▃▄▅▆▇█")


@pytest.mark.parametrize(
    ("number_text", "expected"),
    [
        (text.draw_sparkline([0, 1, 2, 3, 4, 5, 6, 7], 8), "▁▂▃▄▅▆▇█"),
        (text.draw_sparkline([0, 0, 7, 7], 2), "▁█"),
        (text.draw_sparkline([-1, 0, 1], 3), "▁▅█"),
        (text.draw_sparkline([1, math.nan, 1], 3), "█ █"),
        (text.draw_sparkline([0, 0], 2), "▁▁"),
        (text.format_number(12.44), "12.4"),
        (text.format_number(-0.031), "-0.031"),
        (text.format_number(0), "0.000"),
        (text.format_number(1e-9), "1e-09"),
        (text.format_number(math.nan), "-"),
        (text.format_percent(0.0312), "3.1 %"),
        (text.format_percent(math.inf), "-"),
        (text.format_quantity(950), "950"),
        (text.format_quantity(999.6), "1.0k"),
        (text.format_quantity(52_140), "52.1k"),
        (text.format_quantity(4_100_000), "4.1M"),
        (text.format_quantity(2e9), "2.0G"),
        (text.format_duration(59.6), "1:00"),
        (text.format_duration(751), "12:31"),
        (text.format_duration(3723), "1:02:03"),
        (text.format_duration(math.nan), "-"),
        (text.format_elapsed(0.44), "0.4 s"),
        (text.format_elapsed(31.4), "31 s"),
        (text.format_elapsed(125), "2:05"),
    ],
)
def test_numbers_read_well(number_text, expected):
    assert number_text == expected


@given(st.floats())
def test_every_number_has_a_short_text(value):
    for show in (text.format_number, text.format_percent, text.format_quantity):
        assert show(value)
    assert len(text.format_number(value)) <= 7
