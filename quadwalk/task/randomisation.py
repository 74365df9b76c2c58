"""Domain randomisation: the conditions of an episode, drawn anew at its start.

What depends on a robot's size is relative to it.
"""

import math

import jax
import jax.numpy as jnp

from quadwalk.physics.motor import Stepping
from quadwalk.physics.variation import Variation
from quadwalk.task.conditions import Conditions, targets_needed
from quadwalk.task.config import RandomisationConfig, Range
from quadwalk.task.robot_arrays import RobotArrays

_DRAWN = 43  # eleven numbers, and vectors of 3, 12, 2, 12 and 3


def draw_conditions(
    config: RandomisationConfig,
    robot: RobotArrays,
    stepping: Stepping,
    key: jax.Array,
    friction: float,
) -> Conditions:
    """The conditions of one episode; `friction` is the model's own, for where none is drawn."""
    key, key_episode = jax.random.split(key)
    # All numbers at once: XLA takes a second or more to compile each call of a generator.
    shares, taken = jax.random.uniform(key, (_DRAWN,)), 0

    def draw(between: Range, usual: float, shape: tuple[int, ...] = ()) -> jax.Array:
        nonlocal taken
        own = slice(taken, taken + math.prod(shape))
        taken = own.stop
        if between is None:
            return jnp.full(shape, usual)
        low, high = between
        return low + (high - low) * shares[own].reshape(shape)

    variation = Variation(
        friction=draw(config.friction, friction),
        trunk_mass=robot.mass * draw(config.trunk_mass, 0.0),
        trunk_centre=robot.home_height * draw(config.trunk_centre, 0.0, (3,)),
        link_mass=draw(config.link_mass, 1.0, (12,)),
        strength=draw(config.strength, 1.0),
        kp=draw(config.kp, 1.0),
        kd=draw(config.kd, 1.0),
        joint_friction=draw(config.joint_friction, 1.0),
        damping=draw(config.damping, 1.0),
        armature=draw(config.armature, 1.0),
    )
    latest = 0.0 if config.latency is None else config.latency[1] / stepping.dt
    kept = targets_needed(math.ceil(latest), stepping.substeps)
    late = draw(config.sensor_latency, 0.0) / stepping.control_dt
    froude = math.sqrt(robot.gravity * robot.home_height)  # m/s
    drawn = Conditions(
        variation=variation,
        delay=draw(config.latency, 0.0) / stepping.dt,
        sensor_delay=None if config.sensor_latency is None else late,
        push=froude * draw(config.push, 0.0, (2,)),
        noise=draw(config.noise, 0.0),
        encoder=draw(config.encoder, 0.0, (12,)),
        tilt=draw(config.imu_tilt, 0.0, (3,)),
        targets=jnp.tile(jnp.asarray(robot.home_joints, jnp.float32), (kept, 1)),
        key=key_episode,
    )
    assert taken == _DRAWN
    return drawn


def latest_reading(config: RandomisationConfig, control_dt: float) -> int:
    """How many control steps before the newest a sensor's reading may reach back."""
    if not config.enabled or config.sensor_latency is None:
        return 0
    return math.floor(config.sensor_latency[1] / control_dt) + 1
