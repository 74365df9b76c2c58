"""What can be driven: the runs there are, and each run's policies."""

from dataclasses import replace
from pathlib import Path

from quadwalk.errors import UserError
from quadwalk.evaluation.load import LoadedRun, load_run
from quadwalk.files import hash_file, resolve_path
from quadwalk.learn.acting import Policy, load_checkpoint_policy, load_policy
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run, list_checkpoints, list_runs

LAST, BEST = "last", "best"


def run_choices(root: Path, chosen: Run) -> dict[str, Run]:
    """Label to run: `chosen` if from elsewhere, those in `root`, newest first, those packaged."""
    runs = [*list_runs(root), *list_runs(PRETRAINED)]
    if all(resolve_path(run.path) != resolve_path(chosen.path) for run in runs):
        runs.insert(0, chosen)
    return {label_of(root, run): run for run in runs}


def label_of(root: Path, run: Run) -> str:
    """What `run` is called among those in `root`: its name, or the path of one from elsewhere."""
    if resolve_path(run.path).parent == resolve_path(root):
        return run.name
    return f"{run.name} (packaged)" if run.packaged else str(run.path)


def policy_choices(run: Run) -> dict[str, Path]:
    """Label to file: the last policy, the best, and those of the checkpoints, newest first."""
    found = {LAST: run.policy, BEST: run.best}
    for path in reversed(list_checkpoints(run)):
        found[f"{int(path.stem.removeprefix('step_')):,} steps"] = path
    return {label: path for label, path in found.items() if path.exists()}


def choose_policy(run: Run, label: str) -> Path:
    """The file of a policy; `UserError` in one line where the run has none of that name."""
    choices = policy_choices(run)
    if label not in choices:
        raise UserError(f"{run.path} has no {label} policy yet; train it for longer")
    return choices[label]


def open_run(run: Run, label: str) -> LoadedRun:
    """`run` with the policy called `label`, for MuJoCo C; `UserError` where it has none yet."""
    file = choose_policy(run, label)
    which = "best" if label == BEST else "last"
    loaded = load_run(run, 3600.0, which, "mujoco")
    if file == loaded.file:
        return loaded
    policy = read_policy(file, loaded.env.quadruped.joints)
    return replace(loaded, file=file, policy=policy, sha256=hash_file(file))


def getup_of(loaded: LoadedRun, getup: Run | None) -> LoadedRun | None:
    """The policy of `getup` for the robot of `loaded`; None where the two cannot take turns."""
    if getup is None or loaded.run.path == getup.path:
        return None
    found = open_run(getup, LAST)
    return found if loaded.has_same_robot(found) else None


def read_policy(file: Path, joints: tuple[str, ...]) -> Policy:
    """The policy in `file`, a policy's or a checkpoint."""
    if file.name.startswith("step_"):
        return load_checkpoint_policy(file, joints)
    return load_policy(file)
