"""Trainings on the toy, in this process or in their own; `toy` can be imported."""

import multiprocessing
import os
import sys
from collections.abc import Callable
from multiprocessing import forkserver
from pathlib import Path

import jax
import pytest

HERE = str(Path(__file__).parent)
sys.path.insert(0, HERE)

import toy  # noqa: E402

# Small programs come from the compilation cache too.
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


@pytest.fixture(scope="session")
def processes() -> multiprocessing.context.BaseContext:
    """Return a context whose processes begin at once: they are forked where all is imported."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["toy"])
    with pytest.MonkeyPatch.context() as patch:
        # Not every Python tells it where to find what it should import.
        patch.setenv("PYTHONPATH", HERE, prepend=os.pathsep)
        forkserver.ensure_running()
    return context


@pytest.fixture(scope="session")
def flags() -> Callable[..., list[str]]:
    """Return a function that makes the flags of a tiny training on the toy, in folder `runs`.

    Its arguments are that folder, the run's name or None, the number of iterations and more flags.
    """

    def make_flags(runs: Path, name: str | None, iterations: int, *more: str) -> list[str]:
        common = f"--devices=2 --steps={toy.BATCH * iterations} --runs={runs} {toy.TINY}"
        return [*common.split(), *([f"--name={name}"] if name else []), *more]

    return make_flags


@pytest.fixture(scope="session")
def start(processes) -> Callable[..., multiprocessing.Process]:
    """Return a function that starts a process that trains on the toy, and returns the process.

    Its arguments are the file to which the process prints, and the flags of train.py.
    """

    def start_training(output: Path, *flags: str) -> multiprocessing.Process:
        process = processes.Process(target=toy.run_train, args=(output, *flags))
        process.start()
        return process

    return start_training


@pytest.fixture
def train(monkeypatch) -> Callable[..., None]:
    """Return a function that trains on the toy with flags, in this process.

    `watch` is as for `quadwalk.learn.loop.train`.
    """
    from quadwalk.learn.flags import parse_config
    from quadwalk.learn.loop import train

    for module in ("prepare", "warm_start"):
        monkeypatch.setattr(f"quadwalk.learn.{module}.QuadrupedEnv", toy.Toy)
    return lambda *flags, watch=None: train(*parse_config(flags), watch)
