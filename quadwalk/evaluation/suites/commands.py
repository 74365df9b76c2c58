"""The suite "commands": how well a policy follows held and changing commands."""

import dataclasses
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from quadwalk.brax import State
from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.load import LoadedRun, make_evaluation_ranges
from quadwalk.evaluation.metrics import (
    WINDOW,
    average_windows,
    compute_heading_velocity,
    get_mean,
    measure_cells,
    summarize_values,
)
from quadwalk.evaluation.report.tables import (
    format_number,
    format_percent,
    format_value,
    print_table,
    print_text,
)
from quadwalk.evaluation.rollout import (
    GROUP,
    Command,
    Report,
    reset_episodes,
    reset_with_commands,
    roll_out_paths,
)
from quadwalk.evaluation.suites.gaits import SETTLED, draw_gait_panels
from quadwalk.render.figures import get_style, make_figure, tidy
from quadwalk.settings.environment import COMMANDED, CommandConfig

STILL: Command = (0.0, 0.0, 0.0)

FORWARD, TURNS = 12, 9  # commands along each axis of the grid
NO_SLIP = 20  # iterations at most of MuJoCo's no-slip solver
LONG = 20.0  # s, of an episode in which commands change as in training
CHANGE = 4.0  # s, after which it changes where a change is measured
NEAR = 0.1  # of a change: a response that stays so near its end has arrived
WORST = 6  # commands in the table, those followed worst


def to_changing_run(loaded: LoadedRun, **changes: Any) -> LoadedRun:
    """Return `loaded` in MuJoCo C, randomized, with commands that change as in training.

    `changes` are others of the settings in `env`.
    """
    trained = loaded.policy.config.env
    return loaded.to_mujoco(
        command=dataclasses.replace(trained.command, margin=0.0),
        randomization=make_evaluation_ranges(trained, enabled=True),
        episode_seconds=LONG,
        **changes,
    )


def measure_commands(
    loaded: LoadedRun, episodes: int, seed: int, report: Report | None = None
) -> dict[str, Any]:
    """Return tracking at each command, and responses, as plain values for JSON.

    `loaded` comes from `to_held_run`.
    """
    config = loaded.env.config.command
    return {
        "engine": loaded.env.engine,
        "episodes": episodes,
        "cells": measure_held(loaded, make_held_commands(config), episodes, seed, report),
        "standing": measure_still(loaded, episodes, seed),
        "standing_without_creep": measure_still(remove_creep(loaded), episodes, seed),
        "responses": [
            measure_response(loaded, before, after, episodes, seed)
            for before, after in make_changes(config)
        ],
    }


def measure_changing(
    loaded: LoadedRun, episodes: int, seed: int, report: Report | None = None
) -> dict[str, Any]:
    """Return the share of `episodes` without a fall while commands change, as values for JSON.

    It is `success`, with its interval `success_ci95`. `loaded` comes from `to_changing_run`.
    """
    env = loaded.env
    starts, act = reset_episodes(env, episodes, seed), loaded.policy.act
    (figures,) = measure_cells(env, act, starts, episodes, lambda *_: {}, GROUP, report)
    return {"seconds": LONG, "episodes": episodes, **figures}


def make_held_commands(config: CommandConfig) -> list[Command]:
    """Return a grid of commands: forward velocities by yaw rates.

    Those with more centripetal acceleration than in training are left out.
    """
    forward = np.linspace(*config.forward, FORWARD)
    turns = np.linspace(*config.yaw_rate, TURNS)
    most = np.inf if config.turning is None else config.turning + 1e-6
    return [(float(v), 0.0, float(w)) for v in forward for w in turns if abs(v * w) <= most]


def make_changes(config: CommandConfig) -> list[tuple[Command, Command]]:
    """Return pairs of commands, before and after a change.

    They go from a stand to 0.9 of the top speed, back to a stand, and from a left to a right turn.
    """
    fast = (0.9 * config.forward[1], 0.0, 0.0)
    speed = config.forward[1] / 2
    turn = config.yaw_rate[1]
    turn = turn if config.turning is None else min(turn, config.turning / speed)
    return [(STILL, fast), (fast, STILL), ((speed, 0.0, turn), (speed, 0.0, -turn))]


