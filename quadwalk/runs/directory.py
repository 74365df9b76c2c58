"""The run directory, with all that is needed to replay a training or resume it.

runs/NAME/
  config.json          every setting
  robot.urdf           the robot, as it was when training began
  task.py              the file of a task of one's own
  ground-FILE          the file of heights, if the ground is from one
  metrics.jsonl        one line per iteration, the same for the same seed
  timing.jsonl         the time of each iteration, which differs each time
  desk.jsonl           what was changed at the desk while it trained
  tensorboard/         the same numbers for TensorBoard
  checkpoints/         step_000001000000.npz ...: the whole state of training
  policy.npz           the policy as it was last
  best.npz             the policy as it was at the best of the checkpoints
  nan/                 steps that gave numbers that are not finite, if there were any
  learning_curve.png
"""

import contextlib
import datetime
import importlib.metadata
import itertools
import os
import platform
import re
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from quadwalk.errors import UsageError, UserError, suggest
from quadwalk.files import get_os_reason, hold_file, make_folder, resolve_path
from quadwalk.paths import PRETRAINED
from quadwalk.runs import checkpoint

_NAME = re.compile(r"\w[\w.+=@,-]*")
_CHECKPOINT = re.compile(r"step_(\d+)\.npz")
_LISTED = 5  # runs named in a message: enough to recognize one, few enough for a line


class _Place:
    """A path in a run's directory, by its file name."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, run: "Run", _: type) -> Path:
        return run.path / self._name


@dataclass(frozen=True)
class Run:
    """A run's directory and the places in it."""

    path: Path
    config = _Place("config.json")
    urdf = _Place("robot.urdf")
    desk = _Place("desk.jsonl")
    metrics = _Place("metrics.jsonl")
    timing = _Place("timing.jsonl")
    tensorboard = _Place("tensorboard")
    checkpoints = _Place("checkpoints")
    policy = _Place("policy.npz")
    best = _Place("best.npz")
    nan = _Place("nan")
    learning_curve = _Place("learning_curve.png")

    @property
    def name(self) -> str:
        return self.path.resolve().name

    @property
    def packaged(self) -> bool:
        """True for a pretrained run that comes with the package: nothing writes to it."""
        return resolve_path(self.path).parent == PRETRAINED

    def locate_heights(self, file: Path) -> Path:
        """Return the path in this run of the copy of `file`, which holds the ground's heights.

        For the copy itself that is its own path.
        """
        return self.path / f"ground-{file.name.removeprefix('ground-')}"

    def locate_checkpoint(self, steps: int) -> Path:
        """Return the path of the checkpoint after `steps` control steps of training."""
        # Twelve digits, so that a plain listing is in the order of training.
        return self.checkpoints / f"step_{steps:012d}.npz"


