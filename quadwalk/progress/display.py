"""The display of a training while it runs.

On a terminal: finished phases as lines, and below them a live view with the phase, a bar, the
time left, the figures that matter, their course so far, and each reward term. Anywhere else (a
file, a pipe, a notebook, a terminal that cannot move its cursor): plain lines every few seconds.
A terminal that is made narrower keeps rows of the last view.

Importing this module must stay fast, for it gives the first sign of life: no jax here.
"""

import contextlib
import io
import math
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TextIO, cast

import rich.progress
from rich.columns import Columns
from rich.console import Console, RenderableType
from rich.text import Text
from rich.theme import Theme

from quadwalk.progress.metrics import LEVEL, choose_headline
from quadwalk.progress.text import (
    draw_sparkline,
    format_duration,
    format_elapsed,
    format_number,
    format_percent,
    format_quantity,
)

_PLAIN_SECONDS = 5.0  # between plain lines of figures
_HEARTBEAT_SECONDS = 15.0  # between plain lines that only say that a phase goes on
_FRAMES_PER_SECOND = 4  # enough for a spinner; every frame takes time from the training
_TERM = "train/reward/"
_SHARE = 8  # characters of the bar beside a reward term
# On a white screen, yellow and cyan, which Rich has for these, cannot be read.
_THEME = Theme(dict.fromkeys(("progress.elapsed", "progress.remaining", "repr.number"), "none"))


