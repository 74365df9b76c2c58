"""The robot of a task, and what the environment's functions need to know of it, as arrays."""

import math
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from quadwalk.physics.model import Model
from quadwalk.physics.surface import Surface
from quadwalk.robot.mirror import place_at_home
from quadwalk.robot.quadruped import Quadruped
from quadwalk.settings.environment import EnvConfig
from quadwalk.terrain.heightfield import Heightfield, has_field, lay

# A trunk stands above this share of the home pose's height, and with its z axis at most this far
# from the world's, rad.
STANDING_HEIGHT = 0.85
STANDING_TILT = math.radians(18)


@dataclass(frozen=True)
class RobotArrays:
    """A quadruped's constants; its joint i is qpos[7 + i], qvel[6 + i] and ctrl[i]."""

    home: np.ndarray  # (19,) qpos of the standing pose
    lower: np.ndarray  # (12,) rad
    upper: np.ndarray  # (12,) rad
    knees_ahead: np.ndarray  # (4,) whether the knee is ahead of thigh's joint and foot, standing
    mass: float  # kg
    gravity: float  # m/s^2
    geometry: Model  # with the spheres that may touch the floor, and the ground

    @property
    def ground(self) -> Surface | None:
        """The ground's heights; None: level, at height 0, without end."""
        ground = self.geometry.ground
        return None if ground is None else ground.surface

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

    @property
    def froude_speed(self) -> float:
        """Speed whose Froude number is 1 at the home height, m/s; pushes are shares of it."""
        return math.sqrt(self.gravity * self.home_height)


def above_ground(robot: RobotArrays, qpos: jax.Array) -> jax.Array:
    """Height of the trunk's origin above the ground straight below, m; `qpos` is (19,)."""
    return qpos[2] if robot.ground is None else qpos[2] - robot.ground.measure(qpos[0], qpos[1])[0]


def is_standing(robot: RobotArrays, qpos: jax.Array) -> jax.Array:
    """Return True, () bool, for a robot at `qpos` (19,) whose trunk is high and upright."""
    _, x, y, _ = qpos[3:7]
    upright = 1.0 - 2.0 * (x * x + y * y) > math.cos(STANDING_TILT)
    high = above_ground(robot, qpos) > STANDING_HEIGHT * robot.home_height
    return jnp.logical_and(upright, high)


def task_robot(
    quadruped: Quadruped, config: EnvConfig, field: Heightfield | None = None
) -> Quadruped:
    """The robot under the task's gravity, with the motors that the task gives it, on its ground."""
    spec, effort = quadruped.spec.copy(), quadruped.effort
    spec.option.gravity[2] = -config.gravity
    if config.motor.effort is not None:
        effort = np.full(12, config.motor.effort)
        for name, most in zip(quadruped.joints, effort, strict=True):
            # The models have a motor's limit twice, for its control and for its joint.
            spec.actuator(name).ctrlrange = spec.joint(name).actfrcrange = [-most, most]
    if field is not None and not has_field(spec):
        lay(spec, field)
    return replace(quadruped, effort=effort, spec=spec)


def robot_arrays(quadruped: Quadruped, model: mujoco.MjModel, geometry: Model) -> RobotArrays:
    """The constants of a quadruped, of a model built from it, and of the ground."""
    return RobotArrays(
        home=quadruped.home,
        lower=quadruped.lower,
        upper=quadruped.upper,
        knees_ahead=_knees_ahead(quadruped, model),
        mass=float(model.body_subtreemass[0]),
        gravity=float(-model.opt.gravity[2]),
        geometry=geometry,
    )


def _knees_ahead(quadruped: Quadruped, model: mujoco.MjModel) -> np.ndarray:
    pose = place_at_home(quadruped, model)
    feet = pose.geom_xpos[[model.geom(name).id for name in quadruped.feet]]
    ahead: np.ndarray = pose.xanchor[3::3, 0] > (pose.xanchor[2::3, 0] + feet[:, 0]) / 2.0
    return ahead
