"""Motors with their joint controllers, and the control step that all engines share.

Arrays are JAX's, of one robot or with the robots along the last axis, or NumPy's.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from quadwalk.bounds import NotNegative, Positive, Settings
from quadwalk.physics.vectors import Array

if TYPE_CHECKING:  # it takes a second to import, and settings need none of it
    from quadwalk.robot.quadruped import Quadruped

# Coulomb friction passes through zero over this joint speed, rad/s: steep enough to hold a resting
# joint nearly still, gentle enough for an explicit step (friction / speed * dt << joint inertia).
FRICTION_SPEED = 0.1

# A joint's velocity gain is at most this share of the one that would stop the leg beyond it within
# one physics step. From twice that gain on it shakes itself, or sooner with the leg's other joints;
# light calves without a rotor's inertia come near.
MOST_DAMPING = 0.5

SETTLING_TIME = 2.0  # s of simulation, in which a robot settles or sinks
# A robot stands at this share of its home height, and within this angle, rad, of upright. Published
# robots keep 0.92 or more and tilt by less than 0.01.
LOWEST, MOST_TILT = 0.9, 0.1
SHAKING = 1.0  # rad/s; a joint that is still so fast is shaken by its gains
BURST = 200.0  # rad/s; no joint that is at rest at first is ever so fast, unless physics diverges
# Tried in turn where the default position gain, times 1, lets the robot sink.
FACTORS = (1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.4, 8.0)


@dataclass(frozen=True)
class MotorConfig(Settings, group="env.motor"):
    """The motors and their joint controllers; by default those of the robot's description."""

    # Nm/rad, position gain; None: weight * home height * 1.4, more where a robot sinks with that
    kp: NotNegative | None = None
    # Nm s/rad, velocity gain; None: kp * 0.025 s, less for joints that would shake
    kd: NotNegative | None = None
    effort: Positive | None = None  # Nm, largest torque of every motor; None: the robot's own
    speed_limit: bool = True  # torque falls to zero at the motor's speed limit
    joint_friction: bool = True  # use the joints' Coulomb friction


class Motor(NamedTuple):
    """Constants of the motors: (12,), or a number for all of them."""

    kp: Array  # Nm/rad
    kd: Array  # Nm s/rad
    strength: Array  # factor of the torque that the controller commands
    effort: Array  # Nm, the largest at strength 1
    velocity: Array | None  # rad/s, where torque has fallen to zero; None: it never does
    friction: Array | None  # Nm, Coulomb friction of the joints; None: none


@dataclass(frozen=True)
class Stepping:
    """The physics steps of a control step, and the contact solver's iterations in each.

    MJX and MuJoCo C take `dt` and the solver's settings from their models, which must agree.
    """

    dt: float  # s, one physics step
    substeps: int  # physics steps in a control step
    iterations: int  # Newton's, of the contact solver
    line_search: int  # evaluations in each iteration

    @property
    def control_dt(self) -> float:
        """Seconds of one control step."""
        return self.dt * self.substeps

    def replace_dt(self, dt: float) -> "Stepping":
        """Return a control step as long as this one, in physics steps of about `dt` s.

        Their number is the nearest whole one, at least 1.
        """
        substeps = max(1, round(self.control_dt / dt))
        return replace(self, dt=self.control_dt / substeps, substeps=substeps)


class PhysicsState(NamedTuple):
    """The state of one robot, in MuJoCo's coordinates."""

    qpos: jax.Array  # (19,) trunk: m and wxyz, world frame; joints: rad
    qvel: jax.Array  # (18,) trunk: m/s, world frame, and rad/s, body frame; joints: rad/s


class Effort(NamedTuple):
    """The motors' torque and work in a control step."""

    torque: jax.Array  # (12,) Nm, mean
    energy: jax.Array  # () J, positive mechanical work: none is given back to the battery


def make_motor(model: mujoco.MjModel, quadruped: "Quadruped", config: MotorConfig) -> Motor:
    """Return the motors of `quadruped`, which `model` was made from.

    Gains that `config` leaves open grow with the robot's weight and height, so that a light robot
    is held as firmly as a heavy one: 120 Nm/rad and 3 Nm s/rad for the AlienGo. The four hips have
    the same gains, so have the thighs and the calves.
    """
    weight = float(model.body_subtreemass[0] * -model.opt.gravity[2])
    kp = 1.4 * weight * float(quadruped.home[2]) if config.kp is None else config.kp
    kd: Array = 0.025 * kp
    if config.kd is not None:
        kd = config.kd
    else:
        most = MOST_DAMPING * compute_joint_inertia(model, quadruped) / model.opt.timestep
        if most.min() < kd:
            kd = np.tile(np.minimum(kd, most), 4)
    return Motor(
        kp=kp,
        kd=kd,
        strength=1.0,
        effort=quadruped.effort if config.effort is None else np.full(12, config.effort),
        velocity=quadruped.velocity if config.speed_limit else None,
        friction=quadruped.friction if config.joint_friction else None,
    )


def compute_joint_inertia(model: mujoco.MjModel, quadruped: "Quadruped") -> np.ndarray:
    """Return the inertia of hip, thigh and calf joints, (3,) kg m^2: torque per acceleration.

    It is that of one joint alone, of a robot that floats in its home pose: the least of all legs.
    """
    data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:] = quadruped.home
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    inertia: np.ndarray = 1.0 / np.diag(np.linalg.inv(mass))[6:].reshape(4, 3)
    return inertia.min(axis=0)


