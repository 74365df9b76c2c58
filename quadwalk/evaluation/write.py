"""Evaluations and sweeps written into folders: tables on stdout, JSON, pictures, recordings."""

import contextlib
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, Progress, TimeRemainingColumn

from quadwalk.cli.arguments import make_console
from quadwalk.cli.shell import find_program, get_python
from quadwalk.evaluation import sweep
from quadwalk.evaluation.load import LoadedRun
from quadwalk.evaluation.mcap.write import format_rerun_commands
from quadwalk.evaluation.metrics import compare_engines
from quadwalk.evaluation.report import comparison, tables
from quadwalk.evaluation.report.pictures import draw_film_strip, render_video
from quadwalk.evaluation.results import Evaluation, evaluate_policy, make_provenance
from quadwalk.evaluation.rollout import Report
from quadwalk.evaluation.suites import commands, gaits, standing, terrain
from quadwalk.files import write_json
from quadwalk.render.figures import save_figure
from quadwalk.render.images import save_png


def write_evaluation(
    loaded: LoadedRun,
    folder: Path,
    *,
    episodes: int,
    seed: int,
    cell_episodes: int,
    levels: int,
    recordings: int,
    video: str,
) -> dict[str, Any]:
    """Evaluate one run into `folder`, and print it; return the content of metrics.json.

    A run in MuJoCo C on a flat floor is compared with MJX. The options are those of `EvalConfig`;
    `video` is a format.
    """
    console, engine = make_console(), loaded.env.engine
    evaluation = _evaluate(loaded, episodes, seed, recordings)
    title = f"{loaded.run.name}, {loaded.policy.steps:,} steps of training, engine {engine}"
    tables.print_summary(evaluation.summary, title)
    with console.status("looking closely at the episode of median speed"):
        results = dict(evaluation.results)
    # On uneven ground MJX takes longer to compile than all else takes together.
    if engine == "mujoco" and loaded.env.terrain is None:
        mjx = _evaluate(loaded.to_engine("mjx"), episodes, seed, recordings).summary
        results["mjx_summary"] = mjx
        results["difference_to_mjx"] = compare_engines(mjx, evaluation.summary)
        tables.print_engines(mjx, evaluation.summary)
    tables.print_text(tables.describe_gait(evaluation.gait, evaluation.typical.episode))
    files = ["metrics.json"]
    if cell_episodes:
        files += _write_suite(loaded, folder, results, cell_episodes, seed, levels)
    write_json(folder / "metrics.json", results)
    with console.status("writing"):
        files += _write_pictures(evaluation, folder, video)
        paths = evaluation.save_mcap(folder, recordings)
    console.print(f"written to {folder}: {', '.join(files)}, {len(paths)} MCAP files")
    if paths:
        is_there = shutil.which(find_program("rerun")) is not None
        hint = "" if is_there else f" ({get_python()} -m pip install rerun-sdk)"
        console.print(f"see {paths[0]} in Foxglove, or in Rerun{hint} with:")
        console.print(format_rerun_commands(paths[0]))
    return results


def write_comparison(
    labels: list[str], folders: list[Path], results: list[dict[str, Any]], folder: Path
) -> dict[str, Any]:
    """Print and write the comparison of runs whose results are in `folders`; return its JSON."""
    parts = ("training_steps", "policy_sha256", "summary", "typical_episode")
    content = {name: results[0][name] for name in ("engine", "seed", "seconds", "revision")}
    content["runs"] = [
        {"name": label, "folder": str(place), **{name: result[name] for name in parts}}
        for label, place, result in zip(labels, folders, results, strict=True)
    ]
    comparison.print_comparison(labels, results)
    write_json(folder / "comparison.json", content)
    save_figure(comparison.draw_comparison(labels, results), folder / "comparison.png")
    make_console().print(f"written to {folder}: comparison.json, comparison.png")
    return content


def write_sweep(loaded: LoadedRun, folder: Path, episodes: int, seed: int) -> dict[str, Any]:
    """Sweep one run, print a table, write sweep.json and sweep.png; return the first's content."""
    count = len(sweep.make_sweep_points(loaded)[0])
    with _show_progress(loaded, f"{count} x {episodes} episodes") as report:
        sweeps = sweep.measure_sweeps(loaded, episodes, seed, report)
    results = {**make_provenance(loaded, seed), **sweeps}
    sweep.print_sweep(results)
    write_json(folder / "sweep.json", results)
    save_figure(sweep.draw_sweep([results]), folder / "sweep.png")
    make_console().print(f"written to {folder}: sweep.json, sweep.png")
    return results


