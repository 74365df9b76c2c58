"""From action to torque: joint targets, the joint controller, the motor's limits, friction."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from quadwalk.physics.robot_arrays import RobotArrays
from quadwalk.task.config import ActuationConfig

# Coulomb friction passes through zero over this joint speed, rad/s: steep enough to hold a resting
# joint nearly still, gentle enough for an explicit step (friction / speed * dt << joint inertia).
FRICTION_SPEED = 0.1


def joint_target(
    robot: RobotArrays, config: ActuationConfig, action: ArrayLike, q: ArrayLike
) -> jax.Array:
    """Joint position targets (12,), rad, of `action` (12,) in [-1, 1] with the joints at `q` (12,).

    About the home pose and within the joints' limits, or between the bounds that `config` gives;
    then, where there is a step limit, at most that far from `q`.
    """
    action = jnp.asarray(action)
    if config.targets == "home":
        reach = np.tile([config.hip_range, config.thigh_range, config.calf_range], 4)
        target = jnp.clip(robot.home_joints + reach * action, robot.lower, robot.upper)
    else:
        bounds = np.tile([config.hip_bounds, config.thigh_bounds, config.calf_bounds], (4, 1))
        lower, upper = bounds.T
        target = lower + (action + 1.0) / 2.0 * (upper - lower)
    if config.step_limit is None:
        return target
    q = jnp.asarray(q)
    return jnp.clip(target, q - config.step_limit, q + config.step_limit)


def gains(robot: RobotArrays, config: ActuationConfig) -> tuple[float, float]:
    """Position gain, Nm/rad, and velocity gain, Nm s/rad, of the joint controller.

    PyBullet's position control gives a joint, within one of its steps of 1/240 s, the speed that
    takes it a tenth of the way to its target in a step, 24/s times the error, with all the torque
    that this takes up to a limit. Gains kp = 24 kd draw a joint to the same speed, and the closer
    the larger kd is. What remains of a difference: under a load that PyBullet's joint does not
    notice, this one is slower by load / kd and comes to rest load / kp off its target.
    """
    kp = 1.4 * robot.weight * robot.home_height if config.kp is None else config.kp
    kd = 0.025 * kp if config.kd is None else config.kd
    return kp, kd


def motor_torque(
    robot: RobotArrays, config: ActuationConfig, target: ArrayLike, q: ArrayLike, qd: ArrayLike
) -> jax.Array:
    """Torque (12,), Nm, of the joint controller within the motors' limits.

    A motor that drives its joint loses torque in proportion to speed, effort * (1 - qd / limit):
    the line between stall torque and no-load speed of a DC motor. One that brakes has all of it.
    """
    target, q, qd = jnp.asarray(target), jnp.asarray(q), jnp.asarray(qd)
    kp, kd = gains(robot, config)
    torque = kp * (target - q) - kd * qd
    if not config.speed_limit:
        return jnp.clip(torque, jnp.asarray(-robot.effort), jnp.asarray(robot.effort))
    upper = robot.effort * jnp.clip(1.0 - qd / robot.velocity, 0.0, 1.0)
    lower = -robot.effort * jnp.clip(1.0 + qd / robot.velocity, 0.0, 1.0)
    return jnp.clip(torque, lower, upper)


def friction_torque(robot: RobotArrays, config: ActuationConfig, qd: ArrayLike) -> jax.Array:
    """Torque (12,), Nm, by which joint friction opposes joint speeds `qd` (12,), rad/s."""
    if not config.joint_friction:
        return jnp.zeros_like(qd)
    return -jnp.asarray(robot.friction) * jnp.tanh(jnp.asarray(qd) / FRICTION_SPEED)
