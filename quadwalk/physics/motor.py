"""From joint targets to torque: the joint controller, the motor's limits, friction."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from quadwalk.errors import UsageError
from quadwalk.physics.robot_arrays import RobotArrays

# Coulomb friction passes through zero over this joint speed, rad/s: steep enough to hold a resting
# joint nearly still, gentle enough for an explicit step (friction / speed * dt << joint inertia).
FRICTION_SPEED = 0.1


@dataclass(frozen=True)
class MotorConfig:
    """The joint controller and the motors."""

    kp: float | None  # Nm/rad, position gain; None: weight * home height * 1.4
    kd: float | None  # Nm s/rad, velocity gain; None: kp * 0.025 s
    effort: float | None  # Nm, every motor's largest torque; None: the robot's own
    speed_limit: bool  # torque falls to zero at the motor's speed limit
    joint_friction: bool  # Coulomb friction of the joints

    def __post_init__(self) -> None:
        if self.effort is not None and self.effort <= 0.0:
            raise UsageError(f"env.motor.effort is {self.effort}; expected more than 0, or None")


def gains(robot: RobotArrays, config: MotorConfig) -> tuple[float, float]:
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
    robot: RobotArrays, config: MotorConfig, target: ArrayLike, q: ArrayLike, qd: ArrayLike
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


def friction_torque(robot: RobotArrays, config: MotorConfig, qd: ArrayLike) -> jax.Array:
    """Torque (12,), Nm, by which joint friction opposes joint speeds `qd` (12,), rad/s."""
    if not config.joint_friction:
        return jnp.zeros_like(qd)
    return -jnp.asarray(robot.friction) * jnp.tanh(jnp.asarray(qd) / FRICTION_SPEED)
