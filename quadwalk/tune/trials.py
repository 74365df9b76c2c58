"""What `quadwalk tune` is given."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from quadwalk.bounds import Count, Seed
from quadwalk.jobs.place import PlaceConfig


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
