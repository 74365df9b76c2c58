"""The legs of a robot whose trunk is fixed, level, on a stand: joint targets to joint angles.

The bodies' equations and the motors are those of training, in double precision and by steps of
second order: what is found shall be the robot's, not that of a size of step.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.identify.log import find_pieces
from quadwalk.identify.log_files import Log
from quadwalk.physics import rigid_body
from quadwalk.physics import vectors as v
from quadwalk.physics.batching import append_axis
from quadwalk.physics.model import Model
from quadwalk.physics.motor import compute_friction_torque, compute_motor_torque
from quadwalk.physics.vectors import Matrix, Vector

STEP = 0.5e-3  # s, the longest physics step
START = 0.05  # s of a piece that show how it begins
_LEVEL: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_STILL: Vector = (0.0, 0.0, 0.0)


class Joints(NamedTuple):
    """The constants in which n candidates for the robot differ, each (12, n); of one, (12,)."""

    armature: np.ndarray  # kg m^2
    friction: np.ndarray  # Nm, Coulomb
    damping: np.ndarray  # Nm s/rad
    kp: np.ndarray  # Nm/rad
    kd: np.ndarray  # Nm s/rad
    delay: np.ndarray  # s, from a target to its effect
    friction_speed: np.ndarray  # rad/s, over which friction passes through zero
    offset: np.ndarray  # rad, the measured angle less the joint's own
    # rad, the target that the controller has less the recorded one, both as measured angles
    target_offset: np.ndarray


class Steps(NamedTuple):
    """Physics steps through all pieces of a log, one piece after the other."""

    time: tuple[np.ndarray, ...]  # s, of each piece: where its steps begin, and the last one ends
    piece: np.ndarray  # (steps,) of each step
    is_first: np.ndarray  # (steps,) True where a piece begins
    sample: np.ndarray  # (n,) the step in which each of the log's angles was measured
    share: np.ndarray  # (n,) of that step that had passed


def make_steps(log: Log) -> Steps:
    """Return physics steps through the pieces of `log`, all equally long, at most `STEP` s."""
    interval = float(np.median(np.diff(log.time)))
    dt = interval / np.ceil(interval / STEP)
    time, sample, share = [], [], []
    first = 0  # of the piece
    for piece in find_pieces(log.time):
        passed = (log.time[piece] - log.time[piece.start]) / dt
        # One step more than the angles need: the simulation gives the angle before each step.
        count = int(np.ceil(passed[-1])) + 2
        time.append(log.time[piece.start] + dt * np.arange(count + 1))
        sample.append(first + passed.astype(int))
        share.append(passed % 1.0)
        first += count
    lengths = [len(times) - 1 for times in time]
    number = np.repeat(np.arange(len(lengths)), lengths)
    is_first = np.diff(number, prepend=-1) > 0
    return Steps(tuple(time), number, is_first, np.concatenate(sample), np.concatenate(share))


def make_simulator(model: Model, log: Log) -> Callable[[Joints], np.ndarray]:
    """Return a function from n candidates to the angles (samples, 12, n) that the targets cause.

    The angles, rad, are as measured, at the log's times. Each piece of the log begins as it was
    measured, and has held its first target before.
    """
    steps = make_steps(log)
    dt = float(steps.time[0][1] - steps.time[0][0])
    pose, speed = estimate_starts(log)
    share = steps.share[:, None, None]

    @jax.jit
    def compute_angles(joints: Joints, targets: jax.Array) -> jax.Array:
        start_pose = jnp.asarray(pose[:, :, None] - joints.offset)
        start_speed = jnp.broadcast_to(speed[:, :, None], start_pose.shape)
        angles = _simulate(model, joints, targets, (start_pose, start_speed), steps, dt)
        angles = (1.0 - share) * angles[steps.sample] + share * angles[steps.sample + 1]
        return angles + joints.offset

    def simulate(joints: Joints) -> np.ndarray:
        delays, which = np.unique(joints.delay[0], return_inverse=True)
        targets = np.stack([_delay_targets(log, steps, delay) for delay in delays], axis=2)
        with jax.enable_x64(True):
            return np.asarray(compute_angles(joints, targets[:, :, which]))

    return simulate


def estimate_starts(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Return angles, rad, and speeds, rad/s, (pieces, 12) each, with which the pieces begin.

    They are those of parabolas through the first angles: single angles have too much noise.
    """
    starts = []
    for piece in find_pieces(log.time):
        passed = log.time[piece] - log.time[piece.start]
        count = max(3, int(np.searchsorted(passed, START, "right")))
        angles = log.position[piece][:count]
        starts.append(np.polyfit(passed[:count], angles, 2)[[2, 1]])
    pose, speed = np.stack(starts, axis=1)
    return pose, speed


