"""The commands of `quadwalk`, and the entry point of all of them."""

from __future__ import annotations

import contextlib
import importlib
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from quadwalk.cli.process import run_command
from quadwalk.errors import UsageError, suggest

# A command is a function `main(args, prog)`, named by its module and imported when it is called:
# `args` are the words after the command, `prog` is what messages and help call it.
COMMANDS = {
    "train": ("quadwalk.learn.cli:main", "train a quadruped in a task"),
    "eval": ("quadwalk.evaluation.command:call_eval", "evaluate a trained policy"),
    "sweep": ("quadwalk.evaluation.command:call_sweep", "measure what a policy withstands"),
    "view": ("quadwalk.web.view:main", "drive a trained policy in a page of the browser"),
    "demo": ("quadwalk.web.view:main_demo", "drive the policy that comes trained, or your robot"),
    "export": ("quadwalk.export.cli:main", "write a policy as ONNX, to be used elsewhere"),
    "compare": (
        "quadwalk.experiments.commands:compare",
        "train and compare variants over seeds",
    ),
    "tune": ("quadwalk.experiments.commands:tune", "search the settings that make a policy best"),
    "identify": ("quadwalk.identify.cli:main", "fit a robot's joints to a log of them"),
    "runs": ("quadwalk.runs.cli:main", "list, show and remove training runs"),
    "tasks": ("quadwalk.tasks:main", "list the tasks"),
    "robot": ("quadwalk.robot.cli:main", "convert a URDF to MJCF, or draw it"),
    "terrain": ("quadwalk.terrain.cli:main", "draw every kind of terrain"),
    "nan": ("quadwalk.learn.nan:main", "replay a training step that gave no finite numbers"),
    "alongside": ("quadwalk.web.view:main_alongside", ""),  # started by training, not listed
    "doctor": ("quadwalk.cli.doctor:main", "print versions, devices, cores, and what is off here"),
}
LISTED = {name: summary for name, (_, summary) in COMMANDS.items() if summary}


def main(command: str | None = None) -> NoReturn:
    """Run a command and end the process with its exit status.

    It is `command`, in its own script (`train.py` for "train"), or the first word of the command
    line.
    """
    if command is None:
        run_command(lambda: call_command(sys.argv[1:]))
    run_command(lambda: call(command, sys.argv[1:], f"{command}.py"))


def call_command(words: Sequence[str]) -> None:
    """Call the command that the first of `words` names, with the others as its arguments.

    Without words it prints all commands. Raises `UsageError` for an unknown command.
    """
    name, *args = words or ["--help"]
    if name in ("-h", "--help"):
        print("usage: quadwalk COMMAND [OPTIONS]; quadwalk COMMAND --help lists the options\n")
        for command, summary in LISTED.items():
            print(f"  {command:<9}{summary}")
    elif name == "--version":
        from quadwalk import __version__

        print(f"quadwalk {__version__}")
    elif name == "--print-completion":
        print_completion(args[0] if args else "")
    elif name in COMMANDS:
        call(name, args, f"quadwalk {name}")
    else:
        names = ", ".join(LISTED)
        raise UsageError(f"no command {name!r}; expected one of: {names}{suggest(name, LISTED)}")


def call(command: str, args: Sequence[str], prog: str) -> None:
    """Import the function of `command` and call it with `args`; messages call it `prog`."""
    module, _, function = COMMANDS[command][0].partition(":")
    getattr(importlib.import_module(module), function)(list(args), prog)


def print_completion(shell: str) -> None:
    """Print the script, made by tyro, by which bash or zsh completes commands and flags.

    Raises `UsageError` for another shell.
    """
    if shell not in ("bash", "zsh"):
        raise UsageError(f"--print-completion {shell}: expected bash or zsh")
    from functools import reduce
    from operator import or_
    from typing import Annotated

    import tyro

    from quadwalk.cli.arguments import FIND_OPTIONS, OptionsFoundError

    commands: Any = []
    for name in LISTED:
        try:
            call(name, [FIND_OPTIONS], name)
        except OptionsFoundError as options:
            command = tyro.conf.subcommand(name, default=options.default, prefix_name=False)
            commands.append(Annotated[options.cls, command])
    settings = (tyro.conf.SuppressFixed,)
    args = ["--tyro-print-completion", shell]
    with contextlib.suppress(SystemExit):
        tyro.cli(reduce(or_, commands), prog="quadwalk", args=args, config=settings)
    if shell == "bash":  # files too, where tyro knows no word
        print("complete -o default -F _tyro_quadwalk quadwalk")
