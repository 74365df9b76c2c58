"""Saving a training, and dying at the n-th thing that it asks the system for."""

import os
import signal
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import optax

from quadwalk.brax import NestedMeanStd, RunningStatisticsState
from quadwalk.learn.networks import NetworkParams
from quadwalk.learn.ppo import Learner, TrainState
from quadwalk.learn.writer import RunWriter
from quadwalk.runs.directory import Run
from quadwalk.tasks import sprint


def save(folder: Path, first: int, last: int, die_at: int | None = None) -> None:
    """Save a made-up training at each ten steps after `first` up to `last`, as if resumed.

    Each is the best so far, and all of its numbers are those of its steps. The process kills itself
    at its system call `die_at`, which `_die_at_call` counts.
    """
    if die_at is not None:
        _die_at_call(die_at)
    training = make_training(first)
    with RunWriter(training, Run(folder), print) as writer:
        for steps in range(first + 10, last + 1, 10):
            training.metrics.score = float(steps)
            writer.log_iteration({"steps": steps, "x": float(steps)}, SimpleNamespace(flag=0), 1.0)
            assert writer.save(make_state(steps), steps, 1.0)


def make_training(steps: int) -> SimpleNamespace:
    """Return what `RunWriter` asks of a training, after so many steps."""
    return SimpleNamespace(
        config=sprint.TASK,
        start=sprint.TASK,
        quadruped=SimpleNamespace(joints=("joint",)),
        networks=SimpleNamespace(
            mirrors=None,
            to_plain=lambda normalizer, params: (
                NestedMeanStd(normalizer.mean, normalizer.std),
                params,
            ),
            to_plain_value=lambda params: params,
        ),
        metrics=SimpleNamespace(score=0.0, get_state=dict),
        steps=steps,
        resumed=steps > 0,
    )


def make_state(steps: int) -> TrainState:
    """Return a state whose numbers are all `steps`, so that a mixture of two states shows."""
    value = np.full(3000, steps, np.float32)
    normalizer = RunningStatisticsState(
        mean=value, std=value, count=np.zeros(()), summed_variance=value
    )
    params = NetworkParams(policy={"w": value}, value={"w": value})
    return TrainState(Learner(params, optax.EmptyState(), normalizer, np.int32(steps)), value)


def _die_at_call(die_at: int) -> None:
    """Have this process kill itself at its system call `die_at`, counted from 1.

    It counts calls that write, replace and remove files, and the opening of a part of an archive.
    """
    calls = 0

    def count_calls(function):
        def call(*args, **kwargs):
            nonlocal calls
            calls += 1
            if calls == die_at:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*args, **kwargs)

        return call

    for owner, name in (
        *((os, name) for name in ("fsync", "replace", "write", "ftruncate", "unlink")),
        (zipfile.ZipFile, "open"),
    ):
        setattr(owner, name, count_calls(getattr(owner, name)))
