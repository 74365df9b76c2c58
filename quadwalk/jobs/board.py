"""How many trainings go, in one table: on a terminal live, elsewhere as lines now and then."""

import math
import sys
import time
from collections import Counter
from dataclasses import dataclass, field

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from quadwalk.jobs.job import Job
from quadwalk.jobs.news import Row
from quadwalk.train.progress.display import is_screen
from quadwalk.train.progress.text import duration, number, percent, quantity

_PLAIN_SECONDS = 30.0  # between plain lines
_SHOWN = 30  # rows, those that go on first


@dataclass
class _Line:
    """What is known of a job."""

    total: int  # control steps in all
    state: str = "starting"
    row: Row = field(default_factory=dict)
    first: tuple[float, float] | None = None  # time, s, and steps of the first row of this try
    rate: float = 0.0  # control steps/s

    @property
    def left(self) -> float:
        """Control steps that are left."""
        return max(0.0, self.total - self.row.get("steps", 0.0))


class Board:
    """The table of `count` jobs; a context manager."""

    def __init__(self, count: int) -> None:
        self._count, self._lines = count, dict[str, _Line]()
        self._began = self._shown = time.monotonic()
        self._screen = is_screen(sys.stdout)
        self._live = Live(console=Console(highlight=False), refresh_per_second=2, transient=True)

    def __enter__(self) -> "Board":
        if self._screen:
            self._live.start()  # what is printed from here on stands above it
        return self

    def __exit__(self, *_: object) -> None:
        if self._screen:
            self._live.update(Group(self._table(), self.summary()))
            self._live.stop()

    def start(self, job: Job) -> None:
        self._lines[job.name] = _Line(job.config.steps)

    def row(self, name: str, row: Row) -> None:
        line, now = self._lines[name], time.monotonic()
        line.row = row
        line.state = "training" if line.left else "evaluating"
        if line.first is None:
            line.first = now, row["steps"]
        elif now > line.first[0]:
            line.rate = (row["steps"] - line.first[1]) / (now - line.first[0])
        self.show()

    def again(self, name: str) -> None:
        """A job's process has died, and it begins once more from its last checkpoint."""
        self._lines[name].state, self._lines[name].first = "starting", None
        self._say(f"{name}: its process died; it goes on from its last checkpoint")

    def end(self, name: str, state: str, reason: str = "") -> None:
        line = self._lines[name]
        line.state, line.rate = state, 0.0
        if reason:
            self._say(f"{name} {state}: {reason}")
        self.show()

    def show(self) -> None:
        if self._screen:
            self._live.update(Group(self._table(), self.summary()))
        elif time.monotonic() - self._shown > _PLAIN_SECONDS:
            self._say(str(self.summary()))

    def summary(self) -> Text:
        """How many there are of each state, their rate together and the time left, as a line."""
        states = Counter(line.state for line in self._lines.values())
        states["waiting"] = self._count - len(self._lines)
        going = [line for line in self._lines.values() if line.state in ("starting", "training")]
        rate = sum(line.rate for line in going)
        each = sum(line.total for line in self._lines.values()) / max(1, len(self._lines))
        left = sum(line.left for line in going) + each * states["waiting"]
        time_left = duration(left / rate if rate else math.nan)
        done = f"{states.pop('done', 0)} of {self._count} done"
        others = ", ".join(f"{count} {state}" for state, count in sorted(states.items()) if count)
        parts = [done, *[others] * bool(others), f"{quantity(rate)} steps/s", f"{time_left} left"]
        return Text("  ".join(parts))

    def _table(self) -> Table:
        table = Table(box=None, pad_edge=False)
        for heading in ("training", "state", "%", "steps/s", "left", "m/s", "falls"):
            right = heading not in ("training", "state")
            table.add_column(heading, justify="right" if right else "left", no_wrap=True)
        order = ("training", "evaluating", "starting", "failed", "stopped", "done")
        lines = sorted(self._lines.items(), key=lambda item: order.index(item[1].state))
        for name, line in lines[:_SHOWN]:
            table.add_row(
                Text(name),
                line.state,
                f"{100 * (1 - line.left / line.total):.0f}",
                quantity(line.rate) if line.rate else "-",
                duration(line.left / line.rate) if line.rate else "-",
                number(line.row.get("eval/speed", math.nan)),
                percent(line.row.get("eval/fall_rate", math.nan)),
            )
        return table

    def _say(self, text: str) -> None:
        self._shown = time.monotonic()
        if self._screen:
            self._live.console.print(Text(text))
        else:
            print(f"[{duration(self._shown - self._began):>5}] {text}", file=sys.stderr, flush=True)
