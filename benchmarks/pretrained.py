"""The policies that come with the package, for `quadwalk view` before any training.

    python benchmarks/pretrained.py [--runs runs/pretrained]

Trains each task as `python train.py TASK` does, unless the folder has a run of that name, and keeps
each policy and its robot in assets/pretrained/NAME. `drive` begins with the networks of a shorter
`walk`, as in docs/results.md, `universal` with those of `drive`, `universal_getup` of `getup`.
"""

import shutil
from pathlib import Path
from typing import Any

from benchmarks.shared import make_parser
from quadwalk.learn.flags import parse_config
from quadwalk.learn.loop import train
from quadwalk.paths import PRETRAINED
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run
from quadwalk.settings.serialize import to_dict
from quadwalk.settings.training import RobotConfig

# Task -> flags of the training whose networks it begins with, whatever its own seed.
BEGINS = {
    "drive": ["walk", "--steps", "12000000", "--seed", "1"],
    "universal": ["drive"],
    "universal_getup": ["getup"],
}
SEED = {"getup": ["--seed", "2"], "universal": ["--seed", "1"]}
TASKS = ["run", "walk", "drive", "getup", "rough", "universal", "universal_getup"]


def main() -> None:
    """Train each task that has no run yet, and keep its policy in assets/pretrained."""
    parser = make_parser(__doc__)
    parser.add_argument("--runs", type=Path, default=Path("runs/pretrained"))
    parser.add_argument("--tasks", nargs="+", default=TASKS)
    options = parser.parse_args()
    for name in options.tasks:
        run = train_task(name, options.runs, name, SEED.get(name, []))
        copy_run(run, Run(PRETRAINED / name))
        print(f"{name}: {(PRETRAINED / name / 'policy.npz').stat().st_size / 1e3:.0f} kB")


def train_task(task: str, runs: Path, name: str, flags: list[str]) -> Run:
    """Train a run `name` of a task in the folder `runs`, unless it is there; return it.

    A run whose networks it begins with is trained before.
    """
    run = Run(runs / name)
    if not run.policy.exists():
        begin: list[str] = []
        if task in BEGINS:
            begin = ["--init", str(train_first(task, runs))]
        train_run(runs, name, [task, *flags, *begin])
    return run


def train_first(task: str, runs: Path) -> Path:
    """Train the run that runs of `task` begin with, unless it is there; return its folder."""
    first, *more = BEGINS[task]
    if not more:
        return train_task(first, runs, first, SEED.get(first, [])).path
    return train_run(runs, f"{task}-first", [first, *more])


def train_run(runs: Path, name: str, flags: list[str]) -> Path:
    """Train a run `name` in the folder `runs`, unless it exists; return its folder.

    `flags` are those of train.py, the task first.
    """
    run = Run(runs / name)
    if not run.policy.exists():
        train(parse_config([*flags, "--name", name, "--runs", str(runs)])[0])
    return run.path


def copy_run(run: Run, place: Run) -> None:
    """Copy robot and policy of `run` to `place`, without paths of this machine in its settings."""
    place.path.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(run.urdf, place.urdf)
    leaves, metadata = checkpoint.load(run.policy, "policy")
    metadata["config"] |= {
        "robot": to_dict(RobotConfig(Path("robot.urdf"))),
        "runs": "runs",
        "name": None,
        "init": BEGINS[place.name][0] if place.name in BEGINS else None,
    }
    checkpoint.save(place.policy, nest(leaves), metadata)


def nest(leaves: dict[str, Any]) -> dict[str, Any]:
    """Return the tree of `leaves`, whose names are paths such as "policy/params/bias"."""
    tree: dict[str, Any] = {}
    for path, leaf in leaves.items():
        *groups, name = path.split("/")
        place = tree
        for group in groups:
            place = place.setdefault(group, {})
        place[name] = leaf
    return tree


if __name__ == "__main__":
    main()
