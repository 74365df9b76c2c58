"""The figures of a task's policies: evaluate runs, and write studies/results/TASK.json.

    python -m studies.policies drive RUN RUN RUN --trained COMMIT --machine "EPYC C"
    python -m studies.policies drive RUN --read     # evaluates nothing: takes what eval.py wrote
    python -m studies.policies drive                # the policy that comes with the package

Each RUN, a name or a path, becomes a column of the task's table. COMMIT is that of the training,
which a run does not hold. Then the tables of the pages are written.
"""

import argparse
import datetime
import json
import math
import os
import platform
import shlex
import subprocess
import sys
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.pretrained import BEGINS
from quadwalk.cli.process import run_command
from quadwalk.errors import UserError
from quadwalk.files import hash_file, write_json
from quadwalk.paths import PRETRAINED
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run, find_ready, get_results_folder
from studies.figures import read_figures
from studies.tables import RESULTS, ROOT, shorten_revision, write_pages

_UNDISTURBED = "python eval.py RUN --engine mujoco --episodes 32 --mcap 0"
_RANDOMIZED = (
    "python eval.py RUN --randomized --engine fast --episodes 4096 --cell-episodes 0 --mcap 0"
)
_SWEEP = "quadwalk sweep RUN --engine fast --episodes 128"
# Of each task that ships, how its policies are evaluated.
COMMANDS = {
    "run": (_UNDISTURBED, _RANDOMIZED, _SWEEP),
    "walk": (_UNDISTURBED, _RANDOMIZED, _SWEEP),
    "drive": (f"{_UNDISTURBED} --cell-episodes 64", _RANDOMIZED, _SWEEP),
    "getup": ("python eval.py RUN --engine fast --episodes 4 --cell-episodes 1024 --mcap 0",),
    "rough": (
        "python eval.py RUN --engine mujoco --randomized --cell-episodes 64 --levels 7 --mcap 0",
    ),
}
DIGITS = 4  # of the figures that are kept


def main() -> None:
    """Evaluate the runs of a task, write their figures, and write the tables of the pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("task", choices=list(COMMANDS))
    parser.add_argument("run", nargs="*", help="names or paths of runs (default: the packaged one)")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder of all runs")
    parser.add_argument("--machine", default=describe_machine(), help="where it was trained")
    parser.add_argument("--trained", metavar="COMMIT", help="commit of the training")
    parser.add_argument("--read", action="store_true", help="evaluate nothing")
    parser.add_argument("--out", type=Path, help="file of the figures, in place of the pages'")
    options = parser.parse_args()
    runs = [find_ready(options.runs, name, options.task) for name in options.run or [options.task]]
    if not options.read:
        for run in runs:
            evaluate(options.task, run, options.runs)
    file = options.out or RESULTS / f"{options.task}.json"
    origin = {"commit": options.trained, "machine": options.machine}
    write_figures(options.task, runs, options.runs, origin, file)
    if options.out is None:
        write_pages()


def write_figures(
    task: str, runs: list[Run], root: Path, origin: dict[str, str | None], file: Path
) -> None:
    """Write the figures of evaluated runs of a task, in the folder `root` of all runs, to `file`.

    `origin` has the commit and the machine of their training.
    """
    evaluations = [read_evaluations(run, root) for run in runs]
    rows = [
        {"name": name_column(task, run), **origin, **round_figures(read_figures(run, evaluation))}
        for run, evaluation in zip(runs, evaluations, strict=True)
    ]
    write_json(file, make_result(task, rows, list(chain(*evaluations))))
    print(f"written to {file}")


def evaluate(task: str, run: Run, runs: Path) -> None:
    """Evaluate a run with each of the task's commands; `runs` is the folder of all runs."""
    for command in COMMANDS[task]:
        words = ["-m", "quadwalk"] if command.startswith("quadwalk") else []
        words += shlex.split(command)[1:]
        at = words.index("RUN")
        words[at : at + 1] = [str(run.path.resolve())]
        call = [sys.executable, *words, "--runs", str(runs.resolve())]
        done = subprocess.run(call, cwd=ROOT, check=False)
        if done.returncode:
            raise UserError(f"no figures of {run.path}: {shlex.join(call)} failed")


