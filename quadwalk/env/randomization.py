"""Domain randomization of an episode: robot, floor, delays, pushes and sensor noise."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from quadwalk.env.robot_arrays import RobotArrays
from quadwalk.physics.model import RobotRandomization
from quadwalk.physics.motor import PhysicsState, Stepping
from quadwalk.physics.rotation import compute_yaw, multiply, rotate_inverse
from quadwalk.settings.environment import RandomizationConfig, Range

_DRAWN = 43  # eleven numbers, and vectors of 3, 12, 2, 12 and 3
_FACTORS = ("strength", "kp", "kd", "joint_friction", "damping", "armature")
# What wide margins would have less, or negative. Contacts of no friction give NaN in all engines.
_LEAST = {**dict.fromkeys(_FACTORS[:-1], 0.0), "friction": 0.01, "link_mass": 0.1, "armature": 0.1}


class EpisodeRandomization(NamedTuple):
    """The conditions of one episode."""

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


def draw_conditions(
    config: RandomizationConfig,
    robot: RobotArrays,
    stepping: Stepping,
    key: jax.Array,
    friction: float,
) -> EpisodeRandomization:
    """The conditions of one episode, drawn anew at its start: domain randomization.

    What depends on a robot's size is relative to it. Without a range, `friction` is the model's.
    """
    key, key_episode = jax.random.split(key)
    # All numbers at once: XLA takes a second or more to compile each call of a generator. The last
    # says which episodes are ideal; those before it are the same without.
    shares, taken = jax.random.uniform(key, (_DRAWN + (config.ideal > 0.0),)), 0
    ideal = shares[-1] < config.ideal

    def take(shape: tuple[int, ...]) -> jax.Array:
        nonlocal taken
        own = slice(taken, taken + math.prod(shape))
        taken = own.stop
        return shares[own].reshape(shape)

    def draw(between: Range, usual: float, shape: tuple[int, ...] = ()) -> jax.Array:
        drawn = take(shape)
        if between is None:
            return jnp.full(shape, usual)
        low, high = widened(between, usual, config.margin)
        return unless_ideal(low + (high - low) * drawn, usual)

    def unless_ideal(drawn: jax.Array, usual: float) -> jax.Array:
        return jnp.where(ideal, usual, drawn) if config.ideal else drawn

    variation = RobotRandomization(
        friction=draw(config.friction, friction),
        trunk_mass=robot.mass * draw(config.trunk_mass, 0.0),
        trunk_center=robot.home_height * draw(config.trunk_center, 0.0, (3,)),
        link_mass=draw(config.link_mass, 1.0, (12,)),
        **{name: draw(getattr(config, name), 1.0) for name in _FACTORS},
    )
    latest = latest_drawn(config)[0] / stepping.dt
    kept = targets_needed(math.ceil(latest), stepping.substeps)
    late = draw(config.sensor_latency, 0.0) / stepping.control_dt
    drawn = EpisodeRandomization(
        variation=possible(variation),
        delay=draw(config.latency, 0.0) / stepping.dt,
        sensor_delay=None if config.sensor_latency is None else late,
        push=unless_ideal(
            robot.froude_speed * _within(config.push, config.margin, take((2,))), 0.0
        ),
        noise=draw(config.noise, 0.0),
        encoder=draw(config.encoder, 0.0, (12,)),
        tilt=draw(config.imu_tilt, 0.0, (3,)),
        targets=jnp.tile(jnp.asarray(robot.home_joints, jnp.float32), (kept, 1)),
        key=key_episode,
    )
    assert taken == _DRAWN
    return drawn


def possible(variation: RobotRandomization) -> RobotRandomization:
    """`variation`, but that what is less than it can be is as little as it can."""
    return variation._replace(
        **{name: jnp.maximum(getattr(variation, name), least) for name, least in _LEAST.items()}
    )


def latest_drawn(config: RandomizationConfig) -> tuple[float, float]:
    """The longest latency that is drawn of joint targets, and of sensors, s."""
    targets, sensors = (
        widened(own or (0.0, 0.0), 0.0, config.margin)[1]
        for own in (config.latency, config.sensor_latency)
    )
    return targets, sensors


def widened(between: tuple[float, float], usual: float, margin: float) -> tuple[float, float]:
    """The range `between` as training draws from it: wider by `margin`.

    An end moves away from `usual`, the model's own value, and never into the range.
    """
    low, high = between
    share = 1.0 + margin
    return min(low, usual + share * (low - usual)), max(high, usual + share * (high - usual))


def _within(sizes: Range, margin: float, shares: jax.Array) -> jax.Array:
    """(2,) of a quarter of a ring, uniformly over its area; `shares` (2,) are uniform in [0, 1)."""
    if sizes is None:
        return jnp.zeros(2)
    inner, outer = widened(sizes, 0.0, margin)
    size = jnp.sqrt(inner**2 + (outer**2 - inner**2) * shares[0])
    angle = jnp.pi / 2 * shares[1]
    return size * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


def as_values(drawn: EpisodeRandomization, stepping: Stepping) -> dict[str, float | list[float]]:
    """What was drawn for an episode, named and in units as in `RandomizationConfig`.

    But masses are in kg, centers of mass in m and pushes in m/s.
    """
    own = {} if drawn.variation is None else drawn.variation._asdict()
    late = 0.0 if drawn.sensor_delay is None else drawn.sensor_delay
    own |= {
        "encoder": drawn.encoder,
        "imu_tilt": drawn.tilt,
        "latency": drawn.delay * stepping.dt,
        "sensor_latency": late * stepping.control_dt,
        "noise": drawn.noise,
        "push": drawn.push,
    }
    return {name: np.asarray(value, float).tolist() for name, value in own.items()}


def readings_needed(delay: float, control_dt: float) -> int:
    """How many control steps before the newest a reading late by up to `delay` s reaches back."""
    return math.floor(delay / control_dt) + 1


def targets_needed(delay: float, substeps: int) -> int:
    """How many joint targets, the newest included, a delay of so many physics steps needs."""
    return 1 + int(-(-delay // substeps))


def delayed(
    conditions: EpisodeRandomization, target: jax.Array, substeps: int, steps: jax.Array
) -> tuple[EpisodeRandomization, jax.Array]:
    """The targets (substeps, 12) obeyed in each physics step, when `target` (12,) is the newest."""
    targets = jnp.concatenate([target[None], conditions.targets[:-1]])
    jitter = jax.random.uniform(_key(conditions, steps, 2))
    delay = jnp.floor(conditions.delay + jitter).astype(jnp.int32)
    # Of how many control steps ago: those begun within the last `delay` physics steps.
    late = delay - jnp.arange(substeps) + substeps - 1
    ago = jnp.minimum(jnp.maximum(late, 0) // substeps, len(targets) - 1)
    applied_target = targets[ago] - conditions.encoder
    return conditions._replace(targets=targets), applied_target


def pushed(
    conditions: EpisodeRandomization, physics: PhysicsState, steps: jax.Array, period: int
) -> PhysicsState:
    """`physics` after the push of control step `steps`, if it has one: one in each `period`."""
    forward, left = conditions.push * side_of_push(conditions, steps, period)
    heading = compute_yaw(physics.qpos[3:7])
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    kick = jnp.stack([forward * cos - left * sin, forward * sin + left * cos])
    return physics._replace(qvel=physics.qvel.at[:2].add(kick))


def side_of_push(conditions: EpisodeRandomization, steps: jax.Array, period: int) -> jax.Array:
    """(2,) signs in the control step of a push, else 0."""
    drawn = jax.random.uniform(_key(conditions, steps // period, 1), (3,))
    now = steps % period == jnp.floor(drawn[2] * period).astype(jnp.int32)
    return jnp.where(now, jnp.where(drawn[:2] < 0.5, -1.0, 1.0), 0.0)


def measured(conditions: EpisodeRandomization, physics: PhysicsState) -> PhysicsState:
    """`physics` as encoders and IMU measure it that are out of place."""
    turn = conditions.tilt
    half = jnp.concatenate([jnp.ones(1), 0.5 * turn])
    half /= jnp.linalg.norm(half)
    quat = multiply(physics.qpos[3:7], half)
    qpos = physics.qpos.at[3:7].set(quat).at[7:].add(conditions.encoder)
    qvel = physics.qvel.at[3:6].set(rotate_inverse(half, physics.qvel[3:6]))
    return physics._replace(qpos=qpos, qvel=qvel)


def sensed(
    conditions: EpisodeRandomization, seen: jax.Array, scale: ArrayLike, steps: jax.Array
) -> jax.Array:
    """`seen` (n,) with the noise of control step `steps`, `scale` (n,) being level 1."""
    noise = jax.random.normal(_key(conditions, steps, 0), seen.shape)
    return seen + conditions.noise * scale * noise


def reading(conditions: EpisodeRandomization, frames: jax.Array) -> jax.Array:
    """What the sensors tell (n,), late as they are; `frames` (m, n) were measured, newest first."""
    assert conditions.sensor_delay is not None
    whole = jnp.floor(conditions.sensor_delay)
    share = conditions.sensor_delay - whole
    first = jnp.minimum(whole.astype(jnp.int32), len(frames) - 2)
    return (1.0 - share) * frames[first] + share * frames[first + 1]


def _key(conditions: EpisodeRandomization, number: jax.Array, use: int) -> jax.Array:
    """A random key for each of three uses and each `number`."""
    return jax.random.fold_in(conditions.key, 3 * number + use)
