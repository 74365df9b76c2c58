"""One training among many, and the evaluation of its run: the same wherever they are computed."""

import contextlib
import io
import multiprocessing
import os
import signal
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax

from quadwalk.api import train
from quadwalk.cores import pin
from quadwalk.errors import UserError
from quadwalk.experiments.options import PlaceConfig
from quadwalk.learn.devices import ACCELERATOR_ENVS, CPU_ENVS, count_devices, set_up_devices
from quadwalk.learn.prepare import make_run
from quadwalk.robot.load import load_robot
from quadwalk.runs.directory import Run, claim, get_versions
from quadwalk.runs.policy import load_score
from quadwalk.runs.resume import describe_training, read_config
from quadwalk.settings.training import TrainConfig, with_files

PATIENCE = 120.0  # s for a process that was lost to let go of its run

Row = dict[str, float]


class StoppedError(Exception):
    """A training ended early because it was asked to; its run can be resumed."""


class Work(NamedTuple):
    """What the process that computes a job is sent; the settings are in the run's folder."""

    run: Run
    steps: int
    devices: int | None
    cores: int  # 0: on accelerators
    evaluate: Callable[[Run], Any]
    versions: dict[str, str]


@dataclass(frozen=True)
class Job:
    """A training with a name of its own, and the evaluation of its run."""

    config: TrainConfig
    evaluate: Callable[[Run], Any]  # called in the process that has trained; pickled by reference

    @property
    def name(self) -> str:
        return str(self.config.name)

    @property
    def run(self) -> Run:
        return Run(self.config.runs / self.name)

    def work(self, cores: int) -> Work:
        """Return what a process needs to compute this job on `cores` cores."""
        config = self.config
        return Work(self.run, config.steps, config.devices, cores, self.evaluate, get_versions())


def fix_sizes(config: TrainConfig, place: PlaceConfig) -> TrainConfig:
    """Return `config` with numbers of environments and devices that the machine does not change."""
    envs = config.envs or (ACCELERATOR_ENVS if place.gpus else CPU_ENVS)
    most = place.gpus or place.cores_each
    devices = config.devices
    if devices is None:
        devices = count_devices(envs, config.ppo.minibatches, config.ppo.eval_envs, most)
    return replace(config, envs=envs, devices=devices, minutes=None, quiet=True)


def check_same(config: TrainConfig) -> None:
    """Raise a `UserError` if `config` cannot be trained, or its run is there with others."""
    run = Run(config.runs / str(config.name))
    wanted = describe_training(config, load_robot(config.robot))
    if not run.path.exists():
        return
    kept = read_config(run)
    if describe_training(kept, load_robot(kept.robot)) != wanted:
        raise UserError(f"{run.path} has other settings; remove it to train it anew")


def open_run(config: TrainConfig) -> Run:
    """Return the run of `config`, made if it is not there; `UserError` if it has other settings."""
    check_same(config)
    run, robot = Run(config.runs / str(config.name)), config.robot
    if run.path.exists():
        return run
    config = with_files(config, robot.urdf, robot.mesh_dirs, config.env.ground.file)
    return make_run(config, load_robot(config.robot))


def get_stop_file(run: Run) -> Path:
    """Return the file that asks a run's training to end, in whatever process that is."""
    return run.path / "stop"


def train_run(run: Run, steps: int, watch: Callable[[Row], object] | None = None) -> bool:
    """Train a run to `steps`, silently, and return True if it came there.

    `watch` is called with each row of metrics.
    """

    def is_done() -> bool:
        return run.policy.exists() and load_score(run.policy)[0] >= steps

    if not is_done():
        with contextlib.redirect_stdout(io.StringIO()):
            train(resume=run, steps=steps, quiet=True, watch=watch)
    return is_done()


def compute_job(work: Work) -> Any:
    """Train and evaluate a run in a process of its own, and return its evaluation.

    Raises `StoppedError` if it was stopped before it was trained, and `UserError`.
    """
    try:
        _check_machine(work)
        if work.cores:
            pin(work.cores)
            jax.config.update("jax_platforms", "cpu")
        _wait_for(work.run)
        if not train_run(work.run, work.steps, lambda row: _stop_if_asked(work.run)):
            raise StoppedError(work.run.name)
        set_up_devices(work.devices)  # where nothing was left to train
        return work.evaluate(work.run)
    finally:
        if _is_orphan():
            os._exit(1)  # an executor's process would wait for its next job for ever


def _stop_if_asked(run: Run) -> None:
    """Have training save what it has, and end, if it was stopped or nobody waits for it."""
    if _is_orphan() or get_stop_file(run).exists():
        signal.raise_signal(signal.SIGTERM)


def _is_orphan() -> bool:
    """Return True if the process that started this one is gone."""
    parent = multiprocessing.parent_process()
    return parent is not None and not parent.is_alive()


def _check_machine(work: Work) -> None:
    """Raise a `UserError` if this machine lacks the run's folder or has other versions."""
    here = get_versions()
    if here != work.versions:
        differ = ", ".join(
            f"{name} {version} in place of {work.versions[name]}"
            for name, version in here.items()
            if version != work.versions[name]
        )
        raise UserError(f"{socket.gethostname()} has {differ}")
    if not work.run.config.exists():
        raise UserError(
            f"{socket.gethostname()} has no {work.run.path}; expected --runs in a folder that all "
            "machines share"
        )


def _wait_for(run: Run) -> None:
    """Wait until no process trains a run: one that was lost may still be ending."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            with claim(run):
                return
        except UserError:
            if time.monotonic() > end:
                raise
            time.sleep(0.5)
