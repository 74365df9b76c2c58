"""The metrics, timing and TensorBoard events that training writes at every iteration.

`metrics.jsonl` holds only what follows from the seed and the settings. The same seed on the same
machine gives the same file, bit for bit, so files show whether two trainings were the same. What
the clock says differs each time; it goes to `timing.jsonl`.
"""

import contextlib
import json
import math
import os
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary
from tensorboardX.record_writer import RecordWriter

from quadwalk.errors import UserError
from quadwalk.files import DAMAGE, get_os_reason
from quadwalk.runs.directory import Run

_FLUSH_SECONDS = 2.0  # TensorBoard rereads its files every few seconds; more often buys nothing
_BINARY = getattr(os, "O_BINARY", 0)  # Windows would write the ends of lines as it likes them
_TAIL = 1 << 16  # bytes at the end of metrics.jsonl that hold its last row

Row = dict[str, float]


class MetricsLog(contextlib.AbstractContextManager["MetricsLog"]):
    """The files of a run to which each iteration adds its numbers; a context manager.

    With `resume_at`, rows beyond that many steps are dropped first: the training goes on from a
    checkpoint and will write them again. All methods raise `UserError` when the system refuses (no
    space); what was refused is written as soon as there is room. TensorBoard events are a copy, and
    those that were refused are left out.
    """

    def __init__(self, run: Run, resume_at: int | None = None) -> None:
        self._metrics = _Lines(run.metrics, resume_at)
        self._timing = _Lines(run.timing, resume_at)
        self._events = _Events(run.tensorboard, resume_at)

    def append(self, metrics: Mapping[str, Any], timing: Mapping[str, Any] | None = None) -> None:
        """Add a row of `metrics`, which contain "steps", and a row of `timing` at the same steps.

        NaN and infinity are written as null.
        """
        steps = int(metrics["steps"])
        with contextlib.ExitStack() as stack:  # each file, whatever becomes of the others
            stack.callback(self._events.append, steps, {**metrics, **(timing or {})})
            if timing:
                stack.callback(self._timing.append, _make_row(steps, timing))
            stack.callback(self._metrics.append, _make_row(steps, metrics))

    def sync(self) -> None:
        """Put all rows on the disk for good, which a checkpoint needs before it is written."""
        self._metrics.sync()
        self._timing.sync()
        with contextlib.suppress(UserError):
            self._events.flush()

    def close(self) -> None:
        """Close the files. Rows that the disk has refused are lost: call `sync` before."""
        self._metrics.close()
        self._timing.close()
        self._events.close()

    def __exit__(self, *_: object) -> None:
        self.close()


def read_metrics(run: Run) -> list[Row]:
    """Read the rows of a run's metrics in order, null as NaN, without a last line cut short.

    Raises `UserError` for a file that is damaged.
    """
    return [row for row, _ in _read_rows(run.metrics)]


def read_history(run: Run) -> list[Row]:
    """Read a run's metrics, each row joined by the timing of its iteration where there is one."""
    timing = {row["steps"]: row for row, _ in _read_rows(run.timing)}
    return [{**timing.get(row["steps"], {}), **row} for row in read_metrics(run)]