def measure_held(
    loaded: LoadedRun,
    commands: list[Command],
    episodes: int,
    seed: int,
    report: Report | None = None,
) -> list[dict[str, Any]]:
    """Return motion, errors and success at each command, of `episodes` from the same starts.

    - forward, lateral, yaw_rate: means of the motion from `SETTLED` on, m/s and rad/s.
    - velocity_error, yaw_rate_error: the distance of these means from the command.
    - success: the share without a fall.
    """
    env, dt = loaded.env, loaded.env.config.control_dt
    settled = round(SETTLED / dt)

    def measure(number: int, upright: bool, poses: np.ndarray) -> dict[str, float | bool]:
        motion = compute_heading_velocity(poses, dt)[settled:]
        mean = motion.mean(axis=0) if len(motion) else np.full(3, np.nan)
        error = mean - commands[number // episodes]
        return {
            **dict(zip(COMMANDED, map(float, mean), strict=True)),
            "velocity_error": float(np.hypot(error[0], error[1])),
            "yaw_rate_error": float(abs(error[2])),
        }

    starts = reset_with_commands(env, commands, episodes, seed)
    cells = measure_cells(env, loaded.policy.act, starts, episodes, measure, GROUP, report)
    return [
        {"command": list(command)} | cell for command, cell in zip(commands, cells, strict=True)
    ]


def measure_still(loaded: LoadedRun, episodes: int, seed: int) -> dict[str, Any]:
    """Return how far the trunk moves at the command to stand, m, from its place at `SETTLED`.

    moved: the mean of the farthest that each of `episodes` gets. most: the largest.
    """
    env = loaded.env
    settled = round(SETTLED / env.config.control_dt)
    starts = reset_with_commands(env, [STILL], episodes, seed)
    rolled_out = roll_out_paths(env, loaded.policy.act, starts)
    paths = [poses[settled:, :2] for _, _, poses in rolled_out]
    # Those that did not fall before.
    distances = [float(np.linalg.norm(path - path[0], axis=1).max()) for path in paths if len(path)]
    return {"moved": summarize_values(distances), "most": max(distances, default=None)}


def remove_creep(loaded: LoadedRun) -> LoadedRun:
    """Return `loaded`, a run in MuJoCo C, with a solver in which feet at rest do not creep.

    MuJoCo's soft friction gives way a little to any force. Its no-slip solver takes that back.
    """
    quadruped, env = loaded.env.quadruped, loaded.env
    # In the spec, from which the models of randomized robots are made too.
    spec = quadruped.spec.copy()
    spec.option.noslip_iterations = NO_SLIP
    env = QuadrupedEnv(dataclasses.replace(quadruped, spec=spec), env.config, env.engine)
    return dataclasses.replace(loaded, env=env)


def measure_response(
    loaded: LoadedRun, before: Command, after: Command, episodes: int, seed: int
) -> dict[str, Any]:
    """Return how soon motion follows when the command changes from `before` to `after`.

    It changes `CHANGE` s after the start. Measured is the component that changes most: forward or
    lateral velocity, m/s, or yaw rate, rad/s; the result names it as part.

    - curve: the mean motion of `episodes`, averaged over `WINDOW`, from the change on.
    - time: s, until it stays within `NEAR` of the change from its end; None: never.
    - overshoot: share of the change. falls: share of episodes.
    """
    env, dt = loaded.env, loaded.env.config.control_dt
    turn, window = round(CHANGE / dt), round(WINDOW / dt)
    part = int(np.argmax(np.abs(np.subtract(after, before))))

    def change(env: QuadrupedEnv, state: State) -> State:
        start = state.pipeline_state
        # A step sooner: the policy has chosen its action, and sees the command in the next state.
        changed = start.steps >= turn - 1
        velocity = jnp.where(changed[:, None], jnp.asarray(after), start.command.velocity)
        command = start.command._replace(velocity=velocity)
        return state.replace(pipeline_state=start._replace(command=command))

    starts = reset_with_commands(env, [before], episodes, seed)
    paths = roll_out_paths(env, loaded.policy.act, starts, change=change)
    velocities = [
        compute_heading_velocity(poses, dt)[turn:] for _, upright, poses in paths if upright
    ]
    motion = [average_windows(velocity, window)[:, part] for velocity in velocities]
    curve = np.mean(motion, axis=0) if motion else np.zeros(0)
    share = (curve - before[part]) / (after[part] - before[part])
    away = np.flatnonzero(np.abs(share - 1.0) > NEAR)
    arrived = 1 + away[-1] if len(away) else 0
    return {
        "before": list(before),
        "after": list(after),
        "part": COMMANDED[part],
        "time": arrived * dt + WINDOW / 2 if arrived < len(curve) else None,
        "overshoot": max(float(share.max() - 1.0), 0.0) if len(curve) else None,
        "falls": 1.0 - len(velocities) / episodes,
        "curve": curve.tolist(),
        "dt": dt,
    }


def print_commands(results: dict[str, Any]) -> None:
    """Print the commands followed worst, and how soon motion follows changes of the command."""
    episodes = results["episodes"]
    errors = [get_mean(cell["velocity_error"]) for cell in results["cells"]]
    worst_first = np.argsort(-np.nan_to_num(errors, nan=9.0), kind="stable")
    rows = []
    for cell in [results["cells"][k] for k in worst_first[:WORST]]:
        forward, _, turn = cell["command"]
        rows.append(
            (
                f"{forward:zg} m/s, {turn:zg} rad/s",
                format_percent(cell["success"]),
                format_value(cell["velocity_error"]),
                format_value(cell["yaw_rate_error"]),
            )
        )
    title = f"the six of {len(errors)} commands followed worst, {episodes} episodes each"
    print_table(title, ("command", "success, %", "m/s off", "rad/s off"), rows)
    rows = []
    for response in results["responses"]:
        part = COMMANDED.index(response["part"])
        unit = "rad/s" if response["part"] == "yaw_rate" else "m/s"
        rows.append(
            (
                f"{response['before'][part]:z.3g} to {response['after'][part]:z.3g} {unit}",
                format_number(response["time"], ".2f"),
                format_percent(response["overshoot"] or 0.0),
                format_percent(response["falls"]),
            )
        )
    print_table("changes of the command", ("", "s", "overshoot, %", "falls, %"), rows)
    for name, how in (("standing", ""), ("standing_without_creep", " without creep of the soles")):
        still = results[name]
        if still["most"] is not None:
            mean, most = (1e3 * x for x in (still["moved"]["mean"], still["most"]))
            print_text(
                f"at the command to stand{how} the trunk moves by {mean:.1f} mm in the mean of "
                f"{episodes} episodes, by {most:.1f} mm at most"
            )
    changing = results["changing"]
    low, high = (100 * end for end in changing["success_ci95"])
    print_text(
        f"{100 * changing['success']:.1f} % ({low:.1f} to {high:.1f}) of {changing['episodes']} "
        f"episodes of {changing['seconds']:g} s end without a fall, randomized, with commands that "
        "change"
    )


def draw_commands(results: dict[str, Any], gaits: list[dict[str, Any]], title: str) -> Figure:
    """Draw heat maps of errors over commands, responses to changes, and `gaits` by speed."""
    text = f"{title}: {results['episodes']} episodes of each command in MuJoCo C"
    figure = make_figure((15, 13), text)
    panels: Any = figure.subplots(3, 3).ravel()
    maps = (
        ("velocity_error", "velocity error, m/s", 0.5),
        ("yaw_rate_error", "yaw rate error, rad/s", 0.5),
    )
    cells = results["cells"]
    forward, turns = (sorted({cell["command"][part] for cell in cells}) for part in (0, 2))
    for axes, (name, heading, high) in zip(panels, maps, strict=False):
        values = np.full((len(turns), len(forward)), math.nan)
        for cell in cells:
            row, column = turns.index(cell["command"][2]), forward.index(cell["command"][0])
            values[row, column] = get_mean(cell[name])
        mesh = axes.pcolormesh(forward, turns, values, cmap="viridis_r", vmin=0.0, vmax=high)
        figure.colorbar(mesh, ax=axes)
        tidy(axes, heading)
        axes.set_xlabel("commanded forward velocity, m/s")
        axes.set_ylabel("commanded yaw rate, rad/s")
        axes.grid(visible=False)
    for axes, part, unit in ((panels[2], "forward", "m/s"), (panels[3], "yaw_rate", "rad/s")):
        _draw_responses(axes, part, unit, results["responses"])
    draw_gait_panels(list(panels[4:]), gaits)
    return figure


def _draw_responses(axes: Axes, part: str, unit: str, responses: list[dict[str, Any]]) -> None:
    """Draw how one component of the velocity follows changes of its command, over time.

    `part` is "forward", "lateral" or "yaw_rate"; rows are of `measure_response`.
    """
    tidy(axes, f"after a change of the command: {part.replace('_', ' ')}", unit)
    column = COMMANDED.index(part)
    for place, row in enumerate(row for row in responses if row["part"] == part):
        (color, _), before, after = get_style(place), row["before"][column], row["after"][column]
        time = WINDOW / 2 + row["dt"] * np.arange(len(row["curve"]))
        axes.plot(time, row["curve"], color=color, label=f"{before:.3g} to {after:.3g}")
        axes.axhline(after, color=color, linestyle="--", linewidth=1)
    axes.set_xlabel(f"time after the change, s; means of {WINDOW:g} s")
    axes.legend()
