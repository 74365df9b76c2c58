"""What the pages show, measured again on this machine: `make results`.

    python -m studies.measure [--seeds 3] [--only minutes run walk drive getup rough]

- minutes: each task of the README trains for a minute, which gives its steps/s.
- run, walk, drive, getup, rough: policies are trained with the seeds 0, 1, ..., and evaluated.

It takes hours. Ctrl-C stops it; what --runs has from before is not trained again. The figures go to
studies/results, and from there into the pages.
"""

import argparse
import datetime
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.pretrained import train_task
from quadwalk.cli.process import run_command
from quadwalk.evaluation.results import find_revision
from quadwalk.files import write_json
from quadwalk.runs.directory import Run
from quadwalk.task_files import load_task
from studies.policies import COMMANDS, describe_machine, evaluate, write_figures
from studies.tables import RESULTS, ROOT, load_result, shorten_revision, write_pages

MINUTES = "minutes"
WARM_UP = 30.0  # s of a training before its pace counts


def main() -> None:
    """Measure what --only names, by default all; write the figures and the tables of the pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=3, help="of each policy")
    parser.add_argument(
        "--runs", type=Path, default=Path("runs/results"), help="folder of all runs"
    )
    parser.add_argument("--only", nargs="+", choices=[MINUTES, *COMMANDS])
    options = parser.parse_args()
    for name in options.only or [MINUTES, *COMMANDS]:
        if name == MINUTES:
            measure_minutes()
        else:
            measure_policies(name, options.seeds, options.runs)
        write_pages()


def measure_policies(task: str, seeds: int, runs: Path) -> None:
    """Train and evaluate a policy for each seed, and write their figures."""
    trained = []
    for seed in range(seeds):
        run = train_task(task, runs, f"{task}-{seed}", ["--seed", str(seed)])
        evaluate(task, run, runs)
        trained.append(run)
    commit = shorten_revision(find_revision())
    origin: dict[str, str | None] = {"commit": commit, "machine": describe_machine()}
    write_figures(task, trained, runs, origin, RESULTS / f"{task}.json")


def measure_minutes() -> None:
    """Train each task of the README for a minute; write how long all its steps take."""
    result = load_result(MINUTES)
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure_pace(row, Path(folder)) for row in result["figures"]]
    result |= {
        "commit": shorten_revision(find_revision()),
        "machine": describe_machine(),
        "command": ["python train.py TASK --minutes 1"],
        "date": datetime.date.today().isoformat(),
        "figures": rows,
    }
    write_json(RESULTS / f"{MINUTES}.json", result)


def measure_pace(row: dict[str, Any], runs: Path) -> dict[str, Any]:
    """Return the README's row of a task with its steps, steps/s and minutes.

    The task trains for a minute as a run in the folder `runs`.
    """
    task = row["task"].split("`")[1]
    flags = ["--minutes", "1", "--name", task, "--runs", str(runs), "--quiet"]
    subprocess.run([sys.executable, "train.py", task, *flags], cwd=ROOT, check=True)
    pace, steps = compute_pace(Run(runs / task)), load_task(task).steps
    return {
        **row,
        "steps": steps / 1e6,
        "steps_per_second": round(pace),
        "minutes": max(round(steps / pace / 60), 1),
    }


def compute_pace(run: Run) -> float:
    """Return the steps/s of a training after its first `WARM_UP` seconds."""
    rows = [json.loads(line) for line in run.timing.read_text().splitlines()]
    late = [row for row in rows if row["time/elapsed"] >= WARM_UP] or rows
    first, last = late[0], rows[-1]
    if first is last:
        return float(last["steps"] / last["time/elapsed"])
    seconds = last["time/elapsed"] - first["time/elapsed"]
    return float((last["steps"] - first["steps"]) / seconds)


if __name__ == "__main__":
    run_command(main)
