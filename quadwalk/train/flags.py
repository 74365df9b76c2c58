"""The flags of `train.py`: those of every setting of a task, and the run to go on with."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from quadwalk.cli import parse, value_of
from quadwalk.errors import UsageError
from quadwalk.settings.training import TrainConfig
from quadwalk.task_files import load_task, task_list
from quadwalk.train.runs.directory import Run, find_run
from quadwalk.train.runs.resume import resumed_config


@dataclass(frozen=True, kw_only=True)
class TrainFlags(TrainConfig):
    """Teach a quadruped a task. Results go to runs/NAME/."""

    # task to start from, which the other flags change: a name, or the path of a .py file of yours
    preset: str = "run"
    resume: str | None = None  # name or path of a run to go on with, or "latest"


def parse_config(args: Sequence[str], prog: str = "train.py") -> tuple[TrainConfig, Run | None]:
    """The configuration that a command line asks for, and the run to go on with, if any.

    `UsageError` for one that cannot be.
    """
    # The flags that choose what all others change are looked at first.
    which = value_of(args, "--resume")
    previous = None
    if which is not None:
        for flag in ("--preset", "--name", "--init", "--robot.urdf"):
            if value_of(args, flag) is not None:
                raise UsageError(f"{flag} cannot be given with --resume: the run has its own")
        previous = find_run(value_of(args, "--runs") or TrainConfig.runs, which)
        default = resumed_config(previous)
        start: dict[str, Any] = {"preset": default.task, "resume": which}
    else:
        given = value_of(args, "--preset")
        preset = "run" if given is None else given
        try:
            default = load_task(preset)
        except UsageError as error:
            raise UsageError(f"--preset: {error}") from None
        start = {"preset": preset}
    shared: dict[str, Any] = {
        f.name: getattr(default, f.name) for f in dataclasses.fields(TrainConfig)
    }
    description = f"{TrainFlags.__doc__}\n\n{task_list()}"
    flags = parse(TrainFlags, args, prog, TrainFlags(**shared, **start), description)
    config = TrainConfig(**{name: getattr(flags, name) for name in shared})
    world, usual = config.env.randomisation, default.env.randomisation
    if not world.enabled and dataclasses.replace(world, enabled=usual.enabled) != usual:
        raise UsageError("flags of --env.randomisation need --env.randomisation.enabled as well")
    return config, previous
