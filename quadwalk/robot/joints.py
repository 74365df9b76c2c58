"""Joints of a URDF as joints of an MjSpec body: one of MuJoCo's for each direction of motion."""

import mujoco
import numpy as np
import yourdfpy

from quadwalk.robot.legs import joint_range, unit
from quadwalk.robot.shapes import unique

SINGLE = {
    "revolute": mujoco.mjtJoint.mjJNT_HINGE,
    "continuous": mujoco.mjtJoint.mjJNT_HINGE,
    "prismatic": mujoco.mjtJoint.mjJNT_SLIDE,
}


def add_single(body: mujoco.MjsBody, joint: yourdfpy.Joint, armature: float) -> None:
    """Add a joint with one direction of motion, with its limits, damping and friction.

    Args:
        body: what it moves.
        joint: of one of the types in `SINGLE`.
        armature: kg m^2, or kg of a slide.
    """
    added = body.add_joint(name=joint.name, type=SINGLE[joint.type], axis=unit(joint.axis))
    if joint.type != "continuous":
        added.range = joint_range(joint)
    if joint.limit is not None and joint.limit.effort:
        added.actfrcrange = [-joint.limit.effort, joint.limit.effort]
    if joint.limit is not None:
        # MuJoCo knows no largest speed: it is kept as the joint's user datum.
        added.userdata = [joint.limit.velocity]
    if joint.dynamics is not None:
        added.damping[0] = float(joint.dynamics.damping or 0)
        added.frictionloss = float(joint.dynamics.friction or 0)
    added.armature = armature


def add_several(body: mujoco.MjsBody, joint: yourdfpy.Joint, taken: set[str]) -> None:
    """Add the joints of a `planar` or `floating` one, without limits, which URDF has none for.

    Planar: slides JOINT_x and JOINT_y across the axis, then hinge JOINT_turn about it. The first
    slide is along the joint frame's x where the axis is its z; for another axis both are turned by
    the smallest rotation that takes z there. Floating: slides JOINT_x, JOINT_y and JOINT_z along
    the joint frame's axes, then ball JOINT_ball. (A free joint would have to be at the world.)

    Args:
        body: what they move.
        joint: the URDF's.
        taken: joint names that are given away; those added join them.
    """

    def add(suffix: str, kind: mujoco.mjtJoint, axis: np.ndarray) -> None:
        name = unique(f"{joint.name}_{suffix}", taken)
        taken.add(name)
        body.add_joint(name=name, type=kind, axis=axis)

    slide = mujoco.mjtJoint.mjJNT_SLIDE
    if joint.type == "planar":
        x, y, z = _frame_along(unit(joint.axis))
        add("x", slide, x)
        add("y", slide, y)
        add("turn", mujoco.mjtJoint.mjJNT_HINGE, z)
    else:
        for suffix, axis in zip("xyz", np.eye(3), strict=True):
            add(suffix, slide, axis)
        add("ball", mujoco.mjtJoint.mjJNT_BALL, np.array([0.0, 0.0, 1.0]))


def _frame_along(axis: np.ndarray) -> np.ndarray:
    """(3, 3), rows x, y and z = `axis` (3,): the standard axes, turned the shortest way."""
    turn, rows = np.zeros(4), np.zeros((3, 3))
    mujoco.mju_quatZ2Vec(turn, axis)
    for row, standard in zip(rows, np.eye(3), strict=True):
        mujoco.mju_rotVecQuat(row, standard, turn)
    return rows
