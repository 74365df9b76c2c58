"""The robot of a task, and what the environment's functions need to know of it, as arrays."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from quadwalk.robot.quadruped import Quadruped
from quadwalk.robot.scene import CORNERS, KNEES


@dataclass(frozen=True)
class RobotArrays:
    """Constants of a quadruped; joints and feet are in the order of `Quadruped`'s.

    Joint i is qpos[7 + i], qvel[6 + i] and ctrl[i].
    """

    home: np.ndarray  # (19,) qpos of the standing pose
    lower: np.ndarray  # (12,) rad
    upper: np.ndarray  # (12,) rad
    effort: np.ndarray  # (12,) Nm
    velocity: np.ndarray  # (12,) rad/s
    friction: np.ndarray  # (12,) Nm, Coulomb
    weight: float  # N
    foot_geoms: np.ndarray  # (4,) geom indices
    foot_radius: np.ndarray  # (4,) m
    contact_geoms: tuple[np.ndarray, ...]  # (4,) of each kind of sphere that touches the floor
    shell_geoms: np.ndarray  # (n,) every collision shape of the robot but its feet

    @property
    def home_joints(self) -> np.ndarray:
        """(12,) joint angles of the standing pose, rad."""
        return self.home[7:]

    @property
    def home_height(self) -> float:
        """Height of the trunk's origin in the standing pose, m."""
        return float(self.home[2])


def task_robot(quadruped: Quadruped, config: Any) -> Quadruped:
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
    """Look up a quadruped's names in a model built from it."""
    feet = np.array([model.geom(name).id for name in quadruped.feet])
    names = [model.geom(i).name for i in range(model.ngeom)]
    contacts = [
        np.array([names.index(name) for name in spheres])
        for spheres in (quadruped.feet, KNEES, CORNERS)
        if set(spheres) <= set(names)
    ]
    shell = np.array(
        [
            i
            for i in range(model.ngeom)
            if model.geom_bodyid[i] != 0 and model.geom_group[i] == 3 and i not in feet
        ],
        dtype=int,
    )
    return RobotArrays(
        home=quadruped.home,
        lower=quadruped.lower,
        upper=quadruped.upper,
        effort=quadruped.effort,
        velocity=quadruped.velocity,
        friction=quadruped.friction,
        weight=float(model.body_subtreemass[0] * -model.opt.gravity[2]),
        foot_geoms=feet,
        foot_radius=model.geom_size[feet, 0],
        contact_geoms=tuple(contacts),
        shell_geoms=shell,
    )
