"""The run directory: where one training keeps what is needed to replay it or go on with it.

runs/NAME/
  config.json          every setting
  metrics.jsonl        one line per iteration, the same for the same seed
  timing.jsonl         how long each took, which never is
  tensorboard/         the same numbers for TensorBoard
  checkpoints/         step_000001000000.npz ...: the whole state of training
  policy.npz           the result
  learning_curve.png
"""

import contextlib
import datetime
import json
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quadwalk.errors import UsageError, UserError
from quadwalk.files import replacing, why
from quadwalk.train import checkpoint

_NAME = re.compile(r"\w[\w.+=@,-]*")
_CHECKPOINT = re.compile(r"step_(\d+)\.npz")
_LISTED = 5  # runs named in a message: enough to recognise one, few enough for a line


@dataclass(frozen=True)
class Run:
    """A run's directory and the places in it."""

    path: Path

    @property
    def name(self) -> str:
        return self.path.resolve().name

    @property
    def config(self) -> Path:
        return self.path / "config.json"

    @property
    def urdf(self) -> Path:
        return self.path / "robot.urdf"

    @property
    def metrics(self) -> Path:
        return self.path / "metrics.jsonl"

    @property
    def timing(self) -> Path:
        return self.path / "timing.jsonl"

    @property
    def tensorboard(self) -> Path:
        return self.path / "tensorboard"

    @property
    def checkpoints(self) -> Path:
        return self.path / "checkpoints"

    @property
    def policy(self) -> Path:
        return self.path / "policy.npz"

    @property
    def learning_curve(self) -> Path:
        return self.path / "learning_curve.png"

    def checkpoint(self, steps: int) -> Path:
        """Where the checkpoint after this many environment steps goes."""
        # Twelve digits, so that a plain listing is in the order of training.
        return self.checkpoints / f"step_{steps:012d}.npz"


def create_run(root: Path | str, name: str | None = None, label: str = "run") -> Run:
    """Make the directory of a new run in `root`; without a name, call it by date, time and label.

    Raises `UsageError` for a name that exists or cannot be one, `UserError` if `root` cannot be
    written. Nothing is left behind then.
    """
    root = Path(root)
    if name is not None:
        _check_name(name)
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the folder for runs, {root}: {why(error)}") from error
    path = _make_first_free(root, label) if name is None else _make(root / name)
    if path is None:
        raise UsageError(f"run {name!r} exists in {root}: choose another name")
    run = Run(path)
    try:
        run.checkpoints.mkdir()
        run.tensorboard.mkdir()
    except OSError as error:
        shutil.rmtree(path, ignore_errors=True)
        raise UserError(f"cannot write in {path}: {why(error)}") from error
    return run


def find_run(root: Path | str, which: str) -> Run:
    """Find a run by its name in `root`, by its path, or as "latest", the one last written to.

    Raises `UsageError` that lists some of the runs there are.
    """
    root = Path(root)
    if which == "latest":
        runs = list_runs(root)
        if not runs:
            raise UsageError(f"no run in {root} yet: train one first")
        return runs[0]
    if which.strip():
        for path in (root / which, Path(which)):
            if _is_run(path):
                return Run(path)
    raise UsageError(f"no run {which!r}: {_known_runs(root)}")


def list_runs(root: Path | str) -> list[Run]:
    """The runs in `root`, the one last written to first; none if there is no such folder."""
    try:
        runs = [Run(path) for path in sorted(Path(root).iterdir()) if _is_run(path)]
    except OSError:
        return []
    return sorted(runs, key=_last_written, reverse=True)


def write_json_atomic(path: Path | str, value: Any) -> None:
    """Write `value` as readable, strict JSON, whole or not at all."""
    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False)
    with replacing(path) as file:
        file.write(text.encode() + b"\n")


def list_checkpoints(run: Run) -> list[Path]:
    """The run's checkpoints, oldest first."""
    try:
        found = [(_CHECKPOINT.fullmatch(path.name), path) for path in run.checkpoints.iterdir()]
    except OSError:
        return []
    return [path for _, path in sorted((int(match[1]), path) for match, path in found if match)]


def latest_checkpoint(run: Run, warn: Callable[[str], None] | None = None) -> Path:
    """The newest checkpoint that can be read whole.

    A damaged one is skipped, and `warn` (by default, stderr) is told. Raises `UserError` if none
    is left.
    """
    warn = warn or (lambda text: print(f"warning: {text}", file=sys.stderr))
    for path in reversed(list_checkpoints(run)):
        try:
            checkpoint.load(path, "checkpoint")
        except UserError as error:
            warn(f"{error}; trying the one before")
            continue
        return path
    raise UserError(f"{run.path} has no checkpoint that can be read")


def keep_last(run: Run, count: int) -> None:
    """Delete all but the newest `count` checkpoints, and what an interrupted save left."""
    if count < 1:
        raise ValueError("at least one checkpoint is kept")
    outdated = list_checkpoints(run)[:-count]
    for path in [*outdated, *run.checkpoints.glob("*.part")]:
        # A file that cannot be deleted costs space, not the training.
        with contextlib.suppress(OSError):
            path.unlink()


def _check_name(name: str) -> None:
    if name == "latest":
        raise UsageError("a run cannot be called 'latest': that means the newest one")
    if len(name) > 100 or not _NAME.fullmatch(name):
        raise UsageError(
            f"a run cannot be called {name!r}: expected at most 100 letters, digits and any of "
            "- _ . + = @ , beginning with a letter or digit"
        )


def _make(path: Path) -> Path | None:
    """Make a directory; None if the name is taken."""
    try:
        path.mkdir()
    except FileExistsError:
        return None
    except OSError as error:
        raise UserError(f"cannot make the run's folder {path}: {why(error)}") from error
    return path


def _make_first_free(root: Path, label: str) -> Path:
    # Taking the name by making the directory leaves no gap for a run started at the same moment.
    name = f"{datetime.datetime.now():%Y-%m-%d_%H%M}-{label}"
    _check_name(name)
    number = 1
    while True:
        path = _make(root / (name if number == 1 else f"{name}-{number}"))
        if path is not None:
            return path
        number += 1


def _is_run(path: Path) -> bool:
    try:
        return any((path / part).exists() for part in ("config.json", "policy.npz", "checkpoints"))
    except (OSError, ValueError):  # a name that no file could have
        return False


def _last_written(run: Run) -> float:
    def written(path: Path) -> float:
        try:
            return path.stat().st_mtime
        except OSError:
            return 0.0

    return max(map(written, (run.path, run.config, run.metrics, run.policy)))


def _known_runs(root: Path) -> str:
    runs = list_runs(root)
    if not runs:
        return f"there is none in {root} yet"
    names = ", ".join(run.name for run in runs[:_LISTED])
    more = f" and {len(runs) - _LISTED} older" if len(runs) > _LISTED else ""
    return f"expected 'latest', a path, or one in {root}: {names}{more}"
