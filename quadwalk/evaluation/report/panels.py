"""Pictures of many panels: the sweeps of a policy, and several runs side by side."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from quadwalk.evaluation.motion.course import WINDOW
from quadwalk.evaluation.statistics import figure_mean
from quadwalk.evaluation.summary import FIGURES, engines_of
from quadwalk.render.figures import INK, make_figure, tidy
from quadwalk.settings.environment import COMMANDED

_COLUMNS = 3  # panels of a comparison in a row
_SPREAD = 0.28  # of the distance between two runs, over which their episodes are drawn
# Okabe and Ito's, which the color-blind can tell apart
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_MARKS = "os^Dv*P"


def draw_sweep(
    results: list[dict[str, Any]],
    names: Sequence[str] | None = None,
    columns: int = 4,
    title: str = "",
) -> Figure:
    """One panel for each sweep, or each of `names`: success and speed, with 95 % intervals.

    `results` are those of one run or several, at the same points. Their first says which range of
    each condition the task draws from: it is shaded.
    """
    first = results[0]
    sweeps = first["sweeps"]
    shown = list(names or sweeps)
    rows = math.ceil(len(shown) / columns)
    text = title or f"{', '.join(result['run'] for result in results)}: robustness"
    text += f" ({first['episodes']} episodes of {first['seconds']:g} s at each point)"
    figure = make_figure((3.6 * columns, 0.8 + 2.9 * rows), text)
    top = max(
        point["speed"]["mean"]
        for result in results
        for name in shown
        for point in result["sweeps"][name]["points"]
    )
    panels: Any = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for place, (axes, name) in enumerate(zip(panels, shown, strict=False)):
        tidy(axes, sweeps[name]["heading"], sweeps[name]["unit"])
        axes.set_ylim(-3, 106)
        axes.axvline(sweeps[name]["nominal"], color=INK, linewidth=1, linestyle=":")
        speed = axes.twinx()
        speed.spines["top"].set_visible(False)
        lowest = min(
            _sweep(axes, speed, result, name, _color(k), _MARKS[k % 7])
            for k, result in enumerate(results)
        )
        (left, right), (low, high) = axes.get_xlim(), sweeps[name]["range"]
        axes.axvspan(max(left, low), min(right, high), color="0.92", zorder=0)
        # The same scale in every panel, and as high as that of success: 100 % is the top speed.
        speed.set_ylim(min(-0.03 * max(top, 0.1), 1.05 * lowest), 1.06 * max(top, 0.1))
        if place % columns == 0:
            axes.set_ylabel("episodes without a fall, %")
        last = place % columns == columns - 1 or place == len(shown) - 1
        speed.tick_params(labelright=last)
        if last:
            speed.set_ylabel("speed, m/s")
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    _explain(figure, [result["run"] for result in results])
    return figure


def _explain(figure: Figure, runs: list[str]) -> None:
    handles: list[Any] = [
        Line2D([], [], color=_color(k), marker=_MARKS[k % 7], lw=2, label=run)
        for k, run in enumerate(runs)
    ]
    handles += [
        Line2D([], [], color=INK, lw=2, label="without a fall"),
        Line2D([], [], color=INK, lw=1, ls="--", label="speed"),
        Line2D([], [], color=INK, lw=1, ls=":", label="the robot's model"),
        Patch(color="0.92", label="range of the task"),
    ]
    figure.legend(handles=handles, loc="outside lower left", ncols=len(handles), frameon=False)


def _sweep(
    axes: Axes, speed: Axes, result: dict[str, Any], name: str, color: str, mark: str
) -> float:
    """Draw one run's sweep; the lowest speed drawn."""
    points = result["sweeps"][name]["points"]
    values = [point["value"] for point in points]
    low, high = 100 * np.array([point["success_ci95"] for point in points]).T
    axes.fill_between(values, low, high, color=color, alpha=0.2, lw=0)
    shares = [100 * point["success"] for point in points]
    axes.plot(values, shares, f"{mark}-", color=color, linewidth=2, label=result["run"])
    means = [point["speed"]["mean"] for point in points]
    errors = [point["speed"]["ci95"] or 0.0 for point in points]
    speed.errorbar(values, means, yerr=errors, fmt="--", color=color, linewidth=1, capsize=2)
    return min(0.0, *(mean - error for mean, error in zip(means, errors, strict=True)))


