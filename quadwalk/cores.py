"""The processor: its cores, its instructions, and where programs compiled for it are kept."""

import functools
import hashlib
import os
import platform
from pathlib import Path

import platformdirs


def cpu_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def instructions() -> str:
    """The processor's instruction sets, as Linux lists them; else nothing."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(errors="replace").splitlines() if cpuinfo.exists() else []
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")


def compilation_cache() -> Path:
    """The folder of compiled programs, one per kind of processor.

    A home folder may be shared by machines that cannot run each other's instructions.
    """
    processor = (platform.processor() or platform.machine()) + instructions()
    kind = hashlib.sha256(processor.encode()).hexdigest()[:12]
    return Path(platformdirs.user_cache_dir("quadwalk", appauthor=False)) / "xla" / kind
