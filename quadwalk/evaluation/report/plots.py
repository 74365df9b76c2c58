"""One picture of an episode: its steps, its speed, what its joints did, and where it ran."""

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from quadwalk.evaluation.gait import (
    find_contacts,
    find_middle_strides,
    measure_footfalls,
    measure_gait,
    remove_chatter,
)
from quadwalk.evaluation.metrics import (
    compute_heading_velocity,
    compute_motor_limits,
    to_roll_pitch_yaw,
)
from quadwalk.evaluation.rollout import Rollout
from quadwalk.render.figures import INK, LEG_COLORS, make_figure, tidy
from quadwalk.robot.quadruped import Quadruped
from quadwalk.terrain.heightfield import compute_floor_height

WINDOW = 3.0  # s of footfalls
STRIDES = 2  # of joints and sensors
SMOOTHING = 0.5  # s, over which reward terms are averaged, to show their course
_SENSORS = 3  # panels
_PARTS = ("hip", "thigh", "calf")


def draw_report(rollout: Rollout, quadruped: Quadruped, title: str = "") -> Figure:
    """Draw one episode: footfalls, speed, posture, angles, torques, rewards, path and sensors.

    The figure is 16 by 18 inches; 21 with sensors, which are drawn if they are not ideal.
    Footfalls are those of `WINDOW` seconds about the episode's middle. Angles, torques and sensors
    are those of `STRIDES` strides there. The film strip, another picture, shows the same strides.
    `title` goes before the figure's own headline.
    """
    heights, height = [0.85, 1.2, 1.2, 1.2, 1.6], 18
    if rollout.truth is not None:
        heights, height = [*heights, 1.0], 21
    figure = make_figure((16, height), _format_headline(rollout, quadruped, title), fontsize=15)
    # Each row lays out its own panels, so that long labels do not squeeze the other rows.
    rows: Any = figure.subfigures(len(heights), 1, height_ratios=heights)
    draw_footfalls(rows[0].subplots(), rollout, quadruped)
    speed, posture = rows[1].subplots(1, 2)
    (_draw_speed if rollout.command is None else _draw_tracking)(speed, rollout)
    _draw_posture(posture, rollout, quadruped)
    for part, (angles, torques) in enumerate(
        zip(rows[2].subplots(1, 3), rows[3].subplots(1, 3), strict=True)
    ):
        _draw_angles(angles, rollout, quadruped, part)
        _draw_torques(torques, rollout, quadruped, part)
    rewards, path = rows[4].subplots(1, 2, width_ratios=(8, 7))
    _draw_rewards(rewards, rollout)
    _draw_path(path, rollout)
    if rollout.truth is not None:
        _draw_sensors(rows[5].subplots(1, _SENSORS), rollout, rollout.truth)
    for axes in figure.axes:
        axes.tick_params(labelsize=9)
    return figure


def _format_headline(rollout: Rollout, quadruped: Quadruped, title: str) -> str:
    """Return two lines for the top of a report: `title`, if any, and the figures of the episode.

    They are robot, seed, duration or fall, speed, gait, strides and cost of transport.
    """
    gait = measure_gait(rollout, quadruped)
    end = f"{gait.duration:.1f} s"
    parts = [
        f"{quadruped.name}, episode {rollout.episode}, seed {rollout.seed}",
        f"fell ({gait.end}) after {end}" if gait.fell else end,
    ]
    if np.isfinite(gait.speed):
        parts.append(f"{gait.speed:z.2f} m/s")
    parts.append(gait.gait)
    if np.isfinite(gait.stride_length):
        parts.append(f"{gait.stride_frequency:.1f} strides/s of {gait.stride_length:.2f} m")
    if np.isfinite(gait.cost_of_transport):
        parts.append(f"cost of transport {gait.cost_of_transport:.2f}")
    line = "  ·  ".join(parts)
    return f"{title}\n{line}" if title else line


def _find_shown_states(rollout: Rollout) -> tuple[int, int]:
    """Return the first and the last state of `STRIDES` strides in the middle of the episode."""
    start, end = find_middle_strides(rollout, STRIDES, otherwise=WINDOW)
    return math.floor(start), math.ceil(end)


