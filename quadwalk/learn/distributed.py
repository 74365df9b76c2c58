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
_PATIENCE = 120  # seconds that the processes may start apart from each other
_FAREWELL = 30  # seconds that they may end apart: one that failed need not wait for the others long
_AFTER = 0.5  # seconds in which the others stop asking


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
            initialization_timeout=_PATIENCE,
            shutdown_timeout_seconds=_FAREWELL,
        )
    except (RuntimeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise UserError(
            f"the {config.processes} processes did not meet at {config.coordinator}: {reason}"
        ) from error
    atexit.register(_leave)


def _leave() -> None:
    """Wait for the others to leave too, and only then end the service at which all have met.

    A process that still asks it is ended by JAX, with a page of text. `jax.distributed.shutdown`
    alone gives them no time, so that some do.
    """
    if global_state.client is not None:
        with contextlib.suppress(RuntimeError):  # another one is gone
            global_state.client.shutdown()
        global_state.client = None
    if global_state.service is not None:
        time.sleep(_AFTER)
    jax.distributed.shutdown()


def any_process(flag: bool) -> bool:
    """Whether `flag` is set in any process: the same answer in all, so that all act as one."""
    return flag if jax.process_count() == 1 else bool(_gather(np.array(flag)).any())


def together(action: Callable[[], T]) -> T:
    """What `action` returns; if it raises a `UserError` in any process, all raise one."""
    trouble = None
    try:
        result = action()
    except UserError as error:
        trouble = error
    if any_process(trouble is not None):
        raise trouble or UserError("another process could not begin: see what it says")
    return result


def check_same(text: str) -> None:
    """`UserError` in every process unless `text` is the same in all: else they would hang."""
    digests = _gather(np.frombuffer(hashlib.sha256(text.encode()).digest(), np.uint8))
    if (digests != digests[0]).any():
        raise UserError("the processes have different settings, robots or tasks: expected the same")


def gathered(tree: Any) -> Any:
    """`tree` with every process's part of its arrays, as NumPy arrays; called by all of them."""
    if jax.process_count() == 1:
        return tree
    return jax.tree.map(
        lambda x: np.asarray(x) if x.is_fully_replicated else process_allgather(x, tiled=True),
        tree,
    )


def _gather(array: np.ndarray) -> np.ndarray:
    """Every process's `array`, along a new first axis."""
    return np.asarray(process_allgather(array))
