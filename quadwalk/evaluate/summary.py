"""Figures of episodes: each one's, and over all of them the mean with its uncertainty.

An episode runs along world x, or, with velocity commands, where it is told, so that its distance is
then that along its path. In what is written as JSON, None stands for what cannot be measured.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from quadwalk.evaluate.motion.kinematics import roll_pitch_yaw
from quadwalk.evaluate.rollout import Rollout
from quadwalk.physics.mujoco_c import varied_masses
from quadwalk.robot.quadruped import Quadruped
from quadwalk.task.terms import Reward

LEAST_DISTANCE = 1.0  # m: over less, what is per metre says nothing
WINDOW = 0.5  # s, a stride or more: over it velocities are averaged, and a path is straight
SETTLING = 1.0  # s after the start and after each change of the command, not judged

# name in metrics.json, heading in the table, unit
FIGURES = (
    ("speed", "speed along x", "m/s"),
    ("distance", "distance along x", "m"),
    ("lateral_drift", "lateral drift", "m"),
    ("heading_error", "mean heading error", "deg"),
    ("velocity_error", "velocity error", "m/s"),
    ("yaw_rate_error", "yaw rate error", "rad/s"),
    ("path_speed", "speed along path", "m/s"),
    ("path", "path length", "m"),
    ("duration", "episode length", "s"),
    ("energy_per_metre", "energy per metre", "J/m"),
    ("cost_of_transport", "cost of transport", ""),
    ("power", "mean mechanical power", "W"),
    ("peak_power", "peak mechanical power", "W"),
    ("torque_limit", "time at a torque limit", "%"),
    ("action_rate", "action rate", "1/s"),
    ("reward", "reward per step", ""),
)
HIGH_IS_BAD = (
    *("lateral_drift", "heading_error", "velocity_error", "yaw_rate_error"),
    *("energy_per_metre", "cost_of_transport", "power", "peak_power"),
    *("torque_limit", "action_rate"),
)
AT_LIMIT = 0.95  # of a motor's torque limit, as the mean over a control step, counts as at it


def weight_of(rollout: Rollout, model: mujoco.MjModel) -> float:
    """N, of the robot of an episode; `model` is one of the robot as nothing was drawn for it."""
    drawn = rollout.conditions and rollout.conditions.variation
    masses = model.body_mass if drawn is None else varied_masses(model, drawn)
    return float(-model.opt.gravity[2] * masses.sum())


def motor_limits(rollout: Rollout, quadruped: Quadruped) -> np.ndarray:
    """(12,) Nm: the largest torques of the motors of an episode."""
    drawn = rollout.conditions and rollout.conditions.variation
    return quadruped.effort if drawn is None else quadruped.effort * np.asarray(drawn.strength)


@dataclass(frozen=True)
class Course:
    """How far an episode went and what that took; NaN where it cannot be measured."""

    duration: float  # s
    distance: float  # m, displacement along world x; with commands, length of the path
    speed: float  # m/s, distance / duration
    lateral_drift: float  # m, size of the displacement along world y
    energy_per_metre: float  # J/m, positive mechanical work of the motors / distance


def measure_course(rollout: Rollout) -> Course:
    """The course of an episode of finite states."""
    duration = rollout.steps * rollout.control_dt
    along, across = (rollout.qpos[-1, :2] - rollout.qpos[0, :2]).astype(float)
    distance = float(along if rollout.command is None else path_length(rollout))
    return Course(
        duration=duration,
        distance=distance,
        speed=distance / duration if duration else math.nan,
        lateral_drift=float(abs(across)),
        energy_per_metre=float(rollout.energy.sum() / distance)
        if distance > LEAST_DISTANCE
        else math.nan,
    )


def heading_velocity(rollout: Rollout) -> np.ndarray:
    """(T, 3): what a velocity command is of, in each step.

    Forward and lateral velocity of the trunk, m/s, in the frame of the heading at the step's end,
    and yaw rate, rad/s: means over the step.
    """
    return velocity_of(rollout.qpos, rollout.control_dt)


def velocity_of(poses: np.ndarray, dt: float) -> np.ndarray:
    """`heading_velocity` (T, 3) of a trunk at `poses` (T + 1, 7 or more: m, wxyz), `dt` s apart."""
    yaw = np.unwrap(roll_pitch_yaw(poses[:, 3:7])[:, 2])
    x, y = np.diff(poses[:, :2], axis=0).T / dt
    cos, sin = np.cos(yaw[1:]), np.sin(yaw[1:])
    rate = np.diff(yaw) / dt
    return np.stack([cos * x + sin * y, cos * y - sin * x, rate], axis=1)


def tracking_errors(rollout: Rollout) -> tuple[float, float]:
    """How far velocity (m/s) and yaw rate (rad/s) were from the commands; NaN where too short.

    The length of the difference, and its absolute value, between what `heading_velocity` is on
    average over a `WINDOW` and the command: the mean over all windows in which one command holds
    and which begin `SETTLING` after it was given, or later.
    """
    assert rollout.command is not None
    settling, window = (round(s / rollout.control_dt) for s in (SETTLING, WINDOW))
    errors = heading_velocity(rollout) - rollout.command
    changes = np.flatnonzero(np.any(np.diff(rollout.command, axis=0), axis=1)) + 1
    found = []
    for part in np.split(errors, changes):
        judged = part[settling:]
        if len(judged) >= window:
            found.append(window_means(judged, window))
    if not found:
        return math.nan, math.nan
    means = np.concatenate(found)
    return float(np.linalg.norm(means[:, :2], axis=1).mean()), float(np.abs(means[:, 2]).mean())


def window_means(values: np.ndarray, window: int) -> np.ndarray:
    """(T - window + 1, n) means of `values` (T, n) over every `window` rows on end."""
    sums = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), values]), axis=0)
    means: np.ndarray = (sums[window:] - sums[:-window]) / window
    return means


def path_length(rollout: Rollout) -> float:
    """Length of the trunk's path on the floor, m, as straight lines of `WINDOW` each.

    So that swaying from step to step does not count.
    """
    every = max(round(WINDOW / rollout.control_dt), 1)
    points = np.concatenate([rollout.qpos[:-1:every, :2], rollout.qpos[-1:, :2]])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def episode_figures(
    rollout: Rollout, rewards: Mapping[str, Reward], weight: float, effort: np.ndarray
) -> dict[str, Any]:
    """Figures of one episode of a robot of so many N and motors of `effort` (12,) Nm, for JSON.

    speed, distance, lateral_drift, duration, energy_per_metre: as in `Course`; heading_error: mean
    |yaw|, deg; cost_of_transport: energy per metre over weight; power, peak_power: positive
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
        velocity_error, yaw_rate_error = tracking_errors(rollout)
        figures = {
            "velocity_error": number(velocity_error),
            "yaw_rate_error": number(yaw_rate_error),
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
        "energy_per_metre": number(course.energy_per_metre),
        "cost_of_transport": number(course.energy_per_metre / weight),
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


def action_rate(rollout: Rollout) -> float:
    """Root mean square rate of the actions, which are in [-1, 1], 1/s; NaN for a single step."""
    changes = np.diff(rollout.action.astype(float), axis=0) / rollout.control_dt
    return float(np.sqrt(np.mean(np.square(changes)))) if len(changes) else math.nan


def number(value: float) -> float | None:
    """`value` for JSON, which knows no NaN."""
    return float(value) if math.isfinite(value) else None


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
        mean, half_width = mean_interval(values)
        summary[name] = {
            "mean": mean,
            "median": float(np.median(values)),
            "worst": float(values.max() if name in HIGH_IS_BAD else values.min()),
            "ci95": half_width,
        }
    return summary


def mean_interval(values: Sequence[float] | np.ndarray) -> tuple[float, float | None]:
    """The mean, and half the width of its 95 % confidence interval by Student's t.

    None in its place for a single value. Values must be there and finite.
    """
    from scipy import stats  # half a second, which those that measure nothing need not wait

    mean, freedom = float(np.mean(values)), len(values) - 1
    if not freedom:
        return mean, None
    return mean, float(stats.t.ppf(0.975, freedom) * stats.sem(values))


def mean_figure(values: Sequence[float] | np.ndarray) -> dict[str, float | None] | None:
    """The `mean_interval` of those `values` that are finite, for JSON; None where none is."""
    finite = np.asarray(values)[np.isfinite(values)]
    if not len(finite):
        return None
    mean, half_width = mean_interval(finite)
    return {"mean": mean, "ci95": half_width}


def share_interval(count: int, total: int) -> tuple[float, float]:
    """The 95 % confidence interval of a share, `count` of `total`.

    Wilson's (J. American Statistical Association 22, 1927), which does not claim certainty where
    none or all of a few succeeded.
    """
    from scipy import stats

    interval = stats.binomtest(count, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def engine_differences(mjx: dict[str, Any], mujoco: dict[str, Any]) -> dict[str, Any]:
    """Of falls and each figure's mean in two summaries, MuJoCo C's less MJX's.

    `difference` in the figure's own unit (of `fall_rate`, a share), `percent` of the size of MJX's;
    None where one of the two has no figure, or MJX's is 0.
    """
    means = {
        name: (figure_mean(mjx[name]), figure_mean(mujoco[name]))
        for name, _, _ in FIGURES
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


def figure_mean(figure: dict[str, Any] | None) -> float:
    """The mean of a summary's figure; NaN where there is none."""
    return math.nan if figure is None else figure["mean"]


def typical_episode(episodes: Sequence[dict[str, Any]]) -> int:
    """Index of the episode of median speed: the one to look at."""
    speed = "speed" if "speed" in episodes[0] else "path_speed"
    order = np.argsort([episode[speed] for episode in episodes], kind="stable")
    return int(order[len(order) // 2])
