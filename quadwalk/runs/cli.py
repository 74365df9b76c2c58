"""`quadwalk runs`: list, show and remove training runs."""

import json
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from quadwalk.cli.arguments import parse
from quadwalk.errors import UsageError, UserError
from quadwalk.files import os_reason
from quadwalk.progress.headline import choose_headline
from quadwalk.runs.directory import Run, claim, find_run, list_runs

_TAIL = 16_384  # bytes at the end of metrics.jsonl, which hold its last line


@dataclass(frozen=True)
class RunsConfig:
    """List training runs, show their settings, or remove them."""

    action: Annotated[Literal["list", "show", "remove"], tyro.conf.Positional] = "list"
    # names or paths of runs
    run: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[RUN ...]")] = ()
    runs: Path = Path("runs")  # folder of all runs


def main(args: Sequence[str], prog: str = "quadwalk runs") -> None:
    """List all runs, show some with all of their settings, or remove some."""
    config = parse(RunsConfig, args, prog)
    if config.action == "list":
        if config.run:
            raise UsageError(f"list {config.run[0]}: expected list alone")
        _print_table(list_runs(config.runs), config.runs)
        return
    if not config.run:
        raise UsageError(f"{config.action}: expected one or more runs")
    runs = [find_run(config.runs, name) for name in config.run]  # all, before one is removed
    for run in runs:
        if config.action == "show":
            print(run.config.read_text("utf-8"))
            continue
        with claim(run):  # not one that is being trained
            pass
        try:
            shutil.rmtree(run.path)
        except OSError as error:
            raise UserError(f"cannot remove {run.path}: {os_reason(error)}") from error
        print(f"removed {run.path}")


def _print_table(runs: list[Run], root: Path) -> None:
    if not runs:
        print(f"no run in {root} yet")
        return
    table = Table("name", "task", "steps", "speed or velocity error", "falls, %", "size, MB")
    for run in runs:
        last = _last_metrics(run)
        headline, falls = choose_headline(last), last.get("eval/fall_rate")
        value = headline.value(last)
        figure = f"{value:z.2f} {headline.unit} {headline.off}".rstrip()
        size = sum(path.stat().st_size for path in run.path.rglob("*") if path.is_file()) / 1e6
        table.add_row(
            run.name,
            _task(run),
            f"{last.get('steps', 0):,.0f}",
            "-" if math.isnan(value) else figure,
            "-" if falls is None else f"{100 * falls:.1f}",
            f"{size:.1f}",
        )
    Console(soft_wrap=True).print(table)


def _task(run: Run) -> str:
    """The task's name; "-" for a run that cannot be read."""
    try:
        return str(json.loads(run.config.read_bytes())["config"]["task"])
    except (OSError, ValueError, KeyError, TypeError):
        return "-"


def _last_metrics(run: Run) -> dict[str, Any]:
    """The last whole line of metrics.jsonl; nothing where there is none."""
    try:
        with open(run.metrics, "rb") as file:
            file.seek(max(run.metrics.stat().st_size - _TAIL, 0))
            lines = file.read().split(b"\n")
        return dict(json.loads(lines[-2]))
    except (OSError, ValueError, IndexError, TypeError):
        return {}
