"""The legs of a robot whose trunk is fixed, level, on a stand: joint targets to joint angles.

The bodies' equations and the motors are those of training, in double precision and by steps of
second order: what is found shall be the robot's, not that of a size of step.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.identify.joint_log import Log
from quadwalk.physics import rigid_body
from quadwalk.physics import vectors as v
from quadwalk.physics.batching import column
from quadwalk.physics.model import Model
from quadwalk.physics.motor import friction_torque, motor_torque
from quadwalk.physics.vectors import Matrix, Vector

STEP = 0.5e-3  # s, the longest physics step
_LEVEL: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_STILL: Vector = (0.0, 0.0, 0.0)


class Joints(NamedTuple):
    """What the joints of n candidates for the robot differ by, each (12, n); of one, (12,)."""

    armature: np.ndarray  # kg m^2
    friction: np.ndarray  # Nm, Coulomb
    damping: np.ndarray  # Nm s/rad
    kp: np.ndarray  # Nm/rad
    kd: np.ndarray  # Nm s/rad
    delay: np.ndarray  # s, from a target to its effect
    friction_speed: np.ndarray  # rad/s, over which friction passes through zero


def simulator(model: Model, log: Log) -> Callable[[Joints], np.ndarray]:
    """What gives the angles (samples, 12, n), rad, at the log's times, that its targets cause.

    Each robot begins at rest in the first measured pose, and has held the first target before.
    """
    interval = float(np.median(np.diff(log.time)))
    dt = interval / np.ceil(interval / STEP)
    steps = int(np.ceil((log.time[-1] - log.time[0]) / dt)) + 1
    times = log.time[0] + dt * np.arange(steps + 1)
    before = np.searchsorted(times, log.time, "right") - 1
    share = ((log.time - times[before]) / dt)[:, None, None]

    @jax.jit
    def angles(joints: Joints, targets: jax.Array) -> jax.Array:
        start = jnp.repeat(log.position[0][:, None], targets.shape[-1], axis=1)
        found = _angles(model, joints, targets, start, dt)
        return (1.0 - share) * found[before] + share * found[before + 1]

    def simulate(joints: Joints) -> np.ndarray:
        delays, which = np.unique(joints.delay[0], return_inverse=True)
        targets = np.stack([mean_targets(log, times, delay) for delay in delays], axis=2)
        with jax.enable_x64(True):
            return np.asarray(angles(joints, targets[:, :, which]))

    return simulate


def mean_targets(log: Log, times: np.ndarray, delay: float) -> np.ndarray:
    """The mean target (steps, 12), rad, between each two of `times`, when each is late by `delay`.

    A target holds until the next. Means change smoothly with the delay, where single values jump.
    """
    knots = np.concatenate([[times[0] - 1e3], log.target_time, [times[-1] + 1e3]])
    held = np.concatenate([log.target[:1], log.target])
    area = np.concatenate([np.zeros((1, 12)), np.cumsum(held * np.diff(knots)[:, None], axis=0)])
    own = np.stack([np.interp(times - delay, knots, angle) for angle in area.T], axis=1)
    return np.diff(own, axis=0) / np.diff(times)[:, None]


def _angles(
    model: Model, joints: Joints, targets: jax.Array, start: jax.Array, dt: float
) -> jax.Array:
    """The angles (steps + 1, 12, n) from `start` (12, n), by explicit midpoint steps."""
    own = zip(model.links, _by_link(joints.armature), _by_link(joints.damping), strict=True)
    links = tuple(
        jax.tree.map(column, link)._replace(armature=armature, damping=damping)
        for link, armature, damping in own
    )
    motor = jax.tree.map(column, model.motor)
    motor = motor._replace(kp=joints.kp, kd=joints.kd, friction=joints.friction)
    model = model._replace(links=links, motor=motor)

    def acceleration(q: jax.Array, qd: jax.Array, target: jax.Array) -> jax.Array:
        torque = motor_torque(motor, target, q, qd) + friction_torque(
            motor, qd, joints.friction_speed
        )
        return joint_acceleration(model, q, qd, torque)

    def step(
        state: tuple[jax.Array, jax.Array], target: jax.Array
    ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        q, qd = state
        half = qd + 0.5 * dt * acceleration(q, qd, target)
        after = q + dt * half, qd + dt * acceleration(q + 0.5 * dt * qd, half, target)
        return after, after[0]

    found = jax.lax.scan(step, (start, jnp.zeros_like(start)), targets)[1]
    return jnp.concatenate([start[None], found])


def joint_acceleration(model: Model, q: jax.Array, qd: jax.Array, torque: jax.Array) -> jax.Array:
    """Of the joints (12, n), rad/s^2, at `q` (12, n), rad, and `qd`, with torques (12, n), Nm.

    The constants of the `model` have a last axis for the candidates.
    """
    pose = rigid_body.pose_of(model.links, _LEVEL, _by_link(q))
    bodies = rigid_body.place_bodies(model.trunk, model.links, pose)
    mass = rigid_body.mass_matrix(model.trunk, model.links, pose, bodies).legs
    velocity = rigid_body.Motion(_STILL, _STILL, _by_link(qd))
    bias = rigid_body.bias_force(model.trunk, model.links, pose, bodies, velocity, model.gravity)
    parts = zip(_by_link(torque), model.links, velocity.joints, bias.joints, strict=True)
    force = v.vector(own - link.damping * rate - held for own, link, rate, held in parts)
    hip, thigh, calf = map(v.vector, mass)
    # The inverse of a 3x3 matrix from the cross products of its rows.
    inverse = v.cross(thigh, calf), v.cross(calf, hip), v.cross(hip, thigh)
    found = v.scale(1.0 / v.dot(hip, inverse[0]), v.apply_transposed(inverse, force))
    return jnp.stack(found, axis=1).reshape(4 * rigid_body.LINKS, -1)


def _by_link(joints: jax.Array | np.ndarray) -> Vector:
    """(12, n) as hip, thigh and calf joints, (4, n) each."""
    legs = joints.reshape(4, rigid_body.LINKS, -1)
    return legs[:, 0], legs[:, 1], legs[:, 2]
