"""The settings of commands and scripts that train many times, and of where they train."""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from quadwalk.bounds import Count, Natural, Seed, Settings
from quadwalk.cores import count_cores


@dataclass(frozen=True)
class PlaceConfig(Settings):
    """Where many trainings are computed."""

    cores: Count | None = None  # CPU cores of each training; None: 2, or 1 where there is one
    gpus: Natural = 0  # GPUs of each training, in place of its cores; needs --cluster
    # a Ray cluster to train on: HOST:PORT, auto (the one this machine is part of), or local;
    # None: processes of this machine
    cluster: str | None = None

    @property
    def cores_each(self) -> int:
        """CPU cores of each training: `cores`, or 2, or 1 where there is only one."""
        return self.cores or min(2, count_cores())


def add_place_flags(parser: argparse.ArgumentParser, cores: int | None = None) -> None:
    """Add the flags of `PlaceConfig`, for a script whose default is so many cores."""
    cores_help = f"CPU cores of each training (default: {cores or 2})"
    parser.add_argument("--cores", type=int, default=cores, help=cores_help)
    parser.add_argument("--gpus", type=int, default=0, help="of each training; needs --cluster")
    parser.add_argument("--cluster", help="Ray cluster: HOST:PORT, auto or local")


def read_place(options: argparse.Namespace) -> PlaceConfig:
    """Return the place that the flags of `add_place_flags` name."""
    return PlaceConfig(cores=options.cores, gpus=options.gpus, cluster=options.cluster)


@dataclass(frozen=True)
class CompareConfig(PlaceConfig):
    """Train variants of a task's settings over several seeds, and evaluate each in both engines.

    quadwalk compare "" "--env.reward.energy -0.1" "walk" [OPTIONS]

    Each argument holds the flags of `quadwalk train` of one variant, "" the defaults. A run that is
    there already is not trained again, so that what was stopped goes on where it was. As many
    train at a time as have cores, here or on a Ray cluster. Rows are printed as they come, as
    Markdown; the table, the figures and the learning curves, each with the
    band of its seeds, are written to the folder of the runs.
    """

    steps: Count | None = None  # control steps of each training; by default the task's
    seeds: Count = 3  # trainings of each variant: from seed 0 up
    episodes: Count = 64  # of each run, in each engine
    runs: Path = Path("runs/compare")  # folder of the runs and of what is written


@dataclass(frozen=True)
class TuneConfig(PlaceConfig):
    """Search settings of a task: which make its policy best?

    quadwalk tune drive --over env.reward.fidget=-4:-0.5 env.reward.energy=-0.2:-0.01 [OPTIONS]

    Each trial is a training with settings that Optuna's TPE sampler picks; one whose learning curve
    is below the median of the others is stopped early. The study is kept in a file: the same
    command goes on where it was stopped or killed, and a larger --trials goes on further. At the
    end there are a table of the best and the command that trains with them.
    """

    task: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[TASK]")] = "run"
    # settings to search: NAME=LOW:HIGH, NAME=LOW:HIGH:log, or NAME=VALUE,VALUE,...
    over: tuple[str, ...] = ()
    # flags of `quadwalk train` that all trials have, in one argument: --flags="--env.blind"
    flags: str = ""
    trials: Count = 20  # in all, with those that were stopped early
    steps: Count | None = None  # control steps of each training; by default the task's
    # of every training and of the sampler; not those of `quadwalk compare`, which begin at 0
    seed: Seed = 100
    # what is best: score (evaluation speed in training, which with commands is the commanded speed
    # less the error, times the share of episodes without a fall), or a figure of metrics.json's
    # summary in MuJoCo C, as velocity_error
    objective: str = "score"
    episodes: Count = 64  # of each evaluation, for an objective other than score
    prune: bool = True  # stop trials whose learning curve is below the median
    name: str | None = None  # of the search; by default the task's
    runs: Path = Path("runs/tune")  # folder of searches; each has its runs in a folder of its own
