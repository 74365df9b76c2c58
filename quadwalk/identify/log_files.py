"""Files of joint logs, CSV or MCAP: joint targets and measured joint angles over time."""

import csv
import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from quadwalk.errors import UserError
from quadwalk.files import get_os_reason, read_bytes

STAND = 0.02  # m that a trunk on a stand may move
_ANGLES, _TARGETS, _POSE = "/joint_states", "/joint_cmd", "/pose"


class Log(NamedTuple):
    """A log of a robot on a stand; joints are in the order of the robot's, times begin anywhere."""

    time: np.ndarray  # (n,) s, of the angles, ascending; as in the file until `read_log` is done
    position: np.ndarray  # (n, 12) rad, measured
    target_time: np.ndarray  # (m,) s, from when each target holds, ascending
    target: np.ndarray  # (m, 12) rad
    rows: tuple[str, ...] = ()  # n places of the angles in the file, for errors
    target_rows: tuple[str, ...] = ()  # m, of the targets
    notes: tuple[str, ...] = ()  # for the user: an assumed unit, and gaps


def read_csv(path: Path, joints: tuple[str, ...]) -> Log:
    """Read the joints' targets and angles from a CSV with a header.

    Commas, semicolons or tabs separate columns. Numbers have decimal points or, where no comma
    separates them, commas. Raises `UserError` for a missing column or what is not a number.
    """
    text = read_bytes(path).decode("utf-8-sig", "replace")
    delimiter = max(",;\t", key=text.partition("\n")[0].count)
    lines = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    header = [name.strip() for name in next(lines, [])]
    names = ["time", *(f"{kind}_{j}" for kind in ("target", "position") for j in joints)]
    missing = [name for name in names if name not in header]
    if missing:
        more = f" and {len(missing) - 1} more" if missing[1:] else ""
        raise UserError(
            f"{path}: has no column {missing[0]}{more}; expected time, and target_JOINT and "
            "position_JOINT of each joint"
        )
    columns = [header.index(name) for name in names]
    rows, numbers = [], []
    for fields in filter(None, lines):
        row = f"line {lines.line_num}"
        if any(fields[len(header) :]):
            raise UserError(
                f"{path}, {row}: has {len(fields)} values for {len(header)} columns; expected "
                "decimal points, or semicolons between columns"
            )
        rows.append(row)
        numbers.append(_read_numbers(f"{path}, {row}", fields, columns))
    values = np.array(numbers).reshape(-1, len(columns))
    time, target, position = values[:, 0], values[:, 1:13], values[:, 13:]
    return Log(time, position, time, target, tuple(rows), tuple(rows))


def _read_numbers(source: str, fields: list[str], columns: list[int]) -> list[float]:
    """Return the numbers in these columns of a row; `source` names the row in a `UserError`."""
    try:
        numbers = [float(fields[column].replace(",", ".")) for column in columns]
    except (IndexError, ValueError):
        numbers = [np.nan]
    if not np.isfinite(numbers).all():
        raise UserError(f"{source}: expected a finite number in every column")
    return numbers


def read_mcap(path: Path, joints: tuple[str, ...]) -> Log:
    """Read the joints' targets and angles from an MCAP file of a robot on a stand.

    Raises `UserError` if the file is damaged, the trunk moves, or a topic or joint is missing.
    """
    messages: dict[str, list[tuple[float, Any]]] = {name: [] for name in (_ANGLES, _TARGETS, _POSE)}
    try:
        with open(path, "rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            for _, channel, message, decoded in reader.iter_decoded_messages(list(messages)):
                messages[channel.topic].append((message.log_time * 1e-9, decoded))
    except OSError as error:
        raise UserError(f"cannot read {path}: {get_os_reason(error)}") from error
    except Exception as error:  # damaged bytes meet the reader's parts anywhere
        reason = str(error) or type(error).__name__
        raise UserError(f"{path}: is no MCAP file that can be read ({reason})") from error
    places = [pose.pose.position for _, pose in messages[_POSE]]
    travel = np.ptp([(p.x, p.y, p.z) for p in places], axis=0).max() if places else 0.0
    if travel > STAND:
        raise UserError(f"{path}: the trunk moves by {travel:.2f} m; expected a robot on a stand")
    time, position = _read_angles(path, _ANGLES, messages[_ANGLES], joints)
    target_time, target = _read_angles(path, _TARGETS, messages[_TARGETS], joints)
    rows, target_rows = (
        tuple(f"message {number} of {topic}" for number in range(1, len(times) + 1))
        for topic, times in ((_ANGLES, time), (_TARGETS, target_time))
    )
    return Log(time, position, target_time, target, rows, target_rows)


def _read_angles(
    path: Path, topic: str, messages: list[tuple[float, Any]], joints: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n,), s, and angles (n, 12), rad, from messages `foxglove.JointStates`."""
    try:
        rows = [{j.name: j.position for j in message.joints} for _, message in messages]
        angles = [[row[joint] for joint in joints] for row in rows]
    except (AttributeError, KeyError) as error:
        missing = error.args[0] if isinstance(error, KeyError) else "joints"
        raise UserError(
            f"{path}: {topic} has no {missing}; expected foxglove.JointStates of all joints"
        ) from None
    if not angles:
        raise UserError(f"{path}: has no {topic}; expected {_ANGLES} and {_TARGETS}")
    return np.array([time for time, _ in messages]), np.array(angles)
