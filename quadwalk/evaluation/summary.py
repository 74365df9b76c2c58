"""Figures of episodes: each one's, and over all of them the mean with its uncertainty.

An episode runs along world x; with velocity commands its distance is that along its path. In what
is written as JSON, None stands for what cannot be measured.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadwalk.evaluation.motion.course import (
    action_rate,
    heading_velocity,
    measure_course,
    tracking_errors,
)
from quadwalk.evaluation.motion.kinematics import roll_pitch_yaw
from quadwalk.evaluation.rollout import Rollout
from quadwalk.evaluation.statistics import figure_mean, mean_interval, number, share_interval
from quadwalk.settings.terms import Reward


class Figure(NamedTuple):
    name: str  # in metrics.json
    heading: str  # in tables
    unit: str
    worst: Callable[[np.ndarray], float] = np.min  # of several episodes' the least favorable


FIGURES = (
    Figure("speed", "speed along x", "m/s"),
    Figure("distance", "distance along x", "m"),
    Figure("lateral_drift", "lateral drift", "m", np.max),
    Figure("heading_error", "mean heading error", "deg", np.max),
    Figure("velocity_error", "velocity error", "m/s", np.max),
    Figure("yaw_rate_error", "yaw rate error", "rad/s", np.max),
    Figure("path_speed", "speed along path", "m/s"),
    Figure("path", "path length", "m"),
    Figure("duration", "episode length", "s"),
    Figure("energy_per_meter", "energy per meter", "J/m", np.max),
    Figure("cost_of_transport", "cost of transport", "", np.max),
    Figure("power", "mean mechanical power", "W", np.max),
    Figure("peak_power", "peak mechanical power", "W", np.max),
    Figure("torque_limit", "time at a torque limit", "%", np.max),
    Figure("action_rate", "action rate", "1/s", np.max),
    Figure("reward", "reward per step", ""),
)
AT_LIMIT = 0.95  # of a motor's torque limit, as the mean over a control step, counts as at it


def episode_figures(
    rollout: Rollout, rewards: Mapping[str, Reward], weight: float, effort: np.ndarray
) -> dict[str, Any]:
    """Figures of one episode of a robot of so many N and motors of `effort` (12,) Nm, for JSON.

    speed, distance, lateral_drift, duration, energy_per_meter: as in `Course`; heading_error: mean
    |yaw|, deg; cost_of_transport: energy per meter over weight; power, peak_power: positive
    mechanical power of all motors, W, mean and highest of a control step; torque_limit: % of steps
    in which a motor was at its limit; action_rate: root mean square of the actions' rate, which are
    in [-1, 1], 1/s; reward/NAME: mean per step of a scaled term. With velocity commands there are,
    in place of the first three and the heading error: path_speed, m/s, and path, m, which are the
    `Course`'s speed and distance; velocity_error, m/s, and yaw_rate_error, rad/s, as in
    `tracking_errors`; command: the first.
    """
    course = measure_course(rollout)
    loaded = np.abs(rollout.torque) / effort
    figures: dict[str, Any]
    if rollout.command is None:
        yaw = roll_pitch_yaw(rollout.qpos[:, 3:7])[:, 2]
        figures = {
            "speed": course.speed,
            "distance": course.distance,
            "lateral_drift": course.lateral_drift,
            "heading_error": float(np.degrees(np.abs(yaw).mean())),
        }
    else:
        velocity = heading_velocity(rollout.qpos, rollout.control_dt)
        errors = tracking_errors(velocity, rollout.command, rollout.control_dt)
        figures = {
            "velocity_error": number(errors[0]),
            "yaw_rate_error": number(errors[1]),
            "path_speed": course.speed,
            "path": course.distance,
            "command": np.asarray(rollout.command[0], float).tolist(),
        }
    return {
        "episode": rollout.episode,
        "end": rollout.end,
        "fell": rollout.fell,
        **figures,
        "duration": course.duration,
        "energy_per_meter": number(course.energy_per_meter),
        "cost_of_transport": number(course.energy_per_meter / weight),
        "power": float(rollout.energy.mean() / rollout.control_dt),
        "peak_power": float(rollout.energy.max() / rollout.control_dt),
        "torque_limit": float(100.0 * np.any(loaded >= AT_LIMIT, axis=1).mean()),
        "action_rate": number(action_rate(rollout)),
        "reward": float(rollout.reward.mean()),
        **{
            f"reward/{name}": float(rewards[name].scale * values.mean())
            for name, values in rollout.reward_terms.items()
        },
    }


def summarize(episodes: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Over all episodes: falls, and of each figure mean, median, worst and the mean's uncertainty.

    `ci95` is half the width of the 95 % confidence interval of the mean, `fall_rate_ci95` the ends
    of that of the share of falls. `worst` is the least favorable episode's: the highest of
    figures that are better low, the lowest of the others.
    """
    falls = sum(episode["fell"] for episode in episodes)
    summary: dict[str, Any] = {
        "episodes": len(episodes),
        "fall_rate": falls / len(episodes),
        "fall_rate_ci95": list(share_interval(falls, len(episodes))),
    }
    terms = [Figure(name, name, "") for name in episodes[0] if name.startswith("reward/")]
    for name, _, _, worst in (*FIGURES, *terms):
        if name not in episodes[0]:
            continue
        values = np.array([e[name] for e in episodes if e[name] is not None], float)
        if not len(values):
            summary[name] = None
            continue
        mean, half_width = mean_interval(values)
        summary[name] = {
            "mean": mean,
            "median": float(np.median(values)),
            "worst": float(worst(values)),
            "ci95": half_width,
        }
    return summary


def engine_differences(mjx: dict[str, Any], mujoco: dict[str, Any]) -> dict[str, Any]:
    """Of falls and each figure's mean in two summaries, MuJoCo C's less MJX's.

    `difference` in the figure's own unit (of `fall_rate`, a share), `percent` of the size of MJX's;
    None where one of the two has no figure, or MJX's is 0.
    """
    means = {
        name: (figure_mean(mjx[name]), figure_mean(mujoco[name]))
        for name, *_ in FIGURES
        if name in mjx
    }
    means = {"fall_rate": (mjx["fall_rate"], mujoco["fall_rate"]), **means}
    return {
        name: {
            "difference": number(second - first),
            "percent": number(100 * (second - first) / abs(first)) if first else None,
        }
        for name, (first, second) in means.items()
    }


def typical_episode(episodes: Sequence[dict[str, Any]]) -> int:
    """Index of the episode of median speed: the one to look at."""
    speed = "speed" if "speed" in episodes[0] else "path_speed"
    order = np.argsort([episode[speed] for episode in episodes], kind="stable")
    return int(order[len(order) // 2])


def engines_of(results: Sequence[dict[str, Any]]) -> str:
    """The engines of these metrics, in words."""
    return " and ".join(dict.fromkeys(result["engine"] for result in results))
