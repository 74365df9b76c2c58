"""Rotations and link poses of whole rollouts.

Where things are in the world is MuJoCo's answer. What viewers draw is the URDF, so the transforms
from link to link that they are given are those of its own tree, fixed links included. Quaternions
are wxyz.
"""

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
import yourdfpy
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from quadwalk.robot.quadruped import Quadruped
from quadwalk.robot.structure.tree import to_matrix
from quadwalk.robot.urdf import parse_urdf


def rotations(quat: np.ndarray) -> Rotation:
    """`quat` (T, 4) of any length as rotations; zeros or NaN, which SciPy refuses, turn nothing."""
    quat = np.asarray(quat, dtype=float)
    given = np.linalg.norm(quat, axis=1, keepdims=True) > mujoco.mjMINVAL
    return Rotation.from_quat(np.where(given, quat, [1.0, 0.0, 0.0, 0.0]), scalar_first=True)


def roll_pitch_yaw(quat: np.ndarray) -> np.ndarray:
    """(T, 3) rad of `quat` (T, 4); the rotation is Rz(yaw) Ry(pitch) Rx(roll), as in a URDF."""
    return rotations(quat).as_euler("xyz", suppress_warnings=True)


def turned(vector: ArrayLike, angle: ArrayLike) -> np.ndarray:
    """(2, ...): `vector` (2, ...), along x and y, turned to the left by `angle` (...), rad."""
    (x, y), cos, sin = np.asarray(vector), np.cos(angle), np.sin(angle)
    return np.stack([cos * x - sin * y, sin * x + cos * y])


@dataclass(frozen=True)
class LinkFrames:
    """Frames of a URDF's links but the root, each in its parent's frame; parents come first."""

    links: tuple[str, ...]
    parents: tuple[str, ...]
    translation: np.ndarray  # (L, 3) m
    rotation: np.ndarray  # (L, 4) at joint position 0
    axis: np.ndarray  # (L, 3) unit, in the link's own frame; zero for a fixed link
    column: np.ndarray  # (L,) of the joint positions; 0 for a fixed link

    def rotations(self, joints: np.ndarray) -> np.ndarray:
        """(T, L, 4) of the links in their parents' frames, of joint positions (T, 12), rad."""
        turn = joints[:, self.column, None] * self.axis
        fixed = Rotation.from_quat(np.tile(self.rotation, (len(joints), 1)), scalar_first=True)
        whole = fixed * Rotation.from_rotvec(turn.reshape(-1, 3))
        return whole.as_quat(scalar_first=True).reshape(*turn.shape[:2], 4)


@lru_cache(maxsize=1)  # an evaluation asks for one robot's with every recording
def link_frames(quadruped: Quadruped) -> LinkFrames:
    """The frames of a quadruped's URDF; no joint but those of the legs moves, and these turn."""
    tree = parse_urdf(quadruped.urdf, repair_inertia=True).tree
    joints: list[yourdfpy.Joint] = []
    pending = [tree.root]
    while pending:
        below = tree.joints_below[pending.pop(0)]
        joints += below
        pending += [joint.child for joint in below]
    column = {name: k for k, name in enumerate(quadruped.joints)}
    frames = np.array([to_matrix(joint.origin) for joint in joints])
    axes = np.zeros((len(joints), 3))
    for axis, joint in zip(axes, joints, strict=True):
        if joint.name in column:
            axis[:] = [1.0, 0.0, 0.0] if joint.axis is None else joint.axis
            axis /= np.linalg.norm(axis)
    return LinkFrames(
        links=tuple(joint.child for joint in joints),
        parents=tuple(joint.parent for joint in joints),
        translation=frames[:, :3, 3],
        rotation=Rotation.from_matrix(frames[:, :3, :3]).as_quat(scalar_first=True),
        axis=axes,
        column=np.array([column.get(joint.name, 0) for joint in joints]),
    )


def foot_poses(
    model: mujoco.MjModel, feet: tuple[str, ...], qpos: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where the feet are in the states `qpos` (T, 19): by name, those of `Quadruped.feet`.

    Returns the world positions of the centers of their spheres, (T, 4, 3) in m, and the
    orientations of the calves that carry them, (T, 4, 4).
    """
    data = mujoco.MjData(model)
    geoms = [model.geom(foot).id for foot in feet]
    calves = model.geom_bodyid[geoms]
    centers, turns = np.empty((len(qpos), 4, 3)), np.empty((len(qpos), 4, 4))
    for row, state in enumerate(qpos):
        data.qpos = state
        mujoco.mj_kinematics(model, data)
        centers[row], turns[row] = data.geom_xpos[geoms], data.xquat[calves]
    return centers, turns
