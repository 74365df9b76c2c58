"""The table of variants: a row for each run, its figures in both engines."""

import hashlib
import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from quadwalk.api import evaluate
from quadwalk.cli.arguments import find_value, split_words
from quadwalk.errors import UsageError, UserError
from quadwalk.evaluation.statistics import figure_mean, number
from quadwalk.experiments.bands import draw_bands
from quadwalk.experiments.job import Job, fix_sizes
from quadwalk.experiments.options import CompareConfig
from quadwalk.experiments.places import make_place
from quadwalk.experiments.runner import collect_values, run_jobs
from quadwalk.files import atomic_write, real_path, write_json
from quadwalk.learn.flags import parse_config
from quadwalk.render.figures import save_figure
from quadwalk.runs.directory import Run
from quadwalk.runs.log import read_history
from quadwalk.settings.training import TrainConfig

# Heading of a column, unit or "" and how it is written. Of a task with commands, "off" and
# "turning off" are in the place of speed, drift and heading.
COLUMNS = {
    "m/s": ".2f",
    "falls": ".1%",
    "slow": "d",
    "drift": ".1%",
    "heading, °": ".1f",
    "off, m/s": ".3f",
    "turning off, rad/s": ".3f",
    "m/s in C": ".2f",
    "falls in C": ".1%",
    "off in C": ".3f",
    "gait": "s",
    "swing, cm": ".1f",
    "slip": ".1%",
    "torque": ".0%",
    "joint speed": ".0%",
    "action rate, 1/s": ".1f",
}


def compare_variants(variants: Sequence[str], config: CompareConfig) -> None:
    """Train and evaluate what has not been, print rows, and write them with their picture."""
    folder = real_path(config.runs)
    measure = partial(evaluate_run, episodes=config.episodes)
    jobs: list[Job] = []
    heads: dict[str, dict[str, Any]] = {}
    for flags, seed in itertools.product(variants, range(config.seeds)):
        training = plan_training(flags, seed, config.steps, folder)
        job = Job(fix_sizes(training, config), measure)
        jobs.append(job)
        heads[job.name] = {"flags": flags, "seed": seed, "run": job.name, "steps": config.steps}
    if len(heads) < len(jobs):
        raise UsageError(f"of the variants {', '.join(map(repr, variants))} two are the same")
    results: dict[str, dict[str, Any]] = {}
    failure = None
    try:
        for job, figures in collect_values(run_jobs(jobs, make_place(config), len(jobs))):
            if not results:
                print("\n".join(HEADING), flush=True)
            results[job.name] = {**heads[job.name], "figures": figures}
            print(format_row(results[job.name]), flush=True)
    except UserError as error:
        failure = error
    if results:
        _write_results([results[name] for name in heads if name in results], config.runs)
    if failure:
        raise failure


def _write_results(results: Sequence[dict[str, Any]], runs: Path) -> None:
    """Write the table of `results`, their figures and the picture of their learning curves."""
    histories = [
        (result["flags"] or "defaults", read_history(Run(runs / result["run"])))
        for result in results
    ]
    with atomic_write(runs / "compare.md") as file:
        file.write(("\n".join((*HEADING, *map(format_row, results))) + "\n").encode())
    write_json(runs / "compare.json", results)
    save_figure(draw_bands(histories), runs / "compare.png")
    print(f"written to {runs}: compare.md, compare.json, compare.png")


def evaluate_run(run: Run, episodes: int) -> dict[str, Any]:
    """Return the figures of a run by the heads of the table's columns; None where there is none."""
    mjx = evaluate(run, episodes=episodes).summary
    c = evaluate(run, episodes=episodes, engine="mujoco")
    gait = c.gait
    speed = "path_speed" if "path_speed" in mjx else "speed"
    straight = speed == "speed"
    speeds = np.array([episode[speed] for episode in c.episodes])

    def mean(name: str, summary: Mapping[str, Any] = mjx) -> float:
        return figure_mean(summary.get(name))

    figures: dict[str, Any] = {
        "m/s": mean(speed),
        "falls": mjx["fall_rate"],
        # Less than half as fast as the median: it stands, or limps.
        "slow": int(np.sum(speeds < 0.5 * np.median(speeds))) if straight else None,
        "drift": mean("lateral_drift") / mean("distance"),
        "heading, °": mean("heading_error"),
        "off, m/s": mean("velocity_error"),
        "turning off, rad/s": mean("yaw_rate_error"),
        "m/s in C": mean(speed, c.summary),
        "falls in C": c.summary["fall_rate"],
        "off in C": mean("velocity_error", c.summary),
        "gait": gait.gait,
        "swing, cm": 100 * float(np.nan_to_num(gait.swing_height).min()),
        "slip": float(np.fmax.reduce(gait.slip_share)),
        "torque": float(np.fmax.reduce(gait.torque_peak)),
        "joint speed": float(np.fmax.reduce(gait.joint_speed_peak)),
        "action rate, 1/s": gait.action_rate,
    }
    # A task without commands has no velocity error, and a robot that never took a step no slip.
    return {name: number(x) if isinstance(x, float) else x for name, x in figures.items()}


def plan_training(flags: str, seed: int, steps: int | None, runs: Path) -> TrainConfig:
    """Return the training of a variant and a seed, under a name that no other variant has."""
    words = split_words(flags)
    for flag in ("--name", "--runs", "--seed", "--minutes", "--resume"):
        if find_value(words, flag) is not None:
            raise UsageError(f"{flag} is in the variant {flags!r}; compare sets it: leave it out")
    config, _ = parse_config(words, "quadwalk train")
    parts = [part for word in words for part in word.split("=") if part]
    plain = "-".join(part.removeprefix("--") for part in parts) or "default"
    name = re.sub(r"[^\w.+@,-]+", "-", plain).lstrip("-.+@,_")
    if name != plain or len(name) > 60:
        name = f"{name[:50]}-{hashlib.sha256(plain.encode()).hexdigest()[:8]}"
    name = f"{name}_{steps or 'full'}_s{seed}"
    steps = steps or config.steps
    return replace(config, name=name, runs=runs, seed=seed, steps=steps)


def format_row(result: dict[str, Any]) -> str:
    """Return the row of a run, as Markdown."""
    figures = result["figures"]
    cells = [
        "-" if figures[name] is None else f"{figures[name]:{form}}"
        for name, form in COLUMNS.items()
    ]
    return _format_line((f"`{result['flags'] or 'defaults'}`", str(result["seed"]), *cells))


def _format_line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


HEADING = (_format_line(("flags", "seed", *COLUMNS)), "|" + "---|" * (2 + len(COLUMNS)))