def draw_footfalls(axes: Axes, rollout: Rollout, quadruped: Quadruped) -> None:
    """Draw the gait diagram: when each foot was on the ground, in the episode's middle.

    It shows `WINDOW` seconds. A band marks the strides that other panels show.
    """
    dt = rollout.control_dt
    start = max((rollout.steps - round(WINDOW / dt)) // 2, 0)
    stop = rollout.steps - start
    contact = remove_chatter(rollout.contact, dt)[start:stop]
    feet_down = (3, 2, 1, 0)  # the lines, from the lowest up
    for line, foot in enumerate(feet_down):
        # A row's contact is known at its step's end, and drawn over that step.
        bars = [((start + a) * dt, (b - a) * dt) for a, b in find_contacts(contact[:, foot])]
        axes.broken_barh(bars, (line - 0.36, 0.72), color=LEG_COLORS[foot])
    first, last = _find_shown_states(rollout)
    if last - first < stop - start:
        axes.axvspan(first * dt, last * dt, color="0.9", zorder=0)
    footfalls = measure_footfalls(rollout)
    duty, phase = _format_percents(footfalls.duty_factor), _format_percents(footfalls.phase)
    labels = [f"{quadruped.legs[k]}   duty {duty[k]}, phase {phase[k]}" for k in feet_down]
    axes.set_yticks(range(4), labels)
    axes.set_ylim(-0.6, 3.6)
    axes.set_xlim(start * dt, max(stop, start + 1) * dt)
    tidy(axes, f"Feet on the ground (gait diagram; gray: the {STRIDES} strides below)")
    axes.set_xlabel("time, s", fontsize=9)


def _format_percents(values: np.ndarray) -> list[str]:
    """Return fractions as texts in percent; "none" for NaN."""
    return [f"{100 * value:.0f} %" if np.isfinite(value) else "none" for value in values]


def _draw_speed(axes: Axes, rollout: Rollout) -> None:
    """Draw the trunk's velocity ahead and to the left, in the world frame, over time."""
    axes.plot(rollout.time, rollout.qvel[:, 0], color=LEG_COLORS[3], label="ahead", lw=1.2)
    axes.plot(rollout.time, rollout.qvel[:, 1], color=LEG_COLORS[2], label="left", lw=1.2)
    mean = rollout.qvel[:, 0].mean()
    axes.axhline(mean, color=INK, linewidth=0.9, linestyle="--", label=f"mean {mean:z.2f}")
    _finish(axes, "Speed of the base in the world", rollout.time, "m/s", margin=0.15)


def _draw_tracking(axes: Axes, rollout: Rollout) -> None:
    """Draw the velocity in the frame of the heading and the velocity command over time."""
    assert rollout.command is not None
    velocity = compute_heading_velocity(rollout.qpos, rollout.control_dt)
    time = rollout.time[1:]
    for column, label in enumerate(("forward, m/s", "lateral, m/s", "yaw rate, rad/s")):
        color = LEG_COLORS[3 - column]
        axes.plot(time, velocity[:, column], color=color, label=label, linewidth=0.9, alpha=0.7)
        axes.plot(time, rollout.command[:, column], color=color, linewidth=1.6, linestyle="--")
    title = "Velocity in the frame of the heading and, dashed, the velocity command"
    _finish(axes, title, rollout.time, "m/s or rad/s", margin=0.15)


def _draw_posture(axes: Axes, rollout: Rollout, quadruped: Quadruped) -> None:
    """Draw the trunk's height above the ground, roll, pitch and yaw over time."""
    ground = compute_floor_height(quadruped.make_full_model(), rollout.qpos[:, :2])
    height = rollout.qpos[:, 2] - ground
    axes.plot(rollout.time, height, color=INK, linewidth=1.4, label="height, m")
    angles = to_roll_pitch_yaw(rollout.qpos[:, 3:7])
    angles[:, 2] = np.unwrap(angles[:, 2])
    for name, values, color in zip(("roll", "pitch", "yaw"), angles.T, LEG_COLORS, strict=False):
        axes.plot(rollout.time, values, color=color, linewidth=0.9, label=f"{name}, rad")
    title = "Height above ground, and attitude, of the base"
    _finish(axes, title, rollout.time, "m or rad", margin=0.15)


def _draw_sensors(panels: Any, rollout: Rollout, truth: np.ndarray) -> None:
    """Draw one observation in each of `panels`, as the policy saw it and as it was.

    `truth` (T, n) holds the exact observations. Those that differ from it are drawn, evenly chosen.
    """
    first, last = _find_shown_states(rollout)
    time = rollout.time[first:last]
    observed = rollout.observation[:, : truth.shape[1]]
    columns = np.flatnonzero(np.any(observed != truth, axis=0))
    if not len(columns):
        columns = np.arange(truth.shape[1])
    columns = columns[np.linspace(0, len(columns) - 1, _SENSORS).astype(int)]
    for axes, column in zip(panels, columns, strict=True):
        name = rollout.observation_names[column]
        values, true_values = observed[first:last, column], truth[first:last, column]
        axes.plot(time, values, color=LEG_COLORS[0], lw=0.8, label="seen")
        axes.plot(time, true_values, color=INK, lw=1.4, label="true")
        title = f"{name}: what the policy saw, and the truth"
        _finish(axes, title, rollout.time[first : last + 1], "as observed", margin=0.2)


def _draw_angles(axes: Axes, rollout: Rollout, quadruped: Quadruped, part: int) -> None:
    """Draw angles and targets of all four hip, thigh or calf joints (`part` 0, 1, 2)."""
    first, last = _find_shown_states(rollout)
    time = rollout.time[first : last + 1]
    applied_target = rollout.applied_target
    for leg, name in enumerate(quadruped.legs):
        column, color = 3 * leg + part, LEG_COLORS[leg]
        axes.plot(time, rollout.qpos[first : last + 1, 7 + column], color=color, label=name)
        target = rollout.target[first:last, column]
        axes.plot(time[:-1], target, color=color, linewidth=0.6, alpha=0.6)
        if applied_target is not None:
            target = applied_target[first:last, column]
            axes.plot(time[1:], target, color=color, lw=0.6, alpha=0.6, ls=":")
    late = "" if applied_target is None else ", dotted: applied"
    low, high = float(quadruped.lower[part::3].max()), float(quadruped.upper[part::3].min())
    _draw_limits(axes, low, high, f"limits {low:.2f} to {high:.2f} rad")
    _finish(axes, f"{_PARTS[part].capitalize()} angles (thin: targets{late})", time, "rad")


def _draw_torques(axes: Axes, rollout: Rollout, quadruped: Quadruped, part: int) -> None:
    """Draw the torques of all four hip, thigh or calf motors (`part` 0, 1, 2) over time."""
    first, last = _find_shown_states(rollout)
    time = rollout.time[first : last + 1]
    limits = compute_motor_limits(rollout, quadruped)
    effort = float(limits[part::3].min())
    for leg, name in enumerate(quadruped.legs):
        torque = rollout.torque[:, 3 * leg + part]
        # A step's torque is drawn from its start to its end.
        values = np.concatenate([torque[first : first + 1], torque[first:last]])
        axes.step(time[: len(values)], values, color=LEG_COLORS[leg], label=name, linewidth=1.0)
    note = f"limits ±{effort:.1f} Nm"
    if rollout.steps:
        peak = (np.abs(rollout.torque) / limits)[:, part::3].max()
        rates = np.abs(rollout.qvel[:, 6 + part :: 3]).max() / quadruped.velocity[part::3].min()
        note += f"; peak torque {100 * peak:.0f} %, speed {100 * rates:.0f} %"
    _draw_limits(axes, -effort, effort, note)
    _finish(axes, f"{_PARTS[part].capitalize()} torques", time, "Nm")


def _draw_limits(axes: Axes, low: float, high: float, note: str) -> None:
    """Draw two limits as lines, and `note` above; the panel is scaled to its curves alone.

    The limits may thus be out of sight.
    """
    bottom, top = axes.dataLim.intervaly
    if not bottom <= top:  # nothing is plotted
        bottom, top = low, high
    span = max(top - bottom, 0.01 * (high - low))
    axes.set_ylim(bottom - 0.06 * span, top + 0.2 * span)  # room for the legend
    for value in (low, high):
        axes.axhline(value, color="#b00020", linewidth=1.2, linestyle=(0, (6, 3)))
    axes.set_title(note, loc="right", fontsize=8)


def _draw_rewards(axes: Axes, rollout: Rollout) -> None:
    """Draw the reward and its raw terms, smoothed, over time."""
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
    _finish(axes, title, rollout.time, "per step")
    axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.02))
    axes.set_yscale("symlog", linthresh=0.1)  # raw terms differ in size by orders
    axes.yaxis.set_major_formatter("{x:g}")


def _smooth(values: np.ndarray, width: int) -> np.ndarray:
    """Return the running mean of `values` (T,), each over itself and the `width` - 1 before."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - width, 0)
    return (sums[ends] - sums[starts]) / (ends - starts)


def _draw_path(axes: Axes, rollout: Rollout) -> None:
    """Draw the trunk's path from above, with start, end and a dot for each second."""
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
    tidy(axes, "Path from above")
    axes.set_xlabel("x, ahead, m", fontsize=9)
    axes.set_ylabel("y, to the left, m", fontsize=9)
    axes.legend(fontsize=8, frameon=False, loc="upper left")


def _finish(
    axes: Axes, title: str, time: np.ndarray, unit: str, margin: float | None = None
) -> None:
    """Add title, labels, legend and margins to a panel of curves over time."""
    axes.margins(y=margin)
    tidy(axes, title)
    axes.set_ylabel(unit, fontsize=9)
    axes.set_xlim(time[0], time[-1] if len(time) > 1 else time[0] + 0.02)
    axes.set_xlabel("time, s", fontsize=9)
    axes.legend(fontsize=8, frameon=False, ncols=4, loc="upper right")
