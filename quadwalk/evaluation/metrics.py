"""Metrics of episodes: those of each one, and over all of them the mean with its uncertainty.

An episode runs along world x; with velocity commands its distance is that along its path. World
frame: z up, x ahead. Quaternions are wxyz. None stands in JSON for what cannot be measured.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np
import scipy  # its parts are imported when they are used: stats takes half a second
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from quadwalk.brax import State
from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.rollout import ActionFunction, Report, Rollout, roll_out_paths
from quadwalk.physics.mujoco_c import compute_randomized_masses
from quadwalk.robot.quadruped import Quadruped
from quadwalk.settings.terms import Reward

LEAST_DISTANCE = 1.0  # m: over less, what is per meter says nothing
WINDOW = 0.5  # s, a stride or more: over it velocities are averaged, and a path is straight
SETTLING = 1.0  # s after the start and after each change of the command, not evaluated
AT_LIMIT = 0.95  # of a motor's torque limit, as the mean over a control step, counts as at it


class Metric(NamedTuple):
    """A figure of an episode, as tables and metrics.json show it."""

    name: str  # in metrics.json
    heading: str  # in tables
    unit: str
    worst: Callable[[np.ndarray], float] = np.min  # the least favorable of several episodes


METRICS = (
    Metric("speed", "speed along x", "m/s"),
    Metric("distance", "distance along x", "m"),
    Metric("lateral_drift", "lateral drift", "m", np.max),
    Metric("heading_error", "mean heading error", "deg", np.max),
    Metric("velocity_error", "velocity error", "m/s", np.max),
    Metric("yaw_rate_error", "yaw rate error", "rad/s", np.max),
    Metric("path_speed", "speed along path", "m/s"),
    Metric("path", "path length", "m"),
    Metric("duration", "episode length", "s"),
    Metric("energy_per_meter", "energy per meter", "J/m", np.max),
    Metric("cost_of_transport", "cost of transport", "", np.max),
    Metric("power", "mean mechanical power", "W", np.max),
    Metric("peak_power", "peak mechanical power", "W", np.max),
    Metric("torque_limit", "time at a torque limit", "%", np.max),
    Metric("action_rate", "action rate", "1/s", np.max),
    Metric("reward", "reward per step", ""),
)


def compute_metrics(
    rollout: Rollout, rewards: Mapping[str, Reward], weight: float, effort: np.ndarray
) -> dict[str, Any]:
    """Return the metrics of one episode, as plain values for JSON.

    The robot weighs `weight` N, and its motors give `effort` (12,) Nm at most.

    - speed, distance, lateral_drift, duration, energy_per_meter: as in `Course`.
    - heading_error: mean |yaw|, deg. cost_of_transport: energy per meter over weight.
    - power, peak_power: positive mechanical power of all motors, W, mean and highest of a step.
    - torque_limit: % of steps in which a motor was at its limit. action_rate: root mean square
      of the actions' rate, which are in [-1, 1], 1/s.
    - reward/NAME: mean per step of a scaled term.

    With velocity commands path_speed, m/s, and path, m, are the `Course`'s speed and distance.
    They take the place of the first three and of the heading error. Besides there are
    velocity_error and yaw_rate_error, as of `compute_tracking_errors`, and the first command.
    """
    course = measure_course(rollout)
    load = np.abs(rollout.torque) / effort
    metrics: dict[str, Any]
    if rollout.command is None:
        yaw = to_roll_pitch_yaw(rollout.qpos[:, 3:7])[:, 2]
        metrics = {
            "speed": course.speed,
            "distance": course.distance,
            "lateral_drift": course.lateral_drift,
            "heading_error": float(np.degrees(np.abs(yaw).mean())),
        }
    else:
        velocity = compute_heading_velocity(rollout.qpos, rollout.control_dt)
        errors = compute_tracking_errors(velocity, rollout.command, rollout.control_dt)
        metrics = {
            "velocity_error": to_json_number(errors[0]),
            "yaw_rate_error": to_json_number(errors[1]),
            "path_speed": course.speed,
            "path": course.distance,
            "command": np.asarray(rollout.command[0], float).tolist(),
        }
    return {
        "episode": rollout.episode,
        "end": rollout.end,
        "fell": rollout.fell,
        **metrics,
        "duration": course.duration,
        "energy_per_meter": to_json_number(course.energy_per_meter),
        "cost_of_transport": to_json_number(course.energy_per_meter / weight),
        "power": float(rollout.energy.mean() / rollout.control_dt),
        "peak_power": float(rollout.energy.max() / rollout.control_dt),
        "torque_limit": float(100.0 * np.any(load >= AT_LIMIT, axis=1).mean()),
        "action_rate": to_json_number(compute_action_rate(rollout)),
        "reward": float(rollout.reward.mean()),
        **{
            f"reward/{name}": float(rewards[name].scale * values.mean())
            for name, values in rollout.reward_terms.items()
        },
    }


def summarize_episodes(episodes: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the falls, and of each metric mean, median, worst and the mean's uncertainty.

    `ci95` is half the width of the mean's 95 % confidence interval. `fall_rate_ci95` are the ends
    of the interval of the share of falls. `worst` is the least favorable episode's: the highest of
    metrics that are better low, the lowest of the others.
    """
    falls = sum(episode["fell"] for episode in episodes)
    summary: dict[str, Any] = {
        "episodes": len(episodes),
        "fall_rate": falls / len(episodes),
        "fall_rate_ci95": list(compute_share_interval(falls, len(episodes))),
    }
    terms = [Metric(name, name, "") for name in episodes[0] if name.startswith("reward/")]
    for name, _, _, worst in (*METRICS, *terms):
        if name not in episodes[0]:
            continue
        values = np.array([e[name] for e in episodes if e[name] is not None], float)
        if not len(values):
            summary[name] = None
            continue
        mean, half_width = compute_mean_interval(values)
        summary[name] = {
            "mean": mean,
            "median": float(np.median(values)),
            "worst": float(worst(values)),
            "ci95": half_width,
        }
    return summary


