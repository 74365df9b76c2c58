"""Whether a robot's default gains hold its home pose, by simulation, and gains that do.

Default gains follow from weight and height. A leg that is bent far, or stands wide of its hip,
gives its weight a longer lever: then they are too soft, and the robot sinks.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from quadwalk.physics.motor import Motor, MotorConfig, friction_torque, make_motor, motor_torque

if TYPE_CHECKING:  # as in quadwalk/physics/motor.py
    from quadwalk.robot.quadruped import Quadruped

SECONDS = 2.0  # of simulation, in which a robot settles or sinks
# A robot stands at this share of its home height, and within this angle, rad, of upright. Published
# robots keep 0.92 or more and tilt by less than 0.01.
LOWEST, MOST_TILT = 0.9, 0.1
SHAKING = 1.0  # rad/s; a joint that is still so fast is shaken by its gains
BURST = 200.0  # rad/s; no joint that is at rest at first is ever so fast, unless physics diverges
FACTORS = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.4, 8.0)  # of the default position gain


def make_standing_motor(
    model: mujoco.MjModel, quadruped: "Quadruped", config: MotorConfig
) -> tuple[Motor, str]:
    """Return `make_motor`'s motors, as stiff as standing needs, and a line where that is special.

    Gains are raised only where `config` leaves the position gain open. Where none of `FACTORS`
    would do, the default stays, and the line says so; else it is empty or says what was raised.
    """
    motor = make_motor(model, quadruped, config)
    if config.kp is not None:
        return motor, ""
    level = _make_level(model, quadruped)
    usual = float(motor.kp)
    for factor in FACTORS:
        stiffer = motor
        if factor > 1.0:
            stiffer = make_motor(model, quadruped, replace(config, kp=factor * usual))
        if stands(level, quadruped, stiffer):
            raised = (
                f"gains raised to {factor:g} times the default, {factor * usual:.3g} Nm/rad: with "
                "less the robot sinks below its home pose"
            )
            return stiffer, raised if factor > 1.0 else ""
    return motor, (
        f"{quadruped.name} sinks below its home pose with gains of {usual:.3g} to "
        f"{FACTORS[-1] * usual:.3g} Nm/rad: are its motors, of {quadruped.effort.max():g} Nm at "
        "most, too weak?"
    )


def stands(model: mujoco.MjModel, quadruped: "Quadruped", motor: Motor) -> bool:
    """Return whether the robot stays up and at rest when its joints are to keep the home pose."""
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    while data.time < SECONDS:
        speed = data.qvel[6:]
        if np.abs(speed).max() > BURST:  # before MuJoCo warns of it
            return False
        data.ctrl[:] = motor_torque(motor, quadruped.home[7:], data.qpos[7:], speed)
        data.qfrc_applied[6:] = friction_torque(motor, speed)
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    upright = data.xmat[model.jnt_bodyid[0]][8]
    return bool(
        data.qpos[2] > LOWEST * quadruped.home[2]
        and upright > np.cos(MOST_TILT)
        and np.abs(data.qvel[6:]).max() < SHAKING
    )


def _make_level(model: mujoco.MjModel, quadruped: "Quadruped") -> mujoco.MjModel:
    """Return a training model of the robot on a level floor, with the time step of `model`."""
    spec = quadruped.spec.copy()
    floor = spec.geom("floor")
    floor.type, floor.hfieldname = mujoco.mjtGeom.mjGEOM_PLANE, ""
    floor.size, floor.pos = [0, 0, 0.05], [0, 0, 0]
    return replace(quadruped, spec=spec).make_training_model(model.opt.timestep, iterations=4)
