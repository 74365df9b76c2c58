"""How far, how fast and with what effort an episode went, and how well it kept to its commands.

World frame: z up, x ahead.
"""

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from quadwalk.evaluation.motion.kinematics import roll_pitch_yaw, turned
from quadwalk.evaluation.rollout import Rollout
from quadwalk.physics.mujoco_c import randomize_masses
from quadwalk.robot.quadruped import Quadruped

LEAST_DISTANCE = 1.0  # m: over less, what is per meter says nothing
WINDOW = 0.5  # s, a stride or more: over it velocities are averaged, and a path is straight
SETTLING = 1.0  # s after the start and after each change of the command, not evaluated


def weight_of(rollout: Rollout, model: mujoco.MjModel) -> float:
    """N, of the robot of an episode; `model` is one of the robot as nothing was drawn for it."""
    drawn = rollout.conditions and rollout.conditions.variation
    masses = model.body_mass if drawn is None else randomize_masses(model, drawn)
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
    energy_per_meter: float  # J/m, positive mechanical work of the motors / distance


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
        energy_per_meter=float(rollout.energy.sum() / distance)
        if distance > LEAST_DISTANCE
        else math.nan,
    )


def heading_velocity(poses: np.ndarray, dt: float) -> np.ndarray:
    """(T, 3): what a velocity command is of, in each step between `poses`, which are `dt` s apart.

    Of `poses` (T + 1, 7 or more) the first seven are the trunk's position, m, and quaternion, wxyz.
    Forward and lateral velocity of the trunk, m/s, in the frame of the heading at the step's end,
    and yaw rate, rad/s: means over the step.
    """
    yaw = np.unwrap(roll_pitch_yaw(poses[:, 3:7])[:, 2])
    moved = turned(np.diff(poses[:, :2], axis=0).T / dt, -yaw[1:])
    return np.stack([*moved, np.diff(yaw) / dt], axis=1)


def tracking_errors(
    velocity: np.ndarray, command: np.ndarray, dt: float, apart: int = 1
) -> tuple[float, float]:
    """How far velocity (m/s) and yaw rate (rad/s) were from the commands; NaN where too short.

    `velocity` and `command` (T, 3) are as `heading_velocity`. The errors are the length of the
    difference, and its absolute value, between the velocity's mean over a `WINDOW` and the command:
    the mean over all windows, begun `apart` steps apart, in which one command holds and which begin
    `SETTLING` after it was given, or later.
    """
    settling, window = (round(s / dt) for s in (SETTLING, WINDOW))
    changes = np.flatnonzero(np.any(np.diff(command, axis=0), axis=1)) + 1
    parts = [part[settling:] for part in np.split(velocity - command, changes)]
    found = [window_means(part, window)[::apart] for part in parts if len(part) >= window]
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
    """Length of the trunk's path on the floor, m, in lines of `WINDOW`: swaying does not count."""
    every = max(round(WINDOW / rollout.control_dt), 1)
    points = np.concatenate([rollout.qpos[:-1:every, :2], rollout.qpos[-1:, :2]])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def action_rate(rollout: Rollout) -> float:
    """Root mean square rate of the actions, which are in [-1, 1], 1/s; NaN for a single step."""
    changes = np.diff(rollout.action.astype(float), axis=0) / rollout.control_dt
    return float(np.sqrt(np.mean(np.square(changes)))) if len(changes) else math.nan
