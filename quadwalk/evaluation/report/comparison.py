"""Several runs side by side: a table, and a picture with a panel for each metric."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from quadwalk.evaluation.metrics import METRICS, name_engines
from quadwalk.evaluation.report.tables import (
    format_falls,
    format_value,
    list_shown_metrics,
    print_table,
)
from quadwalk.render.figures import INK, get_style, make_figure, tidy

_COLUMNS = 3  # panels in a row
_SPREAD = 0.28  # of the distance between two runs, over which their episodes are drawn
_NOT_DRAWN = ("distance", "path", "cost_of_transport", "reward")


def print_comparison(labels: Sequence[str], results: Sequence[dict[str, Any]]) -> None:
    """Print a table of the metrics of runs from the same starts, one column for each run."""
    summaries = [result["summary"] for result in results]
    rows = [
        ("training", *(f"{result['training_steps']:,}" for result in results), "steps"),
        ("falls", *map(format_falls, summaries), "%"),
    ]
    for name, heading, unit in list_shown_metrics(*summaries):
        # A run may have been trained without some of the terms.
        values = [format_value(summary.get(name)) for summary in summaries]
        rows.append((heading, *values, unit))
    rows.append(("gait", *(result["typical_episode"]["gait"] for result in results), ""))
    title = (
        f"{summaries[0]['episodes']} episodes each from the same starts, engine "
        f"{name_engines(results)}, mean ± 95 %"
    )
    print_table(title, ("", *labels, "unit"), rows)


def draw_comparison(labels: list[str], results: list[dict[str, Any]]) -> Figure:
    """Draw the metrics as panels: each run's episodes as dots, their mean and its interval."""
    names = {name for result in results for name in result["summary"]}
    metrics = [row for row in METRICS if row.name in names and row.name not in _NOT_DRAWN]
    lines = math.ceil((1 + len(metrics)) / _COLUMNS)
    first = results[0]
    figure = make_figure(
        (15, 4.5 * lines),
        f"{first['summary']['episodes']} episodes of up to {first['seconds']:g} s each, from the "
        f"same starts, engine {name_engines(results)}: mean, its 95 % interval, and every episode",
    )
    panels: Any = figure.subplots(lines, _COLUMNS).ravel()
    tidy(panels[0], "episodes that end by a fall", "%")
    for place, result in enumerate(results):
        _draw_falls(panels[0], place, result["summary"])
    for axes in panels[1 + len(metrics) :]:
        axes.set_axis_off()
    for axes, (name, heading, unit, _) in zip(panels[1 : 1 + len(metrics)], metrics, strict=True):
        tidy(axes, heading, unit)
        for place, result in enumerate(results):
            _draw_metric(axes, place, result, name)
        axes.margins(y=0.12)
    for axes in panels:
        axes.set_xticks(range(len(labels)), labels)
        if sum(map(len, labels)) > 40:
            axes.tick_params(axis="x", labelrotation=25)
        axes.set_xlim(-0.6, len(labels) - 0.4)
        axes.grid(visible=False, axis="x")
    return figure


def _draw_falls(axes: Axes, place: int, summary: dict[str, Any]) -> None:
    """Draw a run's share of falls, %, with its interval, as bar number `place`."""
    share = 100 * summary["fall_rate"]
    low, high = (100 * end for end in summary["fall_rate_ci95"])
    axes.bar(place, share, width=0.5, color=get_style(place)[0], alpha=0.5)
    error = [[max(share - low, 0.0)], [max(high - share, 0.0)]]
    axes.errorbar(place, share, yerr=error, color=INK, capsize=6, fmt="none", linewidth=1.6)
    axes.text(place + 0.06, share, f" {share:.1f}", va="bottom", fontsize=10, color=INK)
    axes.set_ylim(0, 105)


def _draw_metric(axes: Axes, place: int, result: dict[str, Any], name: str) -> None:
    """Draw a run's values of one metric as dots in column `place`, with their mean and interval."""
    summary = result["summary"].get(name)
    if summary is None:
        axes.text(place, 0.5, "none", ha="center", transform=axes.get_xaxis_transform())
        return
    values = np.array([e[name] for e in result["episodes"] if e[name] is not None], dtype=float)
    across = place + np.linspace(-_SPREAD, _SPREAD, len(values)) if len(values) > 1 else [place]
    color, _ = get_style(place)
    axes.plot(across, values, "o", color=color, markersize=4, alpha=0.5, markeredgewidth=0)
    error = summary["ci95"] or 0.0
    axes.errorbar(place, summary["mean"], yerr=error, color=INK, capsize=6, fmt="D", markersize=5)
    label = f" {summary['mean']:.3g}"
    axes.annotate(label, (place + _SPREAD, summary["mean"]), va="center", fontsize=10, color=INK)
