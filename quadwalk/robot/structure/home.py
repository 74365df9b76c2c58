"""How a quadruped stands: a pose from the geometry of its legs and the limits of its joints."""

import numpy as np
import yourdfpy
from trimesh.transformations import rotation_matrix

from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.legs import Leg
from quadwalk.robot.structure.tree import Tree, get_range, normalize

# Distance from thigh joint to foot, standing, as a share of the stretched leg: Unitree stands its
# robots at thigh 0.8, calf -1.6, and thighs and calves are of equal length.
STANDING_LENGTH = np.cos(0.8)
# How far, m, a thigh joint lies ahead of its hip joint before the leg counts as turned that way.
TURNED = 0.01
# A stated pose stands if feet are this share of a leg's length below the hips, at heights that
# differ by less than that share.
LEAST_DEPTH, LEVEL = 0.4, 0.05


def compute_standing_pose(tree: Tree, legs: tuple[Leg, ...]) -> np.ndarray:
    """Return joint angles (12,), rad: thighs level, feet below their thigh joints, knees bent.

    The foot is `STANDING_LENGTH` of the stretched leg below the thigh joint, or as near to that
    as the limits allow. Rounded to 1e-4 rad: a choice, not a measurement. Raise `UrdfError` for a
    leg that cannot stand so.
    """
    pose = np.concatenate([_solve_leg(tree, leg) for leg in legs])
    joints = [tree.joint_above[link] for leg in legs for link in leg.links]
    # Adding 0 turns -0 into 0.
    return np.clip(np.round(pose, 4), *np.transpose([get_range(j) for j in joints])) + 0.0


def find_stated_pose(
    tree: Tree, legs: tuple[Leg, ...], home: dict[str, float]
) -> np.ndarray | None:
    """Return the joint angles (12,), rad, that `home` states; None if the robot cannot stand so.

    Joints are within their limits, all feet at one height and well below the hips.
    """
    if any(name not in home for leg in legs for name in leg.joints):
        return None
    pose = np.array([[home[name] for name in leg.joints] for leg in legs])
    ranges = np.array([[get_range(tree.joint_above[link]) for link in leg.links] for leg in legs])
    depths, soles = [], []
    for leg, angles in zip(legs, pose, strict=True):
        hip, _, calf = (tree.joint_above[link] for link in leg.links)
        foot = _compute_foot(tree, leg, angles)
        thigh = tree.compute_frame(calf)[:3, 3]
        length = np.linalg.norm(thigh) + np.linalg.norm(leg.foot.center)
        depths.append((tree.compute_frame(hip)[2, 3] - foot[2]) / length)
        soles.append((foot[2] - leg.foot.radius) / length)
    within = (ranges[..., 0] <= pose) & (pose <= ranges[..., 1])
    stands = min(depths) > LEAST_DEPTH and np.ptp(soles) < LEVEL
    return pose.ravel() if stands and within.all() else None


def _compute_foot(tree: Tree, leg: Leg, angles: np.ndarray) -> np.ndarray:
    """Return the foot's center (3,), m, in the trunk's frame, at joint `angles` (3,), rad."""
    frame = np.eye(4)
    for link, angle in zip(leg.links, angles, strict=True):
        joint = tree.joint_above[link]
        frame = frame @ tree.compute_frame(joint) @ rotation_matrix(angle, joint.axis)
    return frame[:3, :3] @ leg.foot.center + frame[:3, 3]


