"""`quadwalk runs`: list, show and remove training runs."""

import json
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Table

from quadwalk.cli.arguments import parse
from quadwalk.errors import UsageError, UserError
from quadwalk.files import DAMAGE, get_os_reason
from quadwalk.progress.metrics import choose_headline
from quadwalk.progress.text import format_percent
from quadwalk.runs.directory import Run, claim, find_run, list_runs
from quadwalk.runs.log import read_last_row


@dataclass(frozen=True)
class ListRunsConfig:
    """List training runs, show their settings, or remove them."""

    action: Annotated[Literal["list", "show", "remove"], tyro.conf.Positional] = "list"
    # names or paths of runs
    run: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[RUN ...]")] = ()
    runs: Path = Path("runs")  # folder of all runs


def main(args: Sequence[str], prog: str = "quadwalk runs") -> None:
    """List all runs, or, as `args` say, show some with all of their settings or remove them."""
    config = parse(ListRunsConfig, args, prog)
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
            raise UserError(f"cannot remove {run.path}: {get_os_reason(error)}") from error
        print(f"removed {run.path}")


def _print_table(runs: list[Run], root: Path) -> None:
    """Print a row for each run: its task, progress and last metrics."""
    if not runs:
        print(f"no run in {root} yet")
        return
    table = Table("name", "task", "steps", "speed or velocity error", "falls, %", "size, MB")
    for run in runs:
        row = read_last_row(run) or {}
        headline, falls = choose_headline(row), row.get("eval/fall_rate", math.nan)
        value = headline.get_value(row)
        figure = f"{value:z.2f} {headline.unit} {headline.off}".rstrip()
        size = sum(path.stat().st_size for path in run.path.rglob("*") if path.is_file()) / 1e6
        table.add_row(
            run.name,
            _read_task(run),
            f"{row.get('steps', 0):,.0f}",
            "-" if math.isnan(value) else figure,
            format_percent(falls, unit=False),
            f"{size:.1f}",
        )
    Console(soft_wrap=True).print(table)


def _read_task(run: Run) -> str:
    """Return the name of the task of a run; "-" if its settings cannot be read."""
    try:
        return str(json.loads(run.config.read_bytes())["config"]["task"])
    except (OSError, *DAMAGE):
        return "-"
