"""What the functions of a task read: constants of the robot, the state, and one control step."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp

from quadwalk.physics.fast import compute_leg_points
from quadwalk.physics.model import Model, RobotRandomization
from quadwalk.physics.motor import PhysicsState
from quadwalk.physics.rotation import compute_yaw, rotate_back_about_z
from quadwalk.physics.surface import Surface

# A trunk stands above this share of the home pose's height, and with its z axis at most this far
# from the world's, rad.
STANDING_HEIGHT = 0.85
STANDING_TILT = math.radians(18)

F = TypeVar("F", bound=Callable[..., Any])
Array: TypeAlias = Any  # NumPy's; JAX's where bodies differ from episode to episode
Scalar: TypeAlias = Any  # a number, or a JAX array of shape ()

# Uses of an episode's random key, for `EpisodeRandomization.make_key`.
NOISE, PUSH, JITTER = range(3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RobotConstants:
    """A quadruped's constants; its joint i is qpos[7 + i], qvel[6 + i] and ctrl[i].

    Where bodies differ from episode to episode, the numbers are JAX's.
    """

    home: Array  # (19,) qpos of the standing pose
    lower: Array  # (12,) rad
    upper: Array  # (12,) rad
    knees_ahead: Array  # (4,) whether the knee is ahead of thigh's joint and foot, standing
    mass: Scalar  # kg
    gravity: Scalar  # m/s^2
    leg: Scalar  # m, from the thigh's joint to the foot's center, the knee stretched
    # How joints move the feet, see `to_standard`: signs (12,), and of a knee that is ahead by how
    # much its leg turns with it (4,).
    joint_signs: Array
    knee_turns: Array
    description: Array  # (n,) of the body, see `quadwalk/env/constants.py`
    geometry: Model  # with the spheres that may touch the floor, and the ground
    # m, of the legs of a robot of standard size and joints, as which rewards and observations may
    # have this one (`quadwalk/env/similarity.py`); None: they have it as it is
    standard_leg: Scalar | None = None

    @property
    def ground(self) -> Surface | None:
        """The ground's heights; None: level, at height 0, without end."""
        ground = self.geometry.ground
        return None if ground is None else ground.surface

    @property
    def weight(self) -> Scalar:
        """Weight of the robot as its model has it, not as an episode randomizes it, N."""
        return self.mass * self.gravity

    @property
    def home_joints(self) -> Array:
        """Joint angles of the standing pose (12,), rad."""
        return self.home[7:]

    @property
    def home_height(self) -> Scalar:
        """Height of the trunk's origin in the standing pose, m."""
        return self.home[2]

    @property
    def froude_speed(self) -> Scalar:
        """Speed whose Froude number is 1 at the home height, m/s; pushes are shares of it."""
        return (self.gravity * self.home_height) ** 0.5

    def to_standard(self, joints: Array) -> Array:
        """Return angles from the home pose, or speeds (12,), as those of standard joints.

        Standard hips turn about x, thighs and calves about y, as a right hand does, and the knee is
        behind. They move the foot as the robot's own joints do: a knee ahead has a thigh that turns
        by what the leg does.
        """
        legs = (self.joint_signs * joints).reshape(4, 3)
        # A knee ahead has the sign of its calf turned already.
        thigh = legs[:, 1] - self.knee_turns * legs[:, 2]
        return jnp.stack([legs[:, 0], thigh, legs[:, 2]], axis=1).ravel()

    def from_standard(self, joints: Array) -> Array:
        """Return the robot's own angles from the home pose (12,) for those of standard joints."""
        legs = joints.reshape(4, 3)
        thigh = legs[:, 1] + self.knee_turns * legs[:, 2]
        return self.joint_signs * jnp.stack([legs[:, 0], thigh, legs[:, 2]], axis=1).ravel()

    def compute_leg_points(self, joints: Array) -> Array:
        """Return the centers of the feet, and of the knees if they may touch the ground (n, 4, 3).

        They are in the trunk's frame, m. `joints` (12,), rad, and lengths are those of a robot with
        legs of `standard_leg`, if there is one.
        """
        if self.standard_leg is None:
            return compute_leg_points(self.geometry, joints)
        angles = self.home_joints + self.from_standard(joints - self.home_joints)
        return self.standard_leg / self.leg * compute_leg_points(self.geometry, angles)


class Command(NamedTuple):
    """The velocity command of one episode."""

    velocity: jax.Array  # (3,) forward and lateral m/s, in the frame of the heading; yaw rate rad/s
    key: jax.Array  # of all commands of the episode
    until: jax.Array | None = None  # () int32, control steps; None: changes are regular
    # (2,) m/s, on its way from the last command to this one; None: it is there at once
    reached: jax.Array | None = None


