"""Domain randomization of an episode: robot, floor, delays, pushes and sensor noise."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.state import EpisodeRandomization, RobotConstants
from quadwalk.physics.model import RobotRandomization
from quadwalk.physics.motor import Stepping
from quadwalk.settings.environment import RandomizationConfig, Range

_SHARES = 43  # eleven numbers, and vectors of 3, 12, 2, 12 and 3
_FACTORS = ("strength", "kp", "kd", "joint_friction", "damping", "armature")
# Wide margins would go below. Contacts of no friction give NaN in all engines.
_PHYSICAL_MINIMA = {
    **dict.fromkeys(_FACTORS[:-1], 0.0),
    "friction": 0.01,
    "link_mass": 0.1,
    "armature": 0.1,
}


def sample_randomization(
    config: RandomizationConfig,
    robot: RobotConstants,
    stepping: Stepping,
    key: jax.Array,
    friction: float,
) -> EpisodeRandomization:
    """Return the randomization of one episode.

    What depends on a robot's size is relative to it. Without a range, `friction` is the model's.
    """
    key, key_episode = jax.random.split(key)
    # All numbers at once: XLA takes a second or more to compile each call of a generator. The last
    # says which episodes are ideal; those before it are the same without.
    shares = jax.random.uniform(key, (_SHARES + (config.ideal > 0.0),))
    is_ideal = shares[-1] < config.ideal
    used = 0

    def take_shares(shape: tuple[int, ...]) -> jax.Array:
        nonlocal used
        start, used = used, used + math.prod(shape)
        return shares[start:used].reshape(shape)

    def sample(between: Range, nominal: float, shape: tuple[int, ...] = ()) -> jax.Array:
        share = take_shares(shape)
        if between is None:
            return jnp.full(shape, nominal)
        low, high = widen_range(between, nominal, config.margin)
        return replace_ideal(low + (high - low) * share, nominal)

    def replace_ideal(value: jax.Array, nominal: float) -> jax.Array:
        return jnp.where(is_ideal, nominal, value) if config.ideal else value

    variation = RobotRandomization(
        friction=sample(config.friction, friction),
        trunk_mass=robot.mass * sample(config.trunk_mass, 0.0),
        trunk_center=robot.home_height * sample(config.trunk_center, 0.0, (3,)),
        link_mass=sample(config.link_mass, 1.0, (12,)),
        **{name: sample(getattr(config, name), 1.0) for name in _FACTORS},
    )
    longest = compute_longest_latencies(config)[0] / stepping.dt
    count = count_targets(math.ceil(longest), stepping.substeps)
    sensor_delay = sample(config.sensor_latency, 0.0) / stepping.control_dt
    randomization = EpisodeRandomization(
        variation=clip_to_physical(variation),
        delay=sample(config.latency, 0.0) / stepping.dt,
        sensor_delay=None if config.sensor_latency is None else sensor_delay,
        push=replace_ideal(
            robot.froude_speed * _compute_push(config.push, config.margin, take_shares((2,))), 0.0
        ),
        noise=sample(config.noise, 0.0),
        encoder=sample(config.encoder, 0.0, (12,)),
        tilt=sample(config.imu_tilt, 0.0, (3,)),
        targets=jnp.tile(jnp.asarray(robot.home_joints, jnp.float32), (count, 1)),
        key=key_episode,
    )
    assert used == _SHARES
    return randomization


def clip_to_physical(variation: RobotRandomization) -> RobotRandomization:
    """Clip each value to its physical minimum."""
    clipped = {
        name: jnp.maximum(getattr(variation, name), least)
        for name, least in _PHYSICAL_MINIMA.items()
    }
    return variation._replace(**clipped)


def compute_longest_latencies(config: RandomizationConfig) -> tuple[float, float]:
    """Return the longest latency of joint targets and of sensors that training samples, s."""
    targets, sensors = (
        widen_range(between or (0.0, 0.0), 0.0, config.margin)[1]
        for between in (config.latency, config.sensor_latency)
    )
    return targets, sensors


def widen_range(between: tuple[float, float], nominal: float, margin: float) -> tuple[float, float]:
    """Return the range that training samples from: `between` widened by the share `margin`.

    An end moves away from `nominal`, the model's own value, and never into the range.
    """
    low, high = between
    below, above = (nominal + (1.0 + margin) * (end - nominal) for end in between)
    if isinstance(low, jax.Array):  # an argument of a program
        return jnp.minimum(low, below), jnp.maximum(high, above)
    return min(low, below), max(high, above)


def count_targets(delay: float, substeps: int) -> int:
    """Return how many joint targets, the newest included, a delay of physics steps needs."""
    return 1 + int(-(-delay // substeps))


def count_readings(delay: float, control_dt: float) -> int:
    """Return how many control steps a sensor reading goes back that is late by up to `delay` s."""
    return math.floor(delay / control_dt) + 1


def to_values(
    randomization: EpisodeRandomization, stepping: Stepping
) -> dict[str, float | list[float]]:
    """Return an episode's randomization by the names and in the units of `RandomizationConfig`.

    Only masses are in kg, centers of mass in m and pushes in m/s.
    """
    values = {} if randomization.variation is None else randomization.variation._asdict()
    sensor_delay = 0.0 if randomization.sensor_delay is None else randomization.sensor_delay
    values |= {
        "encoder": randomization.encoder,
        "imu_tilt": randomization.tilt,
        "latency": randomization.delay * stepping.dt,
        "sensor_latency": sensor_delay * stepping.control_dt,
        "noise": randomization.noise,
        "push": randomization.push,
    }
    return {name: np.asarray(value, float).tolist() for name, value in values.items()}


def _compute_push(sizes: Range, margin: float, shares: jax.Array) -> jax.Array:
    """Return a push (2,), uniform over a quarter of a ring for `shares` (2,) uniform in [0, 1)."""
    if sizes is None:
        return jnp.zeros(2)
    inner, outer = widen_range(sizes, 0.0, margin)
    size = jnp.sqrt(inner**2 + (outer**2 - inner**2) * shares[0])
    angle = jnp.pi / 2 * shares[1]
    return size * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
