"""A log of a robot on a stand: joint targets and measured joint angles over time."""

from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadwalk.errors import UserError
from quadwalk.identify.log_checks import check_angles, check_times, target_at
from quadwalk.identify.log_files import Columns, read_csv, read_mcap

SHORTEST = 5.0  # s
FEWEST, MOST = 40, 10_000  # samples a second: less does not show a delay of some ms
GAP = 0.1  # s without an angle, in which the targets are not known either
PIECE = 1.0  # s, the shortest piece between two gaps that shows something
_UNITS = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}


class Log(NamedTuple):
    """Joints are in the order of the robot's; times begin anywhere."""

    time: np.ndarray  # (n,) s, of the angles, ascending
    position: np.ndarray  # (n, 12) rad, measured
    target_time: np.ndarray  # (m,) s, from when each target holds, ascending
    target: np.ndarray  # (m, 12) rad
    notes: tuple[str, ...] = ()  # for the user: an assumed unit, and gaps


def find_pieces(time: np.ndarray) -> list[slice]:
    """Return the rows of each piece between gaps; `time` (n,), s."""
    ends = [0, *(np.flatnonzero(np.diff(time) > GAP) + 1).tolist(), len(time)]
    return [slice(start, end) for start, end in pairwise(ends)]


def read_log(
    path: Path,
    joints: tuple[str, ...],
    lower: np.ndarray | float = -np.inf,
    upper: np.ndarray | float = np.inf,
) -> Log:
    """Read a CSV or MCAP file of the `joints`, whose limits (12,), rad, are `lower` and `upper`.

    Raise `UserError`, in one line with row and joint, for a log that nothing can be fitted to.
    """
    is_mcap = path.suffix.lower() == ".mcap"
    columns = read_mcap(path, joints) if is_mcap else read_csv(path, joints)
    if not columns.rows:
        raise UserError(f"{path}: has no row of numbers; expected {SHORTEST:g} s or more")
    unit = _guess_unit(columns.time)
    columns = columns._replace(
        time=_UNITS[unit] * columns.time, target_time=_UNITS[unit] * columns.target_time
    )
    check_times(path, columns)
    _check_rate(path, columns.time)
    notes = [] if unit == "seconds" else [f"its times are read as {unit}"]
    notes += _describe_gaps(columns)
    columns = _drop_short_pieces(columns)
    _check_length(path, columns.time)
    check_angles(path, columns, joints, lower, upper)
    return Log(*columns[:4], notes=tuple(notes))


def find_followed_target(log: Log, joint: int) -> tuple[int, float]:
    """Return the joint whose target a joint's angles follow best, and their correlation."""
    target = target_at(log.target_time, log.target, log.time)
    correlation = np.corrcoef(log.position[:, joint], target.T)[0, 1:]
    best = int(np.abs(correlation).argmax())
    return best, float(correlation[best])


def _guess_unit(time: np.ndarray) -> str:
    """Return the unit in which the times (n,) make a log of a usable rate; seconds if none does."""
    interval = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    for unit, seconds in _UNITS.items():
        is_long = (time[-1] - time[0]) * seconds >= SHORTEST
        if is_long and 1.0 / MOST <= interval * seconds <= 1.0 / FEWEST:
            return unit
    return "seconds"


def _describe_gaps(columns: Columns) -> list[str]:
    """Return one note on the gaps, if there are any."""
    starts = [piece.start for piece in find_pieces(columns.time)[1:]]
    if not starts:
        return []
    lengths = [columns.time[start] - columns.time[start - 1] for start in starts]
    longest = int(np.argmax(lengths))
    gaps = "a gap" if len(starts) == 1 else f"{len(starts)} gaps, the longest"
    return [
        f"has {gaps} of {lengths[longest]:.2f} s before {columns.rows[starts[longest]]}; "
        f"each piece of {PIECE:g} s or more is fitted"
    ]


def _drop_short_pieces(columns: Columns) -> Columns:
    """Return the columns without pieces too short to show anything."""
    time = columns.time
    pieces = find_pieces(time)
    long = [p for p in pieces if time[p.stop - 1] - time[p.start] >= PIECE or len(pieces) == 1]
    rows = [row for piece in long for row in range(piece.start, piece.stop)]
    return columns._replace(
        time=time[rows],
        position=columns.position[rows],
        rows=[columns.rows[row] for row in rows],
    )


def _check_rate(path: Path, time: np.ndarray) -> None:
    rate = 1.0 / np.median(np.diff(time))
    if rate < FEWEST:
        raise UserError(f"{path}: has {rate:.0f} angles a second; expected {FEWEST} or more")


def _check_length(path: Path, time: np.ndarray) -> None:
    seconds = sum(np.ptp(time[piece]) for piece in find_pieces(time) if len(time))
    if seconds < SHORTEST:
        raise UserError(f"{path}: has {seconds:.1f} s; expected {SHORTEST:g} s or more")
