"""The evaluation command: find the runs, judge each, compare them, write it all down."""

import contextlib
import datetime
import shutil
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from quadwalk.errors import UsageError, UserError
from quadwalk.evaluate.options import EvalConfig
from quadwalk.files import os_reason
from quadwalk.shell import words
from quadwalk.train.runs.directory import (
    Run,
    find_any_run,
    numbered,
    results_folder,
    write_json_atomic,
)

if TYPE_CHECKING:
    from quadwalk.evaluate.evaluation import Evaluation
    from quadwalk.evaluate.loaded import LoadedRun


def evaluate(config: EvalConfig) -> dict[str, Any]:
    """Evaluate as `config` says; return what metrics.json, sweep.json or comparison.json holds."""
    runs = _find_runs(config)
    with contextlib.ExitStack() as made:
        return _evaluate(config, runs, *_make_outputs(config, runs, made))


def _evaluate(
    config: EvalConfig, runs: list[Run], outs: list[Path], together: Path | None
) -> dict[str, Any]:
    # On stderr: what is printed on stdout is the result alone.
    console = Console(stderr=True, highlight=False, soft_wrap=True, markup=False, emoji=False)
    console.print(f"evaluating {', '.join(str(run.path) for run in runs)}")

    # All of these late, since they take seconds.
    from quadwalk.train.devices import set_up_devices

    set_up_devices()
    from quadwalk.evaluate.loaded import load_run
    from quadwalk.evaluate.sweep import sweep

    # All of them before the first is simulated, so that a bad one is told at once.
    all_loaded = [
        load_run(run, config.seconds, config.policy, config.engine, config.randomised, config.seed)
        for run in runs
    ]
    if config.sweep:
        swept = [
            sweep(loaded, config, out, console)
            for loaded, out in zip(all_loaded, outs, strict=True)
        ]
        return swept[0] if together is None else _compare_sweeps(_labels(runs), swept, together)
    results = [
        judge(loaded, config, out, console) for loaded, out in zip(all_loaded, outs, strict=True)
    ]
    if together is None:
        return results[0]
    return compare(_labels(runs), outs, results, together, console)


def judge(loaded: "LoadedRun", config: EvalConfig, out: Path, console: Console) -> dict[str, Any]:
    """Evaluate one run into the folder `out`; return what its metrics.json holds.

    The result is printed on standard output, what is being done on `console`.
    """
    from quadwalk.evaluate.report.console import describe_gait, print_engines, print_summary
    from quadwalk.evaluate.report.panels import draw_by_ground
    from quadwalk.evaluate.report.plots import save_figure
    from quadwalk.evaluate.summary import engine_differences

    name = loaded.run.name
    found = _roll_out(loaded, config, console)
    steps = f"{loaded.policy.steps:,} steps of training"
    print_summary(found.summary, f"{name}, {steps}, engine {config.engine}")
    with console.status("looking closely at the episode of median speed"):
        results = dict(found.results)
    # On uneven ground MJX takes longer to compile than all else takes together.
    if config.engine == "mujoco" and loaded.env.terrain is None:
        other = _roll_out(loaded.in_engine("mjx"), config, console).summary
        results["mjx_summary"] = other
        results["difference_to_mjx"] = engine_differences(other, found.summary)
        print_engines(other, found.summary)
    print(describe_gait(found.gait, found.typical.episode))
    maps = []
    if loaded.env.terrain is not None and config.cell:
        results["ground"] = ground = _by_ground(loaded, config, console)
        save_figure(draw_by_ground(ground, f"{name}, {config.engine}"), out / "ground.png")
        maps = ["ground.png"]
    write_json_atomic(out / "metrics.json", results)

    with console.status("writing"):
        recorded = len(found.save_mcap(out, config.recordings))
        save_figure(found.report(), out / "report.png")
        pictures = _draw(config, found, out)
    written = ["metrics.json", *maps, "report.png", *pictures, f"{recorded} MCAP files"]
    console.print(f"written to {out}: {', '.join(written)}")
    if recorded:
        recording = out / "episode_000.mcap"
        rerun = shutil.which("rerun")
        see = f"see it with: {words('rerun', recording)}, or open it in Foxglove"
        console.print(see if rerun else f"open {recording} in Rerun or Foxglove")
    return results