class EpisodeRandomization(NamedTuple):
    """What is randomized in one episode."""

    variation: RobotRandomization | None  # of robot and floor from the model; None: not at all
    # () physics steps until a joint target takes effect; the home pose holds until the first does.
    # A delay of 2.3 steps is 3 in three control steps of ten and 2 in the others.
    delay: jax.Array
    sensor_delay: jax.Array | None  # () control steps, between readings it interpolates; None: none
    # (2,) m/s, change of the trunk's velocity along its heading and to its left, in an instant,
    # with random signs, once in every period, at a time that `key` draws
    push: jax.Array
    noise: jax.Array  # () level of each observed number's Gaussian noise; the task states level 1
    encoder: jax.Array  # (12,) rad, offset of measured joint angles, for policy and controller
    tilt: jax.Array  # (3,) rad, rotation vector of the IMU in the trunk
    targets: jax.Array  # (n, 12) joint targets, the newest first, as many as the delay needs
    key: jax.Array  # of the episode's noise, pushes and jitter

    def make_key(self, use: int, number: jax.Array) -> jax.Array:
        """Return a random key for `NOISE`, `PUSH` or `JITTER`, another for each `number`."""
        return jax.random.fold_in(self.key, 3 * number + use)


class Travel(NamedTuple):
    """How far an episode has come, for a curriculum."""

    start: jax.Array  # (2,) m, x and y of the trunk where it began
    steps: jax.Array  # () int32, control steps since then
    walked: jax.Array  # () m, along the velocity command, or along x where there is none
    commanded: jax.Array  # () m, by the velocity command, or at the curriculum's pace

    def advance(self, velocity: jax.Array, command: jax.Array, dt: float) -> "Travel":
        """Return the travel after `dt` s at a mean `velocity` (2,), m/s, in `command`'s frame."""
        size = jnp.linalg.norm(command)
        along = jnp.dot(velocity, command) / jnp.maximum(size, 1e-6)
        return self._replace(
            steps=self.steps + 1,
            walked=self.walked + along * dt,
            commanded=self.commanded + size * dt,
        )


def start_travel(qpos: jax.Array) -> Travel:
    """Return the travel of an episode that starts at `qpos` (19,)."""
    zero = jnp.zeros(())
    return Travel(qpos[:2], jnp.zeros((), jnp.int32), zero, zero)


STRIDE = 0.3  # s, about the time that a stride takes


class Strides(NamedTuple):
    """The stride that each foot is in, and the mean of what sways with strides."""

    time: jax.Array  # (4,) s since it touched down, or since the episode's start
    peak: jax.Array  # (4,) m, highest that the sole was since it was last on the floor
    # () rad/s, yaw rate minus its command, exponential mean of about the last `STRIDE`
    yaw_rate_error: jax.Array

    def advance(self, step: "Step") -> "Strides":
        """Return the strides after a control step, in which a foot's last stride may have ended."""
        return Strides(
            time=jnp.where(step.landed, 0.0, self.time + step.dt),
            peak=jnp.where(step.contact, 0.0, jnp.maximum(self.peak, step.soles[:, 2])),
            yaw_rate_error=self.yaw_rate_error
            + (step.yaw_rate_error - self.yaw_rate_error) * (step.dt / STRIDE),
        )


def start_strides() -> Strides:
    """Return the strides of an episode that starts."""
    return Strides(jnp.zeros(4), jnp.zeros(4), jnp.zeros(()))


class EnvState(NamedTuple):
    """What one environment carries from step to step."""

    physics: PhysicsState
    last_action: jax.Array  # (12,)
    steps: jax.Array  # () int32, control steps since the episode's start
    command: Command | None = None  # None where there is none
    conditions: EpisodeRandomization | None = None  # None where nothing is randomized
    # (m, n) what was measured, newest first, for delayed sensors; then the readings observed in
    # earlier steps, newest first; None: only this step
    frames: jax.Array | None = None
    contact: jax.Array | None = None  # (4,) bool, feet on the floor; None at an episode's start
    tile: jax.Array | None = None  # () int32, of the terrain, where it began; None: a flat floor
    travel: Travel | None = None  # None without a curriculum
    strides: Strides | None = None  # None where no term of the task needs them
    # () int32, place of the episode's body in the bank; None: the environment's only robot
    body: jax.Array | None = None

    @property
    def qpos(self) -> jax.Array:
        """(19,) position m, quaternion wxyz, joints rad."""
        return self.physics.qpos

    @property
    def qvel(self) -> jax.Array:
        """(18,) trunk: world linear m/s, body angular rad/s; joints rad/s."""
        return self.physics.qvel

    @property
    def velocity_command(self) -> jax.Array:
        """(3,) forward and lateral m/s, yaw rate rad/s; zero where there is none."""
        return jnp.zeros(3) if self.command is None else self.command.velocity


