"""One picture of an episode: its steps, its speed, what its joints did, and where it ran."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from quadwalk.drawing.figures import INK, LEG_COLORS, new_figure, tidy
from quadwalk.evaluate.motion.course import heading_velocity, motor_limits
from quadwalk.evaluate.motion.footfalls import contact_spans, without_chatter
from quadwalk.evaluate.motion.gait import footfalls_of, measure_gait
from quadwalk.evaluate.motion.kinematics import roll_pitch_yaw
from quadwalk.evaluate.rollout import Rollout, finite_part
from quadwalk.ground.heightfield import heights_under
from quadwalk.robot.quadruped import Quadruped

WINDOW = 3.0  # s shown of what repeats with each stride
SMOOTHING = 0.5  # s, over which reward terms are averaged, to show their course
_SENSORS = 3  # panels
_PARTS = ("hip", "thigh", "calf")


def draw_report(rollout: Rollout, quadruped: Quadruped, title: str = "") -> Figure:
    """One episode as a figure, 16 by 18 inches; 21 with the sensors, where they are not ideal.

    Footfalls, angles and torques are those of the last `WINDOW` seconds, where strides are seen
    apart. `title` goes before the figure's own headline.
    """
    shown = finite_part(rollout)
    heights, height = [0.85, 1.2, 1.2, 1.2, 1.6], 18
    if shown.truth is not None:
        heights, height = [*heights, 1.0], 21
    figure = new_figure((16, height), _headline(rollout, quadruped, title), fontsize=15)
    # Each row lays out its own panels, so that one's long labels do not squeeze the others.
    rows: Any = figure.subfigures(len(heights), 1, height_ratios=heights)
    draw_footfalls(rows[0].subplots(), shown, quadruped)
    speed, posture = rows[1].subplots(1, 2)
    (draw_speed if shown.command is None else _tracking)(speed, shown)
    _posture(posture, shown, quadruped)
    for part, (angles, torques) in enumerate(
        zip(rows[2].subplots(1, 3), rows[3].subplots(1, 3), strict=True)
    ):
        _angles(angles, shown, quadruped, part)
        _torques(torques, shown, quadruped, part)
    rewards, path = rows[4].subplots(1, 2, width_ratios=(8, 7))
    _rewards(rewards, shown)
    _path(path, shown)
    if shown.truth is not None:
        _sensors(rows[5].subplots(1, _SENSORS), shown, shown.truth)
    for axes in figure.axes:
        axes.tick_params(labelsize=9)
    return figure


def _headline(rollout: Rollout, quadruped: Quadruped, title: str) -> str:
    gait = measure_gait(rollout, quadruped)
    ended = (
        f"fell ({gait.end}) after {gait.duration:.1f} s" if gait.fell else f"{gait.duration:.1f} s"
    )
    parts = [
        (f"{quadruped.name}, episode {rollout.episode}, seed {rollout.seed}", 0.0),
        (ended, 0.0),
        (f"{gait.speed:.2f} m/s", gait.speed),
        (gait.gait, 0.0),
        (
            f"{gait.stride_frequency:.1f} strides/s of {gait.stride_length:.2f} m",
            gait.stride_length,
        ),
        (f"cost of transport {gait.cost_of_transport:.2f}", gait.cost_of_transport),
    ]
    line = "  ·  ".join(text for text, value in parts if np.isfinite(value))
    return f"{title}\n{line}" if title else line


def _window(rollout: Rollout) -> int:
    """The first step of the last `WINDOW` seconds."""
    return max(rollout.steps - round(WINDOW / rollout.control_dt), 0)


def draw_footfalls(axes: Axes, rollout: Rollout, quadruped: Quadruped) -> None:
    """The gait diagram: when each foot was on the ground, over the last `WINDOW` seconds."""
    start, dt = _window(rollout), rollout.control_dt
    contact = without_chatter(rollout.contact, dt)[start:]
    order = (1, 0, 3, 2)  # left above right, fore above hind, as one draws footfalls
    for line, foot in enumerate(reversed(order)):
        # A row's contact is known at its step's end, and drawn over that step.
        bars = [((start + a) * dt, (b - a) * dt) for a, b in contact_spans(contact[:, foot])]
        axes.broken_barh(bars, (line - 0.36, 0.72), color=LEG_COLORS[foot])
    feet = footfalls_of(rollout)
    duty, phase = _percent(feet.duty_factor), _percent(feet.phase)
    labels = [f"{quadruped.legs[k]}   duty {duty[k]}, phase {phase[k]}" for k in reversed(order)]
    axes.set_yticks(range(4), labels)
    axes.set_ylim(-0.6, 3.6)
    axes.set_xlim(start * dt, max(rollout.steps, start + 1) * dt)
    tidy(axes, "Feet on the ground (gait diagram)")
    axes.set_xlabel("time, s", fontsize=9)


def _percent(values: np.ndarray) -> list[str]:
    return [f"{100 * value:.0f} %" if np.isfinite(value) else "none" for value in values]


def draw_speed(axes: Axes, rollout: Rollout) -> None:
    """Speed of the base in the world, ahead and to the left, from beginning to end."""
    for column, label, color in ((0, "ahead", LEG_COLORS[3]), (1, "left", LEG_COLORS[2])):
        axes.plot(rollout.time, rollout.qvel[:, column], color=color, label=label, linewidth=1.2)
    mean = rollout.qvel[:, 0].mean()
    axes.axhline(mean, color=INK, linewidth=0.9, linestyle="--", label=f"mean {mean:.2f}")
    axes.margins(y=0.15)
    _finish(axes, "Speed of the base in the world, m/s", rollout.time)


def _tracking(axes: Axes, rollout: Rollout) -> None:
    assert rollout.command is not None
    velocity, time = heading_velocity(rollout.qpos, rollout.control_dt), rollout.time[1:]
    for column, label in enumerate(("forward", "lateral", "yaw rate, rad/s")):
        color = LEG_COLORS[3 - column]
        axes.plot(time, velocity[:, column], color=color, label=label, linewidth=0.9, alpha=0.7)
        axes.plot(time, rollout.command[:, column], color=color, linewidth=1.6, linestyle="--")
    axes.margins(y=0.15)
    title = "Velocity in the frame of the heading and, dashed, the velocity command, m/s"
    _finish(axes, title, rollout.time)


def _posture(axes: Axes, rollout: Rollout, quadruped: Quadruped) -> None:
    below = heights_under(quadruped.full_model(), rollout.qpos[:, :2])
    axes.plot(rollout.time, rollout.qpos[:, 2] - below, color=INK, linewidth=1.4, label="height, m")
    angles = roll_pitch_yaw(rollout.qpos[:, 3:7])
    for column, name in enumerate(("roll", "pitch", "yaw")):
        values = np.unwrap(angles[:, column]) if name == "yaw" else angles[:, column]
        color = LEG_COLORS[column]
        axes.plot(rollout.time, values, color=color, linewidth=0.9, label=f"{name}, rad")
    axes.margins(y=0.15)
    _finish(axes, "Height above ground, and attitude, of the base", rollout.time)


def _sensors(panels: Any, rollout: Rollout, truth: np.ndarray) -> None:
    """Some of what the policy saw beside what was so: from each end and between."""
    start, time = _window(rollout), rollout.time[:-1]
    seen = rollout.observation[:, : truth.shape[1]]
    wrong = np.flatnonzero(np.any(seen != truth, axis=0))
    if not len(wrong):
        wrong = np.arange(truth.shape[1])
    some = wrong[np.linspace(0, len(wrong) - 1, _SENSORS).astype(int)]
    for axes, column in zip(panels, some, strict=True):
        name = rollout.observation_names[column]
        axes.plot(time[start:], seen[start:, column], color=LEG_COLORS[0], lw=0.8, label="seen")
        axes.plot(time[start:], truth[start:, column], color=INK, lw=1.4, label="true")
        axes.margins(y=0.2)
        _finish(axes, f"{name}: what the policy saw, and the truth", rollout.time[start:])


def _angles(axes: Axes, rollout: Rollout, quadruped: Quadruped, part: int) -> None:
    start = _window(rollout)
    time = rollout.time[start:]
    for leg, name in enumerate(quadruped.legs):
        column = 3 * leg + part
        axes.plot(time, rollout.qpos[start:, 7 + column], color=LEG_COLORS[leg], label=name)
        if rollout.steps:
            target = rollout.target[start:, column]
            axes.plot(time[:-1], target, color=LEG_COLORS[leg], linewidth=0.6, alpha=0.6)
            if rollout.applied_target is not None:
                applied_target = rollout.applied_target[start:, column]
                axes.plot(
                    time[1:], applied_target, color=LEG_COLORS[leg], lw=0.6, alpha=0.6, ls=":"
                )
    _limits(axes, quadruped.lower[part::3].max(), quadruped.upper[part::3].min())
    late = "" if rollout.applied_target is None else ", dotted: applied"
    title = f"{_PARTS[part].capitalize()} angles (thin: targets{late}) and limits, rad"
    _finish(axes, title, time)


def _torques(axes: Axes, rollout: Rollout, quadruped: Quadruped, part: int) -> None:
    start = _window(rollout)
    time = rollout.time[start:]
    limits = motor_limits(rollout, quadruped)
    effort = float(limits[part::3].min())
    peaks = []
    for leg, name in enumerate(quadruped.legs):
        column = 3 * leg + part
        torque = rollout.torque[:, column]
        axes.step(time[1:], torque[start:], color=LEG_COLORS[leg], label=name, linewidth=1.0)
        if len(torque):
            peaks.append(np.abs(torque).max() / limits[column])
    _limits(axes, -effort, effort)
    rates = np.abs(rollout.qvel[:, 6 + part :: 3]).max() / quadruped.velocity[part::3].min()
    _finish(axes, f"{_PARTS[part].capitalize()} torques and limits, Nm", time)
    if peaks:
        most = f"peak torque {100 * max(peaks):.0f} %, speed {100 * rates:.0f} % of the limit"
        axes.text(0.01, 0.08, most, transform=axes.transAxes, fontsize=8, color=INK)


def _limits(axes: Axes, low: float, high: float) -> None:
    for value in (low, high):
        axes.axhline(value, color="#b00020", linewidth=1.2, linestyle=(0, (6, 3)))
    span = high - low
    axes.set_ylim(low - 0.06 * span, high + 0.22 * span)  # room for the legend


def _rewards(axes: Axes, rollout: Rollout) -> None:
    series = {"total": rollout.reward, **rollout.reward_terms}
    width = max(round(SMOOTHING / rollout.control_dt), 1)
    time = rollout.time[1:]
    for index, (name, values) in enumerate(series.items()):
        style = (
            {"color": INK, "linewidth": 2.0}
            if name == "total"
            else {"color": f"C{(index - 1) % 10}", "linestyle": "-" if index <= 10 else "--"}
        )
        values = np.nan_to_num(np.asarray(values, dtype=float))
        mean = f"{values.mean():.3g}" if len(values) else "-"
        axes.plot(time, _smooth(values, width), label=f"{name}  {mean}", **style)
    title = f"Reward and its raw terms, mean of {SMOOTHING:g} s (in the legend: of all)"
    _finish(axes, title, rollout.time, outside=True)
    axes.set_yscale("symlog", linthresh=0.1)  # raw terms differ in size by orders
    axes.yaxis.set_major_formatter("{x:g}")


def _smooth(values: np.ndarray, width: int) -> np.ndarray:
    """Mean of the last `width` values (of as many as there are, in the beginning)."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - width, 0)
    return (sums[ends] - sums[starts]) / (ends - starts)


