"""One training in several processes (`jax.distributed`), which all run the same program.

Each process holds its own devices and their share of the environments, and every process holds the
same learner. Process 0 alone writes files and shows progress. With one process, nothing here does
anything.
"""

import atexit
import contextlib
import hashlib
import time
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import numpy as np
from jax._src.distributed import global_state
from jax.experimental.multihost_utils import process_allgather

from quadwalk.errors import UserError
from quadwalk.settings.training import DistributedConfig

T = TypeVar("T")
_START_TIMEOUT = 120  # seconds that the processes may start apart from each other
_END_TIMEOUT = 30  # seconds that they may end apart: none waits long for one that failed
_ASKING = 0.5  # seconds in which the others stop asking


def join(config: DistributedConfig) -> None:
    """Meet the other processes; before JAX computes anything."""
    if config.coordinator is None:
        return
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    try:
        jax.distributed.initialize(
            config.coordinator,
            config.processes,
            config.process,
            initialization_timeout=_START_TIMEOUT,
            shutdown_timeout_seconds=_END_TIMEOUT,
        )
    except (RuntimeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise UserError(
            f"the {config.processes} processes did not meet at {config.coordinator}: {reason}"
        ) from error
    atexit.register(_leave)


def _leave() -> None:
    """Wait for the others to leave too, and only then end the service at which all have met.

    JAX ends a process that still asks the service, with a page of text. `jax.distributed.shutdown`
    alone leaves no time for that.
    """
    if global_state.client is not None:
        with contextlib.suppress(RuntimeError):  # another process is gone
            global_state.client.shutdown()
        global_state.client = None
    if global_state.service is not None:
        time.sleep(_ASKING)
    jax.distributed.shutdown()


def is_true_anywhere(flag: bool) -> bool:
    """Return True in all processes if `flag` is set in any: so all act as one."""
    return flag if jax.process_count() == 1 else bool(_gather_array(np.array(flag)).any())


def run_together(action: Callable[[], T]) -> T:
    """Return what `action` returns; if it raises a `UserError` in any process, all raise one."""
    failure = None
    try:
        result = action()
    except UserError as error:
        failure = error
    if is_true_anywhere(failure is not None):
        raise failure or UserError("another process could not begin: see what it says")
    return result


def check_same(text: str) -> None:
    """Raise a `UserError` in all processes if `text` differs between them: training would hang."""
    digests = _gather_array(np.frombuffer(hashlib.sha256(text.encode()).digest(), np.uint8))
    if (digests != digests[0]).any():
        raise UserError("the processes have different settings, robots or tasks: expected the same")


def gather(tree: Any) -> Any:
    """Return `tree` with every process's part of its arrays; all processes must call it."""
    if jax.process_count() == 1:
        return tree
    return jax.tree.map(
        lambda x: np.asarray(x) if x.is_fully_replicated else process_allgather(x, tiled=True),
        tree,
    )


def _gather_array(array: np.ndarray) -> np.ndarray:
    """Return every process's `array`, along a new first axis."""
    return np.asarray(process_allgather(array))