def read_evaluations(run: Run, runs: Path) -> list[dict[str, Any]]:
    """Return the contents of metrics.json and sweep.json of the run's policy, oldest first.

    Each has the `date` of its file too. Evaluations of another policy, as of a checkpoint, are
    left out.
    """
    results = get_results_folder(runs, run) / "eval"
    files = [file for name in ("metrics", "sweep") for file in results.glob(f"*/{name}.json")]
    policy, evaluations = hash_file(run.policy), []
    for file in sorted(files, key=lambda file: file.stat().st_mtime):
        date = datetime.date.fromtimestamp(file.stat().st_mtime).isoformat()
        evaluations.append({**json.loads(file.read_text()), "date": date})
    evaluations = [content for content in evaluations if content["policy_sha256"] == policy]
    if not evaluations:
        raise UserError(f"{run.path} was not evaluated; expected the same command without --read")
    return evaluations


def name_column(task: str, run: Run) -> str:
    """Return the heading of a run in the table of its task."""
    seed = checkpoint.load(run.policy, "policy")[1]["config"]["seed"]
    return f"seed {seed}, packaged" if is_packaged(task, run) else f"seed {seed}"


def is_packaged(task: str, run: Run) -> bool:
    """Return True if the run's policy has the weights of the one that comes with the package."""
    arrays, packaged = (
        checkpoint.load(file, "policy")[0] for file in (run.policy, Run(PRETRAINED / task).policy)
    )
    return arrays.keys() == packaged.keys() and all(
        np.array_equal(arrays[name], packaged[name]) for name in arrays
    )


def round_figures(value: Any) -> Any:
    """Return figures with `DIGITS` digits; a number that is not finite becomes None."""
    if isinstance(value, dict):
        return {name: round_figures(item) for name, item in value.items()}
    if isinstance(value, list):
        return [round_figures(item) for item in value]
    if not isinstance(value, float):
        return value
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None


def make_result(task: str, rows: list[Any], evaluations: list[Any]) -> dict[str, Any]:
    """Return the content of studies/results/TASK.json: the rows, and where they come from."""
    commits = {shorten_revision(content["revision"]) for content in evaluations}
    return {
        "policy": task,
        "commit": ", ".join(sorted(commits)),
        "machine": describe_machine(),
        "command": [*list_trainings(task), *dict.fromkeys(map(format_command, evaluations))],
        "date": max(content["date"] for content in evaluations),
        "figures": rows,
    }


def format_command(content: dict[str, Any]) -> str:
    """Return the command that wrote the content of a metrics.json or sweep.json."""
    if "sweeps" in content:
        return f"quadwalk sweep RUN --engine {content['engine']} --episodes {content['episodes']}"
    words = ["python eval.py RUN --engine", content["engine"]]
    words += ["--randomized"] if content["randomized"] else []
    words += ["--episodes", str(content["summary"]["episodes"])]
    # Each command of the suite "commands" gets a fourth of them.
    for suite, share in {"steering": 4, "standing": 1, "ground": 1}.items():
        if suite in content:
            words += ["--cell-episodes", str(share * content[suite]["episodes"])]
    if "ground" in content:
        words += ["--levels", str(len(content["ground"]["difficulties"]))]
    return " ".join(words)


def list_trainings(task: str) -> list[str]:
    """Return the commands that train a task's policy with the seed N."""
    if task not in BEGINS:
        return [f"python train.py {task} --seed N"]
    return [
        f"python train.py {' '.join(BEGINS[task])} --name first",
        f"python train.py {task} --init first --seed N",
    ]


def describe_machine() -> str:
    """Return the processor and the number of its cores."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.partition(": ")[2] for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.machine()}, {os.cpu_count()} cores"


if __name__ == "__main__":
    run_command(main)
