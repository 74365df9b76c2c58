"""Several runs, judged from the same starts, side by side."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from quadwalk.evaluate.report.plots import INK, LEG_COLOURS, save_figure
from quadwalk.evaluate.summary import FIGURES, falls_text, figure_text
from quadwalk.train.runs.directory import write_json_atomic

_COLUMNS = 3  # panels in a row
_SPREAD = 0.28  # of the distance between two runs, over which their episodes are drawn


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


def print_comparison(comparison: dict[str, Any]) -> None:
    """The comparison as a table on standard output, one column per run."""
    runs = comparison["runs"]
    summaries = [run["summary"] for run in runs]
    episodes = summaries[0]["episodes"]
    table = Table(
        title=f"{episodes} episodes each from the same starts, engine {comparison['engine']}, "
        "mean ± 95 %",
        title_justify="left",
    )
    table.add_column("")
    for run in runs:
        table.add_column(run["name"], justify="right", overflow="fold")
    table.add_column("unit")
    table.add_row("training", *(f"{run['training_steps']:,}" for run in runs), "steps")
    table.add_row("falls", *map(falls_text, summaries), "%")
    rows = [row for row in FIGURES if any(row[0] in summary for summary in summaries)]
    # A run may have been trained without some of the terms.
    terms = dict.fromkeys(n for s in summaries for n in s if n.startswith("reward/"))
    rows += [(name, f"  {name.partition('/')[2]}", "") for name in terms]
    for name, heading, unit in rows:
        table.add_row(heading, *(figure_text(summary.get(name)) for summary in summaries), unit)
    table.add_row("gait", *(run["typical_episode"]["gait"] for run in runs), "")
    Console().print(table)


def draw_comparison(labels: list[str], results: list[dict[str, Any]]) -> Figure:
    """The figures as panels: each run's episodes as dots, their mean and its 95 % interval."""
    shown = [
        row
        for row in FIGURES
        if row[0] not in ("distance", "path", "cost_of_transport", "reward")
        and any(row[0] in result["summary"] for result in results)
    ]
    lines = math.ceil((1 + len(shown)) / _COLUMNS)
    figure = Figure(figsize=(15, 4.5 * lines), layout="constrained")
    FigureCanvasAgg(figure)
    first = results[0]
    figure.suptitle(
        f"{first['summary']['episodes']} episodes of up to {first['seconds']:g} s each, from the "
        f"same starts, engine {first['engine']}: mean, its 95 % interval, and every episode",
        x=0.01,
        ha="left",
        fontsize=13,
    )
    panels: Any = figure.subplots(lines, _COLUMNS).ravel()
    _falls(panels[0], results)
    for axes, (name, heading, unit) in zip(panels[1:], shown, strict=True):
        for place, result in enumerate(results):
            _figure(axes, place, result, name)
        title = heading[0].upper() + heading[1:]
        axes.set_title(f"{title}, {unit}", loc="left", fontsize=11)
        axes.margins(y=0.12)
    for axes in panels:
        axes.set_xticks(range(len(labels)), labels)
        if sum(map(len, labels)) > 40:
            axes.tick_params(axis="x", labelrotation=25)
        axes.set_xlim(-0.6, len(labels) - 0.4)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", alpha=0.25, linewidth=0.6)
        axes.set_axisbelow(True)
    return figure


def _falls(axes: Axes, results: list[dict[str, Any]]) -> None:
    for place, result in enumerate(results):
        summary = result["summary"]
        share = 100 * summary["fall_rate"]
        low, high = (100 * end for end in summary["fall_rate_ci95"])
        axes.bar(place, share, width=0.5, color=_colour(place), alpha=0.5)
        error = [[max(share - low, 0.0)], [max(high - share, 0.0)]]
        axes.errorbar(place, share, yerr=error, color=INK, capsize=6, fmt="none", linewidth=1.6)
        axes.text(place + 0.06, share, f" {share:.1f}", va="bottom", fontsize=10, color=INK)
    axes.set_ylim(0, 105)
    axes.set_title("Episodes that end by a fall, %", loc="left", fontsize=11)


def _figure(axes: Axes, place: int, result: dict[str, Any], name: str) -> None:
    summary = result["summary"].get(name)
    if summary is None:
        axes.text(place, 0.5, "none", ha="center", transform=axes.get_xaxis_transform())
        return
    values = np.array([e[name] for e in result["episodes"] if e[name] is not None], dtype=float)
    across = place + np.linspace(-_SPREAD, _SPREAD, len(values)) if len(values) > 1 else [place]
    axes.plot(across, values, "o", color=_colour(place), markersize=4, alpha=0.5, markeredgewidth=0)
    error = summary["ci95"] or 0.0
    axes.errorbar(place, summary["mean"], yerr=error, color=INK, capsize=6, fmt="D", markersize=5)
    label = f" {summary['mean']:.3g}"
    axes.annotate(label, (place + _SPREAD, summary["mean"]), va="center", fontsize=10, color=INK)


def _colour(place: int) -> str:
    return (*LEG_COLOURS, "#6a4c93", "#8d99ae")[place % 6]