def compare_engines(mjx: dict[str, Any], mujoco: dict[str, Any]) -> dict[str, Any]:
    """Return the differences of MuJoCo C's summary from MJX's: of falls and the means of metrics.

    `difference` is in the metric's unit (a share for `fall_rate`), `percent` of the size of MJX's
    value. Both are None if one of the two has no value; `percent` also if MJX's is 0.
    """
    means = {"fall_rate": (mjx["fall_rate"], mujoco["fall_rate"])}
    for name, *_ in METRICS:
        if name in mjx:
            means[name] = (get_mean(mjx[name]), get_mean(mujoco[name]))
    return {
        name: {
            "difference": to_json_number(second - first),
            "percent": to_json_number(100 * (second - first) / abs(first)) if first else None,
        }
        for name, (first, second) in means.items()
    }


def find_typical_episode(episodes: Sequence[dict[str, Any]]) -> int:
    """Return the index of the episode of median speed: the one to look at."""
    speed = "speed" if "speed" in episodes[0] else "path_speed"
    order = np.argsort([episode[speed] for episode in episodes], kind="stable")
    return int(order[len(order) // 2])


def name_engines(results: Sequence[dict[str, Any]]) -> str:
    """Return the names of the engines of several metrics.json, joined for a title."""
    return " and ".join(dict.fromkeys(result["engine"] for result in results))


# Many episodes in cells of equal size: kinds of terrain, commands, conditions.

# Takes an episode's number, True if it did not end by a fall, and its trunk's poses (T + 1, 7).
# They are in m and wxyz. Returns the episode's figures.
Measure = Callable[[int, bool, np.ndarray], dict[str, float | bool]]


def measure_cells(
    env: QuadrupedEnv,
    policy: ActionFunction,
    starts: State,
    episodes: int,
    measure: Measure,
    room: int | None = None,
    report: Report | None = None,
) -> list[dict[str, Any]]:
    """Return success and figures of each cell: `episodes` successive rows of `starts` (n, ...).

    `success` is the share without a fall, `success_ci95` its interval. The other figures are those
    of `measure`: a number becomes its `summarize_values`, a bool its share. At most `room` episodes
    run at a time, by default all.
    """
    figures: dict[int, dict[str, float | bool]] = {}
    room = room and min(room, len(starts.obs))
    for number, upright, poses in roll_out_paths(env, policy, starts, room, report):
        figures[number] = {"success": upright} | measure(number, upright, poses)
    return [
        _summarize_cell([figures[start + k] for k in range(episodes)])
        for start in range(0, len(figures), episodes)
    ]


def _summarize_cell(episodes: Sequence[dict[str, float | bool]]) -> dict[str, Any]:
    """Return the figures of one cell: of each number its mean and interval, of each bool its share.

    `episodes` are the figures of its episodes by name; `success_ci95` is added.
    """
    summary: dict[str, Any] = {}
    for name, example in episodes[0].items():
        values = [figures[name] for figures in episodes]
        is_share = isinstance(example, bool)
        summary[name] = sum(values) / len(values) if is_share else summarize_values(values)
    successes = sum(bool(figures["success"]) for figures in episodes)
    return summary | {"success_ci95": list(compute_share_interval(successes, len(episodes)))}


# The course of an episode.


@dataclass(frozen=True)
class Course:
    """How far an episode went and what that took; NaN where it cannot be measured."""

    duration: float  # s
    distance: float  # m, displacement along world x; with commands, length of the path
    speed: float  # m/s, distance / duration
    lateral_drift: float  # m, size of the displacement along world y
    energy_per_meter: float  # J/m, positive mechanical work of the motors / distance


def measure_course(rollout: Rollout) -> Course:
    """Measure an episode's duration, distance, speed, lateral drift and energy per meter."""
    duration = rollout.steps * rollout.control_dt
    along, across = (rollout.qpos[-1, :2] - rollout.qpos[0, :2]).astype(float)
    distance = float(along if rollout.command is None else measure_path(rollout))
    return Course(
        duration=duration,
        distance=distance,
        speed=distance / duration if duration else math.nan,
        lateral_drift=float(abs(across)),
        energy_per_meter=float(rollout.energy.sum() / distance)
        if distance > LEAST_DISTANCE
        else math.nan,
    )


def measure_path(rollout: Rollout) -> float:
    """Return the length of the trunk's path on the floor, m, without the sway of strides.

    It is made of straight lines of `WINDOW` each.
    """
    every = max(round(WINDOW / rollout.control_dt), 1)
    points = np.concatenate([rollout.qpos[:-1:every, :2], rollout.qpos[-1:, :2]])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def compute_action_rate(rollout: Rollout) -> float:
    """Return the root mean square rate of the actions, 1/s; NaN for a single step.

    Actions are in [-1, 1].
    """
    changes = np.diff(rollout.action.astype(float), axis=0) / rollout.control_dt
    return float(np.sqrt(np.mean(np.square(changes)))) if len(changes) else math.nan


def compute_weight(rollout: Rollout, model: mujoco.MjModel) -> float:
    """Return the weight of an episode's robot, N; `model` is the robot without randomization."""
    variation = rollout.conditions and rollout.conditions.variation
    masses = model.body_mass if variation is None else compute_randomized_masses(model, variation)
    return float(-model.opt.gravity[2] * masses.sum())


def compute_motor_limits(rollout: Rollout, quadruped: Quadruped) -> np.ndarray:
    """Return the torque limits of the motors in an episode, (12,) Nm, as it randomized them."""
    variation = rollout.conditions and rollout.conditions.variation
    if variation is None:
        return quadruped.effort
    return quadruped.effort * np.asarray(variation.strength)


# Velocities and how well they follow commands.


def compute_heading_velocity(poses: np.ndarray, dt: float) -> np.ndarray:
    """Return forward and lateral velocity and yaw rate of a trunk, (T, 3) m/s and rad/s.

    Velocity commands are of these. `poses` (T + 1, 7 or more) begin with the trunk's position, m,
    and quaternion, and are `dt` s apart. The velocities are means over each step, in the frame of
    the heading at its end.
    """
    yaw = np.unwrap(to_roll_pitch_yaw(poses[:, 3:7])[:, 2])
    velocity = rotate_planar(np.diff(poses[:, :2], axis=0).T / dt, -yaw[1:])
    return np.stack([*velocity, np.diff(yaw) / dt], axis=1)


def compute_tracking_errors(
    velocity: np.ndarray, command: np.ndarray, dt: float, apart: int = 1
) -> tuple[float, float]:
    """Return the mean errors of velocity, m/s, and yaw rate, rad/s; NaN where too short.

    `velocity` and `command` (T, 3) are as of `compute_heading_velocity`. The errors compare the
    command with the velocity's mean over a `WINDOW`. Windows begin `apart` steps apart, and in each
    of them one command holds. None begins within `SETTLING` after a change of the command.
    """
    settling, window = (round(s / dt) for s in (SETTLING, WINDOW))
    changes = np.flatnonzero(np.any(np.diff(command, axis=0), axis=1)) + 1
    parts = [part[settling:] for part in np.split(velocity - command, changes)]
    errors = [average_windows(part, window)[::apart] for part in parts if len(part) >= window]
    if not errors:
        return math.nan, math.nan
    means = np.concatenate(errors)
    return float(np.linalg.norm(means[:, :2], axis=1).mean()), float(np.abs(means[:, 2]).mean())


def average_windows(values: np.ndarray, window: int) -> np.ndarray:
    """Return the means (T - window + 1, n) of `values` (T, n) over all `window` successive rows."""
    sums = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), values]), axis=0)
    means: np.ndarray = (sums[window:] - sums[:-window]) / window
    return means


