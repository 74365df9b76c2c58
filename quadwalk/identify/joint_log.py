"""A log of a robot on a stand: joint targets and measured joint angles over time."""

import csv
import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from quadwalk.errors import UserError
from quadwalk.files import os_reason, read_bytes

SHORTEST = 5.0  # s
FEWEST = 40  # samples a second: less does not show a delay of some ms
LEAST = 0.05  # rad that a joint has to move
STAND = 0.02  # m that a trunk on a stand may move
_ANGLES, _TARGETS, _POSE = "/joint_states", "/joint_cmd", "/pose"


class Log(NamedTuple):
    """Joints are in the order of the robot's; times begin anywhere."""

    time: np.ndarray  # (n,) s, of the angles, ascending
    position: np.ndarray  # (n, 12) rad, measured
    target_time: np.ndarray  # (m,) s, from when each target holds, ascending
    target: np.ndarray  # (m, 12) rad


def read_log(path: Path, joints: tuple[str, ...]) -> Log:
    """Read a CSV or MCAP file; `UserError` in one line for one that nothing can be found from."""
    log = (_read_mcap if path.suffix.lower() == ".mcap" else _read_csv)(path, joints)
    for name, time in (("angles", log.time), ("targets", log.target_time)):
        if len(time) < 2 or np.diff(time).min() <= 0:
            raise UserError(f"{path}: its times of {name} do not ascend; expected seconds")
    seconds = log.time[-1] - log.time[0]
    if seconds < SHORTEST:
        raise UserError(f"{path}: has {seconds:.1f} s; expected {SHORTEST:g} s or more")
    rate = (len(log.time) - 1) / seconds
    if rate < FEWEST:
        raise UserError(f"{path}: has {rate:.0f} angles a second; expected {FEWEST} or more")
    for what, angles in (("position", log.position), ("target", log.target)):
        moved = np.ptp(angles, axis=0)
        if moved.min() < LEAST:
            still = joints[int(moved.argmin())]
            raise UserError(
                f"{path}: the {what} of {still} moves by {moved.min():.3f} rad; expected "
                f"{LEAST:g} or more of every joint"
            )
    return log


def _read_csv(path: Path, joints: tuple[str, ...]) -> Log:
    text = read_bytes(path).decode("utf-8-sig", "replace")
    rows = csv.reader(io.StringIO(text, newline=""))
    header = [name.strip() for name in next(rows, [])]
    wanted = ["time", *(f"{what}_{j}" for what in ("target", "position") for j in joints)]
    missing = [name for name in wanted if name not in header]
    if missing:
        more = f" and {len(missing) - 1} more" if missing[1:] else ""
        raise UserError(
            f"{path}: has no column {missing[0]}{more}; expected time, and target_JOINT and "
            "position_JOINT of each joint"
        )
    places = [header.index(name) for name in wanted]
    values = np.array([_numbers(path, rows.line_num, row, places) for row in rows if row])
    if not len(values):
        raise UserError(f"{path}: has no row of numbers; expected {SHORTEST:g} s or more")
    time, target, position = values[:, 0], values[:, 1:13], values[:, 13:]
    return Log(time, position, time, target)


def _numbers(path: Path, line: int, row: list[str], places: list[int]) -> list[float]:
    try:
        found = [float(row[place]) for place in places]
    except (IndexError, ValueError):
        found = [np.nan]
    if not np.isfinite(found).all():
        raise UserError(f"{path}, line {line}: expected a finite number in every column")
    return found


def _read_mcap(path: Path, joints: tuple[str, ...]) -> Log:
    found: dict[str, list[tuple[float, Any]]] = {name: [] for name in (_ANGLES, _TARGETS, _POSE)}
    try:
        with open(path, "rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            for _, channel, message, decoded in reader.iter_decoded_messages(list(found)):
                found[channel.topic].append((message.log_time * 1e-9, decoded))
    except OSError as error:
        raise UserError(f"cannot read {path}: {os_reason(error)}") from error
    except Exception as error:  # damaged bytes meet the reader's parts anywhere
        reason = str(error) or type(error).__name__
        raise UserError(f"{path}: is no MCAP file that can be read ({reason})") from error
    places = [pose.pose.position for _, pose in found[_POSE]]
    moved = np.ptp([(p.x, p.y, p.z) for p in places], axis=0).max() if places else 0.0
    if moved > STAND:
        raise UserError(f"{path}: the trunk moves by {moved:.2f} m; expected a robot on a stand")
    position = _joint_angles(path, _ANGLES, found[_ANGLES], joints)
    return Log(*position, *_joint_angles(path, _TARGETS, found[_TARGETS], joints))


def _joint_angles(
    path: Path, topic: str, messages: list[tuple[float, Any]], joints: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,), s, and angles (n, 12), rad, of `foxglove.JointStates`."""
    try:
        rows = [{j.name: j.position for j in message.joints} for _, message in messages]
        angles = [[row[joint] for joint in joints] for row in rows]
    except (AttributeError, KeyError) as error:
        what = error.args[0] if isinstance(error, KeyError) else "joints"
        raise UserError(
            f"{path}: {topic} has no {what}; expected foxglove.JointStates of all joints"
        ) from None
    if not angles:
        raise UserError(f"{path}: has no {topic}; expected {_ANGLES} and {_TARGETS}")
    return np.array([time for time, _ in messages]), np.array(angles)