def _delay_targets(log: Log, steps: Steps, delay: float) -> np.ndarray:
    """Return the mean target (steps, 12), rad, in each step, with targets `delay` s late."""
    targets = []
    for times in steps.time:
        # Before a piece its first target held: nearer than the last one before the gap.
        later = log.target_time >= times[0]
        piece = log._replace(target_time=log.target_time[later], target=log.target[later])
        targets.append(average_targets(piece, times, delay))
    return np.concatenate(targets)


def average_targets(log: Log, times: np.ndarray, delay: float) -> np.ndarray:
    """Return the mean target (steps, 12), rad, between successive `times` (steps + 1,), s.

    Each target takes effect `delay` s late and holds until the next. Means change smoothly with the
    delay, where single values jump.
    """
    knots = np.concatenate([[times[0] - 1e3], log.target_time, [times[-1] + 1e3]])
    targets = np.concatenate([log.target[:1], log.target])
    area = np.concatenate([np.zeros((1, 12)), np.cumsum(targets * np.diff(knots)[:, None], axis=0)])
    late = np.stack([np.interp(times - delay, knots, angle) for angle in area.T], axis=1)
    return np.diff(late, axis=0) / np.diff(times)[:, None]


def _simulate(
    model: Model,
    joints: Joints,
    targets: jax.Array,
    start: tuple[jax.Array, jax.Array],
    steps: Steps,
    dt: float,
) -> jax.Array:
    """Simulate n candidates through all pieces of a log, one piece after the other.

    Returns the joints' angles (steps, 12, n), rad, at the beginning of each step of `dt` s.
    `targets` are (steps, 12, n). `start` holds angles and speeds (pieces, 12, n), which are set
    where a piece begins. Steps are those of the explicit midpoint method.
    """
    constants = zip(
        model.links, _split_links(joints.armature), _split_links(joints.damping), strict=True
    )
    links = tuple(
        jax.tree.map(append_axis, link)._replace(armature=armature, damping=damping)
        for link, armature, damping in constants
    )
    motor = jax.tree.map(append_axis, model.motor)
    motor = motor._replace(kp=joints.kp, kd=joints.kd, friction=joints.friction)
    model = model._replace(links=links, motor=motor)

    def accelerate(q: jax.Array, qd: jax.Array, target: jax.Array) -> jax.Array:
        regulated = target + joints.target_offset
        torque = compute_motor_torque(motor, regulated, q + joints.offset, qd)
        torque += compute_friction_torque(motor, qd, joints.friction_speed)
        return compute_acceleration(model, q, qd, torque)

    def step(
        state: tuple[jax.Array, jax.Array], inputs: tuple[jax.Array, jax.Array, jax.Array]
    ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        target, piece, is_first = inputs
        q = jnp.where(is_first, start[0][piece], state[0])
        qd = jnp.where(is_first, start[1][piece], state[1])
        half = qd + 0.5 * dt * accelerate(q, qd, target)
        after = q + dt * half, qd + dt * accelerate(q + 0.5 * dt * qd, half, target)
        return after, q

    first = start[0][0], start[1][0]
    inputs = targets, jnp.asarray(steps.piece), jnp.asarray(steps.is_first)
    return jax.lax.scan(step, first, inputs)[1]


def compute_acceleration(model: Model, q: jax.Array, qd: jax.Array, torque: jax.Array) -> jax.Array:
    """Return the joints' accelerations (12, n), rad/s^2, by torques `torque` (12, n), Nm.

    `q` (12, n), rad, and `qd` (12, n), rad/s, are angles and speeds. The constants of the `model`
    have a last axis for the n candidates.
    """
    pose = rigid_body.compute_pose(model.links, _LEVEL, _split_links(q))
    bodies = rigid_body.place_bodies(model.trunk, model.links, pose)
    mass = rigid_body.compute_mass_matrix(model.trunk, model.links, pose, bodies).legs
    velocity = rigid_body.Motion(_STILL, _STILL, _split_links(qd))
    bias = rigid_body.compute_bias_force(
        model.trunk, model.links, pose, bodies, velocity, model.gravity
    )
    parts = zip(_split_links(torque), model.links, velocity.joints, bias.joints, strict=True)
    force = v.to_vector(motor - link.damping * rate - fixed for motor, link, rate, fixed in parts)
    hip, thigh, calf = map(v.to_vector, mass)
    # The inverse of a 3x3 matrix from the cross products of its rows.
    inverse = v.cross(thigh, calf), v.cross(calf, hip), v.cross(hip, thigh)
    acceleration = v.scale(1.0 / v.dot(hip, inverse[0]), v.apply_transposed(inverse, force))
    return jnp.stack(acceleration, axis=1).reshape(4 * rigid_body.LINKS, -1)


def _split_links(joints: jax.Array | np.ndarray) -> Vector:
    """Split values of joints (12, n) into those of hips, thighs and calves, (4, n) each."""
    legs = joints.reshape(4, rigid_body.LINKS, -1)
    return legs[:, 0], legs[:, 1], legs[:, 2]
