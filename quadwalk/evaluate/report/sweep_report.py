"""A sweep as a table and as a picture."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from quadwalk.evaluate.report.plots import INK, LEG_COLOURS
from quadwalk.evaluate.summary import figure_text

_SUCCESS, _SPEED = LEG_COLOURS[3], LEG_COLOURS[0]


def print_sweep(results: dict[str, Any]) -> None:
    """The sweep as a table on standard output; a star marks what training had."""
    table = Table(
        title=f"{results['run']}: {results['episodes']} episodes at each point, mean ± 95 %, "
        "* as in training",
        title_justify="left",
    )
    for heading in ("", "value", "success, %", "speed, m/s"):
        table.add_column(heading, justify="left" if heading == "" else "right")
    for sweep in results["sweeps"].values():
        table.add_section()
        heading = sweep["heading"] + (f", {sweep['unit']}" if sweep["unit"] else "")
        for number, point in enumerate(sweep["points"]):
            low, high = (100 * end for end in point["success_ci95"])
            table.add_row(
                "" if number else heading,
                f"{point['value']:g}" + ("*" if point["value"] == sweep["nominal"] else " "),
                f"{100 * point['success']:.0f} ({low:.0f} to {high:.0f})",
                figure_text(point["speed"]),
            )
    Console().print(table)


def draw_sweep(results: dict[str, Any]) -> Figure:
    """One panel for each sweep: success to the left, speed to the right, with 95 % intervals."""
    figure = Figure(figsize=(16, 9), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(
        f"{results['run']}: share of episodes that reach {results['seconds']:g} s without a fall, "
        f"and speed, {results['episodes']} episodes at each point (bands: 95 %, dotted: training)",
        x=0.01,
        ha="left",
        fontsize=13,
    )
    top = max(
        point["speed"]["mean"] for sweep in results["sweeps"].values() for point in sweep["points"]
    )
    panels: Any = figure.subplots(2, 3).ravel()
    for axes, sweep in zip(panels, results["sweeps"].values(), strict=True):
        _panel(axes, sweep, max(top, 0.1))
    return figure


def _panel(axes: Axes, sweep: dict[str, Any], top: float) -> None:
    points = sweep["points"]
    values = [point["value"] for point in points]
    low, high = zip(*(point["success_ci95"] for point in points), strict=True)
    axes.fill_between(
        values, [100 * e for e in low], [100 * e for e in high], color=_SUCCESS, alpha=0.15, lw=0
    )
    axes.plot(values, [100 * p["success"] for p in points], "o-", color=_SUCCESS, linewidth=2)
    axes.set_ylim(-3, 106)
    axes.set_ylabel("success, %", color=_SUCCESS)
    axes.axvline(sweep["nominal"], color=INK, linewidth=1, linestyle=":")
    speed = axes.twinx()
    means = [point["speed"]["mean"] for point in points]
    errors = [point["speed"]["ci95"] or 0.0 for point in points]
    speed.errorbar(
        values,
        means,
        yerr=errors,
        fmt="s--",
        color=_SPEED,
        linewidth=1.4,
        markersize=5,
        capsize=4,
    )
    # The same scale in every panel, and as high as that of success: 100 % is the top speed.
    lowest = min(0.0, *(mean - error for mean, error in zip(means, errors, strict=True)))
    speed.set_ylim(min(-0.03 * top, 1.05 * lowest), 1.06 * top)
    speed.set_ylabel("speed, m/s", color=_SPEED)
    unit = f", {sweep['unit']}" if sweep["unit"] else ""
    heading = sweep["heading"]
    axes.set_title(f"{heading[0].upper()}{heading[1:]}{unit}", loc="left", fontsize=11)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.set_axisbelow(True)
    for each in (axes, speed):
        each.spines["top"].set_visible(False)