def write_sweep_comparison(
    labels: list[str], results: list[dict[str, Any]], folder: Path
) -> dict[str, Any]:
    """Draw and write the sweeps of several runs together; return the comparison's JSON."""
    runs = [{**result, "run": label} for label, result in zip(labels, results, strict=True)]
    write_json(folder / "comparison.json", {"runs": runs})
    save_figure(sweep.draw_sweep(runs), folder / "sweep.png")
    return {"runs": runs}


def _evaluate(loaded: LoadedRun, episodes: int, seed: int, recordings: int) -> Evaluation:
    """Evaluate one run, show progress and time; keep `recordings` rollouts."""
    start = time.monotonic()
    with _show_progress(loaded, f"{episodes} episodes") as report:
        evaluation = evaluate_policy(loaded, episodes, seed, report, recordings)
    simulated = sum(episode["duration"] for episode in evaluation.episodes)
    make_console().print(
        f"{loaded.run.name}: {simulated:,.0f} s simulated in {loaded.env.engine} in "
        f"{time.monotonic() - start:.1f} s"
    )
    return evaluation


def _write_suite(
    loaded: LoadedRun,
    folder: Path,
    results: dict[str, Any],
    episodes: int,
    seed: int,
    levels: int,
) -> list[str]:
    """Run the suite of measurements of the task, print them and add them to `results`.

    Returns the names of the pictures it wrote into `folder`. A suite of terrain measures at
    `levels` difficulties.
    """
    suite, name, engine = loaded.policy.config.suite, loaded.run.name, loaded.env.engine
    files, has_commands = [], loaded.env.config.command.active
    # One environment for both, since each compiles its own programs.
    held_run = gaits.to_held_run(loaded) if has_commands or suite == "commands" else loaded
    if has_commands:
        files += _write_gaits(held_run, folder, results, seed)
    if suite == "standing":
        mujoco = standing.to_standing_run(loaded)
        with _show_progress(mujoco, f"{episodes} episodes of each condition") as report:
            results["standing"] = standing.measure_standing(mujoco, episodes, seed, report)
        standing.print_standing(results["standing"])
    # A task on uneven ground may have been trained on a flat floor.
    if suite == "terrain" and loaded.env.terrain is not None:
        with _show_progress(loaded, f"{episodes} episodes on each kind of ground") as report:
            ground = terrain.measure_terrain(loaded, episodes, seed, report, levels)
        results["ground"] = ground
        terrain.print_terrain(ground)
        save_figure(terrain.draw_terrain(ground, f"{name}, {engine}"), folder / "ground.png")
        files.append("ground.png")
    if suite == "commands":
        changing = commands.to_changing_run(loaded)
        few, many = max(episodes // 4, 1), 16 * episodes
        with _show_progress(held_run, f"{few} episodes of each command") as report:
            steering = commands.measure_commands(held_run, few, seed, report)
        with _show_progress(changing, f"{many} episodes of changing commands") as report:
            steering["changing"] = commands.measure_changing(changing, many, seed, report)
        results["steering"] = steering
        commands.print_commands(steering)
        figure = commands.draw_commands(steering, results["gaits"], name)
        save_figure(figure, folder / "steering.png")
        files.append("steering.png")
    return files


def _write_gaits(
    held_run: LoadedRun, folder: Path, results: dict[str, Any], seed: int
) -> list[str]:
    """Add the gait at each command to `results`, and print it; return its picture's name.

    `held_run` is of `gaits.to_held_run`. The suite "commands" has these panels in its own picture.
    """
    with make_console().status("looking at the feet at each command"):
        results["gaits"] = gaits.measure_gaits(held_run, seed)
    gaits.print_gaits(results["gaits"])
    if held_run.policy.config.suite == "commands":
        return []
    save_figure(gaits.draw_gaits(results["gaits"], held_run.run.name), folder / "gaits.png")
    return ["gaits.png"]


def _write_pictures(evaluation: Evaluation, folder: Path, video: str) -> list[str]:
    """Write the report, the film strip and the video, if any; return the names of the files."""
    quadruped = evaluation.loaded.env.quadruped
    save_figure(evaluation.report(), folder / "report.png")
    save_png(draw_film_strip(evaluation.typical, quadruped), folder / "film_strip.png")
    files = ["report.png", "film_strip.png"]
    if video != "none":
        files.append(f"episode.{video}")
        render_video(evaluation.typical, quadruped, folder / files[-1])
    return files


@contextlib.contextmanager
def _show_progress(loaded: LoadedRun, what: str) -> Iterator[Report]:
    """Show the progress of a simulation, called `what`, and the time it will take, while it runs.

    Yields the function to call with the number of control steps done.
    """
    env, console = loaded.env, make_console()
    columns = ("{task.description}", BarColumn(), TimeRemainingColumn())
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as progress:
        text = f"simulating {what} in {env.engine}; it compiles first"
        task = progress.add_task(text, total=env.config.episode_steps)
        yield lambda steps: progress.update(task, completed=steps)
