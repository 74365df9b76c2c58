"""How a policy moves its feet at each commanded speed, on a flat floor in MuJoCo C."""

import dataclasses
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.gait import measure_gait
from quadwalk.evaluation.load import LoadedRun
from quadwalk.evaluation.metrics import SETTLING, to_json_number
from quadwalk.evaluation.report.tables import format_number, print_table
from quadwalk.evaluation.rollout import (
    Command,
    reset_with_commands,
    simulate_episodes,
    slice_steps,
)
from quadwalk.render.figures import get_style, make_figure, tidy
from quadwalk.settings.environment import CommandConfig
from quadwalk.terrain.terrain import FLAT

SECONDS = 8.0  # s, that a command is held
SETTLED = 2 * SETTLING  # s, after which a held command's motion is evaluated
SPEEDS = 15  # straight ahead
PANELS = 5  # of `draw_gaits`

# name: heading in the table, factor to its unit there, format
_COLUMNS = {
    "stride_frequency": ("strides/s", 1.0, ".2f"),
    "duty_factor": ("duty factor", 1.0, ".2f"),
    "swing_height": ("swing, cm", 100.0, ".1f"),
    "swing_height_p10": ("lowest tenth, cm", 100.0, ".1f"),
    "slip": ("slip, %", 100.0, ".1f"),
    "touchdown_speed": ("touch-down, m/s", 1.0, ".2f"),
    "torque_reversals": ("torque reversals, %", 100.0, ".0f"),
    "cost_of_transport": ("cost of transport", 1.0, ".2f"),
}


def to_held_run(loaded: LoadedRun) -> LoadedRun:
    """Return `loaded` on a flat floor in MuJoCo C, in episodes as long as a command is held."""
    config = loaded.env.config
    command = dataclasses.replace(config.command, seconds=SECONDS, soonest=None)
    config = dataclasses.replace(config, episode_seconds=SECONDS, command=command, ground=FLAT)
    env = QuadrupedEnv(loaded.load_level_robot(), config, "mujoco")
    return dataclasses.replace(loaded, env=env)


def list_gait_commands(config: CommandConfig) -> list[Command]:
    """Return speeds straight ahead, then back, a turn on the spot and a step aside.

    Each is forward and lateral velocity, m/s, and yaw rate, rad/s. The top speed is among the
    first; the turn has half of the fastest yaw rate, the step aside 0.8 of the fastest.
    """
    ahead = np.linspace(0.0, config.forward[1], 1 + SPEEDS)[1:]
    commands = [(float(round(speed, 3)), 0.0, 0.0) for speed in ahead]
    others = (
        (config.forward[0], 0.0, 0.0),
        (0.0, 0.0, config.yaw_rate[1] / 2),
        (0.0, round(0.8 * config.lateral[1], 3), 0.0),
    )
    return [*commands, *(command for command in others if any(command))]


def measure_gaits(loaded: LoadedRun, seed: int) -> list[dict[str, Any]]:
    """Return the gait at each of `list_gait_commands`, as plain values for JSON.

    `loaded` is of `to_held_run`. Each row is of one episode from `SETTLED` on: the start from a
    stand is left out. Figures of feet and motors are means over them, that of the lowest tenth of
    swings is the lowest foot's.
    """
    env = loaded.env
    commands = list_gait_commands(env.config.command)
    starts = reset_with_commands(env, commands, 1, seed)
    rollouts = simulate_episodes(env, loaded.policy.act, len(commands), seed, starts=starts)
    settled = round(SETTLED / env.config.control_dt)
    rows = []
    for command, rollout in zip(commands, rollouts, strict=True):
        gait = measure_gait(slice_steps(rollout, settled), env.quadruped)
        figures = {
            "speed": gait.speed,
            "stride_frequency": gait.stride_frequency,
            "duty_factor": np.mean(gait.duty_factor),
            "swing_height": np.mean(gait.swing_height),
            "swing_height_p10": np.min(gait.swing_height_p10),
            "slip": np.mean(gait.slip_share),
            "touchdown_speed": np.mean(gait.touchdown_speed),
            "torque_reversals": np.mean(gait.torque_reversals),
            "cost_of_transport": gait.cost_of_transport,
        }
        numbers = {name: to_json_number(value) for name, value in figures.items()}
        rows.append({"command": list(command), "gait": gait.gait, "fell": gait.fell, **numbers})
    return rows


