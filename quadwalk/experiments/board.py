"""The progress of many trainings: on a terminal a row for each, elsewhere a line now and then."""

import math
import sys
import time
from collections import Counter
from typing import Any

from rich.console import Console
from rich.progress import Progress, Task, TaskID, TaskProgressColumn, TextColumn

from quadwalk.experiments.job import Row
from quadwalk.progress.display import is_screen
from quadwalk.progress.text import duration, number, percent, quantity

_PLAIN_SECONDS = 30.0  # between plain lines
_WAITING: dict[str, Any] = {"state": "starting", "rate": "", "left": "", "figures": ""}


class Board:
    """The rows of `count` jobs and one of all together; a context manager."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._steps = 0  # of all jobs that have begun
        self._ended: Counter[str] = Counter()
        self._going: dict[str, TaskID] = {}
        self._screen = is_screen(sys.stdout)
        self._began = self._said = time.monotonic()
        texts = [TextColumn(f"{{task.fields[{name}]}}", markup=False) for name in _WAITING]
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            texts[0],
            TaskProgressColumn(),
            *texts[1:],
            console=Console(highlight=False),
            transient=True,
            disable=not self._screen,
        )
        self._all = self._progress.add_task("all", total=None, **_WAITING)

    def __enter__(self) -> "Board":
        self._progress.start()  # what is printed from here on stands above it
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def start(self, name: str, steps: int) -> None:
        """Add a row for a job of so many control steps, or have it start once more."""
        if name in self._going:
            self._progress.update(self._going[name], **_WAITING)
            return
        self._steps += steps
        self._going[name] = self._progress.add_task(name, total=steps, **_WAITING)

    def update(self, name: str, row: Row) -> None:
        """Show the newest row of metrics of a job."""
        key, task = self._going[name], self._task(self._going[name])
        if task.fields["state"] == "starting" or row["steps"] < task.completed:
            self._progress.reset(key, completed=int(row["steps"]))  # its rate is that from here on
        self._progress.update(key, completed=row["steps"])
        speed = number(row.get("eval/speed", math.nan))
        falls = percent(row.get("eval/fall_rate", math.nan))
        self._progress.update(
            key,
            state="evaluating" if task.finished else "training",
            rate=f"{quantity(task.speed)} steps/s" if task.speed else "",
            left=f"{_time_left(task.remaining, task.speed)} left",
            figures=f"{speed} m/s  {falls} fall",
        )

    def end(self, name: str, error: str | None, stopped: bool) -> None:
        """Remove the row of a job, and say why it failed if it did."""
        self._ended["failed" if error else "stopped" if stopped else "done"] += 1
        self._progress.remove_task(self._going.pop(name))
        if error:
            self.say(f"{name} failed: {error}")

    def show(self) -> None:
        """Show all together: at once on a terminal, elsewhere if it is time for a line."""
        ended = sum(self._ended.values())
        tasks = [self._task(key) for key in self._going.values()]
        states = Counter(task.fields["state"] for task in tasks)
        states.update({name: n for name, n in self._ended.items() if name != "done"})
        states["waiting"] = self._count - ended - len(tasks)
        mean = self._steps / max(1, ended + len(tasks))
        left = sum(task.remaining or 0.0 for task in tasks) + mean * states["waiting"]
        rate = sum(task.speed or 0.0 for task in tasks if not task.finished)
        others = "".join(f", {n} {name}" for name, n in sorted(states.items()) if n)
        state = f"{self._ended['done']} of {self._count} done{others}"
        texts: dict[str, Any] = {
            "rate": f"{quantity(rate)} steps/s",
            "left": f"{_time_left(left, rate)} left",
        }
        total = mean * self._count
        self._progress.update(self._all, total=total, completed=total - left, state=state, **texts)
        if not self._screen and time.monotonic() - self._said > _PLAIN_SECONDS:
            self.say("  ".join((state, *texts.values())))

    def say(self, text: str) -> None:
        """Print a line above the rows, or to stderr where there are none."""
        self._said = time.monotonic()
        if self._screen:
            self._progress.console.print(text, markup=False)
        else:
            elapsed = duration(self._said - self._began)
            print(f"[{elapsed:>5}] {text}", file=sys.stderr, flush=True)

    def _task(self, key: TaskID) -> Task:
        return next(task for task in self._progress.tasks if task.id == key)


def _time_left(steps: float | None, rate: float | None) -> str:
    """Return the time that so many control steps take at a rate in steps/s."""
    return duration(steps / rate if steps is not None and rate else math.nan)