def draw_by_ground(results: dict[str, Any], title: str) -> Figure:
    """Heat maps of kinds by difficulties: success, speed and, with commands, how far off it is."""
    kinds, difficulties = results["kinds"], results["difficulties"]
    commanded = results["command"] is not None
    maps: list[tuple[str, str, float, Any]] = [
        ("success, %", "viridis", 100.0, lambda cell: 100 * cell["success"]),
        ("speed, m/s", "viridis", 0.0, lambda cell: cell["speed"]["mean"]),
        ("velocity error, m/s", "viridis_r", 0.0, lambda cell: figure_mean(cell["velocity_error"])),
    ]
    maps = maps if commanded else maps[:2]
    size = (1.6 + 4.2 * len(maps), 1.6 + 0.5 * max(len(kinds), 3))
    about = f", command {results['command']:g} m/s" if commanded else ""
    text = f"{title}: {results['episodes']} episodes in each cell, unseen ground{about}"
    figure = make_figure(size, text)
    panels: Any = figure.subplots(1, len(maps), squeeze=False)[0]
    for axes, (heading, colors, top, value) in zip(panels, maps, strict=True):
        cells = np.array([value(cell) for cell in results["cells"]], float)
        values = cells.reshape(len(kinds), len(difficulties))
        high = top or max(float(np.nanmax(values, initial=0.0)), 0.1)
        axes.imshow(values, cmap=colors, vmin=0.0, vmax=high, aspect="auto")
        axes.set_title(heading, fontsize=11, loc="left")
        axes.set_xticks(range(len(difficulties)), [f"{x:.2g}" for x in difficulties])
        axes.set_yticks(range(len(kinds)), [kind.replace("_", " ") for kind in kinds])
        axes.set_xlabel("difficulty")
        for (row, column), number in np.ndenumerate(values):
            label = "-" if math.isnan(number) else f"{number:.0f}" if top else f"{number:z.2f}"
            shade = axes.images[0].to_rgba(number)
            color = "white" if np.dot(shade[:3], (0.3, 0.6, 0.1)) < 0.5 else INK
            axes.text(column, row, label, ha="center", va="center", fontsize=10, color=color)
    return figure


def draw_steering(results: dict[str, Any], title: str) -> Figure:
    """Heat maps of success and errors over commands; gaits by speed; responses to changes."""
    text = f"{title}: {results['episodes']} episodes of each command in MuJoCo C"
    figure = make_figure((15, 9), text)
    panels: Any = figure.subplots(2, 3).ravel()
    maps = (
        ("success", "episodes without a fall, %", 100.0),
        ("velocity_error", "velocity error, m/s", 0.5),
        ("yaw_rate_error", "yaw rate error, rad/s", 0.5),
    )
    forward, turns = (
        sorted({cell["command"][part] for cell in results["cells"]}) for part in (0, 2)
    )
    for axes, (name, heading, high) in zip(panels, maps, strict=False):
        colors = "viridis" if name == "success" else "viridis_r"
        values = np.full((len(turns), len(forward)), math.nan)
        for cell in results["cells"]:
            own = 100 * cell[name] if name == "success" else figure_mean(cell[name])
            values[turns.index(cell["command"][2]), forward.index(cell["command"][0])] = own
        drawn = axes.pcolormesh(forward, turns, values, cmap=colors, vmin=0.0, vmax=high)
        figure.colorbar(drawn, ax=axes)
        tidy(axes, heading)
        axes.set_xlabel("commanded forward velocity, m/s")
        axes.set_ylabel("commanded yaw rate, rad/s")
        axes.grid(visible=False)
    _gaits(panels[3], results["gaits"])
    for axes, part, unit in ((panels[4], "forward", "m/s"), (panels[5], "yaw_rate", "rad/s")):
        _responses(axes, part, unit, results["responses"])
    return figure


