"""The arguments of `train.py`: a task, a flag for each of its settings, and the run to resume."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from quadwalk.cli.arguments import find_value, parse, take_value
from quadwalk.errors import UsageError
from quadwalk.files import resolve_path
from quadwalk.runs.directory import Run, find_any_run, find_run
from quadwalk.settings.training import TrainConfig
from quadwalk.task_files import load_task


@dataclass(frozen=True, kw_only=True)
class TrainFlags(TrainConfig):
    """Teach a quadruped a task. Results go to runs/NAME/."""

    resume: str | None = None  # name or path of a run to resume, or "latest"


def parse_config(args: Sequence[str], prog: str = "train.py") -> tuple[TrainConfig, Run | None]:
    """Return the configuration that a command line describes, and the run to resume, if any.

    A first argument that is no flag is the task. Raises `UsageError` for an impossible setting.
    """
    args, task = list(args), None
    if args and not args[0].startswith("-"):
        task = args.pop(0)
    preset, args = take_value(args, "--preset")  # the task's flag in version 0.2
    if preset is not None and task is not None:
        raise UsageError(f"the task is named twice, as {task!r} and by --preset")
    task = preset if task is None else task
    args = ["--help" if arg == "--help-all" else arg for arg in args]
    # The flag that chooses the defaults of all others is read first.
    which = find_value(args, "--resume")
    previous = None
    if which is not None:
        if task is not None:
            raise UsageError(f"task {task!r} with --resume: the run has its own; expected no task")
        for flag in ("--name", "--init", "--robot.urdf", "--robot.file", "--replay"):
            if find_value(args, flag) is not None:
                raise UsageError(f"{flag} with --resume: the run has its own; expected no {flag}")
        from quadwalk.runs.resume import read_config_to_resume  # it imports all that reads a robot

        previous = find_run(find_value(args, "--runs") or TrainConfig.runs, which)
        default = read_config_to_resume(previous)
    elif (session := find_value(args, "--replay")) is not None:
        if task is not None:
            raise UsageError(f"task {task!r} with --replay: the run has its own; expected no task")
        from quadwalk.runs.resume import read_config_to_replay

        root = find_value(args, "--runs") or TrainConfig.runs
        default = read_config_to_replay(find_run(root, session))
        _, args = take_value(args, "--replay")  # the default has its whole path
    else:
        default = load_task("run" if task is None else task)
    shared: Any = {f.name: getattr(default, f.name) for f in dataclasses.fields(TrainConfig)}
    start = TrainFlags(**shared, resume=which)
    flags = parse(TrainFlags, args, prog, start, help_flag="--help-all")
    config = TrainConfig(**{name: getattr(flags, name) for name in shared})
    world, usual = config.env.randomization, default.env.randomization
    if not world.enabled and dataclasses.replace(world, enabled=usual.enabled) != usual:
        raise UsageError("flags of --env.randomization need --env.randomization.enabled as well")
    if config.init is not None and previous is None:
        # Resolved here, so that a command that trains in another folder begins with the same run.
        source = find_any_run(config.runs, config.init)
        config = dataclasses.replace(config, init=str(resolve_path(source.path)))
    return config, previous
