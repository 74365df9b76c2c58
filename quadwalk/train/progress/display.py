"""What a person sees while training runs.

On a terminal: finished phases as lines, and below them a live view with the phase, a bar, the
time left, the figures that matter, their course so far, and each reward term. Anywhere else (a
file, a pipe, a notebook, a terminal that cannot move its cursor): plain lines every few seconds.

Importing this module must stay fast, for it gives the first sign of life: no jax here.
"""

import contextlib
import io
import math
import sys
import threading
import time
from collections.abc import Mapping
from typing import Any, TextIO, cast

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.spinner import Spinner
from rich.text import Text

from quadwalk.train.progress import view
from quadwalk.train.progress.state import State
from quadwalk.train.progress.text import duration, number, percent, quantity, spent

_PLAIN_SECONDS = 5.0  # between plain lines of figures
_HEARTBEAT_SECONDS = 15.0  # between plain lines that only say that a phase goes on
_FRAMES_PER_SECOND = 4  # enough for a spinner; every frame takes time from the training


class Progress:
    """Shows the phases and the figures of one training; a context manager.

    With `quiet`, only what is passed to `end` is shown. Trouble with the output itself (a closed
    pipe, a terminal that has gone) is ignored: a training is worth more than its display.
    """

    def __init__(
        self,
        total_steps: int,
        quiet: bool = False,
        start_steps: int = 0,
        stream: TextIO | None = None,
        ends: float = math.inf,
    ) -> None:
        """`start_steps` were done before, in a training that this one goes on with.

        It ends when `total_steps` are done or when `time.monotonic()` is `ends`.
        """
        output = cast(TextIO, _Forgiving(stream or sys.stdout))
        state = State(total_steps, start_steps, ends)
        self._state = state
        self._view: _Quiet | _Plain | _Screen
        if quiet:
            self._view = _Quiet(output)
        elif _is_screen(output):
            self._view = _Screen(output, state)
        else:
            self._view = _Plain(output, state)

    def __enter__(self) -> "Progress":
        self._view.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._view.stop(stopped=kind is not None)

    def phase(self, text: str, expected_seconds: float | None = None) -> None:
        """Say what begins now: "loading", "compiling", "training", "evaluating", "saving"."""
        if text != self._state.phase:
            self._view.phase_ended()
            self._state.begin(text, expected_seconds)
            self._view.phase_began()

    def update(self, steps: int, metrics: Mapping[str, Any], seconds_training: float) -> None:
        """Show the figures after `steps` environment steps in all.

        `seconds_training` is what this process has spent on training so far; it gives the rate.

        Reads "train/speed" (m/s), "train/fall_rate" (0 to 1), "train/reward", "train/reward/NAME",
        "train/nan" (a count, shown if there is any), "eval/speed" and "eval/fall_rate" (which stay
        until there are newer ones). What is missing, NaN or infinite is shown as "-".
        """
        self._state.update(steps, metrics, seconds_training)
        self._view.updated()

    def message(self, text: str) -> None:
        """A line that stays, above the live view."""
        self._view.line(text)

    def end(self, text: str) -> None:
        """The last word, for after the context: shown even when quiet."""
        self._view.last_word(text)


class _Forgiving(io.TextIOBase):
    """Passes text on to a stream and ignores that it has gone.

    One place for all writers: print, rich, and the thread in which rich redraws.
    """

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


