"""The learning curve of a training as a picture."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from quadwalk.progress.metrics import LEVEL, choose_headline
from quadwalk.progress.text import format_quantity
from quadwalk.render.figures import INK, make_figure, save_figure, tidy

_TERM = "train/reward/"
_ELAPSED = "time/elapsed"
_COLUMNS = 4  # small panels in a row
_LARGE_HEIGHT, _SMALL_HEIGHT = 3.6, 1.7  # inches
_NICE = [1, 2, 2.5, 5, 10]  # what the first figure of a tick's distance may be
_BLUE, _RED, _GREEN, _GREY = "#2a6fbb", "#c44536", "#2e8b57", "#5f6b7a"

RANDOMIZED = (
    "Measured with the task's delays, loads, noise and pushes. eval measures without them, where a "
    "policy does better."
)

Row = Mapping[str, Any]


def save_learning_curve(
    metrics: Sequence[Row], path: Path, best: int | None = None, note: str = ""
) -> None:
    """Write `draw_learning_curve` of the rows `metrics` as a PNG, whole or not at all.

    `best` is the steps of the checkpoint to mark, `note` a line at the top. Raises `UserError`
    where the file cannot be written.
    """
    save_figure(draw_learning_curve(metrics, best, note), path)


def draw_learning_curve(metrics: Sequence[Row], best: int | None = None, note: str = "") -> Figure:
    """Draw the headline, falls, total reward and every reward term over steps.

    The headline and falls are of the evaluation environments. With a curriculum, there is the
    mean level of every kind of ground too. A line marks the checkpoint after `best` steps. `note`
    stands at the top. If rows have "time/elapsed" (s), as those of `read_history` may, minutes are
    a second axis. What was never recorded leaves its panel empty, NaN and None leave a gap.
    """
    rows = sorted(metrics, key=lambda row: row["steps"])
    terms = list(dict.fromkeys(key for row in rows for key in row if key.startswith(_TERM)))
    levels = list(dict.fromkeys(key for row in rows for key in row if key.startswith(LEVEL)))
    groups = [group for group in (terms, levels) if group]
    small_rows = [math.ceil(len(group) / _COLUMNS) for group in groups]
    heights = [_LARGE_HEIGHT, *(_SMALL_HEIGHT * count for count in small_rows)]
    figure = make_figure((12, sum(heights)), note, fontsize=9, dpi=110)
    parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False).flat
    _draw_main_panels(parts[0].subplots(1, 3), rows, best)
    for part, group, count in zip(parts[1:], groups, small_rows, strict=True):
        panels = list(part.subplots(count, _COLUMNS).flat)
        if group is levels:
            part.suptitle("mean level of difficulty", fontsize=10, x=0.01, ha="left")
        for axes, key in zip(panels, group, strict=False):
            name = key.removeprefix(_TERM).removeprefix(LEVEL)
            tidy(axes, name.replace("_", " "), fontsize=9)
            _draw_line(axes, rows, key, _GREY)
            _set_axes(axes, rows, ticks=4)
        for axes in panels[len(group) :]:
            axes.set_visible(False)
    return figure


def _draw_main_panels(panels: Sequence[Axes], rows: Sequence[Row], best: int | None) -> None:
    main, falls, reward = panels
    headline = choose_headline(name for row in rows for name in row)
    tidy(main, headline.name, headline.unit)
    _draw_line(main, rows, headline.key, _BLUE, headline.factor)
    tidy(falls, "episodes that fell", "%")
    _draw_line(falls, rows, "eval/fall_rate", _RED, factor=100.0)
    # At least five: a few falls in a thousand should not fill the panel.
    falls.set_ylim(0.0, max(5.0, falls.get_ylim()[1]))
    tidy(reward, "reward")
    _draw_line(reward, rows, "train/reward", _GREEN)
    for axes in panels:
        _set_axes(axes, rows)
        axes.set_xlabel("environment steps")
        _add_minutes(axes, rows)
        if best is not None:
            axes.axvline(best, color=INK, linewidth=1.0, linestyle=":", label="best checkpoint")
    if best is not None:
        main.legend(fontsize=8, frameon=False, loc="best")


def _draw_line(axes: Axes, rows: Sequence[Row], key: str, color: str, factor: float = 1.0) -> None:
    values = [factor * _get_value(row, key) for row in rows]
    # The mark lets a single point, or one between gaps, be seen.
    mark = "." if sum(map(math.isfinite, values)) < 3 else None
    axes.plot([row["steps"] for row in rows], values, color=color, linewidth=1.6, marker=mark)


def _set_axes(axes: Axes, rows: Sequence[Row], ticks: int = 6) -> None:
    axes.set_xlim(0, 1.02 * max([1, *(row["steps"] for row in rows)]))
    # Zero is always in view: without it noise around a constant looks like a course.
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.0), max(high, 0.0))
    axes.xaxis.set_major_locator(MaxNLocator(ticks, steps=_NICE))
    axes.xaxis.set_major_formatter(lambda steps, _: format_quantity(steps).replace(".0", ""))
    axes.yaxis.set_major_locator(MaxNLocator(ticks - 1, steps=_NICE))
    axes.tick_params(labelsize=8)


def _add_minutes(axes: Axes, rows: Sequence[Row]) -> None:
    """Add an axis of minutes since the start at the top, if two rows or more have a time."""
    timed = [row for row in rows if math.isfinite(_get_value(row, _ELAPSED))]
    if len(timed) < 2:
        return
    minutes = np.maximum.accumulate([_get_value(row, _ELAPSED) / 60.0 for row in timed])
    places = [
        minute
        for minute in MaxNLocator(6, steps=_NICE).tick_values(minutes[0], minutes[-1])
        if minutes[0] <= minute <= minutes[-1]
    ]
    top = axes.twiny()
    top.set_xlim(axes.get_xlim())
    # Training does not go at one pace (compilation, evaluations), so the ticks need not be even.
    top.set_xticks(
        np.interp(places, minutes, [row["steps"] for row in timed]),
        [f"{minute:g}" for minute in places],
    )
    top.set_xlabel("minutes", fontsize=8, loc="right", color=_GREY)
    top.tick_params(labelsize=8, colors=_GREY, length=3)
    top.spines[["right", "left"]].set_visible(False)
    top.spines["top"].set_color(_GREY)


def _get_value(row: Row, key: str) -> float:
    value = row.get(key)
    return math.nan if value is None else float(value)
