"""Joint logs that can be fitted: units, gaps, and mistakes that look like a robot's properties."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from quadwalk.errors import UserError
from quadwalk.identify.log_files import Log, read_csv, read_mcap

SHORTEST = 5.0  # s
FEWEST, MOST = 40, 10_000  # samples a second: less does not show a delay of some ms
GAP = 0.1  # s without an angle, in which the targets are not known either
PIECE = 1.0  # s, the shortest piece between two gaps that shows something
LEAST = 0.05  # rad that a joint has to move
FASTEST = 50.0  # rad/s: no quadruped's joint turns faster
FROZEN = 1.0  # s with exactly one value while the joint's other column moves
# rad beyond a joint's limits: encoders have offsets, and targets ask for more than a joint has.
_BEYOND = {"position": 0.1, "target": 1.0}
_UNITS = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}


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
    log = read_mcap(path, joints) if is_mcap else read_csv(path, joints)
    if not log.rows:
        raise UserError(f"{path}: has no row of numbers; expected {SHORTEST:g} s or more")
    unit = _guess_unit(log.time)
    log = log._replace(time=_UNITS[unit] * log.time, target_time=_UNITS[unit] * log.target_time)
    _check_times(path, log)
    rate = 1.0 / np.median(np.diff(log.time))
    if rate < FEWEST:
        raise UserError(f"{path}: has {rate:.0f} angles a second; expected {FEWEST} or more")
    notes = [] if unit == "seconds" else [f"its times are read as {unit}"]
    notes += _describe_gaps(log)
    log = _drop_short_pieces(log)
    seconds = sum(np.ptp(log.time[piece]) for piece in find_pieces(log.time) if len(log.time))
    if seconds < SHORTEST:
        raise UserError(f"{path}: has {seconds:.1f} s; expected {SHORTEST:g} s or more")
    limits = np.broadcast_to(lower, 12), np.broadcast_to(upper, 12)
    for kind, angles, rows in (
        ("position", log.position, log.rows),
        ("target", log.target, log.target_rows),
    ):
        _check_wraps(path, kind, angles, rows, joints)
        _check_limits(path, kind, angles, rows, joints, *limits)
        _check_motion(path, kind, angles, joints)
    _check_jumps(path, log, joints)
    _check_frozen(path, log, joints)
    return log._replace(notes=tuple(notes))


def find_pieces(time: np.ndarray) -> list[slice]:
    """Return the rows of each piece of a log, which gaps separate; `time` (n,) is in s."""
    ends = [0, *(np.flatnonzero(np.diff(time) > GAP) + 1).tolist(), len(time)]
    return [slice(start, end) for start, end in pairwise(ends)]


def get_targets(log: Log, time: np.ndarray) -> np.ndarray:
    """Return the targets (n, 12), rad, in force at `time` (n,), s: each holds until the next."""
    row = np.searchsorted(log.target_time, time, "right") - 1
    return log.target[np.maximum(row, 0)]


def find_followed_target(log: Log, joint: int) -> tuple[int, float]:
    """Return the index of the joint whose target the angles of `joint` follow best.

    With it comes their correlation, -1 to 1; a negative one counts by its size.
    """
    correlation = np.corrcoef(log.position[:, joint], get_targets(log, log.time).T)[0, 1:]
    best = int(np.abs(correlation).argmax())
    return best, float(correlation[best])


def _guess_unit(time: np.ndarray) -> str:
    """Return the unit of `time` (n,): one in which the log has a plausible rate, else "seconds"."""
    interval = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    for unit, seconds in _UNITS.items():
        is_long = (time[-1] - time[0]) * seconds >= SHORTEST
        if is_long and 1.0 / MOST <= interval * seconds <= 1.0 / FEWEST:
            return unit
    return "seconds"


def _describe_gaps(log: Log) -> list[str]:
    """Return one note on the gaps, if there are any."""
    starts = [piece.start for piece in find_pieces(log.time)[1:]]
    if not starts:
        return []
    lengths = [log.time[start] - log.time[start - 1] for start in starts]
    longest = int(np.argmax(lengths))
    gaps = "a gap" if len(starts) == 1 else f"{len(starts)} gaps, the longest"
    return [
        f"has {gaps} of {lengths[longest]:.2f} s before {log.rows[starts[longest]]}; "
        f"each piece of {PIECE:g} s or more is fitted"
    ]


def _drop_short_pieces(log: Log) -> Log:
    """Return the log without pieces too short to show anything."""
    time = log.time
    pieces = find_pieces(time)
    long = [p for p in pieces if time[p.stop - 1] - time[p.start] >= PIECE or len(pieces) == 1]
    rows = [row for piece in long for row in range(piece.start, piece.stop)]
    places = tuple(log.rows[row] for row in rows)
    return log._replace(time=time[rows], position=log.position[rows], rows=places)


def _check_times(path: Path, log: Log) -> None:
    """Raise `UserError` unless the times of angles and those of targets increase strictly."""
    for name, time, rows in (
        ("angles", log.time, log.rows),
        ("targets", log.target_time, log.target_rows),
    ):
        late = np.flatnonzero(np.diff(time) <= 0.0)
        if len(late) or len(time) < 2:
            row = rows[late[0] + 1] if len(late) else rows[-1]
            raise UserError(f"{path}, {row}: its times of {name} do not ascend; expected seconds")


def _check_wraps(
    path: Path, kind: str, angles: np.ndarray, rows: tuple[str, ...], joints: tuple[str, ...]
) -> None:
    """Raise `UserError` for a joint whose `angles` (n, 12), rad, jump by 2 pi.

    `kind` is "position" or "target", and `rows` are the names of the rows in the file, for the
    message.
    """
    turns = np.abs(np.abs(np.diff(angles, axis=0)) - 2 * np.pi) < 0.5
    for row, joint in np.argwhere(turns):
        raise UserError(
            f"{path}, {rows[row + 1]}: the {kind} of {joints[joint]} jumps by 2 pi; expected "
            "angles that do not wrap around"
        )


def _check_limits(
    path: Path,
    kind: str,
    angles: np.ndarray,
    rows: tuple[str, ...],
    joints: tuple[str, ...],
    lower: np.ndarray,
    upper: np.ndarray,
) -> None:
    """Raise `UserError` for a joint whose `angles` (n, 12), rad, are well beyond its limits (12,).

    `kind` is "position" or "target", and `rows` are the names of the rows in the file, for the
    message.
    """
    low, high = lower - _BEYOND[kind], upper + _BEYOND[kind]
    for row, joint in np.argwhere((angles < low) | (angles > high)):
        radians = np.radians(angles)
        is_degrees = np.all((radians >= low) & (radians <= high))
        raise UserError(
            f"{path}, {rows[row]}: the {kind} of {joints[joint]} is {angles[row, joint]:.2f} rad, "
            f"beyond its limits of {lower[joint]:.2f} and {upper[joint]:.2f}; expected the URDF's "
            "angles in rad" + (", and these look like degrees" if is_degrees else "")
        )


def _check_motion(path: Path, kind: str, angles: np.ndarray, joints: tuple[str, ...]) -> None:
    """Raise `UserError` for a joint whose `angles` (n, 12), rad, hardly move.

    `kind` is "position" or "target", for the message.
    """
    spans = np.ptp(angles, axis=0)
    if spans.min() < LEAST:
        still = joints[int(spans.argmin())]
        raise UserError(
            f"{path}: the {kind} of {still} moves by {spans.min():.3f} rad; expected "
            f"{LEAST:g} or more of every joint"
        )


def _check_jumps(path: Path, log: Log, joints: tuple[str, ...]) -> None:
    """Raise `UserError` for a joint that moves faster than `FASTEST`, rad/s, between two rows."""
    steps = np.abs(np.diff(log.position, axis=0))
    possible = FASTEST * np.diff(log.time)[:, None] + 2 * LEAST
    for row, joint in np.argwhere(steps > possible):
        raise UserError(
            f"{path}, {log.rows[row + 1]}: the position of {joints[joint]} jumps by "
            f"{steps[row, joint]:.2f} rad; expected {FASTEST:g} rad/s or less"
        )


def _check_frozen(path: Path, log: Log, joints: tuple[str, ...]) -> None:
    """Raise `UserError` if a position stays the same while its target moves, or the reverse."""
    columns = {"position": log.position, "target": get_targets(log, log.time)}
    for joint, name in enumerate(joints):
        for kind, other in (("position", "target"), ("target", "position")):
            angles = columns[kind][:, joint]
            for start, end in _find_constant(angles):
                seconds = log.time[end - 1] - log.time[start]
                if seconds < FROZEN:
                    continue
                # The stretch's begin does not count: a joint needs time to reach its target.
                half = np.searchsorted(log.time, log.time[start] + FROZEN / 2)
                if np.ptp(columns[other][half:end, joint]) > LEAST:
                    raise UserError(
                        f"{path}, {log.rows[start]}: the {kind} of {name} stays at "
                        f"{angles[start]:.4f} rad for {seconds:.1f} s in which its {other} "
                        "moves; expected one that is recorded anew in each row"
                    )


def _find_constant(values: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield the first row, and the row after the last, of each stretch of one value."""
    ends = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return pairwise(ends)
