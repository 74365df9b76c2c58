"""What training writes down at every iteration: metrics, timing, TensorBoard events.

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
from quadwalk.files import DAMAGE, os_reason
from quadwalk.runs.directory import Run

_FLUSH_SECONDS = 2.0  # TensorBoard rereads its files every few seconds; more often buys nothing

_BINARY = getattr(os, "O_BINARY", 0)  # Windows would write the ends of lines as it likes them

Row = dict[str, float]


class MetricsLog:
    """Appends an iteration's numbers to the run's files.

    With `resume_at`, rows beyond that many steps are dropped first: the training goes on from a
    checkpoint and will write them again. All methods raise `UserError` when the system refuses (no
    space); every complete row stays readable then, and what was refused is written as soon as
    there is room. TensorBoard events are a copy, and those that were refused are left out.
    """

    def __init__(self, run: Run, resume_at: int | None = None) -> None:
        self._metrics = _Lines(run.metrics, resume_at)
        self._timing = _Lines(run.timing, resume_at)
        self._events = _Events(run.tensorboard, resume_at)

    def append(self, metrics: Mapping[str, Any], timing: Mapping[str, Any] | None = None) -> None:
        """Write `metrics` with their "steps", and their `timing`; null for NaN and infinity."""
        steps = int(metrics["steps"])
        with contextlib.ExitStack() as each:  # whatever becomes of the others
            each.callback(self._events.append, steps, {**metrics, **(timing or {})})
            if timing:
                each.callback(self._timing.append, _row(steps, timing))
            each.callback(self._metrics.append, _row(steps, metrics))

    def sync(self) -> None:
        """Put all rows on the disk for good: before the checkpoint that relies on them."""
        self._metrics.sync()
        self._timing.sync()
        with contextlib.suppress(UserError):
            self._events.flush()

    def close(self) -> None:
        """Give the files back; `sync` first."""
        self._metrics.close()
        self._timing.close()
        self._events.close()

    def __enter__(self) -> "MetricsLog":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_metrics(run: Run) -> list[Row]:
    """A run's metrics in order, null as NaN, less a last line cut short; `UserError` if damaged."""
    return [row for row, _ in _read_rows(run.metrics)]


def read_history(run: Run) -> list[Row]:
    """`read_metrics`, each row joined by the timing of the same iteration where there is one."""
    timing = {row["steps"]: row for row, _ in _read_rows(run.timing)}
    return [{**timing.get(row["steps"], {}), **row} for row in read_metrics(run)]


def _row(steps: int, values: Mapping[str, Any]) -> dict[str, Any]:
    numbers = {name: _number(value) for name, value in sorted(values.items()) if name != "steps"}
    return {"steps": steps, **numbers}


def _number(value: Any) -> int | float | None:
    value = np.asarray(value).item()
    return value if math.isfinite(value) else None


def _read_rows(path: Path) -> Iterator[tuple[Row, int]]:
    """The complete rows of a file of JSON lines, each with the offset at which it ends."""
    end = 0
    try:
        with open(path, "rb") as file:
            for number, line in enumerate(file, 1):
                try:
                    known = json.loads(line)
                    # A name is kept once, not in every row; null is NaN.
                    row = {
                        sys.intern(n): float("nan" if x is None else x) for n, x in known.items()
                    }
                    row["steps"] = int(known["steps"])
                except DAMAGE:
                    row = None
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
        raise UserError(f"cannot read {path}: {os_reason(error)}") from error


class _Lines:
    """A file of JSON lines that only ever grows by whole lines."""

    def __init__(self, path: Path, resume_at: int | None) -> None:
        self._path = path
        self._size = 0
        for row, end in _read_rows(path):
            if resume_at is None or row["steps"] <= resume_at:
                self._size = end
        self._waiting: list[bytes] = []  # for room on the disk
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | _BINARY, 0o666)
            # Also cuts off the torn line that a crash may have left.
            os.ftruncate(self._file, self._size)
            os.lseek(self._file, 0, os.SEEK_END)
        except OSError as error:
            raise self._refused(error) from error

    def append(self, row: Mapping[str, Any]) -> None:
        self._waiting.append(json.dumps(row, allow_nan=False).encode() + b"\n")
        self._write()

    def _write(self) -> None:
        while self._waiting:
            rest = line = self._waiting[0]
            try:
                while rest:
                    rest = rest[os.write(self._file, rest) :]
            except OSError as error:
                # The disk took a part of the line: take it back, or the next would be glued to it.
                os.ftruncate(self._file, self._size)
                os.lseek(self._file, 0, os.SEEK_END)
                raise self._refused(error) from error
            self._size += len(line)
            del self._waiting[0]

    def sync(self) -> None:
        self._write()
        try:
            os.fsync(self._file)
        except OSError as error:
            raise self._refused(error) from error

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _refused(self, error: OSError) -> UserError:
        return UserError(f"cannot write {self._path}: {os_reason(error)}")


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
        scalars = [
            Summary.Value(tag=name, simple_value=float(np.asarray(value).item()))
            for name, value in values.items()
            if name != "steps"
        ]
        event = Event(wall_time=time.time(), step=steps, summary=Summary(value=scalars))
        try:
            if self._writer is None:
                self._writer = self._open()
            self._writer.write(event.SerializeToString())
        except OSError as error:
            raise self._refused(error) from error
        if time.monotonic() - self._flushed > _FLUSH_SECONDS:
            self.flush()

    def flush(self) -> None:
        if self._writer is None:
            return
        try:
            self._writer.flush()
        except OSError as error:
            raise self._refused(error) from error
        self._flushed = time.monotonic()

    def close(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            with contextlib.suppress(OSError):
                writer.close()

    def _open(self) -> Any:
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

    def _refused(self, error: OSError) -> UserError:
        # Half an event may have been written, after which none would be read: a new file is begun.
        self.close()
        return UserError(f"cannot write TensorBoard events in {self._folder}: {os_reason(error)}")