class Progress:
    """Shows the phases and the figures of one training; a context manager.

    With `quiet`, only what is passed to `end` is shown. Trouble with the output itself (a closed
    pipe, a terminal that has gone) is ignored: a training is worth more than its display.
    """

    def __init__(
        self,
        total_steps: int,
        quiet: bool = False,
        stream: TextIO | None = None,
        ends: float = math.inf,
    ) -> None:
        """Training ends when `total_steps` are done or when `time.monotonic()` is `ends`."""
        self._stream = cast(TextIO, _Forgiving(stream or sys.stdout))
        self._total, self._ends, self._quiet = total_steps, ends, quiet
        self._started = self._spoke = time.monotonic()
        self._shown = -math.inf  # when figures were last a plain line
        self._phase = ""
        self._trained = False
        self.stopped = False  # before its end, by whoever waits for it
        self._screen = not quiet and is_screen(self._stream)
        self._view = _View(self._stream, disable=not self._screen)
        self._over = threading.Event()
        self._heartbeat = threading.Thread(target=self._show_life, daemon=True)

    def __enter__(self) -> "Progress":
        if self._screen:
            self._view.start()
        elif not self._quiet:
            self._heartbeat.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._over.set()
        if self._screen:
            self._view.finish(stopped=self.stopped or kind is not None)
        elif kind is not None:
            self.say(f"{self._phase or 'work'} stopped")
        if self._heartbeat.is_alive():
            self._heartbeat.join()

    def show_phase(self, text: str, expected_seconds: float | None = None) -> None:
        """Say what begins now: "loading", "compiling", "training", "saving"."""
        if text == self._phase:
            return
        view, training = self._view, text == "training"
        about = f" (about {expected_seconds:.0f} s)" if expected_seconds else ""
        if self._trained:  # phases come round again and again now
            view.update(view.task.id, description=text)
        else:
            if self._phase and self._screen:
                took = (f"  {format_elapsed(view.task.elapsed or 0.0)}", "dim")
                view.print(Text.assemble(("✓ ", "green"), self._phase, took))
            total = float(self._total) if training else None
            view.reset(view.task.id, description=text + about, total=total)
        # Once there are figures, they themselves show that it is training again.
        if not self._screen and not (training and self._trained):
            self.say(text + about)
        self._phase, self._trained = text, self._trained or training
        view.refresh()

    def set_total(self, steps: int) -> None:
        """Train until `steps` control steps are done in all."""
        self._total = steps
        if self._trained:
            self._view.update(self._view.task.id, total=float(steps))

    def update(self, steps: int, metrics: Mapping[str, Any]) -> None:
        """Show the figures after `steps` control steps of all environments since the start.

        Reads the `Headline`, "eval/fall_rate" (0 to 1), "train/reward", "train/reward/NAME",
        "train/level/KIND" and "train/nan" (a count, shown if there is any). What is missing, NaN or
        infinite is shown as "-".
        """
        view, task, now = self._view, self._view.task, time.monotonic()
        view.metrics = {key: _to_float(value) for key, value in metrics.items()}
        view.course.append(choose_headline(view.metrics).get_value(view.metrics))
        view.update(task.id, completed=steps)
        # The bar is full when the steps are done or, if that comes first, when the time is up.
        if task.speed:
            task.total = min(self._total, steps + task.speed * max(0.0, self._ends - now))
        left = math.nan if task.time_remaining is None else task.time_remaining
        rate = format_quantity(task.finished_speed or task.speed or math.nan)
        steps_text = f"{format_quantity(steps)}/{format_quantity(self._total)}"
        view.pace = f"{steps_text} steps  {rate} steps/s  {format_duration(left)} left"
        view.refresh()
        if not self._screen and (steps >= self._total or now - self._shown >= _PLAIN_SECONDS):
            self._shown = now
            self.say("  ".join([f"{task.percentage:3.0f} %", view.pace, *self._format_figures()]))

    def say(self, text: str) -> None:
        """Print a line that stays above the live view, or without a terminal just a line."""
        self._spoke = time.monotonic()
        if self._screen:
            self._view.print(Text(text))
        elif not self._quiet:
            self.end(f"[{format_duration(self._spoke - self._started):>5}] {text}")

    def end(self, text: str) -> None:
        """Print a line after the context: shown even when quiet."""
        # Plain and unwrapped, so that paths and commands in it can be copied.
        print(text, file=self._stream, flush=True)

    def _format_figures(self) -> Iterator[str]:
        """Yield the newest figures with names and units, for a plain line without a terminal."""
        metrics, get = self._view.metrics, self._view.get
        yield f"reward {format_number(get('train/reward'))}"
        headline = choose_headline(metrics)
        yield f"{headline.name} {format_number(headline.get_value(metrics))} {headline.unit}"
        yield f"falls {format_percent(get('eval/fall_rate'))}"
        levels = self._view.get_group(LEVEL)
        if levels:
            yield f"levels {', '.join(f'{k} {format_number(x)}' for k, x in levels.items())}"
        if get("train/nan") > 0:
            yield f"NaN states {format_quantity(get('train/nan'))}"

    def _show_life(self) -> None:
        """Print a line now and then during a long phase."""
        while not self._over.wait(min(1.0, _HEARTBEAT_SECONDS)):
            if self._phase and time.monotonic() - self._spoke >= _HEARTBEAT_SECONDS:
                self.say(f"{self._phase} continues, {self._view.task.elapsed:.0f} s so far")