def _solve_leg(tree: Tree, leg: Leg) -> np.ndarray:
    hip, thigh, calf = (tree.joint_above[link] for link in leg.links)
    hip_angle = _level_thigh(tree, hip, thigh)
    # In the trunk's axes with thigh and calf at 0; both turn about the same axis.
    turn = rotation_matrix(hip_angle, hip.axis)
    to_thigh = tree.compute_frame(hip) @ turn @ tree.compute_frame(thigh)
    to_calf = to_thigh @ tree.compute_frame(calf)
    axis = to_thigh[:3, :3] @ normalize(thigh.axis)
    calf_axis = to_calf[:3, :3] @ normalize(calf.axis)
    sense = axis @ calf_axis
    if abs(sense) < 0.99:
        raise UrdfError(
            f"{tree.source}: joints '{thigh.name}' and '{calf.name}' turn about different axes; "
            "expected parallel ones, to find a standing pose"
        )
    upper = to_calf[:3, 3] - to_thigh[:3, 3]
    lower = to_calf[:3, :3] @ leg.foot.center
    # The plane across the axis: `down` and, a quarter turn on about the axis, `side`.
    down = np.array([0.0, 0.0, -1.0])
    down -= axis * (axis @ down)
    if np.linalg.norm(down) < 0.5:
        raise UrdfError(
            f"{tree.source}: joint '{thigh.name}' turns about a vertical axis; expected a level one"
        )
    down /= np.linalg.norm(down)
    side = np.cross(axis, down)

    def to_polar(vector: np.ndarray) -> tuple[float, float]:
        x, y = vector @ down, vector @ side
        return float(np.hypot(x, y)), float(np.arctan2(y, x))

    (l1, a1), (l2, a2) = to_polar(upper), to_polar(lower)
    if min(l1, l2) < 1e-3:
        raise UrdfError(f"{tree.source}: leg {leg.name} has a thigh or calf without length")
    reach = STANDING_LENGTH * (l1 + l2)
    bend = np.arccos(np.clip((reach**2 - l1**2 - l2**2) / (2 * l1 * l2), -1, 1))
    poses: list[tuple[float, np.ndarray]] = []
    # The knee behind the thigh joint first (x ahead): thigh 0.8, calf -1.6 on Unitree's robots. But
    # a hind leg that is turned about, with its thigh joint behind its hip's, has its knee ahead.
    backwards = 1 if side @ np.array([1.0, 0, 0]) < 0 else -1
    offset = to_thigh[0, 3] - tree.compute_frame(hip)[0, 3]
    preferred = -backwards if leg.name[0] == "R" and offset < -TURNED else backwards
    for direction in (preferred, -preferred):
        knee = _move_into(sense * (-direction * bend - (a2 - a1)), get_range(calf))
        relative = sense * knee + (a2 - a1)
        # With the knee at that angle, the direction of the foot from the thigh joint.
        foot = a1 + np.arctan2(l2 * np.sin(relative), l1 + l2 * np.cos(relative))
        angle = _move_into(-foot, get_range(thigh))
        miss = abs(_wrap(angle + foot)) + abs(_wrap(relative + direction * bend))
        poses.append((miss, np.array([hip_angle, angle, knee])))
    first, second = poses
    return (second if second[0] < first[0] - 1e-3 else first)[1]


def _level_thigh(tree: Tree, hip: yourdfpy.Joint, thigh: yourdfpy.Joint) -> float:
    """Return the hip's angle, rad, nearest to 0, at which the thigh turns about a level axis.

    A hip that turns about the vertical is left at 0.
    """
    frame, to_thigh = tree.compute_frame(hip), tree.compute_frame(thigh)
    spin = normalize(hip.axis)
    axis = to_thigh[:3, :3] @ normalize(thigh.axis)
    up = frame[2, :3]  # the world's, in the hip's frame
    # Height of the thigh's axis over the hip's angle: constant + cosine and sine parts.
    constant = (axis @ spin) * (spin @ up)
    cosine, sine = axis @ up - constant, np.cross(spin, axis) @ up
    size = np.hypot(cosine, sine)
    if abs(axis @ up) < 1e-3 or size < max(abs(constant), 1e-6):
        return float(np.clip(0.0, *get_range(hip)))
    middle, half = np.arctan2(sine, cosine), np.arccos(-constant / size)
    angles = [_move_into(middle + half, get_range(hip)), _move_into(middle - half, get_range(hip))]
    return min(angles, key=abs)


def _wrap(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def _move_into(angle: float, limits: tuple[float, float]) -> float:
    """Return the angle, whole turns apart from `angle`, that is nearest to lying in `limits`."""
    turns = [_wrap(angle) + 2 * np.pi * k for k in (-1, 0, 1)]
    best = min(turns, key=lambda a: (abs(a - np.clip(a, *limits)), abs(a)))
    return float(np.clip(best, *limits))
