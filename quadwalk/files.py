"""Files that appear under their final name whole, or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

from quadwalk.errors import UserError

# What is raised where a file's JSON, or what was expected in it, is not as it should be: numbers
# may be infinite or larger than any float, and lists nested deeper than Python goes.
DAMAGE = (AttributeError, LookupError, OverflowError, RecursionError, TypeError, ValueError)


@contextlib.contextmanager
def remove_on_error(path: Path) -> Iterator[None]:
    """Remove the file or folder `path`, if it exists, when the context ends with an exception."""
    try:
        yield
    except BaseException:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        with contextlib.suppress(OSError):
            path.unlink()
        raise


@contextlib.contextmanager
def open_atomic(path: Path | str) -> Iterator[BinaryIO]:
    """Open `path` + ".part" for writing bytes, and rename it to `path` when the context ends.

    Whatever goes wrong (no space, Ctrl-C), the part file is removed and an older `path` stays. A
    link stays, and its target is written. A device or a pipe is written as it is. The system's
    refusals become a `UserError` that names `path`.
    """
    target = resolve_path(Path(path))
    part = Path(f"{target}.part")
    try:
        if _is_special(path):
            with open(path, "wb") as file:
                yield file
            return
        with remove_on_error(part):
            with open(part, "wb") as file:
                yield file
                file.flush()
                # Without this a power cut after the rename could leave an empty file under `path`.
                os.fsync(file.fileno())
            os.replace(part, target)
    except OSError as error:
        raise UserError(f"cannot write {path}: {get_os_reason(error)}") from error
    _sync_folder(target.parent)


def resolve_path(path: Path) -> Path:
    """Return the absolute path without links; `Path.resolve` raises where they go in a circle."""
    return Path(os.path.realpath(path))


def read_bytes(path: Path | str) -> bytes:
    """Return a file's content; raise `UserError` where the system refuses it."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise UserError(f"cannot read {path}: {get_os_reason(error)}") from error


def hash_file(path: Path | str) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    return hashlib.sha256(read_bytes(path)).hexdigest()


def format_json(value: Any) -> bytes:
    """Return `value` as indented JSON in UTF-8; raise `ValueError` for NaN and infinity."""
    return json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False).encode() + b"\n"


def write_json(path: Path | str, value: Any) -> None:
    """Write `value` as readable, strict JSON, whole or not at all."""
    content = format_json(value)  # before there is a file: it may be refused
    with open_atomic(path) as file:
        file.write(content)


def make_folder(path: Path, what: str = "the folder") -> None:
    """Make a folder and those above it; raise `UserError` where the system refuses."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make {what} {path}: {get_os_reason(error)}") from error


def lock(file: Any, wait: bool = False) -> bool | None:
    """Lock `file` until it is closed: True if this process has it now, False if another has.

    With `wait` it waits for another. None where the system or the file system has no such locks.
    """
    if fcntl is None:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


@contextlib.contextmanager
def hold_file(path: Path, message: str | None) -> Iterator[None]:
    """Lock a file, made if need be, while the context is open.

    Raises `UserError` with the text `message` if another process has it, and waits without one.
    The system unlocks it when the process ends, however it ends.
    """
    try:
        file = open(path, "ab")  # noqa: SIM115 - opened apart, to tell what is refused
    except OSError as error:
        raise UserError(f"cannot write {path}: {get_os_reason(error)}") from error
    with file:
        if lock(file, wait=message is None) is False:
            raise UserError(str(message))
        yield


def get_os_reason(error: OSError) -> str:
    """Return the system's reason alone ("No space left on device"), without numbers or paths."""
    return error.strerror or str(error) or type(error).__name__


def _is_special(path: Path | str) -> bool:
    """Return True if the path leads to a device, pipe or folder; False for a file or nothing."""
    try:
        # Not of the resolved path: /dev/stdout leads to a pipe that has no path.
        return not stat.S_ISREG(os.stat(path).st_mode)
    except FileNotFoundError:
        return False


def _sync_folder(folder: Path) -> None:
    """Write a folder's names to the disk, so that a new one survives a power cut."""
    # Some systems (Windows, some network file systems) cannot sync a folder. The file is complete
    # and in place by now, so that is no reason to fail.
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
