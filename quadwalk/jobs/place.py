"""Flags that say where many trainings are computed."""

import argparse
from dataclasses import dataclass

from quadwalk.bounds import Count, Natural, Settings
from quadwalk.cores import cpu_cores


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
        """CPU cores of each training."""
        return self.cores or min(2, cpu_cores())


def add_place_flags(parser: argparse.ArgumentParser, cores: int | None = None) -> None:
    """The flags of `PlaceConfig`, for a script whose trainings have so many cores by default."""
    what = f"CPU cores of each training (default: {cores or 2})"
    parser.add_argument("--cores", type=int, default=cores, help=what)
    parser.add_argument("--gpus", type=int, default=0, help="of each training; needs --cluster")
    parser.add_argument("--cluster", help="Ray cluster: HOST:PORT, auto or local")


def place_config(options: argparse.Namespace) -> PlaceConfig:
    """What those flags were given."""
    return PlaceConfig(cores=options.cores, gpus=options.gpus, cluster=options.cluster)
