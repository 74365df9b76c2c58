"""What `quadwalk compare` is given."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from quadwalk.bounds import Count
from quadwalk.jobs.place import PlaceConfig


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


def split(args: Sequence[str]) -> tuple[list[str], list[str]]:
    """The variants among `args`, and what is left: the command's own options with their values."""
    own = {f"--{field.name.replace('_', '-')}" for field in dataclasses.fields(CompareConfig)}
    variants, options, takes_value = [], [], False
    for arg in args:
        known = arg.partition("=")[0].replace("_", "-") in own
        if takes_value or known or arg in ("-h", "--help"):
            options.append(arg)
            takes_value = not takes_value and known and "=" not in arg
        else:
            variants.append(arg)
    return variants, options
