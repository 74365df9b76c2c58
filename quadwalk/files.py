"""Files that appear under their final name whole, or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from quadwalk.errors import UserError

# What is raised where a file's JSON, or what was expected in it, is not as it should be: numbers
# may be infinite or larger than any float, and lists nested deeper than Python goes.
DAMAGE = (AttributeError, LookupError, OverflowError, RecursionError, TypeError, ValueError)


@contextlib.contextmanager
def atomic_write(path: Path | str) -> Iterator[BinaryIO]:
    """Open `path` + ".part" for writing bytes; it takes the place of `path` when the block ends.

    Whatever goes wrong (no space, no permission, Ctrl-C), the part file is removed and an older
    `path` stays as it was. The system's refusals become a `UserError` that names `path`.
    """
    path = Path(path)
    part = Path(f"{path}.part")
    try:
        with open(part, "wb") as file:
            yield file
            file.flush()
            # Without this a power cut after the rename could leave an empty file under `path`.
            os.fsync(file.fileno())
        os.replace(part, path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise UserError(f"cannot write {path}: {os_reason(error)}") from error
        raise
    _sync_folder(path.parent)


def real_path(path: Path) -> Path:
    """Absolute, without symbolic links; those that go round stay, where `Path.resolve` raises."""
    return Path(os.path.realpath(path))


def os_reason(error: OSError) -> str:
    """The system's reason alone ("No space left on device"), without numbers or paths."""
    return error.strerror or str(error) or type(error).__name__


def _sync_folder(folder: Path) -> None:
    """Make the new name itself survive a power cut."""
    # Some systems (Windows, some network file systems) cannot sync a folder. The file is complete
    # and in place by now, so that is no reason to fail.
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
