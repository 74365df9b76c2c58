"""One training among many, and the evaluation of its run: the same wherever they are computed."""

import contextlib
import io
import multiprocessing
import os
import signal
import socket
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax

from quadwalk.api import train
from quadwalk.errors import UserError
from quadwalk.experiments.options import PlaceConfig
from quadwalk.learn.devices import ACCELERATOR_ENVS, CPU_ENVS, count_devices, set_up_devices
from quadwalk.robot.load import load_robot
from quadwalk.runs.directory import Run, claim, get_versions
from quadwalk.runs.policy import load_score
from quadwalk.runs.resume import describe_training, make_run, read_config
from quadwalk.settings.training import TrainConfig, set_files


class Work(NamedTuple):
    """The arguments of the process that computes a job; the settings are in the run's folder."""

    run: Run
    steps: int
    devices: int | None
    evaluate: Callable[[Run], Any]
    versions: dict[str, str]
    on_cpu: bool


@dataclass(frozen=True)
class Job:
    """A training with a name of its own, and the evaluation of its run."""

    config: TrainConfig
    evaluate: Callable[[Run], Any]  # called in the process that has trained; pickled by reference

    @property
    def name(self) -> str:
        """Name of the job and of its run."""
        return str(self.config.name)

    @property
    def run(self) -> Run:
        """Run that the job trains; its folder need not exist yet."""
        return Run(self.config.runs / self.name)

    def make_work(self, on_cpu: bool = True) -> Work:
        """Return what a process needs to compute this job."""
        config = self.config
        return Work(self.run, config.steps, config.devices, self.evaluate, get_versions(), on_cpu)


def fix_sizes(config: TrainConfig, place: PlaceConfig) -> TrainConfig:
    """Return `config` with numbers of environments and devices that the machine does not change."""
    envs = config.envs or (ACCELERATOR_ENVS if place.gpus else CPU_ENVS)
    most = place.gpus or place.cores_each
    devices = config.devices
    if devices is None:
        devices = count_devices(envs, config.ppo.minibatches, config.ppo.eval_envs, most)
    return replace(config, envs=envs, devices=devices, minutes=None, quiet=True)


def open_run(job: Job) -> Run:
    """Return the run of a job, made if it is not there; `UserError` if it has other settings."""
    config, quadruped = job.config, load_robot(job.config.robot)
    if not job.run.path.exists():
        robot = config.robot
        config = set_files(config, robot.urdf, robot.mesh_dirs, config.env.ground.file)
        return make_run(config, quadruped)
    saved = read_config(job.run)
    if describe_training(saved, load_robot(saved.robot)) != describe_training(config, quadruped):
        raise UserError(f"{job.run.path} has other settings; remove it to train it anew")
    return job.run


def compute_job(work: Work) -> Any:
    """Train and evaluate a run in a process of its own, and return its evaluation.

    Raises a `UserError` if it was stopped before it was trained.
    """
    if get_versions() != work.versions:
        raise UserError(f"{socket.gethostname()} has {get_versions()}; expected {work.versions}")
    if work.on_cpu:
        jax.config.update("jax_platforms", "cpu")
    try:
        with claim(work.run, wait=True):  # a process that was lost may still be ending
            pass
        if not _is_trained(work):
            with contextlib.redirect_stdout(io.StringIO()):
                train(resume=work.run, steps=work.steps, quiet=True, watch=_stop_orphan)
        if not _is_trained(work):
            raise UserError("it was stopped")
        set_up_devices(work.devices)  # where nothing was left to train
        return work.evaluate(work.run)
    finally:
        if _is_orphan():
            os._exit(1)  # an executor's process would wait for its next job for ever


def _is_trained(work: Work) -> bool:
    """Return True if the run's policy has all the steps of its job, so that none are left."""
    return work.run.policy.exists() and load_score(work.run.policy)[0] >= work.steps


def _is_orphan() -> bool:
    """Return True if the process that started this one is gone."""
    parent = multiprocessing.parent_process()
    return parent is not None and not parent.is_alive()


def _stop_orphan(_row: dict[str, float]) -> None:
    """Have training save what it has, and end, if nobody waits for it."""
    if _is_orphan():
        signal.raise_signal(signal.SIGTERM)