def make_standing_motor(
    model: mujoco.MjModel, quadruped: "Quadruped", config: MotorConfig
) -> tuple[Motor, str]:
    """Return motors that are stiff enough to hold the home pose, and a note.

    Default gains follow from weight and height. A leg that is bent far, or stands wide of its hip,
    gives the weight a longer lever: then they are too soft. They are raised if `config` leaves the
    position gain open. The note says so, or that none of `FACTORS` is enough and the default stays;
    otherwise it is empty.
    """
    motor = make_motor(model, quadruped, config)
    if config.kp is not None:
        return motor, ""
    level = _make_level_model(model, quadruped)
    if holds_home_pose(level, quadruped, motor):
        return motor, ""
    default = float(motor.kp)
    for factor in FACTORS:
        stiffer = make_motor(model, quadruped, replace(config, kp=factor * default))
        if holds_home_pose(level, quadruped, stiffer):
            return stiffer, (
                f"gains raised to {factor:g} times the default, {factor * default:.3g} Nm/rad: "
                "with less the robot sinks below its home pose"
            )
    return motor, (
        f"{quadruped.name} sinks below its home pose with gains of {default:.3g} to "
        f"{FACTORS[-1] * default:.3g} Nm/rad: are its motors, of {quadruped.effort.max():g} Nm at "
        "most, too weak?"
    )


def holds_home_pose(model: mujoco.MjModel, quadruped: "Quadruped", motor: Motor) -> bool:
    """Return True if the robot comes to rest in its home pose; simulates `SETTLING_TIME`."""
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    while data.time < SETTLING_TIME:
        speed = data.qvel[6:]
        if np.abs(speed).max() > BURST:  # before MuJoCo warns of it
            return False
        data.ctrl[:] = compute_motor_torque(motor, quadruped.home[7:], data.qpos[7:], speed)
        data.qfrc_applied[6:] = compute_friction_torque(motor, speed)
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    upright = data.xmat[model.jnt_bodyid[0]][8]
    return bool(
        data.qpos[2] > LOWEST * quadruped.home[2]
        and upright > np.cos(MOST_TILT)
        and np.abs(data.qvel[6:]).max() < SHAKING
    )


def _make_level_model(model: mujoco.MjModel, quadruped: "Quadruped") -> mujoco.MjModel:
    """Return a training model of the robot on a level floor, with the time step of `model`."""
    spec = quadruped.spec.copy()
    floor = spec.geom("floor")
    floor.type, floor.hfieldname = mujoco.mjtGeom.mjGEOM_PLANE, ""
    floor.size, floor.pos = [0, 0, 0.05], [0, 0, 0]
    return replace(quadruped, spec=spec).make_training_model(model.opt.timestep, iterations=4)


def compute_motor_torque(motor: Motor, target: Any, q: Any, qd: Any) -> Any:
    """Return the torque of the joint controllers within the motors' limits, (12,) Nm.

    `target` and `q` are joint angles (12,), rad, `qd` joint speeds (12,), rad/s. A motor that
    drives its joint loses torque in proportion to speed, effort * (1 - qd / velocity): the line
    between stall torque and no-load speed of a DC motor. One that brakes has all of it.
    """
    xp = _get_namespace(q)
    torque = motor.kp * (target - q) - motor.kd * qd
    if motor.velocity is None:
        return motor.strength * xp.clip(torque, -motor.effort, motor.effort)
    upper = motor.effort * xp.clip(1.0 - qd / motor.velocity, 0.0, 1.0)
    lower = -motor.effort * xp.clip(1.0 + qd / motor.velocity, 0.0, 1.0)
    return motor.strength * xp.clip(torque, lower, upper)


def compute_friction_torque(motor: Motor, qd: Any, through: Any = FRICTION_SPEED) -> Any:
    """Return joint friction (12,), Nm, at speeds `qd` (12,), rad/s.

    It is Coulomb friction, smoothed: below the speed `through`, rad/s, it falls to 0.
    """
    xp = _get_namespace(qd)
    if motor.friction is None:
        return xp.zeros_like(qd)
    return -xp.asarray(motor.friction) * xp.tanh(qd / through)


def run_control_step(
    motor: Motor,
    stepping: Stepping,
    physics: PhysicsState,
    target: Any,
    advance: Callable[[PhysicsState, Any], PhysicsState],
) -> tuple[PhysicsState, Effort]:
    """Run the physics steps of a control step, with the joint controllers in each.

    `target` is (12,), rad, or (substeps, 12), one for each physics step. `advance` is an engine's
    physics step: it takes a state and the joints' torques (12,), Nm, friction included. Work is
    torque times the mean of a joint's speeds before and after a physics step.
    """
    many_targets = target.ndim > physics.qpos.ndim

    def step(
        carry: tuple[PhysicsState, Effort], step_target: Any
    ) -> tuple[tuple[PhysicsState, Effort], None]:
        state, effort = carry
        q, qd = state.qpos[7:], state.qvel[6:]
        torque = compute_motor_torque(motor, step_target if many_targets else target, q, qd)
        friction = compute_friction_torque(motor, qd)
        after = advance(state, torque + friction)
        speed = 0.5 * (qd + after.qvel[6:])
        work = xp.sum(xp.maximum(torque * speed, 0.0), axis=0) * stepping.dt
        effort = Effort(effort.torque + torque / stepping.substeps, effort.energy + work)
        return (after, effort), None

    xp = _get_namespace(physics.qpos)
    zeros = xp.zeros_like(physics.qpos[7:])
    carry = (physics, Effort(zeros, zeros[0]))
    if xp is np:
        for k in range(stepping.substeps):
            carry, _ = step(carry, target[k] if many_targets else None)
        return carry
    targets = target if many_targets else None
    return jax.lax.scan(step, carry, targets, length=stepping.substeps)[0]


def _get_namespace(array: Any) -> ModuleType:
    """Return the module NumPy for an array of NumPy, JAX's NumPy for all others."""
    return np if isinstance(array, np.ndarray) else jnp
