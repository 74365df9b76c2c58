"""Trainings of a study: each run trained once, and a process for each."""

import contextlib
import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, TypeVar

from quadwalk.api import train
from quadwalk.errors import UserError
from quadwalk.settings.training import TrainConfig
from quadwalk.train.devices import set_up_devices
from quadwalk.train.robot import content, load_robot
from quadwalk.train.runs.directory import Run
from quadwalk.train.runs.policy import load_score
from quadwalk.train.runs.resume import read_config

T = TypeVar("T")


def trained(config: TrainConfig) -> Run:
    """The run called `config.name`: trained, gone on with if it was stopped, or as it is.

    What training prints goes to stderr. Raises `UserError` if the run there has other settings, and
    `KeyboardInterrupt` if a signal ended training.
    """
    run = Run(config.runs / str(config.name))
    check_same(config)

    def is_done() -> bool:
        return run.policy.exists() and load_score(run.policy)[0] >= config.steps

    with contextlib.redirect_stdout(sys.stderr):
        if not run.path.exists():
            train(config)
        elif not is_done():
            train(resume=run, quiet=config.quiet)
    if config.minutes is None and not is_done():
        raise KeyboardInterrupt
    return run


def check_same(config: TrainConfig) -> None:
    """`UserError` if `config` cannot be trained, or if the run of its name is not one of it."""
    run, wanted = Run(config.runs / str(config.name)), content(config, load_robot(config.robot))
    if run.path.exists():
        kept = read_config(run)
        if content(kept, load_robot(kept.robot)) != wanted:
            raise UserError(f"{run.path} has other settings; remove it to train it anew")


def in_processes(
    job: Callable[..., T], cases: Iterable[tuple[Any, ...]], at_once: int, devices: int | None
) -> Iterator[T]:
    """What `job` returns for the arguments of each case, in order.

    Each has a process of its own with so many devices, by default one per core: JAX is set up once
    in a process. Ends with the first that raises; on Ctrl-C each saves what it trains.
    """
    with ProcessPoolExecutor(
        at_once,
        mp_context=multiprocessing.get_context("spawn"),
        # From its start a signal ends a process at once, unless it trains.
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_DFL),
        max_tasks_per_child=1,
    ) as pool:
        yield from pool.map(partial(_on_devices, devices, job), *zip(*cases, strict=True))


def _on_devices(devices: int | None, job: Callable[..., T], *case: Any) -> T:
    set_up_devices(devices)
    return job(*case)
