"""The robot of a task, and what the environment's functions need to know of it, as arrays."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from quadwalk.robot.quadruped import Quadruped
from quadwalk.task.config import EnvConfig


@dataclass(frozen=True)
class RobotArrays:
    """Constants of a quadruped; joints are in the order of `Quadruped`'s.

    Joint i is qpos[7 + i], qvel[6 + i] and ctrl[i].
    """

    home: np.ndarray  # (19,) qpos of the standing pose
    lower: np.ndarray  # (12,) rad
    upper: np.ndarray  # (12,) rad
    mass: float  # kg
    gravity: float  # m/s^2

    @property
    def weight(self) -> float:
        """Of the whole robot, N."""
        return self.mass * self.gravity

    @property
    def home_joints(self) -> np.ndarray:
        """(12,) joint angles of the standing pose, rad."""
        return self.home[7:]

    @property
    def home_height(self) -> float:
        """Height of the trunk's origin in the standing pose, m."""
        return float(self.home[2])


def task_robot(quadruped: Quadruped, config: EnvConfig) -> Quadruped:
    """The robot under the task's gravity, with the motors that the task gives it."""
    spec, effort = quadruped.spec.copy(), quadruped.effort
    spec.option.gravity[2] = -config.gravity
    if config.motor.effort is not None:
        effort = np.full(12, config.motor.effort)
        for name, most in zip(quadruped.joints, effort, strict=True):
            # The models have a motor's limit twice, for its control and for its joint.
            spec.actuator(name).ctrlrange = spec.joint(name).actfrcrange = [-most, most]
    return replace(quadruped, effort=effort, spec=spec)


def robot_arrays(quadruped: Quadruped, model: mujoco.MjModel) -> RobotArrays:
    """The constants of a quadruped and of a model built from it."""
    return RobotArrays(
        home=quadruped.home,
        lower=quadruped.lower,
        upper=quadruped.upper,
        mass=float(model.body_subtreemass[0]),
        gravity=float(-model.opt.gravity[2]),
    )