def _path(axes: Axes, rollout: Rollout) -> None:
    x, y = rollout.qpos[:, 0], rollout.qpos[:, 1]
    axes.axhline(0.0, color="#9aa3ad", linewidth=0.8, linestyle="--")
    axes.plot(x, y, color=LEG_COLORS[3], linewidth=1.6)
    seconds = np.arange(0, rollout.steps + 1, max(round(1 / rollout.control_dt), 1))
    axes.plot(x[seconds], y[seconds], "o", color=LEG_COLORS[3], markersize=3, label="each second")
    axes.plot(x[0], y[0], "o", color="#2a9d5c", markersize=8, label="start")
    axes.plot(x[-1], y[-1], "X", color="#b00020", markersize=9, label="end")
    # Equal scales, so that a drift looks as large as it is. The box is about twice as wide as high.
    half = max(np.ptp(x) / 2, np.ptp(y), 1.0) * 1.1
    middle = (x.max() + x.min()) / 2, (y.max() + y.min()) / 2
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half / 2, middle[1] + half / 2)
    axes.set_aspect("equal", adjustable="box")
    tidy(axes, "Path from above, m (x ahead, y to the left)")
    axes.legend(fontsize=8, frameon=False, loc="upper left")


def _finish(axes: Axes, title: str, time: np.ndarray, outside: bool = False) -> None:
    tidy(axes, title)
    axes.set_xlim(time[0], time[-1] if len(time) > 1 else time[0] + 0.02)
    axes.set_xlabel("time, s", fontsize=9)
    if outside:
        axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.02))
    else:
        axes.legend(fontsize=8, frameon=False, ncols=4, loc="upper right")
