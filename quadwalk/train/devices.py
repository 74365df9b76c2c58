"""XLA devices, one for each CPU core, and the cache of what was compiled for them."""

import hashlib
import os
import platform
from pathlib import Path

import platformdirs

from quadwalk.errors import UsageError


def cpu_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def device_count(envs: int, minibatches: int, judges: int) -> int:
    """As many devices as there are cores, or the most below that which share the work evenly.

    Each gets the same number of environments for every minibatch, and of judges.
    """
    return max(
        count
        for count in range(1, cpu_cores() + 1)
        if count == 1 or (envs % (count * minibatches) == 0 and judges % count == 0)
    )


def set_up_devices(count: int | None = None) -> int:
    """Make JAX offer `count` CPU devices, by default one per core; return how many there are.

    MJX on one XLA device leaves most of a second core idle. Must run before JAX computes anything.
    What is compiled is kept in the user's cache folder: the second start takes seconds.
    """
    # XLA kills a process whose devices wait long for each other, as they do when a laptop sleeps.
    patience = "--xla_cpu_collective_call_terminate_timeout_seconds=86400"
    os.environ["XLA_FLAGS"] = f"{patience} {os.environ.get('XLA_FLAGS', '')}".strip()
    # On each cache hit XLA prints a page on "features" that are its own tuning hints. Errors that
    # matter reach Python as exceptions.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    import jax

    jax.config.update("jax_num_cpu_devices", count or cpu_cores())
    if jax.config.jax_compilation_cache_dir is None:  # type: ignore[attr-defined]
        jax.config.update("jax_compilation_cache_dir", str(compilation_cache()))
    available = len(jax.devices())
    if count is not None and count > available:
        raise UsageError(f"--devices is {count}; expected at most the {available} there are")
    return available


def compilation_cache() -> Path:
    """The folder of compiled programs, one per kind of processor.

    A home folder may be shared by machines that cannot run each other's instructions.
    """
    processor = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = cpuinfo.read_text(errors="replace").splitlines()
        processor += next((line for line in lines if line.startswith(("flags", "Features"))), "")
    kind = hashlib.sha256(processor.encode()).hexdigest()[:12]
    return Path(platformdirs.user_cache_dir("quadwalk", appauthor=False)) / "xla" / kind