class _View(rich.progress.Progress):
    """The live view: a bar, which also measures the pace, the figures and the reward terms."""

    def __init__(self, stream: TextIO, disable: bool) -> None:
        self.metrics: dict[str, float] = {}
        self.course: list[float] = []  # of the headline
        self.pace = ""
        self._mark = rich.progress.SpinnerColumn()
        super().__init__(
            self._mark,
            rich.progress.TextColumn("[bold]{task.description}"),
            rich.progress.BarColumn(),
            rich.progress.TaskProgressColumn(),
            rich.progress.TimeElapsedColumn(),
            console=Console(file=stream, highlight=False, theme=_THEME),
            refresh_per_second=_FRAMES_PER_SECOND,
            get_time=time.monotonic,
            disable=disable,
        )
        self.add_task("starting", total=None)

    @property
    def task(self) -> rich.progress.Task:
        return self.tasks[0]

    def get(self, key: str) -> float:
        """Return the newest figure of that name; NaN where there is none."""
        return self.metrics.get(key, math.nan)

    def get_group(self, prefix: str) -> dict[str, float]:
        """Return the figures whose names begin with `prefix`, by the rest of the name."""
        return {
            key.removeprefix(prefix): value
            for key, value in self.metrics.items()
            if key.startswith(prefix)
        }

    def finish(self, stopped: bool) -> None:
        """Leave the last view behind, with a mark in the place of the spinner."""
        self._mark.finished_text = Text("■", "red") if stopped else Text("✓", "green")
        self.task.finished_time = self.task.elapsed
        self.update(self.task.id, description="stopped" if stopped else "done")
        self.stop()

    def get_renderables(self) -> Iterator[RenderableType]:
        """Yield the bar, figures, levels and reward terms that rich draws at each refresh."""
        yield self.make_tasks_table(self.tasks)
        if not self.pace:
            return
        headline = choose_headline(self.metrics)
        unit = f" {headline.unit} {headline.off}".rstrip() + "  "
        course = draw_sparkline(self.course, min(40, self.console.width - 16 - len(unit)))
        yield _make_line((f"  {self.pace}", "dim"))
        yield ""
        value = format_number(headline.get_value(self.metrics))
        yield _make_figure(headline.name.split()[-1], value, unit, (course, ""))
        falls = format_percent(self.get("eval/fall_rate"), unit=False)
        yield _make_figure("falls", falls, " % of episodes")
        yield _make_figure("reward", format_number(self.get("train/reward")))
        if self.get("train/nan") > 0:
            yield _make_figure(
                "NaN", format_quantity(self.get("train/nan")), " states, episodes ended"
            )
        levels = self.get_group(LEVEL)
        if levels:
            yield ""
            yield _make_line(("levels of difficulty", "dim"))
            yield _make_columns(levels)
        terms = self.get_group(_TERM)
        if terms:
            yield ""
            yield _make_columns(terms)


def _make_line(*parts: tuple[str, str] | str) -> Text:
    """Return a line of texts or (text, style), cut off with an ellipsis at the terminal's edge."""
    return Text.assemble(*parts, no_wrap=True, overflow="ellipsis")


def _make_figure(name: str, value: str, unit: str = "", *more: tuple[str, str]) -> Text:
    return _make_line((f"{name:<8}", "dim"), (f"{value:>7}", "bold"), (unit, "dim"), *more)


def _make_columns(terms: Mapping[str, float]) -> Columns:
    """Return numbers by name, in columns, each with a bar of its share of the largest."""
    longest = max(map(len, terms))
    largest = max((abs(value) for value in terms.values() if math.isfinite(value)), default=0.0)

    def make_cell(name: str, value: float) -> Text:
        share = abs(value) / largest if math.isfinite(value) and largest > 0 else 0.0
        bar = f"{'■' * math.ceil(share * _SHARE):<{_SHARE}}"
        color = "green" if value > 0 else "red"
        return _make_line(
            (f"{name:<{longest}} ", "dim"), f"{format_number(value):>7} ", (bar, color)
        )

    cells: Sequence[Text] = [make_cell(name, value) for name, value in terms.items()]
    # Down, then across: neighbors stay neighbors.
    return Columns(cells, padding=(0, 3), column_first=True)


class _Forgiving(io.TextIOBase):
    """A text stream that passes all on to another, and ignores it where that is closed or gone."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError, ValueError):  # ValueError: it was closed
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._stream.flush()

    def isatty(self) -> bool:
        try:
            return self._stream.isatty()
        except (OSError, ValueError):
            return False

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._stream.encoding or "ascii"


def is_screen(stream: TextIO) -> bool:
    """Return True for a terminal that can redraw, and shows more than ASCII."""
    if not stream.isatty() or Console(file=stream).is_dumb_terminal:
        return False
    try:
        "━✓■▁".encode(stream.encoding)
    except (UnicodeError, LookupError):
        return False
    return True


def _to_float(value: Any) -> float:
    """Return `value` as a float; NaN where it is no number."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan
