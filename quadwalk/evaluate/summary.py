"""Figures of many episodes: each one's, and over all of them the mean with its uncertainty."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from quadwalk.evaluate.gait import Gait
from quadwalk.evaluate.kinematics import rpy_from_quat
from quadwalk.evaluate.rollout import Rollout
from quadwalk.evaluate.statistics import mean_interval, share_interval
from quadwalk.evaluate.tracking import path_length, tracking_errors
from quadwalk.task.config import RewardConfig

# name in metrics.json, heading in the table, unit
FIGURES = (
    ("speed", "speed along x", "m/s"),
    ("distance", "distance along x", "m"),
    ("sideways", "sideways drift", "m"),
    ("heading", "mean heading error", "deg"),
    ("velocity_error", "velocity error", "m/s"),
    ("turning_error", "turning error", "rad/s"),
    ("path_speed", "speed along path", "m/s"),
    ("path", "path length", "m"),
    ("duration", "episode length", "s"),
    ("energy_per_metre", "energy per metre", "J/m"),
    ("cost_of_transport", "cost of transport", ""),
    ("reward", "reward per step", ""),
)
HIGH_IS_BAD = (
    *("sideways", "heading", "velocity_error", "turning_error"),
    *("energy_per_metre", "cost_of_transport"),
)


def episode_figures(rollout: Rollout, scales: RewardConfig, weight: float) -> dict[str, Any]:
    """Figures of one episode of a robot of so many N.

    speed: distance along world x over duration, m/s, from a standing start. sideways: |y| gained,
    m. heading: mean |yaw|, deg. With commands, in place of these: velocity_error, m/s, and
    turning_error, rad/s, as in `tracking_errors`; path, m, as in `path_length`; path_speed: path
    over duration, m/s; command: the first. energy_per_metre: positive mechanical work of the
    motors over distance or path, J/m; cost_of_transport: the same over weight. reward/NAME: mean
    per step of a scaled term.
    """
    duration = rollout.steps * rollout.control_dt
    course: dict[str, Any]
    if rollout.command is None:
        distance, sideways = rollout.qpos[-1, :2] - rollout.qpos[0, :2]
        yaw = rpy_from_quat(rollout.qpos[:, 3:7])[:, 2]
        course = {
            "speed": distance / duration,
            "distance": float(distance),
            "sideways": float(abs(sideways)),
            "heading": float(np.degrees(np.abs(yaw).mean())),
        }
    else:
        distance = path_length(rollout)
        velocity_error, turning_error = tracking_errors(rollout) or (None, None)
        course = {
            "velocity_error": velocity_error,
            "turning_error": turning_error,
            "path_speed": distance / duration,
            "path": distance,
            "command": np.asarray(rollout.command[0], float).tolist(),
        }
    # Over less than a metre, a cost per metre says nothing.
    energy = float(rollout.energy.sum() / distance) if distance > 1.0 else None
    terms = {
        f"reward/{name}": float(getattr(scales, name) * values.mean())
        for name, values in rollout.reward_terms.items()
    }
    return {
        "episode": rollout.episode,
        "end": rollout.end,
        "fell": rollout.fell,
        **course,
        "duration": duration,
        "energy_per_metre": energy,
        "cost_of_transport": None if energy is None else energy / weight,
        "reward": float(rollout.reward.mean()),
        **terms,
    }


def summarise(episodes: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Over all episodes: falls, and of each figure mean, median, worst and the mean's uncertainty.

    `ci95` is half the width of the 95 % confidence interval of the mean, `fall_rate_ci95` the ends
    of that of the share of falls. `worst` is the least favourable episode's: the highest of
    `HIGH_IS_BAD`, the lowest of the others.
    """
    falls = sum(episode["fell"] for episode in episodes)
    summary: dict[str, Any] = {
        "episodes": len(episodes),
        "fall_rate": falls / len(episodes),
        "fall_rate_ci95": list(share_interval(falls, len(episodes))),
    }
    names = [name for name, _, _ in FIGURES if name in episodes[0]]
    names += [name for name in episodes[0] if name.startswith("reward/")]
    for name in names:
        values = np.array([e[name] for e in episodes if e[name] is not None], float)
        if not len(values):
            summary[name] = None
            continue
        high_is_bad = name in HIGH_IS_BAD
        mean, half_width = mean_interval(values)
        summary[name] = {
            "mean": mean,
            "median": float(np.median(values)),
            "worst": float(values.max() if high_is_bad else values.min()),
            "ci95": half_width,
        }
    return summary


def typical_episode(episodes: Sequence[dict[str, Any]]) -> int:
    """Index of the episode of median speed: the one to look at."""
    speed = "speed" if "speed" in episodes[0] else "path_speed"
    order = np.argsort([episode[speed] for episode in episodes], kind="stable")
    return int(order[len(order) // 2])


def describe_gait(gait: Gait, episode: int) -> str:
    """The gait of one episode in a line or two."""
    return (
        f"gait of episode {episode}: {gait.gait}, {gait.stride_frequency:.2f} strides/s of "
        f"{gait.stride_length:.2f} m, duty factor {np.mean(gait.duty_factor):.2f}, "
        f"swing height {100 * np.min(gait.swing_height):.1f} cm or more, "
        f"slip up to {100 * np.max(gait.slip_share):.1f} % of the distance, "
        f"cost of transport {gait.cost_of_transport:.2f}\n"
        f"of their limits, at most: torque {100 * np.max(gait.torque_peak):.0f} %, "
        f"joint speed {100 * np.max(gait.joint_speed_peak):.0f} %; "
        f"actions change at {gait.action_rate:.1f}/s (root mean square; they are in [-1, 1])"
    )


def print_table(summary: dict[str, Any], title: str) -> None:
    """The summary as a table on standard output."""
    table = Table(title=title, title_justify="left")
    for heading in ("", "mean", "± 95 %", "median", "worst", "unit"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    falls = summary["fall_rate"] * summary["episodes"]
    low, high = summary["fall_rate_ci95"]
    table.add_row(
        "falls",
        f"{100 * summary['fall_rate']:.1f}",
        f"{100 * low:.0f} to {100 * high:.0f}",
        "",
        "",
        f"% ({falls:.0f} episodes)",
    )
    rows = [row for row in FIGURES if row[0] in summary]
    rows += [(n, f"  {n.partition('/')[2]}", "") for n in summary if n.startswith("reward/")]
    for name, heading, unit in rows:
        figure = summary[name]
        if figure is None:
            table.add_row(heading, "-", "", "", "", unit)
            continue
        ci = "" if figure["ci95"] is None else f"{figure['ci95']:.3f}"
        values = [f"{figure[key]:.3f}" for key in ("mean", "median", "worst")]
        table.add_row(heading, values[0], ci, *values[1:], unit)
    Console().print(table)


def figure_text(figure: dict[str, Any] | None) -> str:
    """A figure of a summary as "mean ± half its 95 % interval"; "-" where there is none."""
    if figure is None:
        return "-"
    # As many decimals as leave the mean four digits, up to three.
    decimals = 3 - min(len(f"{abs(figure['mean']):.0f}") - 1, 3)
    text = f"{figure['mean']:.{decimals}f}"
    return text if figure["ci95"] is None else f"{text} ± {figure['ci95']:.{decimals}f}"


def falls_text(summary: dict[str, Any]) -> str:
    """The share of falls in percent, and its 95 % interval."""
    low, high = (100 * end for end in summary["fall_rate_ci95"])
    return f"{100 * summary['fall_rate']:.1f} ({low:.0f} to {high:.0f})"