def _gaits(axes: Axes, gaits: list[dict[str, Any]]) -> None:
    tidy(axes, "cost of transport and gait by speed")
    for place, name in enumerate(dict.fromkeys(each["gait"] for each in gaits)):
        own = [each for each in gaits if each["gait"] == name and each["cost_of_transport"]]
        at = [each["speed"] for each in own], [each["cost_of_transport"] for each in own]
        axes.plot(*at, _MARKS[place % 7], color=_color(place), label=name)
    axes.set_xlabel("speed, m/s")
    axes.set_ylim(bottom=0.0)
    axes.legend()


def _responses(axes: Axes, part: str, unit: str, responses: list[dict[str, Any]]) -> None:
    tidy(axes, f"after a change of the command: {part.replace('_', ' ')}", unit)
    which = COMMANDED.index(part)
    own = [each for each in responses if each["part"] == part]
    for place, each in enumerate(own):
        time = WINDOW / 2 + each["dt"] * np.arange(len(each["curve"]))
        label = f"{each['before'][which]:.3g} to {each['after'][which]:.3g}"
        axes.plot(time, each["curve"], color=_color(place), label=label)
        axes.axhline(each["after"][which], color=_color(place), linestyle="--", linewidth=1)
    axes.set_xlabel(f"time after the change, s; means of {WINDOW:g} s")
    axes.legend()


def draw_comparison(labels: list[str], results: list[dict[str, Any]]) -> Figure:
    """The figures as panels: each run's episodes as dots, their mean and its 95 % interval."""
    shown = [
        row
        for row in FIGURES
        if row.name not in ("distance", "path", "cost_of_transport", "reward")
        and any(row.name in result["summary"] for result in results)
    ]
    lines = math.ceil((1 + len(shown)) / _COLUMNS)
    first = results[0]
    figure = make_figure(
        (15, 4.5 * lines),
        f"{first['summary']['episodes']} episodes of up to {first['seconds']:g} s each, from the "
        f"same starts, engine {engines_of(results)}: mean, its 95 % interval, and every episode",
    )
    panels: Any = figure.subplots(lines, _COLUMNS).ravel()
    tidy(panels[0], "episodes that end by a fall", "%")
    for place, result in enumerate(results):
        _falls(panels[0], place, result["summary"])
    for axes in panels[1 + len(shown) :]:
        axes.set_axis_off()
    for axes, (name, heading, unit, _) in zip(panels[1 : 1 + len(shown)], shown, strict=True):
        tidy(axes, heading, unit)
        for place, result in enumerate(results):
            _figure(axes, place, result, name)
        axes.margins(y=0.12)
    for axes in panels:
        axes.set_xticks(range(len(labels)), labels)
        if sum(map(len, labels)) > 40:
            axes.tick_params(axis="x", labelrotation=25)
        axes.set_xlim(-0.6, len(labels) - 0.4)
        axes.grid(visible=False, axis="x")
    return figure


def _falls(axes: Axes, place: int, summary: dict[str, Any]) -> None:
    share = 100 * summary["fall_rate"]
    low, high = (100 * end for end in summary["fall_rate_ci95"])
    axes.bar(place, share, width=0.5, color=_color(place), alpha=0.5)
    error = [[max(share - low, 0.0)], [max(high - share, 0.0)]]
    axes.errorbar(place, share, yerr=error, color=INK, capsize=6, fmt="none", linewidth=1.6)
    axes.text(place + 0.06, share, f" {share:.1f}", va="bottom", fontsize=10, color=INK)
    axes.set_ylim(0, 105)


def _figure(axes: Axes, place: int, result: dict[str, Any], name: str) -> None:
    summary = result["summary"].get(name)
    if summary is None:
        axes.text(place, 0.5, "none", ha="center", transform=axes.get_xaxis_transform())
        return
    values = np.array([e[name] for e in result["episodes"] if e[name] is not None], dtype=float)
    across = place + np.linspace(-_SPREAD, _SPREAD, len(values)) if len(values) > 1 else [place]
    axes.plot(across, values, "o", color=_color(place), markersize=4, alpha=0.5, markeredgewidth=0)
    error = summary["ci95"] or 0.0
    axes.errorbar(place, summary["mean"], yerr=error, color=INK, capsize=6, fmt="D", markersize=5)
    label = f" {summary['mean']:.3g}"
    axes.annotate(label, (place + _SPREAD, summary["mean"]), va="center", fontsize=10, color=INK)


def _color(place: int) -> str:
    return _COLORS[place % len(_COLORS)]
