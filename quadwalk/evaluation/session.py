"""The evaluation command: find its runs, make folders for their results, and evaluate them."""

import contextlib
import datetime
import tempfile
from pathlib import Path
from typing import Any

from quadwalk.cli.arguments import make_console
from quadwalk.errors import UsageError, UserError
from quadwalk.evaluation.options import EvalConfig
from quadwalk.files import os_reason
from quadwalk.runs import directory
from quadwalk.runs.directory import Run


def evaluate_runs(config: EvalConfig) -> dict[str, Any]:
    """Evaluate as `config` says; return what metrics.json, sweep.json or comparison.json holds."""
    runs = _find_runs(config)
    with contextlib.ExitStack() as made:
        outs, together = _make_outputs(config, runs, made)
        # On stderr: what is printed on stdout is the result alone.
        console = make_console()
        console.print(
            f"evaluating {', '.join(directory.describe_origin(config.runs, run) for run in runs)}"
        )

        # All of these late, since they take seconds.
        from quadwalk.learn.devices import set_up_devices

        set_up_devices()
        from quadwalk.evaluation import judge
        from quadwalk.evaluation.loaded import load_run

        options = config.seconds, config.policy, config.engine, config.randomized, config.seed
        # All of them before the first is simulated, so that a bad one is known at once.
        loaded = [load_run(run, *options) for run in runs]
        for policy in loaded:
            for note in policy.notes:
                console.print(f"{policy.run.name}: {note}")
        one = judge.sweep if config.sweep else judge.judge
        results = [one(each, config, out, console) for each, out in zip(loaded, outs, strict=True)]
        if together is None:
            return results[0]
        if config.sweep:
            return judge.compare_sweeps(_labels(runs), results, together)
        return judge.compare(_labels(runs), outs, results, together, console)


def _find_runs(config: EvalConfig) -> list[Run]:
    """The runs that are named; `UsageError` for one that is not there, or named twice."""
    runs: list[Run] = []
    for which in config.run:
        run = directory.find_ready(config.runs, which, "run")
        for other, called in zip(runs, config.run, strict=False):
            if other.path.resolve() == run.path.resolve():
                raise UsageError(
                    f"{called!r} and {which!r} are the same run, {run.path}; expected others to "
                    "compare it with"
                )
        runs.append(run)
    return runs


def _labels(runs: list[Run]) -> list[str]:
    """What each run is called in a comparison: its name, or its path where names meet."""
    names = [run.name for run in runs]
    return [run.name if names.count(run.name) == 1 else str(run.path) for run in runs]


def _make_outputs(
    config: EvalConfig, runs: list[Run], made: contextlib.ExitStack
) -> tuple[list[Path], Path | None]:
    """Folders, made, for each run's results, and for those of a comparison."""
    if config.out is not None:
        together = _make_folder(config.out, made, new=False)
        if len(runs) == 1:
            return [together], None
        labels = [label.strip("/").replace("/", "_") for label in _labels(runs)]
        return [_make_folder(together / label, made, new=False) for label in labels], together
    what = "sweep" if config.sweep else config.engine
    name = f"{datetime.datetime.now():%Y-%m-%d_%H%M%S}-{what}"
    places = [directory.get_results_folder(config.runs, run) / "eval" for run in runs]
    if len(runs) > 1:
        places.append(config.runs / "comparisons")
    folders = [_make_folder(place / name, made) for place in places]
    return folders[: len(runs)], folders[-1] if len(runs) > 1 else None


def _make_folder(folder: Path, made: contextlib.ExitStack, new: bool = True) -> Path:
    """`folder`, or if it is to be `new` and is there, the first of `numbered` that is not.

    What has been made and is empty when `made` closes is deleted.
    """
    missing = [path for path in folder.parents if not path.exists()]
    try:
        if new:
            folder = next(
                filter(_is_made, map(folder.with_name, directory.generate_names(folder.name)))
            )
        if new or _is_made(folder):
            missing.insert(0, folder)
        for path in reversed(missing):
            made.callback(_delete_empty, path)
        # What is written is read back, to verify it; that this is possible is better known now
        # than after the simulation.
        with tempfile.NamedTemporaryFile(
            dir=folder, suffix=".part", delete_on_close=False
        ) as probe:
            open(probe.name, "rb").close()
    except OSError as error:
        raise UserError(
            f"cannot write results to the folder {folder}: {os_reason(error)}"
        ) from error
    return folder


def _is_made(folder: Path) -> bool:
    """Make `folder`; False if it is there, even by an evaluation begun at the same moment."""
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        return False
    return True


def _delete_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()
