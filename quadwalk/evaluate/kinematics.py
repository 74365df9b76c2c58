"""Link poses of a whole rollout in plain numpy, from the URDF's tree.

Viewers draw the URDF, so the transforms they are given come from the same tree, by its own
definition (a child frame = the joint's origin, then the joint's motion), and not from a physics
engine's bodies, where fixed links are fused away and `xpos` lags `qpos` by a step.
Quaternions are wxyz.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from quadwalk.robot.legs import find_legs
from quadwalk.robot.tree import build_tree, matrix
from quadwalk.robot.urdf import parse_urdf


@dataclass(frozen=True)
class Joint:
    """One joint of the tree: where its child frame stands in the parent's, and how it moves."""

    name: str
    parent: str
    child: str
    kind: str  # the URDF's joint type
    translation: np.ndarray  # (3,) m
    rotation: np.ndarray  # (4,) wxyz
    axis: np.ndarray  # (3,) unit, in the child's frame
    column: int | None  # of the joint positions; None where it does not move


@dataclass(frozen=True)
class Foot:
    """The sphere at the end of a leg."""

    link: str  # the calf, which carries it
    centre: np.ndarray  # (3,) m in that link's frame
    radius: float  # m


@dataclass(frozen=True)
class LinkTree:
    """A URDF's links: parents come before their children."""

    root: str
    joints: tuple[Joint, ...]
    mass: float  # kg, all links together
    feet: tuple[Foot, ...]  # FR, FL, RR, RL
    thighs: tuple[str, ...]  # the links whose frames are the thigh joints, in the same order

    @property
    def links(self) -> tuple[str, ...]:
        return (self.root, *(joint.child for joint in self.joints))


def read_tree(urdf: str, moving_joints: tuple[str, ...]) -> LinkTree:
    """The link tree of a quadruped's URDF (its text).

    `moving_joints` names the columns of the joint positions; any other joint stays at zero.
    """
    tree = build_tree(parse_urdf(urdf).robot)
    columns = {name: k for k, name in enumerate(moving_joints)}
    ordered: list[Joint] = []
    queue = [tree.root]
    while queue:
        for joint in tree.joints_below[queue.pop(0)]:
            ordered.append(_joint(joint, columns))
            queue.append(joint.child)
    legs = find_legs(tree, "URDF")
    masses = [link.inertial.mass for link in tree.links.values() if link.inertial is not None]
    return LinkTree(
        root=tree.root,
        joints=tuple(ordered),
        mass=sum(mass for mass in masses if mass),
        feet=tuple(Foot(leg.links[2], np.asarray(leg.centre), leg.radius) for leg in legs),
        thighs=tuple(leg.links[1] for leg in legs),
    )


def _joint(joint, columns: dict[str, int]) -> Joint:
    frame = matrix(joint.origin)
    rotation = np.empty(4)
    mujoco.mju_mat2Quat(rotation, frame[:3, :3].flatten())
    axis = np.asarray([1.0, 0.0, 0.0] if joint.axis is None else joint.axis, dtype=float)
    return Joint(
        name=joint.name,
        parent=joint.parent,
        child=joint.child,
        kind=joint.type,
        translation=frame[:3, 3],
        rotation=rotation,
        axis=axis / max(np.linalg.norm(axis), 1e-12),
        column=columns.get(joint.name),
    )


def local_poses(tree: LinkTree, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each joint's child frame in its parent's frame, for T rows of joint positions (T, 12).

    Returns translations (T, J, 3) in m and quaternions (T, J, 4), joints in the tree's order.
    """
    rows = len(joints)
    translation = np.empty((rows, len(tree.joints), 3))
    rotation = np.empty((rows, len(tree.joints), 4))
    for k, joint in enumerate(tree.joints):
        translation[:, k] = joint.translation
        rotation[:, k] = joint.rotation
        if joint.column is None:
            continue
        value = joints[:, joint.column, None]
        if joint.kind == "prismatic":
            translation[:, k] += rotate(joint.rotation, joint.axis) * value
        else:
            motion = np.concatenate([np.cos(value / 2), np.sin(value / 2) * joint.axis], axis=1)
            rotation[:, k] = quat_mul(rotation[:, k], motion)
    return translation, rotation


def world_poses(tree: LinkTree, qpos: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Every link in the world: name -> (positions (T, 3) m, quaternions (T, 4)).

    `qpos` is (T, 19); its first seven columns are the pose of the root link.
    """
    translation, rotation = local_poses(tree, qpos[:, 7:])
    poses = {tree.root: (qpos[:, :3].astype(float), quat_normalised(qpos[:, 3:7]))}
    for k, joint in enumerate(tree.joints):
        position, turn = poses[joint.parent]
        poses[joint.child] = (
            position + rotate(turn, translation[:, k]),
            quat_mul(turn, rotation[:, k]),
        )
    return poses


def foot_positions(tree: LinkTree, poses: dict[str, tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(T, 4, 3) world positions in m of the foot spheres' centres, from `world_poses`."""
    return np.stack(
        [poses[f.link][0] + rotate(poses[f.link][1], f.centre) for f in tree.feet], axis=1
    )


def rpy_from_quat(quat: np.ndarray) -> np.ndarray:
    """(..., 3) roll, pitch, yaw in rad of (..., 4) unit quaternions.

    Fixed axes, as URDF and PyBullet mean them: the rotation is Rz(yaw) Ry(pitch) Rx(roll).
    """
    w, x, y, z = np.moveaxis(np.asarray(quat, dtype=float), -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def quat_mul(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rotation `b`, then `a`; (..., 4) each, broadcast against each other."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def quat_conjugate(quat: np.ndarray) -> np.ndarray:
    return quat * np.array([1.0, -1.0, -1.0, -1.0])


def quat_normalised(quat: np.ndarray) -> np.ndarray:
    return quat / np.maximum(np.linalg.norm(quat, axis=-1, keepdims=True), 1e-12)


def rotate(quat: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """`vector` (..., 3) turned by the unit quaternions `quat` (..., 4)."""
    w, axis = quat[..., :1], quat[..., 1:]
    twice = 2 * np.cross(axis, vector)
    return vector + w * twice + np.cross(axis, twice)
