"""The table of variants: a row for each run, its figures in both engines; and their curves."""

import hashlib
import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from quadwalk.api import evaluate
from quadwalk.cli.arguments import find_value, split_words
from quadwalk.errors import UsageError, UserError
from quadwalk.evaluation.metrics import get_mean, to_json_number
from quadwalk.experiments.job import Job, fix_sizes
from quadwalk.experiments.options import CompareConfig
from quadwalk.experiments.places import make_place
from quadwalk.experiments.runner import collect_values, run_jobs
from quadwalk.files import open_atomic, resolve_path, write_json
from quadwalk.learn.flags import parse_config
from quadwalk.progress.metrics import Headline, choose_headline
from quadwalk.render.figures import make_figure, save_figure, tidy
from quadwalk.runs.directory import Run
from quadwalk.runs.log import Row, read_history
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
SHARED_CURVES = (
    Headline("eval/fall_rate", "episodes that fell", "%", factor=100.0),
    Headline("train/reward", "reward", ""),
)

Result = dict[str, Any]  # flags, seed, run and steps of a training, and its figures
History = Sequence[Row]


def compare_variants(variants: Sequence[str], config: CompareConfig) -> None:
    """Train and evaluate what has not been, print rows, and write them with their picture."""
    folder = resolve_path(config.runs)
    jobs: list[Job] = []
    results: dict[str, Result] = {}
    for flags, seed in itertools.product(variants, range(config.seeds)):
        training = plan_training(flags, seed, config.steps, folder)
        job = Job(fix_sizes(training, config), partial(evaluate_run, episodes=config.episodes))
        jobs.append(job)
        results[job.name] = {"flags": flags, "seed": seed, "run": job.name, "steps": config.steps}
    if len(results) < len(jobs):
        raise UsageError(f"of the variants {', '.join(map(repr, variants))} two are the same")
    heading = [
        _format_line(("flags", "seed", *COLUMNS)),
        "|" + "---|" * (2 + len(COLUMNS)),
    ]
    failure = None
    try:
        for job, figures in collect_values(run_jobs(jobs, make_place(config), len(jobs))):
            if not any("figures" in result for result in results.values()):
                print("\n".join(heading), flush=True)
            results[job.name]["figures"] = figures
            print(format_row(results[job.name]), flush=True)
    except UserError as error:
        failure = error
    successes = [result for result in results.values() if "figures" in result]
    if successes:
        with open_atomic(config.runs / "compare.md") as file:
            file.write(("\n".join((*heading, *map(format_row, successes))) + "\n").encode())
        write_json(config.runs / "compare.json", successes)
        histories = [
            (result["flags"] or "defaults", read_history(Run(config.runs / result["run"])))
            for result in successes
        ]
        save_figure(draw_bands(histories), config.runs / "compare.png")
        print(f"written to {config.runs}: compare.md, compare.json, compare.png")
    if failure:
        raise failure


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
    return replace(config, name=name, runs=runs, seed=seed, steps=steps or config.steps)


def evaluate_run(run: Run, episodes: int) -> dict[str, Any]:
    """Return the figures of a run by the heads of the table's columns; None where there is none."""
    mjx = evaluate(run, episodes=episodes).summary
    c = evaluate(run, episodes=episodes, engine="mujoco")
    gait = c.gait
    speed = "path_speed" if "path_speed" in mjx else "speed"
    straight = speed == "speed"
    speeds = np.array([episode[speed] for episode in c.episodes])

    def read_mean(name: str, summary: Mapping[str, Any] = mjx) -> float:
        return get_mean(summary.get(name))

    figures: dict[str, Any] = {
        "m/s": read_mean(speed),
        "falls": mjx["fall_rate"],
        # Less than half as fast as the median: it stands, or limps.
        "slow": int(np.sum(speeds < 0.5 * np.median(speeds))) if straight else None,
        "drift": read_mean("lateral_drift") / read_mean("distance"),
        "heading, °": read_mean("heading_error"),
        "off, m/s": read_mean("velocity_error"),
        "turning off, rad/s": read_mean("yaw_rate_error"),
        "m/s in C": read_mean(speed, c.summary),
        "falls in C": c.summary["fall_rate"],
        "off in C": read_mean("velocity_error", c.summary),
        "gait": gait.gait,
        "swing, cm": 100 * float(np.nan_to_num(gait.swing_height).min()),
        "slip": float(np.fmax.reduce(gait.slip_share)),
        "torque": float(np.fmax.reduce(gait.torque_peak)),
        "joint speed": float(np.fmax.reduce(gait.joint_speed_peak)),
        "action rate, 1/s": gait.action_rate,
    }
    # A task without commands has no velocity error, and a robot that never took a step no slip.
    return {name: to_json_number(x) if isinstance(x, float) else x for name, x in figures.items()}


def format_row(result: Result) -> str:
    """Return a run's row of the Markdown table; "-" where there is no figure."""
    figures = result["figures"]
    cells = [
        "-" if figures[name] is None else f"{figures[name]:{form}}"
        for name, form in COLUMNS.items()
    ]
    return _format_line((f"`{result['flags'] or 'defaults'}`", str(result["seed"]), *cells))


def _format_line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def draw_bands(histories: Sequence[tuple[str, History]]) -> Figure:
    """Draw learning curves of variants: the mean of the seeds, in a band from worst to best.

    `histories` are (variant's name, rows of a run), one for each seed. The panels are the variants'
    headlines, falls and reward.
    """
    headlines = [choose_headline(itertools.chain(*rows)) for _, rows in histories]
    curves = [*dict.fromkeys(headlines), *SHARED_CURVES]
    figure = make_figure((4.4 * len(curves), 4.2), dpi=110)
    panels = figure.subplots(1, len(curves))
    for name in dict.fromkeys(name for name, _ in histories):
        runs = [rows for variant, rows in histories if variant == name]
        for axes, curve in zip(panels, curves, strict=True):
            steps, low, mean, high = compute_band(runs, curve)
            (line,) = axes.plot(steps / 1e6, mean, linewidth=1.8, label=name)
            axes.fill_between(steps / 1e6, low, high, color=line.get_color(), alpha=0.2, lw=0)
            tidy(axes, curve.name, curve.unit)
            axes.set_xlabel("million steps")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", frameon=False)
    return figure


def compute_band(
    runs: Sequence[History], curve: Headline
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return steps (n,), and there the lowest, mean and highest of a figure, as far as all came."""
    points = []
    for rows in runs:
        values = np.array([(row["steps"], curve.get_value(row)) for row in rows]).reshape(-1, 2)
        points.append(values[np.isfinite(values[:, 1])])
    if not all(map(len, points)):
        return (np.zeros(0),) * 4
    end = min(values[-1, 0] for values in points)
    steps = np.unique(np.concatenate([values[:, 0] for values in points]))
    steps = steps[steps <= end]
    bands = np.stack([np.interp(steps, *values.T) for values in points])
    return steps, bands.min(axis=0), bands.mean(axis=0), bands.max(axis=0)