class _Quiet:
    """Nothing but the last word."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def start(self) -> None: ...
    def stop(self, stopped: bool) -> None: ...
    def phase_ended(self) -> None: ...
    def phase_began(self) -> None: ...
    def updated(self) -> None: ...
    def line(self, text: str) -> None: ...

    def last_word(self, text: str) -> None:
        self._print(text)

    def _print(self, text: str) -> None:
        print(text, file=self._stream, flush=True)


class _Plain(_Quiet):
    """Lines in ASCII, each with the minutes since the start."""

    def __init__(self, stream: TextIO, state: State) -> None:
        super().__init__(stream)
        self._state = state
        self._printed = -math.inf
        self._heartbeat = threading.Thread(target=self._beat, daemon=True)
        self._over = threading.Event()

    def start(self) -> None:
        self._heartbeat.start()

    def stop(self, stopped: bool) -> None:
        self._over.set()
        if self._heartbeat.is_alive():
            self._heartbeat.join()
        if stopped:
            self.line(f"{self._state.phase or 'work'} stopped")

    def phase_began(self) -> None:
        # Between evaluations the figures themselves show that it is training again.
        if not (self._state.phase.startswith("training") and self._state.speeds):
            self.line(self._state.phase_text())

    def updated(self) -> None:
        now = time.monotonic()
        done = self._state.steps >= self._state.total_steps
        if done or self._state.tested or now - self._printed >= _PLAIN_SECONDS:
            self._printed = now
            self.line(self._figures())

    def line(self, text: str) -> None:
        self._print(f"[{duration(time.monotonic() - self._state.started):>5}] {text}")

    def _figures(self) -> str:
        state = self._state
        parts = [
            f"{100 * state.fraction:3.0f} %",
            f"{quantity(state.steps)}/{quantity(state.total_steps)} steps",
            f"{quantity(state.rate)} steps/s",
            f"{duration(state.seconds_left)} left",
            f"reward {number(state.get('train/reward'))}",
            f"speed {number(state.get('train/speed'))} m/s",
            f"falls {percent(state.get('train/fall_rate'))}",
        ]
        if state.tested:
            falls = percent(state.get("eval/fall_rate"))
            parts.append(f"tested {number(state.get('eval/speed'))} m/s, {falls} falls")
        if state.get("train/nan") > 0:
            parts.append(f"NaN states {quantity(state.get('train/nan'))}")
        return "  ".join(parts)

    def _beat(self) -> None:
        """Say now and then that a long phase goes on."""
        said = time.monotonic()
        while not self._over.wait(1.0):
            state, now = self._state, time.monotonic()
            said = max(said, state.phase_started, self._printed)
            if state.phase and now - said >= _HEARTBEAT_SECONDS:
                said = now
                self.line(f"{state.phase} goes on, {state.in_phase:.0f} s so far")


class _Screen(_Quiet):
    """A live view at the bottom of the terminal, finished phases and messages above it."""

    def __init__(self, stream: TextIO, state: State) -> None:
        super().__init__(stream)
        self._state = state
        self._console = Console(file=stream, highlight=False)
        self._spinner = Spinner("dots", style="cyan")
        self._over = ""
        self._live = Live(
            console=self._console,
            get_renderable=self._render,
            refresh_per_second=_FRAMES_PER_SECOND,
        )

    def start(self) -> None:
        self._live.start(refresh=True)

    def stop(self, stopped: bool) -> None:
        self._over = "stopped" if stopped else "done"
        self._live.stop()

    def phase_ended(self) -> None:
        state = self._state
        # Once training, phases come round again and again: only the live view tells of them.
        if state.phase and not state.trained:
            tick = Text.assemble(("✓ ", "green"), state.phase)
            tick.append(f"  {spent(state.in_phase)}", style="dim")
            self._console.print(tick)

    def phase_began(self) -> None:
        self._live.refresh()

    def updated(self) -> None:
        self._live.refresh()

    def line(self, text: str) -> None:
        self._console.print(Text(text))

    def last_word(self, text: str) -> None:
        # Plain and unwrapped, so that paths and commands in it can be copied.
        self._print(text)

    def _render(self) -> RenderableType:
        state, width = self._state, self._console.width
        parts: list[RenderableType] = [self._phase_line()]
        if state.trained:
            parts += [view.bar(state, width), "", view.figures(state, width)]
            if state.terms():
                parts += ["", view.terms(state.terms(), width)]
        return Group(*parts)

    def _phase_line(self) -> RenderableType:
        state = self._state
        if self._over:
            mark = ("✓ ", "green") if self._over == "done" else ("■ ", "yellow")
            took = f"  {spent(time.monotonic() - state.started)}"
            return view.line(mark, (self._over, "bold"), (took, "dim"))
        text = Text.assemble((state.phase_text() or "starting", "bold"), no_wrap=True)
        # While training, the time left says more than the time spent.
        if not state.phase.startswith("training"):
            text.append(f"  {state.in_phase:.0f} s", style="dim")
        self._spinner.update(text=text)
        return self._spinner


def _is_screen(stream: TextIO) -> bool:
    """Whether the stream is a terminal that can redraw, and shows more than ASCII."""
    if not stream.isatty() or Console(file=stream).is_dumb_terminal:
        return False
    try:
        "━✓■▁".encode(stream.encoding)
    except (UnicodeError, LookupError):
        return False
    return True