def create_run(
    root: Path | str,
    name: str | None = None,
    label: str = "run",
    files: Mapping[str, bytes] | None = None,
) -> Run:
    """Make the directory of a new run in `root`; without a name, call it by date, time and label.

    `files` go into it, from name to content: the directory appears with all of them or not at all.
    Raises `UsageError` for a name that exists or cannot be one, `UserError` if `root` cannot be
    written. Nothing is left behind then.
    """
    root = Path(root)
    if name is not None:
        _check_name(name)
    make_folder(root, "the folder for runs,")
    # Filled under another name: a run without its configuration could not be resumed.
    part = Run(root / f".{os.urandom(8).hex()}.part")
    try:
        part.path.mkdir()
        part.checkpoints.mkdir()
        part.tensorboard.mkdir()
        for file, content in (files or {}).items():
            with open(part.path / file, "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
        path = _rename_to_free(part.path, label) if name is None else _rename(part.path, name)
    except OSError as error:
        raise UserError(f"cannot write in {root / (name or '')}: {get_os_reason(error)}") from error
    finally:
        shutil.rmtree(part.path, ignore_errors=True)
    if path is None:
        raise UsageError(f"run {name!r} exists in {root}: choose another name")
    return Run(path)


def find_run(root: Path | str, which: str) -> Run:
    """Find a run by its name in `root`, by its path, or "latest".

    Raises a `UsageError` that lists the runs in `root`.
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
    raise _make_unknown_run_error(root, which)


def find_any_run(root: Path | str, which: str) -> Run:
    """Find a run as `find_run` does, or else a pretrained run of the package by its name."""
    packaged = sorted(folder.name for folder in PRETRAINED.iterdir())
    try:
        return find_run(root, which)
    except UsageError:
        # By its name, or by the path that it has where the package is installed elsewhere.
        folder, name = Path(which).parts[-3:-1], Path(which).name
        if name in packaged and folder in ((), PRETRAINED.parts[-2:]):
            return Run(PRETRAINED / name)
        if which == "latest":
            raise
        raise _make_unknown_run_error(Path(root), which, packaged) from None


def _make_unknown_run_error(root: Path, which: str, packaged: Sequence[str] = ()) -> UsageError:
    """Return an error that lists the runs in `root` and `packaged`, and suggests the likeliest."""
    names = [run.name for run in list_runs(root)]
    expected = f"there is none in {root} yet"
    if names:
        more = f" and {len(names) - _LISTED} older" if len(names) > _LISTED else ""
        listing = ", ".join(names[:_LISTED])
        expected = f"expected 'latest', a path, or one in {root}: {listing}{more}"
    trained = f"; {', '.join(packaged)} come trained" if packaged else ""
    hint = suggest(which, [*names, *packaged])
    return UsageError(f"no run {which!r}: {expected}{trained}{hint}")


def find_ready(root: Path | str, which: str, packaged: str) -> Run:
    """Find a run as `find_any_run` does, but "latest" is `packaged` if `root` has no run.

    `packaged` is the name of a pretrained run of the package.
    """
    nothing_yet = which == "latest" and not list_runs(root)
    return find_any_run(root, packaged if nothing_yet else which)


def describe_origin(root: Path | str, run: Run) -> str:
    """Return the path of a run, with a note if the run comes with the package."""
    if not run.packaged:
        return str(run.path)
    note = "" if list_runs(root) else f": no run in {root} yet"
    return f"{run.path}, which comes trained{note}"


def get_results_folder(root: Path | str, run: Run) -> Path:
    """Return the folder for plots, films and the like of a run: the run's folder.

    For a pretrained run of the package, to which nothing is written, it is a folder in `root`.
    """
    if run.packaged:
        return Path(root) / PRETRAINED.name / run.name
    return run.path


def list_runs(root: Path | str) -> list[Run]:
    """Return the runs in `root`, the last trained first; an empty list if it does not exist."""
    try:
        runs = [Run(path) for path in sorted(Path(root).iterdir()) if _is_run(path)]
    except OSError:
        return []

    def get_last_change(run: Run) -> float:
        return max(map(get_modified_time, (run.config, run.metrics, run.policy)))

    return sorted(runs, key=get_last_change, reverse=True)


def get_versions() -> dict[str, str]:
    """Return the versions of Python, quadwalk and the packages it computes with, by name."""
    packages = ("quadwalk", "mujoco", "mujoco-mjx", "jax", "jaxlib", "brax", "flax", "optax")
    versions = {name: importlib.metadata.version(name) for name in packages}
    return {"python": platform.python_version(), **versions}


def list_checkpoints(run: Run) -> list[Path]:
    """Return the run's checkpoints, oldest first."""
    try:
        names = [path.name for path in run.checkpoints.iterdir()]
    except OSError:
        return []
    steps = sorted(int(match[1]) for match in map(_CHECKPOINT.fullmatch, names) if match)
    return list(map(run.locate_checkpoint, steps))


def find_latest_checkpoint(run: Run, warn: Callable[[str], None]) -> Path | None:
    """Return the newest checkpoint that can be read whole; None if there are none at all.

    A damaged one is skipped with a line to `warn`. Raises `UserError` if all are damaged.
    """
    paths = list_checkpoints(run)
    for path in reversed(paths):
        try:
            checkpoint.load(path, "checkpoint")
        except UserError as error:
            warn(f"{error}; trying the one before")
            continue
        return path
    if paths:
        raise UserError(f"{run.path} has no checkpoint that can be read")
    return None


def prune_checkpoints(run: Run, count: int, also: Collection[Path] = ()) -> None:
    """Delete all checkpoints of a run except the newest `count` and those at `also`."""
    _delete(path for path in list_checkpoints(run)[:-count] if path not in also)


def delete_checkpoints_after(run: Run, steps: int) -> None:
    """Delete the checkpoints after more than `steps` control steps."""
    last = run.locate_checkpoint(steps)
    _delete(path for path in list_checkpoints(run) if path.name > last.name)


def get_checkpoint_steps(path: Path) -> int:
    """Return the control steps behind a checkpoint, from the name of its file."""
    return int(path.stem.removeprefix("step_"))


def claim(run: Run, wait: bool = False) -> contextlib.AbstractContextManager[None]:
    """Return a context in which no other process can train this run.

    If another process trains it already, wait for that one to end, or, without `wait`, raise
    `UserError`.
    """
    message = f"{run.path} is being trained by another process"
    return hold_file(run.metrics, None if wait else message)


def delete_partial_files(run: Run) -> None:
    """Delete the partial files that interrupted saves left in a run's folders."""
    # Not below: an evaluation may be writing there.
    _delete(path for place in (run.path, run.checkpoints, run.nan) for path in place.glob("*.part"))


def _delete(paths: Iterable[Path]) -> None:
    """Delete files; one that cannot be deleted is left."""
    for path in paths:
        # A file that cannot be deleted costs space, not the training.
        with contextlib.suppress(OSError):
            path.unlink()


def _check_name(name: str) -> None:
    """Raise `UsageError` for a name that a run cannot have."""
    if name == "latest":
        raise UsageError("a run cannot be called 'latest': that means the newest one")
    if len(name) > 100 or not _NAME.fullmatch(name):
        raise UsageError(
            f"a run cannot be called {name!r}: expected at most 100 letters, digits and any of "
            "- _ . + = @ , beginning with a letter or digit"
        )


def _rename(folder: Path, name: str) -> Path | None:
    """Rename `folder` within its parent and return its new path; None if the name is taken.

    That holds even against a run that another process begins at the same moment.
    """
    path = folder.with_name(name)
    try:
        # The system refuses to put it in the place of a file, or of a folder that is not empty.
        folder.rename(path)
    except OSError:
        if path.exists() or path.is_symlink():
            return None
        raise
    return path


def _rename_to_free(folder: Path, label: str) -> Path:
    """Rename `folder` to the time and `label`, and a number if that is taken; return its path."""
    words = re.sub(r"[^\w.+=@,-]+", "-", label)[:50]  # a user's task may be called anything
    names = generate_names(f"{datetime.datetime.now():%Y-%m-%d_%H%M}-{words}")
    return next(path for name in names if (path := _rename(folder, name)))


def generate_names(name: str) -> Iterator[str]:
    """Yield `name`, then `name`-2, `name`-3 and so on: the caller takes the first free one."""
    yield name
    yield from (f"{name}-{number}" for number in itertools.count(2))


def _is_run(path: Path) -> bool:
    """Return True for a directory that holds the settings or the policy of a run."""
    if path.name.startswith(".") and path.name.endswith(".part"):
        return False
    try:
        # Files: the folder of a run that is called so is none.
        return any((path / part).is_file() for part in ("config.json", "policy.npz"))
    except (OSError, ValueError):  # a name that no file could have
        return False


def get_modified_time(path: Path) -> float:
    """Return the time at which `path` was last written, s since 1970; 0 if it does not exist."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