class Step(NamedTuple):
    """One control step, as rewards and terminations see it."""

    dt: float  # s
    steps: jax.Array  # () int32, control steps since the episode's start
    start: jax.Array  # (19,) qpos before the step
    qpos: jax.Array  # (19,) after it
    qvel: jax.Array  # (18,) after it; trunk: world linear m/s, body angular rad/s
    action: jax.Array  # (12,)
    last_action: jax.Array  # (12,)
    power: jax.Array  # () W, mean mechanical power that the motors gave in the step
    fell: jax.Array  # () bool, whether any termination holds; terminations see False
    command: jax.Array  # (3,) velocity command; zero where there is none
    start_soles: jax.Array  # (4, 3) m, the feet's lowest points before it, z above the ground
    soles: jax.Array  # (4, 3) after it
    start_contact: jax.Array  # (4,) bool, feet on the floor before it
    contact: jax.Array  # (4,) bool, after it
    # (2,) m, above the ground, lowest points of the trunk, of legs without feet; where a foot has
    # sunk in, by its radius at most, its leg's height is corrected by that
    lowest: jax.Array
    ground: jax.Array | None = None  # () m, of the ground under the trunk after it; None: 0
    # before it; None where no term of the task is marked with `needs_strides`
    strides: Strides | None = None

    @property
    def landed(self) -> jax.Array:
        """Feet that touched down in the step (4,), bool."""
        return self.contact & ~self.start_contact

    @property
    def height(self) -> jax.Array:
        """Height of the trunk's origin above the ground straight below, m."""
        return self.qpos[2] if self.ground is None else self.qpos[2] - self.ground

    @property
    def mean_velocity(self) -> jax.Array:
        """Mean velocity (2,) of the trunk over the step along world x and y, m/s."""
        return (self.qpos[:2] - self.start[:2]) / self.dt

    @property
    def heading_velocity(self) -> jax.Array:
        """Mean velocity (2,) over the step, m/s, forward and left in the final heading's frame."""
        return compute_motion(self.start, self.qpos, self.dt)[:2]

    @property
    def velocity_error(self) -> jax.Array:
        """`heading_velocity` minus the commanded velocity (2,), m/s, forward and left."""
        return self.heading_velocity - self.command[:2]

    @property
    def commanded_speed(self) -> jax.Array:
        """Size of the commanded velocity minus the size of `velocity_error`, m/s."""
        return jnp.linalg.norm(self.command[:2]) - jnp.linalg.norm(self.velocity_error)

    @property
    def yaw_rate_error(self) -> jax.Array:
        """Mean yaw rate over the step minus the commanded one, rad/s."""
        return compute_motion(self.start, self.qpos, self.dt)[2] - self.command[2]


def needs_strides(function: F) -> F:
    """Mark a term's function: it reads the strides of a step or of a state."""
    function.needs_strides = True  # type: ignore[attr-defined]
    return function


def compute_motion(start: jax.Array, qpos: jax.Array, dt: float) -> jax.Array:
    """Return mean forward and left velocity, m/s, and yaw rate, rad/s, as commands have them (3,).

    The trunk moves from `start` (19,) to `qpos` (19,) in `dt` s. The frame is that of the heading
    at the end.
    """
    heading = compute_yaw(qpos[3:7])
    x, y = (qpos[:2] - start[:2]) / dt
    turn = heading - compute_yaw(start[3:7])
    turn = jnp.arctan2(jnp.sin(turn), jnp.cos(turn))  # the short way round
    return jnp.stack([*rotate_back_about_z(heading, x, y), turn / dt])


def compute_height(robot: RobotConstants, qpos: jax.Array) -> jax.Array:
    """Return the height of the trunk's origin above the ground, m; `qpos` is (19,)."""
    return qpos[2] if robot.ground is None else qpos[2] - robot.ground.measure(qpos[0], qpos[1])[0]


def is_standing(robot: RobotConstants, qpos: jax.Array) -> jax.Array:
    """Return True, () bool, for a robot at `qpos` (19,) whose trunk is high and upright."""
    _, x, y, _ = qpos[3:7]
    upright = 1.0 - 2.0 * (x * x + y * y) > math.cos(STANDING_TILT)
    high = compute_height(robot, qpos) > STANDING_HEIGHT * robot.home_height
    return jnp.logical_and(upright, high)


def compute_trot_swing(steps: jax.Array, command: jax.Array, stride: float) -> jax.Array:
    """Return how far FR and RL, and FL and RR, are into the swing of a trot (2,), from -1 to 1.

    Above 0 the feet are off the floor; 0 at the command to stand. `stride` is in control steps.
    """
    swing = jnp.sin(2.0 * jnp.pi * steps / stride)
    return jnp.stack([swing, -swing]) * jnp.any(command != 0.0)


def select_rows(rows: jax.Array, new: Any, old: Any) -> Any:
    """Return `new` where `rows` (n,) is true, else `old`: pytrees of arrays (n, ...)."""
    return jax.tree.map(
        lambda new, old: jnp.where(rows.reshape(-1, *[1] * (new.ndim - 1)), new, old), new, old
    )
