"""How well an episode followed its commands, and how far it went."""

import numpy as np

from quadwalk.evaluate import kinematics
from quadwalk.evaluate.rollout import Rollout

WINDOW = 0.5  # s, a stride or more: over it velocities are averaged, and a path is straight
SETTLING = 1.0  # s after the start and after each change of the command, not judged


def heading_velocity(rollout: Rollout) -> np.ndarray:
    """(T, 3): what a command is of, in each step.

    Velocity of the trunk forward and to the left, m/s, in the frame of the heading at the step's
    end, and the heading's rate to the left, rad/s: means over the step.
    """
    quat = kinematics.quat_normalised(rollout.qpos[:, 3:7])
    yaw = np.unwrap(kinematics.rpy_from_quat(quat)[:, 2])
    x, y = np.diff(rollout.qpos[:, :2], axis=0).T / rollout.control_dt
    cos, sin = np.cos(yaw[1:]), np.sin(yaw[1:])
    rate = np.diff(yaw) / rollout.control_dt
    return np.stack([cos * x + sin * y, cos * y - sin * x, rate], axis=1)


def tracking_errors(rollout: Rollout) -> tuple[float, float] | None:
    """How far velocity (m/s) and turning rate (rad/s) were from the commands; None where too short.

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
            sums = np.cumsum(np.concatenate([np.zeros((1, 3)), judged]), axis=0)
            found.append((sums[window:] - sums[:-window]) / window)
    if not found:
        return None
    means = np.concatenate(found)
    return float(np.linalg.norm(means[:, :2], axis=1).mean()), float(np.abs(means[:, 2]).mean())


def path_length(rollout: Rollout) -> float:
    """Length of the trunk's path on the floor, m, as straight lines of `WINDOW` each.

    So that swaying from step to step does not count.
    """
    every = max(round(WINDOW / rollout.control_dt), 1)
    points = np.concatenate([rollout.qpos[:-1:every, :2], rollout.qpos[-1:, :2]])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
