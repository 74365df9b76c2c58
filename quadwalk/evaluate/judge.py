"""Runs judged into folders: each evaluated or swept, and several compared."""

import contextlib
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from quadwalk.drawing.figures import save_figure
from quadwalk.drawing.images import save_png
from quadwalk.evaluate.evaluation import Evaluation, measure
from quadwalk.evaluate.grids.by_ground import measure_by_ground
from quadwalk.evaluate.grids.standing import measure_standing, standing_run
from quadwalk.evaluate.grids.steering import (
    changing_run,
    measure_changing,
    measure_steering,
    steering_run,
)
from quadwalk.evaluate.grids.sweep import measure_sweeps, sweep_points
from quadwalk.evaluate.loaded import LoadedRun
from quadwalk.evaluate.options import EvalConfig
from quadwalk.evaluate.recording.provenance import provenance
from quadwalk.evaluate.report.console import (
    describe_gait,
    print_by_ground,
    print_comparison,
    print_engines,
    print_standing,
    print_steering,
    print_summary,
    print_sweep,
    simulating,
)
from quadwalk.evaluate.report.panels import (
    draw_by_ground,
    draw_comparison,
    draw_steering,
    draw_sweep,
)
from quadwalk.evaluate.report.pictures import draw_film_strip, render_video
from quadwalk.evaluate.summary import engine_differences
from quadwalk.shell import words
from quadwalk.train.runs.directory import write_json_atomic


def judge(loaded: LoadedRun, config: EvalConfig, out: Path, console: Console) -> dict[str, Any]:
    """Evaluate one run into the folder `out`; return what its metrics.json holds.

    The result is printed on standard output, what is being done on `console`.
    """
    name = loaded.run.name
    found = _evaluation(loaded, config, console)
    steps = f"{loaded.policy.steps:,} steps of training"
    print_summary(found.summary, f"{name}, {steps}, engine {config.engine}")
    with console.status("looking closely at the episode of median speed"):
        results = dict(found.results)
    # On uneven ground MJX takes longer to compile than all else takes together.
    if config.engine == "mujoco" and loaded.env.terrain is None:
        other = _evaluation(loaded.in_engine("mjx"), config, console).summary
        results["mjx_summary"] = other
        results["difference_to_mjx"] = engine_differences(other, found.summary)
        print_engines(other, found.summary)
    print(describe_gait(found.gait, found.typical.episode))
    written = ["metrics.json"]
    if loaded.env.terrain is not None and config.cell_episodes:
        with _progress(
            loaded, f"{config.cell_episodes} episodes on each kind of ground", console
        ) as report:
            ground = measure_by_ground(
                loaded, config.levels, config.cell_episodes, config.seed, report
            )
        print_by_ground(ground)
        results["ground"] = ground
        save_figure(draw_by_ground(ground, f"{name}, {config.engine}"), out / "ground.png")
        written.append("ground.png")
    elif loaded.env.config.reset.tumbled and config.cell_episodes:
        rising = standing_run(loaded)
        with _progress(
            rising, f"{config.cell_episodes} episodes of each condition", console
        ) as report:
            results["standing"] = measure_standing(
                rising, config.cell_episodes, config.seed, report
            )
        print_standing(results["standing"])
    elif loaded.env.config.command.turning is not None and config.cell_episodes:
        driven, episodes = steering_run(loaded), max(config.cell_episodes // 4, 1)
        with _progress(driven, f"{episodes} episodes of each command", console) as report:
            results["steering"] = measure_steering(driven, episodes, config.seed, report)
        long, episodes = changing_run(loaded), 16 * config.cell_episodes
        with _progress(long, f"{episodes} episodes of changing commands", console) as report:
            changing = measure_changing(long, episodes, config.seed, report)
        results["steering"]["changing"] = changing
        print_steering(results["steering"])
        save_figure(draw_steering(results["steering"], name), out / "steering.png")
        written.append("steering.png")
    write_json_atomic(out / "metrics.json", results)
    with console.status("writing"):
        written += _write_pictures(found, config, out)
        recorded = found.save_mcap(out, config.recordings)
    console.print(f"written to {out}: {', '.join(written)}, {len(recorded)} MCAP files")
    if recorded:
        see = f"see it with: {words('rerun', recorded[0])}, or open it in Foxglove"
        other_way = f"open {recorded[0]} in Rerun or Foxglove"
        console.print(see if shutil.which("rerun") else other_way)
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
    own = ("training_steps", "policy_sha256", "summary", "typical_episode")
    comparison = {name: results[0][name] for name in ("engine", "seed", "seconds", "revision")}
    comparison["runs"] = [
        {"name": label, "folder": str(folder), **{name: result[name] for name in own}}
        for label, folder, result in zip(labels, folders, results, strict=True)
    ]
    print_comparison(labels, results)
    write_json_atomic(out / "comparison.json", comparison)
    save_figure(draw_comparison(labels, results), out / "comparison.png")
    console.print(f"written to {out}: comparison.json, comparison.png")
    return comparison


def sweep(loaded: LoadedRun, config: EvalConfig, out: Path, console: Console) -> dict[str, Any]:
    """Sweep, print the table, write sweep.json and sweep.png to `out`; return the former."""
    count = len(sweep_points(loaded)[0])
    with _progress(loaded, f"{count} x {config.episodes} episodes", console) as report:
        swept = measure_sweeps(loaded, config.episodes, config.seed, report)
    results = {**provenance(loaded, config.seed), **swept}
    print_sweep(results)
    write_json_atomic(out / "sweep.json", results)
    save_figure(draw_sweep([results]), out / "sweep.png")
    console.print(f"written to {out}: sweep.json, sweep.png")
    return results


def compare_sweeps(labels: list[str], results: list[dict[str, Any]], out: Path) -> dict[str, Any]:
    """Draw and write the sweeps of runs called `labels` together; what comparison.json holds."""
    named = [{**result, "run": label} for label, result in zip(labels, results, strict=True)]
    write_json_atomic(out / "comparison.json", {"runs": named})
    save_figure(draw_sweep(named), out / "sweep.png")
    return {"runs": named}


def _progress(
    loaded: LoadedRun, what: str, console: Console
) -> contextlib.AbstractContextManager[Callable[[int], None]]:
    env = loaded.env
    what = f"simulating {what} in {env.engine}"
    return simulating(console, what, env.config.episode_steps, env.config.control_dt)


def _evaluation(loaded: LoadedRun, config: EvalConfig, console: Console) -> Evaluation:
    began = time.monotonic()
    with _progress(loaded, f"{config.episodes} episodes", console) as report:
        found = measure(loaded, config.episodes, config.seed, report, config.recordings)
    simulated = sum(episode["duration"] for episode in found.episodes)
    took = time.monotonic() - began
    console.print(
        f"{loaded.run.name}: {simulated:,.0f} s simulated in {loaded.env.engine} in {took:.1f} s"
    )
    return found


def _write_pictures(found: Evaluation, config: EvalConfig, out: Path) -> list[str]:
    """Write the report, the film strip and the video, if any; the names of the files."""
    quadruped = found.loaded.env.quadruped
    save_figure(found.report(), out / "report.png")
    save_png(draw_film_strip(found.typical, quadruped), out / "film_strip.png")
    if config.video == "none":
        return ["report.png", "film_strip.png"]
    video = f"episode.{config.video}"
    render_video(found.typical, quadruped, out / video)
    return ["report.png", "film_strip.png", video]
