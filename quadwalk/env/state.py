"""What a task's functions read: the state of an environment, and one control step of it."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from quadwalk.env.command import Command
from quadwalk.env.curriculum import Travel
from quadwalk.env.randomization import EpisodeRandomization
from quadwalk.physics.motor import PhysicsState
from quadwalk.physics.rotation import compute_yaw


class EnvState(NamedTuple):
    """What one environment carries from step to step."""

    physics: PhysicsState
    last_action: jax.Array  # (12,)
    steps: jax.Array  # () int32, control steps since the episode's start
    command: Command | None = None  # None where there is none
    conditions: EpisodeRandomization | None = None  # None where they are those of the simulator
    # (m, n) what was measured, newest first, for delayed sensors; then the readings seen in
    # earlier steps, newest first; None: only this step
    frames: jax.Array | None = None
    contact: jax.Array | None = None  # (4,) bool, feet on the floor; None at an episode's start
    tile: jax.Array | None = None  # () int32, of the terrain, where it began; None: a flat floor
    travel: Travel | None = None  # None without a curriculum

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
    contact: jax.Array  # (4,) bool, feet on the floor after it
    # (2,) m, above the ground, lowest points of the trunk, of legs without feet; where a foot has
    # sunk in, by its radius at most, its leg's height is corrected by that
    lowest: jax.Array
    ground: jax.Array | None = None  # () m, of the ground under the trunk after it; None: 0

    @property
    def height(self) -> jax.Array:
        """Of the trunk's origin above the ground straight below, m."""
        return self.qpos[2] if self.ground is None else self.qpos[2] - self.ground


def trot_swing(steps: jax.Array, command: jax.Array, stride: float) -> jax.Array:
    """How far the feet of a trot are into their swing (2,), from -1 to 1, above 0 off the floor.

    First of FR and RL, then of FL and RR; 0 at the command to stand. `stride`: control steps.
    """
    swing = jnp.sin(2.0 * jnp.pi * steps / stride)
    return jnp.stack([swing, -swing]) * jnp.any(command != 0.0)


def mean_velocity(step: Step) -> jax.Array:
    """Mean velocity (2,) of the trunk over the step along world x and y, m/s."""
    return (step.qpos[:2] - step.start[:2]) / step.dt


def motion(start: jax.Array, qpos: jax.Array, dt: float) -> jax.Array:
    """What a velocity command is of (3,): the mean over `dt` s from `start` (19,) to `qpos` (19,).

    Forward and left in the frame of the heading at the end, m/s, and the yaw rate, rad/s.
    """
    heading = compute_yaw(qpos[3:7])
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    x, y = (qpos[:2] - start[:2]) / dt
    turned = heading - compute_yaw(start[3:7])
    turned = jnp.arctan2(jnp.sin(turned), jnp.cos(turned))  # the short way round
    return jnp.stack([cos * x + sin * y, cos * y - sin * x, turned / dt])


def heading_velocity(step: Step) -> jax.Array:
    """Mean velocity in the frame of the heading after the step, forward and left (2,), m/s."""
    return motion(step.start, step.qpos, step.dt)[:2]


def velocity_error(step: Step) -> jax.Array:
    """That less the command (2,), m/s."""
    return heading_velocity(step) - step.command[:2]


def commanded_speed(step: Step) -> jax.Array:
    """How much of the commanded speed there is, m/s: its size less that of the error."""
    return jnp.linalg.norm(step.command[:2]) - jnp.linalg.norm(velocity_error(step))


def yaw_rate_error(step: Step) -> jax.Array:
    """Mean rate of the heading over the step, less the command, rad/s."""
    return motion(step.start, step.qpos, step.dt)[2] - step.command[2]


def tree_where(rows: jax.Array, new: Any, old: Any) -> Any:
    """`new` where `rows` (n,) is true, else `old`: pytrees of arrays (n, ...)."""
    return jax.tree.map(
        lambda new, old: jnp.where(rows.reshape(-1, *[1] * (new.ndim - 1)), new, old), new, old
    )
