"""XLA devices to train on: accelerators, or one for each CPU core; and the compilation cache."""

import ctypes
import dataclasses
import functools
import sys
import tempfile
import warnings
from pathlib import Path
from typing import TypeVar

import jax
import numpy as np
from jax.sharding import Mesh

from quadwalk.cores import count_cores, get_cache_folder
from quadwalk.errors import UsageError
from quadwalk.files import get_os_reason
from quadwalk.learn.distributed import join
from quadwalk.settings.training import TrainConfig

AXIS = "devices"  # of the mesh that training runs on
CPU_ENVS = 2048  # what the learner's defaults are tuned for
ACCELERATOR_ENVS = 8192  # a guess: enough to fill one, and few enough to learn from

T = TypeVar("T")


def count_devices(
    envs: int, minibatches: int, eval_envs: int, most: int | None = None, processes: int = 1
) -> int:
    """Return the number of devices to train on, in all processes together.

    It is the greatest, up to `most` (by default one per core), that shares the work evenly: each
    device has as many environments of every minibatch, and as many for evaluation, and each process
    has as many devices. If none does, it is one device per process.
    """
    most = processes * count_cores() if most is None else most
    return max(
        count
        for count in range(processes, max(most, processes) + 1, processes)
        if count == processes or (envs % (count * minibatches) == 0 and eval_envs % count == 0)
    )


def choose_devices(config: TrainConfig) -> tuple[TrainConfig, list[jax.Device]]:
    """Set up JAX; return `config` with its devices and environments filled in, and the devices.

    Where JAX has accelerators they are used, otherwise CPU cores. Meets the other processes, if
    there are any. Raises `UsageError` for numbers that do not divide evenly.
    """
    processes, ppo = config.distributed.processes, config.ppo
    if config.devices is not None and config.devices % processes:
        raise UsageError(
            f"--devices is {config.devices}; expected a multiple of {processes}, the processes"
        )
    envs = config.envs or CPU_ENVS
    count = config.devices or count_devices(envs, ppo.minibatches, ppo.eval_envs, None, processes)
    _configure_jax(count // processes)
    join(config.distributed)
    available = len(jax.devices())
    if jax.default_backend() != "cpu":
        envs = config.envs or ACCELERATOR_ENVS
    count = config.devices or count_devices(
        envs, ppo.minibatches, ppo.eval_envs, available, processes
    )
    if count > available:
        raise UsageError(f"--devices is {count}; expected at most the {available} there are")
    if ppo.eval_envs % count:
        raise UsageError(
            f"--ppo.eval-envs is {ppo.eval_envs}; expected a multiple of {count}, the devices"
        )
    if envs % (count * ppo.minibatches):
        raise UsageError(
            f"--envs is {envs}; expected a multiple of {count * ppo.minibatches} "
            f"({count} devices times {ppo.minibatches} minibatches)"
        )
    share = count // processes
    devices = [d for index in range(processes) for d in jax.local_devices(index)[:share]]
    return dataclasses.replace(config, envs=envs, devices=count), devices


def set_up_devices(count: int | None = None) -> int:
    """Make JAX offer `count` CPU devices, by default one per core; return how many there are.

    A program on one XLA device leaves much of a second core idle. To be called before JAX computes
    anything: after that its devices stay what they are, and a warning says so if they are fewer.
    What is compiled is kept in the user's cache folder: the second start takes seconds.
    """
    _configure_jax(count or count_cores())
    available = len(jax.devices())
    if count is not None and count > available:
        raise UsageError(f"--devices is {count}; expected at most the {available} there are")
    return available


def make_mesh(devices: list[jax.Device] | None = None) -> Mesh:
    """Make a one-dimensional mesh over `devices`, by default all."""
    return Mesh(np.array(devices or jax.devices()), (AXIS,))


def place_like(saved: T, state: T) -> T:
    """Return `saved`, a tree of NumPy arrays, on the devices that hold the arrays of `state`."""

    def place(new: np.ndarray, old: jax.Array) -> jax.Array:
        return jax.make_array_from_callback(new.shape, old.sharding, lambda index: new[index])

    placed: T = jax.tree.map(place, saved, state)
    return placed


def _configure_jax(cpu_devices: int) -> None:
    """Set everything that JAX reads before it looks for devices."""
    # Have glibc's malloc keep what XLA frees, for each iteration asks for the same again. Given
    # back and asked for again, it is cleared page by page (benchmarks/learning.py).
    mmap_max, trim_threshold, top_pad = -4, -1, -2  # <malloc.h>
    _call_libc("mallopt", mmap_max, 0)
    _call_libc("mallopt", trim_threshold, 2**31 - 1)
    _call_libc("mallopt", top_pad, 2**26)
    try:
        jax.config.update("jax_num_cpu_devices", cpu_devices)
    except RuntimeError:
        # A process that has computed keeps the devices it has, as a notebook that trains twice.
        _warn_of_fewer(cpu_devices)
    if jax.config.jax_compilation_cache_dir is None:  # type: ignore[attr-defined]
        folder = get_cache_folder()
        if _is_writable(folder):
            jax.config.update("jax_compilation_cache_dir", str(folder))
            # Also the forty programs of milliseconds that make a learner: together, a second.
            jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def release_freed_memory() -> None:
    """Have glibc's malloc give back what is free now, as half a gigabyte that compiling needed."""
    _call_libc("malloc_trim", 0)


def _call_libc(name: str, *arguments: int) -> None:
    """Call a function of the C library by its name, if the library has it."""
    try:
        function = getattr(ctypes.CDLL(None), name)
    except (OSError, TypeError, AttributeError):
        return
    function(*arguments)


@functools.cache
def _warn_of_fewer(cpu_devices: int) -> None:
    """Warn, once, if JAX computes on fewer CPU devices than are wanted."""
    available = jax.local_device_count()
    if jax.default_backend() == "cpu" and available < cpu_devices:
        warnings.warn(
            f"JAX has already computed: quadwalk uses {available} CPU "
            f"device{'s' if available > 1 else ''} instead of {cpu_devices}; "
            "restart Python and call quadwalk before anything computes with JAX",
            stacklevel=2,
        )


@functools.cache
def _is_writable(folder: Path) -> bool:
    """Return True if files can be kept in the cache folder; make it first, warn once if not."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        reason = f"cannot keep compiled programs in {folder}: {get_os_reason(error)}"
        print(f"warning: {reason}; every start compiles anew", file=sys.stderr)
        return False
    return True
