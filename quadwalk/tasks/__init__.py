"""The tasks: one file is one task, with all of its numbers."""

import pkgutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from quadwalk.cli.arguments import parse


@dataclass(frozen=True)
class TasksConfig:
    """List the tasks."""


def main(args: Sequence[str], prog: str = "quadwalk tasks") -> None:
    """Print a line for each task; `args` can ask for help only."""
    parse(TasksConfig, args, prog)
    print(format_tasks())


def list_tasks() -> tuple[str, ...]:
    """Return the names of the package's tasks."""
    return tuple(module.name for module in pkgutil.iter_modules(__path__))


def format_tasks() -> str:
    """Return a line for each task, with its name and summary, without importing any task."""
    lines = []
    for name in list_tasks():
        text = Path(__path__[0], f"{name}.py").read_text("utf-8")
        summary = text.partition("\n")[0].strip('"').removeprefix(f"{name}: ")
        lines.append(f"  {name:<10} {summary}")
    return "\n".join(lines)
