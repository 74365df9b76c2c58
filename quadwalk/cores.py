"""The processor: its cores, its instructions, and where programs compiled for it are kept."""

import functools
import hashlib
import os
import platform
import signal
import tempfile
import time
from pathlib import Path

import platformdirs

from quadwalk.files import lock


def count_cores() -> int:
    """Return the number of cores that this process may use; a container's quota does not count."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


_PATIENCE = 2.0  # s for a process that has just ended to give its cores back
_pinned: list[int] = []  # open files whose locks say which cores are this process's


def pin(count: int) -> bool:
    """Keep this process, until it ends, to `count` cores that no other process is kept to.

    Call it before anything starts threads. Where the system cannot, or so many are not free, the
    process may use all cores as before, and the answer is False.
    """
    if not hasattr(os, "sched_setaffinity") or count >= count_cores():
        return False
    folder = Path(tempfile.gettempdir()) / f"quadwalk-cores-{os.getuid()}"
    folder.mkdir(exist_ok=True)
    end = time.monotonic() + _PATIENCE
    while True:
        locks: dict[int, int] = {}
        for core in sorted(os.sched_getaffinity(0)):
            if len(locks) < count and (file := _lock(folder / str(core))) is not None:
                locks[core] = file
        if len(locks) == count:
            _pinned.extend(locks.values())
            os.sched_setaffinity(0, locks)
            return True
        for file in locks.values():
            os.close(file)
        if time.monotonic() > end:
            return False
        time.sleep(0.1)


def prepare_worker(cores: int) -> None:
    """Prepare this process as a worker: `pin` it to so many cores, and ignore Ctrl-C and hangup.

    Its parent ends it.
    """
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):  # Windows has no SIGHUP
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    pin(cores)


def _lock(path: Path) -> int | None:
    """Return the descriptor of a file, locked until this process ends; None if another has it."""
    file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    if lock(file):
        return file
    os.close(file)
    return None


@functools.cache
def get_instructions() -> str:
    """Return the processor's instruction sets, as Linux lists them, or an empty string."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(errors="replace").splitlines() if cpuinfo.exists() else []
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")


def get_cache_folder() -> Path:
    """Return the folder of compiled programs for this kind of processor.

    Machines that share a home have different processors, which run different programs.
    """
    processor = (platform.processor() or platform.machine()) + get_instructions()
    kind = hashlib.sha256(processor.encode()).hexdigest()[:12]
    return Path(platformdirs.user_cache_dir("quadwalk", appauthor=False)) / "xla" / kind