def compare(
    labels: list[str],
    folders: list[Path],
    results: list[dict[str, Any]],
    out: Path,
    console: Console,
) -> dict[str, Any]:
    """Print and write the comparison of runs called `labels`; return what comparison.json holds.

    `results` are their metrics, as `judge` returns them, which it has written to `folders`.
    """
    from quadwalk.evaluate.report.console import print_comparison
    from quadwalk.evaluate.report.panels import draw_comparison
    from quadwalk.evaluate.report.plots import save_figure

    common = {name: results[0][name] for name in ("engine", "seed", "seconds", "revision")}
    runs = [
        {
            "name": label,
            "folder": str(folder),
            **{name: result[name] for name in ("training_steps", "policy_sha256", "summary")},
            "typical_episode": result["typical_episode"],
        }
        for label, folder, result in zip(labels, folders, results, strict=True)
    ]
    comparison = {**common, "runs": runs}
    print_comparison(comparison)
    write_json_atomic(out / "comparison.json", comparison)
    save_figure(draw_comparison(labels, results), out / "comparison.png")
    console.print(f"written to {out}: comparison.json, comparison.png")
    return comparison


def _compare_sweeps(labels: list[str], results: list[dict[str, Any]], out: Path) -> dict[str, Any]:
    """Draw and write the sweeps of runs called `labels` together; what comparison.json holds."""
    from quadwalk.evaluate.report.panels import draw_sweep
    from quadwalk.evaluate.report.plots import save_figure

    named = [{**result, "run": label} for label, result in zip(labels, results, strict=True)]
    write_json_atomic(out / "comparison.json", {"runs": named})
    save_figure(draw_sweep(named), out / "sweep.png")
    return {"runs": named}


def _roll_out(loaded: "LoadedRun", config: EvalConfig, console: Console) -> "Evaluation":
    """The episodes of `loaded`, with a line that says how far they are."""
    from quadwalk.evaluate.evaluation import measure
    from quadwalk.evaluate.report.console import simulating

    env, began = loaded.env, time.monotonic()
    what = f"simulating {config.episodes} episodes in {env.engine}"
    with simulating(console, what, env.config.episode_steps, env.config.control_dt) as report:
        found = measure(loaded, config.episodes, config.seed, report, config.recordings)
    simulated = sum(episode["duration"] for episode in found.episodes)
    took = time.monotonic() - began
    console.print(
        f"{loaded.run.name}: {simulated:,.0f} s simulated in {env.engine} in {took:.1f} s"
    )
    return found


def _by_ground(loaded: "LoadedRun", config: EvalConfig, console: Console) -> dict[str, Any]:
    """Measure and print how well it gets over each kind of ground."""
    from quadwalk.evaluate.by_ground import measure_by_ground
    from quadwalk.evaluate.report.console import print_by_ground, simulating

    env = loaded.env
    what = f"simulating {config.cell} episodes on each kind of ground in {env.engine}"
    with simulating(console, what, env.config.episode_steps, env.config.control_dt) as report:
        found = measure_by_ground(loaded, config.levels, config.cell, config.seed, report)
    print_by_ground(found)
    return found


def _draw(config: EvalConfig, found: "Evaluation", out: Path) -> list[str]:
    """Draw the film strip and the video that is asked for; the names of the files."""
    from quadwalk.drawing.images import save_png
    from quadwalk.evaluate.report.pictures import draw_film_strip, render_video

    quadruped = found.loaded.env.quadruped
    save_png(draw_film_strip(found.typical, quadruped), out / "film_strip.png")
    if config.video == "none":
        return ["film_strip.png"]
    video = f"episode.{config.video}"
    render_video(found.typical, quadruped, out / video)
    return ["film_strip.png", video]


def _find_runs(config: EvalConfig) -> list[Run]:
    """The runs that are named; `UsageError` for one that is not there, or named twice."""
    runs: list[Run] = []
    for which in config.run:
        run = find_any_run(config.runs, which)
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
    places = [results_folder(config.runs, run) / "eval" for run in runs]
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
            folder = next(filter(_is_made, map(folder.with_name, numbered(folder.name))))
        if new or _is_made(folder):
            missing.insert(0, folder)
        for path in reversed(missing):
            made.callback(_delete_empty, path)
        # What is written is read back, to verify it; that this is possible is better known now
        # than after the simulation.
        with tempfile.NamedTemporaryFile(dir=folder, suffix=".part") as probe:
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
