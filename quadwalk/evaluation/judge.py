"""Runs evaluated into folders: each evaluated or swept, and several compared."""

import contextlib
import shutil
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from quadwalk.evaluation.evaluation import Evaluation, measure
from quadwalk.evaluation.grids import steering
from quadwalk.evaluation.grids.by_ground import measure_by_ground
from quadwalk.evaluation.grids.standing import measure_standing, standing_run
from quadwalk.evaluation.grids.sweep import measure_sweeps, sweep_points
from quadwalk.evaluation.loaded import LoadedRun
from quadwalk.evaluation.options import EvalConfig
from quadwalk.evaluation.recording.mcap import rerun_commands
from quadwalk.evaluation.recording.provenance import provenance
from quadwalk.evaluation.report import console as tables
from quadwalk.evaluation.report import panels
from quadwalk.evaluation.report.pictures import draw_film_strip, render_video
from quadwalk.evaluation.summary import engine_differences
from quadwalk.files import write_json
from quadwalk.render.figures import save_figure
from quadwalk.render.images import save_png


def judge(loaded: LoadedRun, config: EvalConfig, out: Path, console: Console) -> dict[str, Any]:
    """Evaluate one run into the folder `out`, and print it; return what its metrics.json holds."""
    name = loaded.run.name
    found = _evaluation(loaded, config, console)
    steps = f"{loaded.policy.steps:,} steps of training"
    tables.print_summary(found.summary, f"{name}, {steps}, engine {config.engine}")
    with console.status("looking closely at the episode of median speed"):
        results = dict(found.results)
    # On uneven ground MJX takes longer to compile than all else takes together.
    if config.engine == "mujoco" and loaded.env.terrain is None:
        other = _evaluation(loaded.in_engine("mjx"), config, console).summary
        results["mjx_summary"] = other
        results["difference_to_mjx"] = engine_differences(other, found.summary)
        tables.print_engines(other, found.summary)
    tables.print_text(tables.describe_gait(found.gait, found.typical.episode))
    written = ["metrics.json"]
    if config.cell_episodes:
        written += _in_cells(loaded, config, out, console, results)
    write_json(out / "metrics.json", results)
    with console.status("writing"):
        written += _write_pictures(found, config, out)
        recorded = found.save_mcap(out, config.recordings)
    console.print(f"written to {out}: {', '.join(written)}, {len(recorded)} MCAP files")
    if recorded:
        where = "in Rerun" if shutil.which("rerun") else "in Rerun (pip install rerun-sdk)"
        console.print(f"see {recorded[0]} in Foxglove, or {where} with:")
        console.print(rerun_commands(recorded[0]))
    return results


def _in_cells(
    loaded: LoadedRun, config: EvalConfig, out: Path, console: Console, results: dict[str, Any]
) -> list[str]:
    """Measure many episodes of what the task is about, into `results`; the pictures drawn."""
    env, name, cell = loaded.env.config, loaded.run.name, config.cell_episodes

    def measured(what: str, own: LoadedRun, measure: Callable[..., Any], episodes: int) -> Any:
        with _progress(own, f"{episodes} episodes {what}", console) as report:
            return measure(own, episodes, config.seed, report)

    if loaded.env.terrain is not None:
        measure = partial(measure_by_ground, levels=config.levels)
        ground = measured("on each kind of ground", loaded, measure, cell)
        results["ground"] = ground
        tables.print_by_ground(ground)
        figure, file = panels.draw_by_ground(ground, f"{name}, {config.engine}"), "ground.png"
    elif env.reset.tumbled:
        standing = measured("of each condition", standing_run(loaded), measure_standing, cell)
        results["standing"] = standing
        tables.print_standing(standing)
        return []
    elif env.command.turning is not None:
        driven, long = steering.steering_run(loaded), steering.changing_run(loaded)
        held = measured("of each command", driven, steering.measure_steering, max(cell // 4, 1))
        changing = measured("of changing commands", long, steering.measure_changing, 16 * cell)
        results["steering"] = held | {"changing": changing}
        tables.print_steering(results["steering"])
        figure, file = panels.draw_steering(results["steering"], name), "steering.png"
    else:
        return []
    save_figure(figure, out / file)
    return [file]


def compare(
    labels: list[str],
    folders: list[Path],
    results: list[dict[str, Any]],
    out: Path,
    console: Console,
) -> dict[str, Any]:
    """Print and write the comparison of the runs that `judge` wrote to `folders`; its JSON data."""
    own = ("training_steps", "policy_sha256", "summary", "typical_episode")
    comparison = {name: results[0][name] for name in ("engine", "seed", "seconds", "revision")}
    comparison["runs"] = [
        {"name": label, "folder": str(folder), **{name: result[name] for name in own}}
        for label, folder, result in zip(labels, folders, results, strict=True)
    ]
    tables.print_comparison(labels, results)
    write_json(out / "comparison.json", comparison)
    save_figure(panels.draw_comparison(labels, results), out / "comparison.png")
    console.print(f"written to {out}: comparison.json, comparison.png")
    return comparison


def sweep(loaded: LoadedRun, config: EvalConfig, out: Path, console: Console) -> dict[str, Any]:
    """Sweep, print the table, write sweep.json and sweep.png to `out`; return the former."""
    count = len(sweep_points(loaded)[0])
    with _progress(loaded, f"{count} x {config.episodes} episodes", console) as report:
        swept = measure_sweeps(loaded, config.episodes, config.seed, report)
    results = {**provenance(loaded, config.seed), **swept}
    tables.print_sweep(results)
    write_json(out / "sweep.json", results)
    save_figure(panels.draw_sweep([results]), out / "sweep.png")
    console.print(f"written to {out}: sweep.json, sweep.png")
    return results


def compare_sweeps(labels: list[str], results: list[dict[str, Any]], out: Path) -> dict[str, Any]:
    """Draw and write the sweeps of runs called `labels` together; what comparison.json holds."""
    named = [{**result, "run": label} for label, result in zip(labels, results, strict=True)]
    write_json(out / "comparison.json", {"runs": named})
    save_figure(panels.draw_sweep(named), out / "sweep.png")
    return {"runs": named}


def _progress(
    loaded: LoadedRun, what: str, console: Console
) -> contextlib.AbstractContextManager[Callable[[int], None]]:
    env = loaded.env
    what = f"simulating {what} in {env.engine}"
    return tables.simulating(console, what, env.config.episode_steps, env.config.control_dt)


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
    written = ["report.png", "film_strip.png"]
    if config.video != "none":
        written.append(f"episode.{config.video}")
        render_video(found.typical, quadruped, out / written[-1])
    return written