# Rotations.


def to_rotations(quat: np.ndarray) -> Rotation:
    """Return quaternions `quat` (T, 4), wxyz and of any norm, as rotations.

    Zeros and NaN become the identity.
    """
    quat = np.asarray(quat, dtype=float)
    is_rotation = np.linalg.norm(quat, axis=1, keepdims=True) > mujoco.mjMINVAL
    quat = np.where(is_rotation, quat, [1.0, 0.0, 0.0, 0.0])
    return Rotation.from_quat(quat, scalar_first=True)


def to_roll_pitch_yaw(quat: np.ndarray) -> np.ndarray:
    """Return roll, pitch and yaw (T, 3), rad, of quaternions `quat` (T, 4), wxyz.

    The rotation is Rz(yaw) Ry(pitch) Rx(roll).
    """
    return to_rotations(quat).as_euler("xyz", suppress_warnings=True)


def rotate_planar(vector: ArrayLike, angle: ArrayLike) -> np.ndarray:
    """Rotate `vector` (2, ...), along x and y, to the left by `angle` (...), rad."""
    (x, y), cos, sin = np.asarray(vector), np.cos(angle), np.sin(angle)
    return np.stack([cos * x - sin * y, sin * x + cos * y])


# Means and shares with their 95 % confidence intervals, as values for JSON.


