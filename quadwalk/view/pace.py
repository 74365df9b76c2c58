"""Real time: how many control steps are due, and whether they are kept up with."""

import time
from collections import deque
from collections.abc import Callable

_PATIENCE = 0.1  # s behind the clock, after which the time is lost rather than made up
_WINDOW = 2.0  # s over which it is measured how fast time goes
_KEPT = 0.97  # of the chosen speed: below this real time is not kept


class Pace:
    """Says when control steps of `dt` s are due. `clock` tells the seconds on the wall."""

    def __init__(self, dt: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.dt = dt
        self.speed = 1.0  # chosen simulated seconds per second
        self._clock = clock
        self.restart()

    def restart(self) -> None:
        """Forget what was: after a pause, nothing is due."""
        self._last = self._clock()
        self._owed = 0.0  # s, simulated
        self._busy = 0.0  # s, spent on the steps of `_marks`
        self._marks: deque[tuple[float, float, float]] = deque()  # wall, simulated, busy
        self._simulated = 0.0

    def due(self) -> int:
        """How many steps are due now. What cannot be made up soon is given up."""
        now = self._clock()
        self._owed = min(self._owed + self.speed * (now - self._last), _PATIENCE + self.dt)
        self._last = now
        return int(self._owed / self.dt + 1e-9)

    def done(self, seconds: float) -> None:
        """One step has been made, in `seconds` of computing."""
        self._owed -= self.dt
        self._simulated += self.dt
        self._busy += seconds
        self._marks.append((self._clock(), self._simulated, self._busy))
        while self._marks[-1][0] - self._marks[0][0] > _WINDOW:
            self._marks.popleft()

    @property
    def reached(self) -> float:
        """Recent simulated seconds per second; the chosen ones until that is known."""
        if len(self._marks) < 2 or self._marks[-1][0] - self._marks[0][0] < _WINDOW / 4:
            return self.speed
        (began, first, _), (_, last, _) = self._marks[0], self._marks[-1]
        return (last - first) / (max(self._clock(), self._last) - began)

    @property
    def kept(self) -> bool:
        """Whether the chosen speed is kept."""
        return self.reached >= _KEPT * self.speed

    @property
    def most(self) -> float:
        """Simulated seconds in one of computing, lately: how fast it could go."""
        if len(self._marks) < 2:
            return float("inf")
        (_, first, before), (_, last, after) = self._marks[0], self._marks[-1]
        return (last - first) / max(after - before, 1e-9)