def read_last_row(run: Run) -> Row | None:
    """Read the last complete row of a run's metrics, null as NaN; None if there is no row."""
    try:
        with open(run.metrics, "rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - _TAIL))
            lines = file.read().split(b"\n")
    except OSError:
        return None
    return _parse_row(lines[-2]) if len(lines) > 1 else None


def _make_row(steps: int, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row of a log for JSON: its steps first, then `values` sorted by name."""
    numbers = {name: _to_json(value) for name, value in sorted(values.items()) if name != "steps"}
    return {"steps": steps, **numbers}


def _to_json(value: Any) -> int | float | None:
    """Return a scalar of Python, NumPy or JAX as a number for JSON; None for NaN and infinity."""
    value = np.asarray(value).item()
    return value if math.isfinite(value) else None


def _parse_row(line: bytes) -> Row | None:
    """Return the row in a line of JSON, null as NaN; None if the line holds no row."""
    try:
        values = json.loads(line)
        # A name is kept once, not in every row.
        row = {sys.intern(name): float("nan" if x is None else x) for name, x in values.items()}
        row["steps"] = int(values["steps"])
    except DAMAGE:
        return None
    return row


def _read_rows(path: Path) -> Iterator[tuple[Row, int]]:
    """Yield the complete rows of a file of JSON lines, each with the offset of its line's end."""
    end = 0
    try:
        with open(path, "rb") as file:
            for number, line in enumerate(file, 1):
                row = _parse_row(line)
                if row is None or not line.endswith(b"\n"):
                    if not file.peek(1):  # the last, cut short by a crash
                        return
                    raise UserError(
                        f"{path}, line {number}: expected an iteration's metrics as JSON"
                    )
                end += len(line)
                yield row, end
    except FileNotFoundError:
        return
    except OSError as error:
        raise UserError(f"cannot read {path}: {get_os_reason(error)}") from error


class _Lines:
    """A file of JSON lines, to which rows are added; `UserError` if the system refuses a write."""

    def __init__(self, path: Path, resume_at: int | None) -> None:
        self._path = path
        self._unwritten = b""  # for which there was no room on the disk
        size = 0
        for row, end in _read_rows(path):
            if resume_at is None or row["steps"] <= resume_at:
                size = end
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | _BINARY, 0o666)
            os.ftruncate(self._file, size)  # cuts off a torn line, too, which a crash may leave
        except OSError as error:
            raise self._make_error(error) from error

    def append(self, row: Mapping[str, Any]) -> None:
        """Write a row, after all rows that the disk has refused so far."""
        self._unwritten += json.dumps(row, allow_nan=False).encode() + b"\n"
        self._write()

    def _write(self) -> None:
        """Write the bytes that are not on the disk yet; they continue a line that broke off."""
        try:
            while self._unwritten:
                self._unwritten = self._unwritten[os.write(self._file, self._unwritten) :]
        except OSError as error:
            raise self._make_error(error) from error

    def sync(self) -> None:
        """Write all rows and wait until they are on the disk for good."""
        self._write()
        try:
            os.fsync(self._file)
        except OSError as error:
            raise self._make_error(error) from error

    def close(self) -> None:
        os.close(self._file)

    def _make_error(self, error: OSError) -> UserError:
        return UserError(f"cannot write {self._path}: {get_os_reason(error)}")


class _Events:
    """TensorBoard events, written in this thread.

    tensorboardX's own `SummaryWriter` hands events to a thread that dies silently on a full disk,
    after which its queue fills up and training waits for ever; its record writer has no such life.
    """

    def __init__(self, folder: Path, resume_at: int | None) -> None:
        self._folder = folder
        self._resume_at = resume_at
        self._writer: Any = None
        self._flushed = 0.0

    def append(self, steps: int, values: Mapping[str, Any]) -> None:
        """Add an event with all of `values` at this step."""
        scalars = [
            Summary.Value(tag=name, simple_value=float(np.asarray(value).item()))
            for name, value in values.items()
            if name != "steps"
        ]
        event = Event(wall_time=time.time(), step=steps, summary=Summary(value=scalars))
        with self._begin_anew_if_refused():
            if self._writer is None:
                self._writer = self._open()
            self._writer.write(event.SerializeToString())
        if time.monotonic() - self._flushed > _FLUSH_SECONDS:
            self.flush()

    def flush(self) -> None:
        """Hand all events to the system."""
        if self._writer is not None:
            with self._begin_anew_if_refused():
                self._writer.flush()
            self._flushed = time.monotonic()

    def close(self) -> None:
        """Close the file, if one is open; the next event begins a new one."""
        writer, self._writer = self._writer, None
        if writer is not None:
            with contextlib.suppress(OSError):
                writer.close()

    def _open(self) -> Any:
        """Begin a file of events; after a resume, hide events of later steps in earlier files."""
        self._folder.mkdir(parents=True, exist_ok=True)
        # The number keeps a run resumed within the same second from overwriting its own events.
        number = sum(1 for _ in self._folder.iterdir())
        name = f"events.out.tfevents.{int(time.time()):010d}.quadwalk.{number}"
        writer = RecordWriter(str(self._folder / name))
        now = time.time()
        writer.write(Event(wall_time=now, file_version="brain.Event:2").SerializeToString())
        if self._resume_at is not None:
            # Tells TensorBoard to forget what the interrupted run wrote beyond this step.
            start = SessionLog(status=SessionLog.START)
            event = Event(wall_time=now, step=self._resume_at + 1, session_log=start)
            writer.write(event.SerializeToString())
        return writer

    @contextlib.contextmanager
    def _begin_anew_if_refused(self) -> Iterator[None]:
        """Raise `UserError` if the system refuses a write, and close the file.

        The next event begins a new file: half an event may end this one, where a reader would stop.
        """
        try:
            yield
        except OSError as error:
            self.close()
            reason = get_os_reason(error)
            raise UserError(
                f"cannot write TensorBoard events in {self._folder}: {reason}"
            ) from error
