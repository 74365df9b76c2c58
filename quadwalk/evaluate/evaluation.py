"""An evaluation from start to end: find the runs, judge each, compare them."""

import datetime
import tempfile
from pathlib import Path
from typing import Any

from rich.console import Console

from quadwalk.errors import UsageError, UserError
from quadwalk.evaluate.options import EvalConfig
from quadwalk.files import os_reason
from quadwalk.train.runs.directory import Run, find_run


def evaluate(config: EvalConfig) -> dict[str, Any]:
    """Evaluate as `config` says; return what metrics.json, sweep.json or comparison.json holds."""
    runs = _find_runs(config)
    what = "sweep" if config.sweep else config.engine
    outs, together = _make_outputs(
        config, runs, f"{datetime.datetime.now():%Y-%m-%d_%H%M%S}-{what}"
    )
    # On stderr: what is printed on stdout is the result alone.
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    console.print(f"evaluating {', '.join(str(run.path) for run in runs)}")

    # Before anything imports JAX; and all of these late, since they take seconds.
    from quadwalk.train.devices import set_up_devices

    set_up_devices()
    from quadwalk.evaluate.comparison import compare
    from quadwalk.evaluate.judge import judge
    from quadwalk.evaluate.subject import load_subject
    from quadwalk.evaluate.sweep import sweep
    from quadwalk.evaluate.view import check_screen

    if config.view:
        check_screen()  # now, not after a minute of simulation
    # All of them before the first is simulated, so that a bad one is told at once.
    subjects = [load_subject(run, config.seconds, config.policy) for run in runs]
    if config.sweep:
        return sweep(subjects[0], config, outs[0], console)
    results = [
        judge(subject, config, out, console) for subject, out in zip(subjects, outs, strict=True)
    ]
    if together is None:
        return results[0]
    return compare(_labels(runs), outs, results, together, console)


def _find_runs(config: EvalConfig) -> list[Run]:
    """The runs that are named; `UsageError` for one that is not there, or named twice."""
    runs: list[Run] = []
    for which in config.run:
        run = find_run(config.runs, which)
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


def _make_outputs(config: EvalConfig, runs: list[Run], name: str) -> tuple[list[Path], Path | None]:
    """Folders, made, for each run's results, and for those of a comparison."""
    if len(runs) == 1:
        return [_make_folder(config.out or runs[0].path / "eval" / name)], None
    together = _make_folder(config.out or config.runs / "comparisons" / name)
    if config.out is None:
        return [_make_folder(run.path / "eval" / name) for run in runs], together
    labels = [label.strip("/").replace("/", "_") for label in _labels(runs)]
    return [_make_folder(together / label) for label in labels], together


def _make_folder(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # What is written is read back, to verify it; that this is possible is better known now
        # than after the simulation.
        with tempfile.NamedTemporaryFile(dir=folder, suffix=".part") as probe:
            open(probe.name, "rb").close()
    except OSError as error:
        raise UserError(
            f"cannot write results to the folder {folder}: {os_reason(error)}"
        ) from error
    return folder
