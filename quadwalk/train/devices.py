"""XLA devices: one for each CPU core."""

import os

from quadwalk.errors import UsageError


def cpu_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def set_up_devices(count: int | None) -> int:
    """Make JAX offer `count` CPU devices, by default one per core; return how many there are.

    MJX on one XLA device leaves most of a second core idle. Must run before JAX computes anything.
    """
    # XLA kills a process whose devices wait long for each other, as they do when a laptop sleeps.
    patience = "--xla_cpu_collective_call_terminate_timeout_seconds=86400"
    os.environ["XLA_FLAGS"] = f"{patience} {os.environ.get('XLA_FLAGS', '')}".strip()
    import jax

    jax.config.update("jax_num_cpu_devices", count or cpu_cores())
    available = len(jax.devices())
    if count is not None and count > available:
        raise UsageError(f"--devices is {count}; expected at most the {available} there are")
    return available
