"""`quadwalk train`, which is also `train.py`: teach a quadruped a task."""

from collections.abc import Sequence

from quadwalk.cli.arguments import make_console
from quadwalk.tasks import format_tasks

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
  --robot.urdf FILE        train another robot: a URDF, an MJCF, or a name such as go2
  --env.reward.NAME X      scale of a reward term
  --watch                  show the newest policy live in a page of the browser
  --desk                   change rewards in that page while training runs
  --replay NAME            make the changes of another run's desk again
  --help-all               every setting, with the task's defaults

examples:
  {prog}
  {prog} walk --name quick --steps 5000000
  {prog} run --env.reward.energy -0.5 --robot.urdf go1.urdf"""


def main(args: Sequence[str], prog: str = "train.py") -> None:
    """Train as the arguments say."""
    if {"-h", "--help"} & set(args):
        print(_HELP.format(prog=prog, tasks=format_tasks()))
        return
    # Tasks are functions of JAX, which takes a second to import.
    with make_console().status("loading"):
        from quadwalk.learn.flags import parse_config

        config, previous = parse_config(args, prog)
        from quadwalk.learn.loop import train

    train(config, previous)
