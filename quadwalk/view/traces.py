"""What is drawn of a live robot beside its shapes: its path, arrows, and the lines of plots."""

from collections import deque

import numpy as np

from quadwalk.evaluation.metrics import rotate_planar
from quadwalk.view.live import LiveRobot

_NOWHERE = np.zeros((1, 2, 3))
_FORCE = 0.5  # m, the arrow of a push as large as the robot's weight
_SPEED = 0.25  # s: the arrow of 1 m/s is as long, in m
_STEP = 0.7  # how high a foot's line rises while it is on the ground, of the room that it has


class Traces:
    """What was seen in the last seconds, 6 for plots, 15 of the path; `add` after each step."""

    def __init__(self, dt: float) -> None:
        self._rows: deque[np.ndarray] = deque(maxlen=round(6.0 / dt))
        self._places: deque[np.ndarray] = deque(maxlen=round(15.0 / dt))

    def clear(self) -> None:
        self._rows.clear()
        self._places.clear()

    def add(self, live: LiveRobot) -> None:
        """Take down where it is, its velocity and its command."""
        if self._rows and live.time <= self._rows[-1][0]:  # it stood up anew
            self.clear()
        known = live.time, live.velocity[0], live.command[0]
        self._rows.append(np.array([*known, *(live.foot_force > 0.0)]))
        self._places.append(live.data.qpos[:2].copy())

    @property
    def speed(self) -> tuple[np.ndarray, ...]:
        """Times (n,) s, forward velocity (n,) and its command (n,), m/s."""
        rows = self._table
        return rows[:, 0], rows[:, 1], rows[:, 2]

    @property
    def footfalls(self) -> tuple[np.ndarray, ...]:
        """Times (n,) s, then a line (n,) for each foot, the first on top, high while it stands."""
        rows = self._table
        return rows[:, 0], *(3 - foot + _STEP * rows[:, 3 + foot] for foot in range(4))

    @property
    def path(self) -> np.ndarray:
        """(n, 2, 3) m, world frame: the pieces of the trunk's path, on the ground."""
        places = np.array(self._places).reshape(-1, 2)[::-5]  # the newest, and of the others some
        points = np.pad(places, [(0, 0), (0, 1)], constant_values=0.01)
        return np.stack([points[:-1], points[1:]], axis=1) if len(points) > 1 else _NOWHERE

    @property
    def _table(self) -> np.ndarray:
        """(n, 7), at least two rows: a plot of fewer has no axis."""
        if len(self._rows) < 2:
            return np.array([np.zeros(7), np.r_[1.0, np.zeros(6)]])
        return np.array(self._rows)


def force_arrows(live: LiveRobot, feet: np.ndarray) -> np.ndarray:
    """(4, 2, 3) m, world frame: from each of `feet` (4, 3) upwards, by the floor's push."""
    length = _FORCE * live.foot_force / live.env.robot.weight
    ends = feet + length[:, None] * [0.0, 0.0, 1.0]
    # Of a foot in the air the arrow has no length; its head is hidden in the trunk.
    hidden = np.broadcast_to(live.data.qpos[:3], (4, 3))
    up = live.foot_force[:, None] > 0.0
    return np.stack([np.where(up, feet, hidden), np.where(up, ends, hidden)], axis=1)


def velocity_arrows(live: LiveRobot) -> np.ndarray:
    """(2, 2, 3) m, world frame: above the trunk, the velocity, and above that the command."""
    command = np.array([*rotate_planar(live.command[:2], live.heading), 0.0])
    does = np.array([*live.data.qvel[:2], 0.0])
    trunk, height = live.data.qpos[:3], live.env.robot.home_height
    arrows = np.empty((2, 2, 3))
    for row, (velocity, above) in enumerate(((does, 0.5), (command, 0.65))):
        seen = float(np.linalg.norm(velocity) > 0.02)  # else hidden in the trunk
        start = trunk + np.array([0.0, 0.0, above * height * seen])
        arrows[row] = start, start + _SPEED * velocity * seen
    return arrows