def describe_command(command: list[float]) -> str:
    """Return a velocity command in words."""
    forward, lateral, turn = command
    if turn:
        return f"{turn:g} rad/s on the spot"
    return f"{lateral:g} m/s aside" if lateral else f"{forward:g} m/s"


def print_gaits(rows: list[dict[str, Any]]) -> None:
    """Print a table with a row for each command."""
    headings = ("command", "gait", *(heading for heading, _, _ in _COLUMNS.values()))
    table = []
    for row in rows:
        texts = [describe_command(row["command"]), "fell" if row["fell"] else row["gait"]]
        for name, (_, factor, form) in _COLUMNS.items():
            value = row[name]
            texts.append(format_number(None if value is None else factor * value, form))
        table.append(texts)
    print_table("feet at each command, on a flat floor in MuJoCo C", headings, table)


def draw_gait_panels(panels: list[Axes], rows: list[dict[str, Any]]) -> None:
    """Draw cost of transport, strides, swings, shares and touch-downs by speed into `PANELS`."""
    ahead = [row for row in rows if row["command"][0] > 0.0 and not any(row["command"][1:])]
    cost, strides, swings, shares, touchdown = panels
    _draw_costs(cost, ahead)
    _draw_lines(strides, ahead, "strides of each foot", "1/s", {"stride_frequency": ("", 1.0)})
    heights = {"swing_height": ("median", 100.0), "swing_height_p10": ("lowest tenth", 100.0)}
    _draw_lines(swings, ahead, "height of swings", "cm", heights)
    percents = {
        "duty_factor": ("of strides on the ground", 100.0),
        "torque_reversals": ("of steps with a torque reversal", 100.0),
        "slip": ("of the way slipped", 100.0),
    }
    _draw_lines(shares, ahead, "shares", "%", percents)
    _draw_lines(touchdown, ahead, "foot before touch-down", "m/s", {"touchdown_speed": ("", 1.0)})


def draw_gaits(rows: list[dict[str, Any]], title: str) -> Figure:
    """Draw a figure of the panels alone."""
    figure = make_figure((15, 8), f"{title}: feet by speed, on a flat floor in MuJoCo C")
    panels = figure.subplots(2, 3).ravel()
    draw_gait_panels(list(panels[:PANELS]), rows)
    panels[-1].remove()
    return figure


def _draw_costs(axes: Axes, rows: list[dict[str, Any]]) -> None:
    """Draw the cost of transport by speed, with a mark for each gait."""
    tidy(axes, "cost of transport and gait")
    for place, name in enumerate(dict.fromkeys(row["gait"] for row in rows)):
        points = [
            (row["speed"], row["cost_of_transport"])
            for row in rows
            if row["gait"] == name and row["cost_of_transport"] is not None
        ]
        color, mark = get_style(place)
        axes.plot(*np.array(points).reshape(-1, 2).T, mark, color=color, label=name)
    axes.set_xlabel("speed, m/s")
    axes.set_ylim(bottom=0.0)
    axes.legend()


def _draw_lines(
    axes: Axes,
    rows: list[dict[str, Any]],
    title: str,
    unit: str,
    lines: dict[str, tuple[str, float]],
) -> None:
    """Draw figures by speed: each of `lines` has a label and the factor to its unit."""
    tidy(axes, title, unit)
    speed = np.array([row["speed"] for row in rows], float)
    for place, (name, (label, factor)) in enumerate(lines.items()):
        values = factor * np.array([row[name] for row in rows], float)
        color, mark = get_style(place)
        axes.plot(speed, values, f"{mark}-", color=color, label=label or None, markersize=4)
    axes.set_xlabel("speed, m/s")
    axes.set_ylim(bottom=0.0)
    if len(lines) > 1:
        axes.legend()
