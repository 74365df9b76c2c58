"""The arguments of `train.py`: a task, a flag for each of its settings, and the run to resume."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from quadwalk.cli.arguments import parse, taken, value_of
from quadwalk.errors import UsageError
from quadwalk.files import real_path
from quadwalk.runs.directory import Run, find_any_run, find_run
from quadwalk.runs.resume import read_config_to_resume
from quadwalk.settings.training import TrainConfig
from quadwalk.task_files import load_task, task_list, task_table


def main(args: Sequence[str], prog: str = "train.py") -> None:
    """Train as the command line says."""
    config, previous = parse_config(args, prog)
    from quadwalk.learn.loop import train  # not before: --help and errors need none of it

    train(config, previous)


@dataclass(frozen=True, kw_only=True)
class TrainFlags(TrainConfig):
    """Teach a quadruped a task. Results go to runs/NAME/."""

    resume: str | None = None  # name or path of a run to resume, or "latest"


_HELP = """usage: {prog} [TASK] [--FLAG VALUE ...]

Teach a quadruped a task. Results go to runs/NAME/; Ctrl-C saves the policy.

tasks (or the path of a .py file that defines TASK):
{tasks}

common flags:
  --name NAME              of the run; the default is date, time and task
  --steps N                control steps of all environments together
  --minutes M              stop after M minutes, with the policy saved
  --seed N                 the same seed on the same machine gives the same numbers
  --resume NAME            resume a run that was stopped
  --init NAME              begin with the networks of another run
  --robot.urdf FILE        train another robot
  --env.reward.NAME X      scale of a reward term
  --watch                  show the newest policy live in a page of the browser
  --help-all               every setting, with the task's defaults

examples:
  {prog}
  {prog} walk --name quick --steps 5000000
  {prog} run --env.reward.energy -0.5 --robot.urdf go1.urdf"""


def parse_config(args: Sequence[str], prog: str = "train.py") -> tuple[TrainConfig, Run | None]:
    """The configuration that a command line describes, and the run to resume, if any.

    A first argument that is no flag is the task. `UsageError` for a configuration that cannot be.
    """
    args, task = list(args), None
    if args and not args[0].startswith("-"):
        task = args.pop(0)
    preset, args = taken(args, "--preset")  # the task's flag in version 0.2
    if preset is not None and task is not None:
        raise UsageError(f"the task is named twice, as {task!r} and by --preset")
    task = preset if task is None else task
    if {"-h", "--help"} & set(args):
        print(_HELP.format(prog=prog, tasks=task_table()))
        raise SystemExit
    args = ["--help" if arg == "--help-all" else arg for arg in args]
    # The flag that chooses the defaults of all others is read first.
    which = value_of(args, "--resume")
    previous = None
    if which is not None:
        if task is not None:
            raise UsageError(f"task {task!r} with --resume: the run has its own; expected no task")
        for flag in ("--name", "--init", "--robot.urdf"):
            if value_of(args, flag) is not None:
                raise UsageError(f"{flag} with --resume: the run has its own; expected no {flag}")
        previous = find_run(value_of(args, "--runs") or TrainConfig.runs, which)
        default = read_config_to_resume(previous)
    else:
        default = load_task("run" if task is None else task)
    shared: Any = {f.name: getattr(default, f.name) for f in dataclasses.fields(TrainConfig)}
    description = f"{TrainFlags.__doc__}\n\n{task_list()}"
    start = TrainFlags(**shared, resume=which)
    flags = parse(TrainFlags, args, prog, start, description, "--help-all")
    config = TrainConfig(**{name: getattr(flags, name) for name in shared})
    world, usual = config.env.randomization, default.env.randomization
    if not world.enabled and dataclasses.replace(world, enabled=usual.enabled) != usual:
        raise UsageError("flags of --env.randomization need --env.randomization.enabled as well")
    if config.init is not None and previous is None:
        # Resolved here, so that a command that trains in another folder begins with the same run.
        source = find_any_run(config.runs, config.init)
        config = dataclasses.replace(config, init=str(real_path(source.path)))
    return config, previous
