"""The constants of a robot that a task's functions read, and the description of its body."""

from typing import NamedTuple

import mujoco
import numpy as np

from quadwalk.env.state import RobotConstants
from quadwalk.physics.model import Model
from quadwalk.physics.motor import Motor
from quadwalk.robot.mirror import compute_home_axes, place_at_home
from quadwalk.robot.quadruped import Quadruped
from quadwalk.terrain.terrain import measure_leg

STANDARD_LEG = 0.5  # m, the AlienGo's, of which the description gives the length
# Motors that could do more are described as if they could do this: a robot that has them never
# needs it. Some files state 1000 Nm.
MOST_EFFORT = 1.5  # of mass * gravity * leg
MOST_SPEED = 15.0  # rad in sqrt(leg / gravity)


class Description(NamedTuple):
    """A body by numbers without a unit: lengths by those of its legs, and so on.

    With lengths in leg lengths L, times in sqrt(L / g) and torques in m g L, bodies of equal
    numbers but `size` move alike (Alexander and Jayes 1983). Of legs they are means.
    """

    size: float  # logarithm of L over 0.5 m
    height: float  # of the home pose
    thigh: float  # its length
    length: float  # distance of front and hind thighs' joints
    width: float  # distance of left and right hips
    offset: float  # from the hip's joint to the foot, aside
    foot: float  # radius
    legs: float  # share of the mass that the legs have
    ahead: float  # of the middle of the thighs' joints, where the trunk's center of mass is
    above: float  # of them
    roll: float  # radius of the trunk's inertia about x, with all of the mass
    pitch: float  # about y
    yaw: float  # about z
    hip_effort: float  # logarithm of the largest torque
    thigh_effort: float
    calf_effort: float
    hip_speed: float  # logarithm of the largest speed
    thigh_speed: float
    calf_speed: float
    rotor: float  # logarithm of the mean armature over m L^2
    stiffness: float  # logarithm of the mean position gain
    damping: float  # logarithm of the mean velocity gain
    front_knees: float  # 1 ahead, -1 behind
    hind_knees: float


def make_robot_constants(
    quadruped: Quadruped, model: mujoco.MjModel, geometry: Model
) -> RobotConstants:
    """Return the constants of a quadruped: `model`, built from it, gives mass, gravity and knees.

    `geometry` is the model of the "fast" engine, by which heights above the ground are measured.
    """
    data = place_at_home(quadruped, model)
    feet = data.geom_xpos[[model.geom(name).id for name in quadruped.feet]]
    thighs, knees = data.xanchor[2::3], data.xanchor[3::3]
    knees_ahead = knees[:, 0] > (thighs[:, 0] + feet[:, 0]) / 2.0
    axes = compute_home_axes(quadruped, model).reshape(4, 3, 3)
    signs = np.where(axes[:, [0, 1, 2], [0, 1, 1]] < 0.0, -1.0, 1.0)
    signs[knees_ahead, 2] *= -1.0
    # How much the line from thigh to foot turns with the calf, by the planes that legs swing in.
    shin, leg = (feet - knees)[:, [0, 2]], (feet - thighs)[:, [0, 2]]
    turns = 2.0 * np.sum(shin * leg, axis=1) / np.sum(leg * leg, axis=1)
    mass, gravity = float(model.body_subtreemass[0]), float(-model.opt.gravity[2])
    description = describe_body(quadruped, model, geometry.motor, knees_ahead)
    return RobotConstants(
        home=quadruped.home,
        lower=quadruped.lower,
        upper=quadruped.upper,
        knees_ahead=knees_ahead,
        mass=mass,
        gravity=gravity,
        leg=measure_legs(quadruped, model)[0].mean().item(),
        joint_signs=signs.ravel(),
        knee_turns=np.where(knees_ahead, turns, 0.0),
        description=np.array(description, np.float32),
        geometry=geometry,
    )


def measure_legs(quadruped: Quadruped, model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the lengths of the stretched legs and of their thighs, (4,) m each."""
    thighs: np.ndarray = np.linalg.norm(model.body_pos[model.jnt_bodyid[3::3]], axis=1)
    return np.array([measure_leg(model, name) for name in quadruped.feet]), thighs


def describe_body(
    quadruped: Quadruped, model: mujoco.MjModel, motor: Motor, knees_ahead: np.ndarray
) -> Description:
    """Return the description of a quadruped, of which `model` was built, with its motors."""
    data = place_at_home(quadruped, model)
    lengths, thighs = measure_legs(quadruped, model)
    leg, mass = lengths.mean(), model.body_subtreemass[0]
    trunk = model.jnt_bodyid[0]
    turn = data.xmat[trunk].reshape(3, 3)
    anchors = ((data.xanchor[1:] - data.xpos[trunk]) @ turn).reshape(4, 3, 3)
    hips, hinges = anchors[:, 0], anchors[:, 1]
    feet = [model.geom(name).id for name in quadruped.feet]
    soles = (data.geom_xpos[feet] - data.xpos[trunk]) @ turn
    frame = turn.T @ data.ximat[trunk].reshape(3, 3)
    inertia = np.diag(frame @ np.diag(model.body_inertia[trunk]) @ frame.T)
    center = (data.xipos[trunk] - data.xpos[trunk]) @ turn
    torque = mass * -model.opt.gravity[2] * leg
    time = np.sqrt(leg / -model.opt.gravity[2])
    effort = np.minimum(quadruped.effort.reshape(4, 3).mean(axis=0) / torque, MOST_EFFORT)
    speed = np.minimum(quadruped.velocity.reshape(4, 3).mean(axis=0) * time, MOST_SPEED)
    rotor = model.dof_armature[6:].mean() / (mass * leg**2)
    return Description(
        size=np.log(leg / STANDARD_LEG),
        height=quadruped.home[2] / leg,
        thigh=thighs.mean() / leg,
        length=(hinges[:2, 0].mean() - hinges[2:, 0].mean()) / leg,
        width=2.0 * np.abs(hips[:, 1]).mean() / leg,
        offset=np.abs(soles[:, 1] - hips[:, 1]).mean() / leg,
        foot=model.geom_size[feet, 0].mean() / leg,
        legs=1.0 - model.body_mass[trunk] / mass,
        ahead=(center[0] - hinges[:, 0].mean()) / leg,
        above=(center[2] - hinges[:, 2].mean()) / leg,
        **dict(zip(("roll", "pitch", "yaw"), np.sqrt(inertia / mass) / leg, strict=True)),
        **dict(zip(("hip_effort", "thigh_effort", "calf_effort"), np.log(effort), strict=True)),
        **dict(zip(("hip_speed", "thigh_speed", "calf_speed"), np.log(speed), strict=True)),
        rotor=np.log(max(rotor, 1e-5)),
        stiffness=np.log(max(np.mean(motor.kp) / torque, 1e-3)),
        damping=np.log(max(np.mean(motor.kd) / (torque * time), 1e-4)),
        front_knees=2.0 * knees_ahead[:2].mean() - 1.0,
        hind_knees=2.0 * knees_ahead[2:].mean() - 1.0,
    )
