"""Where a training stands: what its display draws from."""

import math
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

_RATE_UPDATES = 10  # the rate is that over the last so many updates
_TERM = "train/reward/"


class State:
    """What there is to show. One thread writes it, the screen's thread only reads."""

    def __init__(self, total_steps: int, start_steps: int, ends: float = math.inf) -> None:
        self.total_steps = total_steps
        self.ends = ends  # in time.monotonic()
        self.started = time.monotonic()
        self.phase = ""
        self.phase_started = self.started
        self.expected_seconds: float | None = None
        self.trained = False  # whether figures are worth showing yet
        self.tested = False  # whether the newest figures include an evaluation's
        self.steps = start_steps
        self.metrics: dict[str, float] = {}
        self.speeds: list[float] = []
        self._marks: deque[tuple[float, int]] = deque(maxlen=_RATE_UPDATES + 1)
        self._marks.append((0.0, start_steps))
        self._updated = self.started

    def begin(self, text: str, expected_seconds: float | None) -> None:
        self.phase = text
        self.expected_seconds = expected_seconds
        self.phase_started = time.monotonic()
        self.trained = self.trained or text.startswith("training")

    def update(self, steps: int, metrics: Mapping[str, Any], seconds_training: float) -> None:
        lasting = {key: value for key, value in self.metrics.items() if key.startswith("eval/")}
        self.tested = any(key.startswith("eval/") for key in metrics)
        self.metrics = lasting | {key: _to_float(value) for key, value in metrics.items()}
        self.speeds.append(self.metrics.get("train/speed", math.nan))
        self._marks.append((seconds_training, steps))
        self.steps = steps
        self._updated = time.monotonic()
        self.trained = True

    @property
    def fraction(self) -> float:
        """How much is done, from 0 to 1, of whichever ends it first: the steps or the time."""
        if self._timed:
            now = time.monotonic()
            return min(1.0, (now - self.started) / max(self.ends - self.started, 1e-9))
        return min(1.0, self.steps / self.total_steps) if self.total_steps > 0 else 0.0

    @property
    def rate(self) -> float:
        """Environment steps per second of training; NaN before there are any."""
        (start, first), (end, last) = self._marks[0], self._marks[-1]
        return (last - first) / (end - start) if end > start else math.nan

    @property
    def seconds_left(self) -> float:
        """Counts down between updates too; NaN if not known."""
        if self._timed:
            return max(0.0, self.ends - time.monotonic())
        return self._seconds_of_steps

    @property
    def _timed(self) -> bool:
        """Whether the time is up before the steps are done."""
        left = self._seconds_of_steps
        return self.ends - time.monotonic() < (math.inf if math.isnan(left) else left)

    @property
    def _seconds_of_steps(self) -> float:
        rate = self.rate
        if not rate > 0:
            return math.nan
        seconds = (self.total_steps - self.steps) / rate
        if self.phase.startswith("training"):
            seconds -= time.monotonic() - self._updated
        return max(0.0, seconds)

    @property
    def in_phase(self) -> float:
        return time.monotonic() - self.phase_started

    def phase_text(self) -> str:
        about = f" (about {self.expected_seconds:.0f} s)" if self.expected_seconds else ""
        return self.phase + about

    def get(self, key: str) -> float:
        return self.metrics.get(key, math.nan)

    def terms(self) -> dict[str, float]:
        """Reward terms by name, in the order in which they came."""
        return {
            key.removeprefix(_TERM): value
            for key, value in self.metrics.items()
            if key.startswith(_TERM)
        }


def _to_float(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan
