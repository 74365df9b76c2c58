"""Mistakes in a log that a fit would take for properties of the robot."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from quadwalk.errors import UserError
from quadwalk.identify.log_files import Columns

LEAST = 0.05  # rad that a joint has to move
FASTEST = 50.0  # rad/s: no quadruped's joint turns faster
FROZEN = 1.0  # s with exactly one value while the joint's other column moves
# rad beyond a joint's limits: encoders have offsets, and targets ask for more than a joint has.
_BEYOND = {"position": 0.1, "target": 1.0}


def check_times(path: Path, columns: Columns) -> None:
    """Raise `UserError` unless times ascend."""
    for name, time, rows in (
        ("angles", columns.time, columns.rows),
        ("targets", columns.target_time, columns.target_rows),
    ):
        late = np.flatnonzero(np.diff(time) <= 0.0)
        if len(late) or len(time) < 2:
            row = rows[late[0] + 1] if len(late) else rows[-1]
            raise UserError(f"{path}, {row}: its times of {name} do not ascend; expected seconds")


def check_angles(
    path: Path,
    columns: Columns,
    joints: tuple[str, ...],
    lower: np.ndarray | float,
    upper: np.ndarray | float,
) -> None:
    """Raise `UserError` for the first angle that no joint with these limits, rad, can have."""
    for kind, angles, rows in (
        ("position", columns.position, columns.rows),
        ("target", columns.target, columns.target_rows),
    ):
        _check_wraps(path, kind, angles, rows, joints)
        _check_limits(path, kind, angles, rows, joints, lower, upper)
        _check_motion(path, kind, angles, joints)
    _check_jumps(path, columns, joints)
    _check_frozen(path, columns, joints)


def _check_wraps(
    path: Path, kind: str, angles: np.ndarray, rows: list[str], joints: tuple[str, ...]
) -> None:
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
    rows: list[str],
    joints: tuple[str, ...],
    lower: np.ndarray | float,
    upper: np.ndarray | float,
) -> None:
    low = np.broadcast_to(lower, 12) - _BEYOND[kind]
    high = np.broadcast_to(upper, 12) + _BEYOND[kind]
    for row, joint in np.argwhere((angles < low) | (angles > high)):
        radians = np.radians(angles)
        is_degrees = np.all((radians >= low) & (radians <= high))
        raise UserError(
            f"{path}, {rows[row]}: the {kind} of {joints[joint]} is {angles[row, joint]:.2f} rad, "
            f"beyond its limits of {np.broadcast_to(lower, 12)[joint]:.2f} and "
            f"{np.broadcast_to(upper, 12)[joint]:.2f}; expected the URDF's angles in rad"
            + (", and these look like degrees" if is_degrees else "")
        )


def _check_motion(path: Path, kind: str, angles: np.ndarray, joints: tuple[str, ...]) -> None:
    moved = np.ptp(angles, axis=0)
    if moved.min() < LEAST:
        still = joints[int(moved.argmin())]
        raise UserError(
            f"{path}: the {kind} of {still} moves by {moved.min():.3f} rad; expected "
            f"{LEAST:g} or more of every joint"
        )


def _check_jumps(path: Path, columns: Columns, joints: tuple[str, ...]) -> None:
    steps = np.abs(np.diff(columns.position, axis=0))
    possible = FASTEST * np.diff(columns.time)[:, None] + 2 * LEAST
    for row, joint in np.argwhere(steps > possible):
        raise UserError(
            f"{path}, {columns.rows[row + 1]}: the position of {joints[joint]} jumps by "
            f"{steps[row, joint]:.2f} rad; expected {FASTEST:g} rad/s or less"
        )


def target_at(target_time: np.ndarray, target: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the targets (n, 12) in force at `time` (n,)."""
    row = np.searchsorted(target_time, time, "right") - 1
    return target[np.maximum(row, 0)]


def _check_frozen(path: Path, columns: Columns, joints: tuple[str, ...]) -> None:
    target = target_at(columns.target_time, columns.target, columns.time)
    for joint, name in enumerate(joints):
        pair = {"position": columns.position[:, joint], "target": target[:, joint]}
        for kind, other in (("position", "target"), ("target", "position")):
            for start, end in _find_constant(pair[kind]):
                seconds = columns.time[end - 1] - columns.time[start]
                if seconds < FROZEN:
                    continue
                # The stretch's begin does not count: a joint needs time to reach its target.
                half = np.searchsorted(columns.time, columns.time[start] + FROZEN / 2)
                if np.ptp(pair[other][half:end]) > LEAST:
                    raise UserError(
                        f"{path}, {columns.rows[start]}: the {kind} of {name} stays at "
                        f"{pair[kind][start]:.4f} rad for {seconds:.1f} s in which its {other} "
                        "moves; expected one that is recorded anew in each row"
                    )


def _find_constant(values: np.ndarray) -> Iterator[tuple[int, int]]:
    """Return the first row and the end of each stretch of one value."""
    ends = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return pairwise(ends)