def to_json_number(value: float) -> float | None:
    """Return `value`, or None for NaN and infinity, which JSON does not have."""
    return float(value) if math.isfinite(value) else None


def get_mean(figure: dict[str, Any] | None) -> float:
    """Return the mean in `figure`, an entry of `summarize_values`; NaN if it is None."""
    return math.nan if figure is None else figure["mean"]


def compute_mean_interval(
    values: Sequence[float] | np.ndarray,
) -> tuple[float, float | None]:
    """Return the mean of finite values, and half its 95 % interval by Student's t.

    A single value has no interval: None.
    """
    mean, freedom = float(np.mean(values)), len(values) - 1
    if not freedom:
        return mean, None
    return mean, float(scipy.stats.t.ppf(0.975, freedom) * scipy.stats.sem(values))


def summarize_values(values: Sequence[float] | np.ndarray) -> dict[str, float | None] | None:
    """Return mean and interval (`compute_mean_interval`) of the finite values; None without any."""
    finite = np.asarray(values)[np.isfinite(values)]
    if not len(finite):
        return None
    mean, half_width = compute_mean_interval(finite)
    return {"mean": mean, "ci95": half_width}


def compute_share_interval(count: int, total: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of the share `count` of `total`.

    It is Wilson's (J. American Statistical Association 22, 1927), which does not claim certainty
    where none or all of a few succeeded.
    """
    interval = scipy.stats.binomtest(count, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)
