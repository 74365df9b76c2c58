"""The progress of many trainings: on a terminal a row for each, elsewhere a line now and then."""

import math
import sys
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import AbstractContextManager

from rich.console import Console
from rich.progress import Progress, Task, TaskProgressColumn, TextColumn

from quadwalk.progress.display import is_screen
from quadwalk.progress.metrics import choose_headline
from quadwalk.progress.text import (
    format_duration,
    format_number,
    format_percent,
    format_quantity,
)

_PLAIN_SECONDS = 30.0  # between plain lines


class Board(AbstractContextManager["Board"]):
    """The rows of `count` jobs and one of all together; a context manager."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._steps = 0  # of all jobs that have started
        self._ended: Counter[str] = Counter()
        self._tasks: dict[str, Task] = {}
        self._screen = is_screen(sys.stdout)
        self._started = self._spoke = time.monotonic()
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            TaskProgressColumn(),
            TextColumn("{task.fields[text]}", markup=False),
            console=Console(highlight=False),
            transient=True,
            disable=not self._screen,
        )
        self._all = self._progress.add_task("all", total=None, text="")
        self._progress.start()  # what is printed from here on stands above it

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def start(self, name: str, steps: int) -> None:
        """Add a row for a job of so many control steps, or show that it starts once more."""
        if name not in self._tasks:
            self._steps += steps
            self._progress.add_task(name, total=steps, text="")
            self._tasks[name] = self._progress.tasks[-1]
        self._progress.update(self._tasks[name].id, text="starting")

    def update(self, name: str, row: Mapping[str, float]) -> None:
        """Show the newest row of metrics of the job `name`, which `start` has added."""
        task = self._tasks[name]
        if task.fields["text"] == "starting":
            self._progress.reset(task.id, completed=int(row["steps"]))  # its rate is from here on
        self._progress.update(task.id, completed=row["steps"])
        headline = choose_headline(row)
        figure = f"{headline.name} {format_number(headline.get_value(row))} {headline.unit}"
        falls = format_percent(row.get("eval/fall_rate", math.nan))
        state = "evaluating" if task.finished else _format_pace(task.remaining, task.speed)
        self._progress.update(task.id, text=f"{state}  {figure}  falls {falls}")

    def end(self, name: str, error: str | None, stopped: bool) -> None:
        """Remove the row of a job, and say why it failed if it did."""
        state = "stopped" if stopped else "failed" if error else "done"
        self._ended[state] += 1
        self._progress.remove_task(self._tasks.pop(name).id)
        if state == "failed":
            self.say(f"{name} failed: {error}")

    def refresh(self) -> None:
        """Show all together: at once on a terminal, elsewhere if it is time for a line."""
        tasks = self._tasks.values()
        started = self._ended.total() + len(tasks)
        states = {**self._ended, "running": len(tasks), "waiting": self._count - started}
        finished_count = states.pop("done", 0)
        others = "".join(f", {number} {name}" for name, number in sorted(states.items()) if number)
        mean = self._steps / max(1, started)
        left = sum(task.remaining or 0.0 for task in tasks) + mean * states["waiting"]
        speed = sum(task.speed or 0.0 for task in tasks if not task.finished)
        text = f"{finished_count} of {self._count} done{others}  {_format_pace(left, speed)}"
        total = mean * self._count
        self._progress.update(self._all, total=total, completed=total - left, text=text)
        if not self._screen and time.monotonic() - self._spoke > _PLAIN_SECONDS:
            self.say(text)

    def say(self, text: str) -> None:
        """Print a line above the rows, or to stderr where there are none."""
        self._spoke = time.monotonic()
        if self._screen:
            self._progress.console.print(text, markup=False)
        else:
            elapsed = format_duration(self._spoke - self._started)
            print(f"[{elapsed:>5}] {text}", file=sys.stderr, flush=True)


def _format_pace(steps: float | None, rate: float | None) -> str:
    """Return a rate, steps/s, and the time that so many control steps take at it."""
    seconds = steps / rate if steps is not None and rate else math.nan
    return f"{format_quantity(rate or math.nan)} steps/s  {format_duration(seconds)} left"
