"""One training among many, and what is made of its run: the same wherever it is computed."""

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, Self

import jax

from quadwalk.api import train
from quadwalk.cores import pin
from quadwalk.errors import UserError
from quadwalk.jobs.news import Event, Row
from quadwalk.jobs.place import PlaceConfig
from quadwalk.settings.training import TrainConfig, with_files
from quadwalk.train.devices import ACCELERATOR_ENVS, CPU_ENVS, device_count, set_up_devices
from quadwalk.train.robot import content, load_robot
from quadwalk.train.runs.directory import Run
from quadwalk.train.runs.policy import load_score
from quadwalk.train.runs.resume import read_config
from quadwalk.train.setup import new_run


@dataclass(frozen=True)
class Job:
    """A training with a name of its own, and what is made of its run."""

    config: TrainConfig  # its folder of runs is that of this machine
    judge: Callable[[Run], Any]  # called in the process that has trained; both are pickled

    @property
    def name(self) -> str:
        return str(self.config.name)

    @property
    def work(self) -> "Work":
        run = Run(self.config.runs / self.name)
        return Work(run, self.config.steps, self.config.devices, self.judge)


class Work(NamedTuple):
    """What the process that computes a job is sent: the settings are in the run's folder."""

    run: Run
    steps: int
    devices: int | None
    judge: Callable[[Run], Any]


class Place(Protocol):
    """Where jobs are computed; a context manager, which ends those that still are."""

    slots: int  # jobs that it can compute at a time
    most: float  # jobs that it takes at a time

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def start(self, job: Job) -> None:
        """Begin or resume a job, whose run is there."""

    def stop(self, name: str) -> None:
        """Have a job end early; its training saves what it has."""

    def events(self) -> list[Event]:
        """What has happened since the last call; waits up to a second for it."""


def sized(config: TrainConfig, place: PlaceConfig) -> TrainConfig:
    """`config` with numbers of environments and devices that do not depend on the machine."""
    envs = config.envs or (ACCELERATOR_ENVS if place.gpus else CPU_ENVS)
    ppo, most = config.ppo, place.gpus or place.cores_each
    devices = config.devices or device_count(envs, ppo.minibatches, ppo.eval_envs, most)
    return replace(config, envs=envs, devices=devices, minutes=None, quiet=True)


def check_same(config: TrainConfig) -> None:
    """`UserError` if `config` cannot be trained, or if the run of its name is not one of it."""
    run, wanted = Run(config.runs / str(config.name)), content(config, load_robot(config.robot))
    if run.path.exists():
        kept = read_config(run)
        if content(kept, load_robot(kept.robot)) != wanted:
            raise UserError(f"{run.path} has other settings; remove it to train it anew")


def opened(config: TrainConfig) -> Run:
    """The run of `config`, made if it is not there; `UserError` if it has other settings."""
    check_same(config)
    run, robot = Run(config.runs / str(config.name)), config.robot
    if run.path.exists():
        return run
    config = with_files(config, robot.urdf, robot.mesh_dirs, config.env.ground.file)
    return new_run(config, load_robot(config.robot))


def finish(run: Run, steps: int, watch: Callable[[Row], object] | None = None) -> bool:
    """Train a run to `steps`, silently; whether it came there. `watch` gets each row of metrics."""

    def is_done() -> bool:
        return run.policy.exists() and load_score(run.policy)[0] >= steps

    if not is_done():
        with contextlib.redirect_stdout(io.StringIO()):
            train(resume=run, steps=steps, quiet=True, watch=watch)
    return is_done()


def compute(work: Work, cores: int, watch: Callable[[Row], object]) -> Event:
    """Run a job here, on `cores` cores or, if that is 0, on accelerators, and say how it ended.

    `watch` gets each row of its metrics.
    """
    run = work.run
    if cores:
        pin(cores)
        jax.config.update("jax_platforms", "cpu")
    try:
        if not finish(run, work.steps, watch):
            return Event(run.name, "stopped")
        set_up_devices(work.devices)  # where nothing was left to train
        return Event(run.name, "done", work.judge(run))
    except UserError as error:
        return Event(run.name, "failed", str(error))
