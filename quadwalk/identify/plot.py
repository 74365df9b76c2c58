"""A fit as a picture: fitted and measured angles, what is left, and the constants."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from quadwalk.identify.fit import Fit
from quadwalk.identify.log import find_pieces
from quadwalk.identify.log_files import Log
from quadwalk.identify.results import OF_URDF, PARTS
from quadwalk.render.figures import INK, LEG_COLORS, make_figure, tidy
from quadwalk.robot.quadruped import Quadruped

WINDOW = 2.0  # s of angles that are shown
BIN = 0.25  # s, over which what is left is averaged
_COLORS = {"target": "#9aa3ad", "description": LEG_COLORS[2], "fit": LEG_COLORS[0]}


def draw_fit(fit: Fit, log: Log, quadruped: Quadruped, title: str) -> Figure:
    """Draw a fit in three rows, 15 by 11 inches; a column each for hips, thighs and calves.

    The rows are angles, errors and constants.
    """
    figure = make_figure((15, 11), title)
    left = {"description": fit.before - log.position, "fit": fit.after - log.position}
    for part, column in enumerate(figure.subplots(3, 3).T):
        worst = 3 * int((left["fit"][:, part::3] ** 2).mean(axis=0).argmax()) + part
        _draw_angles(column[0], fit, log, worst, quadruped.joints[worst])
        errors = {name: 1e3 * angles[:, part::3] for name, angles in left.items()}
        _draw_errors(column[1], log.time - log.time[0], errors, fit)
        _draw_constants(column[2], fit, part)
    return figure


def _draw_angles(axes: Axes, fit: Fit, log: Log, joint: int, name: str) -> None:
    """Draw target, measured and simulated angles of one joint over `WINDOW` s.

    They are those in which its target moves most.
    """
    start = max(log.time[:-1], key=lambda t: _compute_path_length(log, joint, t))
    rows = (log.time >= start) & (log.time <= start + WINDOW)
    time = log.time[rows] - log.time[0]
    target_rows = (log.target_time >= start) & (log.target_time <= start + WINDOW)
    target_time = log.target_time[target_rows] - log.time[0]
    color = _COLORS["target"]
    axes.step(
        target_time, log.target[target_rows, joint], color, where="post", lw=1.0, label="target"
    )
    axes.plot(time, log.position[rows, joint], color=INK, lw=2.2, label="measured")
    for label, angles in (("description", fit.before), ("fit", fit.after)):
        axes.plot(time, angles[rows, joint], color=_COLORS[label], lw=1.0, label=label)
    axes.margins(y=0.2)
    _finish(axes, f"{name}, the worst of its kind", "rad", time)


def _compute_path_length(log: Log, joint: int, start: float) -> float:
    """Return the path length of a joint's target, rad, over the `WINDOW` s from `start` on.

    It is 0 if the log ends or has a gap within them.
    """
    rows = slice(*np.searchsorted(log.time, (start, start + WINDOW)))
    if start + WINDOW > log.time[-1] or len(find_pieces(log.time[rows])) > 1:
        return 0.0
    target_rows = slice(*np.searchsorted(log.target_time, (start, start + WINDOW)))
    return float(np.abs(np.diff(log.target[target_rows, joint])).sum())


def _draw_errors(axes: Axes, time: np.ndarray, errors: dict[str, np.ndarray], fit: Fit) -> None:
    """Draw the rms errors of the angles of one kind of joint over time, with and without the fit.

    `errors` are those (n, 4), mrad, of the "description" and the "fit", at `time` (n,), s. Means
    are over `BIN` s and four legs. Gray is what was not fitted.
    """
    bins = (time // BIN).astype(int)
    count = np.bincount(bins)
    for name, angles in errors.items():
        squares = np.full(len(count), np.nan)  # stays so in a gap, where the line breaks
        np.divide(np.bincount(bins, (angles**2).mean(axis=1)), count, out=squares, where=count > 0)
        axes.plot(BIN * (np.arange(len(squares)) + 0.5), np.sqrt(squares), color=_COLORS[name])
        axes.lines[-1].set_label(name)
    if fit.held_out.any():
        axes.axvspan(time[fit.held_out][0], time[-1], color="#9aa3ad", alpha=0.2, lw=0)
    axes.set_ylim(bottom=0.0)
    axes.margins(y=0.25)
    rows = (fit.fitted, fit.held_out)
    rms = [np.sqrt(np.mean(errors["fit"][part] ** 2)) for part in rows if part.any()]
    sizes = ", held out (gray) ".join(f"{size:.2g}" for size in rms)
    _finish(axes, f"What is left, rms: {sizes}", "mrad", time)


def _draw_constants(axes: Axes, fit: Fit, part: int) -> None:
    """Draw the constants of hips, thighs or calves (`part` 0, 1, 2) as shares of the URDF's."""
    for row, name in enumerate(OF_URDF):
        values = [v for v in fit.values if v.name == name and part in {j % 3 for j in v.joints}]
        values = [value for value in values if value.described > 0]
        places = np.linspace(-0.2, 0.2, len(values) + 2)[1:-1]
        for place, value in zip(places, values, strict=True):
            color = LEG_COLORS[value.joints[0] // 3] if len(values) > 1 else INK
            share, interval = (x / value.described for x in (value.estimate, value.interval))
            axes.errorbar(share, row + place, xerr=interval, fmt="o", color=color, capsize=3)
    axes.axvline(1.0, color=_COLORS["description"], linewidth=1.2)
    axes.set_yticks(range(len(OF_URDF)), OF_URDF)
    axes.set_ylim(len(OF_URDF) - 0.5, -0.5)
    axes.set_xlim(left=0.0)
    tidy(axes, f"{PARTS[part]}: found / described, 95 % intervals")


def _finish(axes: Axes, title: str, unit: str, time: np.ndarray) -> None:
    """Add title, labels and legend to a panel over time."""
    tidy(axes, title, unit)
    axes.set_xlim(time[0], time[-1])
    axes.set_xlabel("time, s", fontsize=9)
    axes.legend(fontsize=8, frameon=False, ncols=4, loc="upper right")
