"""Finding a quadruped in a tree of links: legs, feet and a standing pose, from geometry alone."""

from dataclasses import dataclass

import numpy as np
import yourdfpy

from quadwalk.robot.tree import Tree, matrix, rotation
from quadwalk.robot.validate import UrdfError

LEGS = ("FR", "FL", "RR", "RL")

# Distance from thigh joint to foot, standing, as a share of the stretched leg: Unitree stands its
# robots at thigh .8, calf -1.6, and thighs and calves are of equal length.
STANDING_LENGTH = np.cos(0.8)


@dataclass(frozen=True)
class Leg:
    """One leg: its joints and links from the trunk outwards, and its foot.

    Attributes:
        name: FR, FL, RR or RL.
        joints: the names of the hip, thigh and calf joint.
        links: the names of the links that these move.
        foot: name that the foot's site and collision geom have in the model.
        foot_link: the link whose collision sphere touches the ground.
        foot_shape: index of that sphere among the link's collision shapes.
        centre: (3,) m, the sphere's centre in the frame of the calf link.
        radius: m, of that sphere.
    """

    name: str
    joints: tuple[str, str, str]
    links: tuple[str, str, str]
    foot: str
    foot_link: str
    foot_shape: int
    centre: np.ndarray
    radius: float


def find_legs(tree: Tree, source: str) -> tuple[Leg, ...]:
    """The four legs, FR, FL, RR, RL; `UrdfError` says what was found where it is no quadruped.

    A leg is a chain of three actuated joints from the trunk (the root body), with a collision
    sphere at its end. Ahead and left of the middle of the hips are x and y of the trunk's frame.
    """
    chains = [_chain(tree, joint) for joint in tree.moving_joints(tree.root)]
    if len(chains) != 4 or any(len(chain) != 3 for chain in chains):
        found = ", ".join(f"{chain[0].name} ({len(chain)})" for chain in chains) or "none"
        raise UrdfError(
            f"{source}: chains of moving joints from link '{tree.root}': {found}; "
            "a quadruped has four of three joints each"
        )
    for joint in (joint for chain in chains for joint in chain):
        if joint.type not in ("revolute", "continuous"):
            raise UrdfError(
                f"{source}: joint '{joint.name}' of a leg is {joint.type}; expected one that turns"
            )
    hips = np.array([tree.frame_of(chain[0])[:3, 3] for chain in chains])
    ahead, left = ((hips - hips.mean(axis=0))[:, :2] > 0).T
    names = [LEGS[2 * (not x) + y] for x, y in zip(ahead, left, strict=True)]
    if sorted(names) != sorted(LEGS):
        raise UrdfError(
            f"{source}: hips of link '{tree.root}' lie at (x, y) = "
            f"{', '.join(f'({x:.3g}, {y:.3g})' for x, y in hips[:, :2])}; "
            "expected one ahead and one behind on each side (x ahead, y left)"
        )
    legs = {
        name: _leg(tree, name, chain, source) for name, chain in zip(names, chains, strict=True)
    }
    return tuple(legs[name] for name in LEGS)


def _chain(tree: Tree, joint: yourdfpy.Joint) -> list[yourdfpy.Joint]:
    """The moving joints from `joint` outwards, in the order of the tree."""
    chain, pending = [], [joint]
    while pending:
        chain.append(pending.pop())
        pending.extend(reversed(tree.moving_joints(chain[-1].child)))
    return chain


def _leg(tree: Tree, name: str, chain: list[yourdfpy.Joint], source: str) -> Leg:
    calf = chain[2].child
    spheres = [
        (np.linalg.norm(centre), link, index, centre, shape.geometry.sphere.radius)
        for link in tree.parts[calf]
        for index, shape in enumerate(tree.links[link].collisions)
        if shape.geometry.sphere is not None
        for centre in [(tree.placement[link] @ matrix(shape.origin))[:3, 3]]
    ]
    if not spheres:
        raise UrdfError(
            f"{source}: link '{calf}' and what is fixed to it have no collision sphere; "
            f"expected one at the end of leg {name}, as its foot"
        )
    _, link, index, centre, radius = max(spheres, key=lambda sphere: sphere[0])
    return Leg(
        name=name,
        joints=tuple(joint.name for joint in chain),
        links=tuple(joint.child for joint in chain),
        foot=link if link != calf else _free_name(f"{calf}_foot", tree),
        foot_link=link,
        foot_shape=index,
        centre=centre,
        radius=radius,
    )


def _free_name(name: str, tree: Tree) -> str:
    while name in tree.links:
        name += "_"
    return name


def joint_range(joint: yourdfpy.Joint) -> tuple[float, float]:
    """(lower, upper) position limits in rad or m; a continuous joint turns once, -pi .. pi."""
    if joint.type == "continuous":
        return -np.pi, np.pi
    return joint.limit.lower, joint.limit.upper


def standing_pose(tree: Tree, legs: tuple[Leg, ...], source: str) -> np.ndarray:
    """(12,) rad: hips at 0, each foot below its thigh joint, knees bent backwards.

    The foot is `STANDING_LENGTH` of the stretched leg below the thigh joint, or as near to that
    as the limits allow. Rounded to 1e-4 rad: a choice, not a measurement.
    """
    pose = np.concatenate([_stand(tree, leg, source) for leg in legs])
    joints = [tree.joint_above[link] for leg in legs for link in leg.links]
    # Adding 0 turns -0 into 0.
    return np.clip(np.round(pose, 4), *np.transpose([joint_range(j) for j in joints])) + 0.0


def _stand(tree: Tree, leg: Leg, source: str) -> np.ndarray:
    hip, thigh, calf = (tree.joint_above[link] for link in leg.links)
    hip_angle = float(np.clip(0.0, *joint_range(hip)))
    # In the trunk's axes with thigh and calf at 0; both turn about the same axis.
    to_thigh = tree.frame_of(hip) @ rotation(unit(hip.axis), hip_angle) @ tree.frame_of(thigh)
    to_calf = to_thigh @ tree.frame_of(calf)
    axis = to_thigh[:3, :3] @ unit(thigh.axis)
    calf_axis = to_calf[:3, :3] @ unit(calf.axis)
    sense = axis @ calf_axis
    if abs(sense) < 0.99:
        raise UrdfError(
            f"{source}: joints '{thigh.name}' and '{calf.name}' turn about different axes; "
            "expected parallel ones, to find a standing pose"
        )
    upper = to_calf[:3, 3] - to_thigh[:3, 3]
    lower = to_calf[:3, :3] @ leg.centre
    # The plane across the axis: `down` and, a quarter turn on about the axis, `side`.
    down = np.array([0.0, 0.0, -1.0])
    down -= axis * (axis @ down)
    if np.linalg.norm(down) < 0.5:
        raise UrdfError(
            f"{source}: joint '{thigh.name}' turns about a vertical axis; expected a level one"
        )
    down /= np.linalg.norm(down)
    side = np.cross(axis, down)

    def polar(vector: np.ndarray) -> tuple[float, float]:
        x, y = vector @ down, vector @ side
        return float(np.hypot(x, y)), float(np.arctan2(y, x))

    (l1, a1), (l2, a2) = polar(upper), polar(lower)
    if min(l1, l2) < 1e-3:
        raise UrdfError(f"{source}: leg {leg.name} has a thigh or calf without length")
    reach = STANDING_LENGTH * (l1 + l2)
    bend = np.arccos(np.clip((reach**2 - l1**2 - l2**2) / (2 * l1 * l2), -1, 1))
    poses: list[tuple[float, np.ndarray]] = []
    # The knee behind the thigh joint first (x ahead): thigh .8, calf -1.6 on Unitree's robots.
    backwards = 1 if side @ np.array([1.0, 0, 0]) < 0 else -1
    for turn in (backwards, -backwards):
        knee = _into(sense * (-turn * bend - (a2 - a1)), joint_range(calf))
        relative = sense * knee + (a2 - a1)
        # With the knee at that angle, the direction of the foot from the thigh joint.
        foot = a1 + np.arctan2(l2 * np.sin(relative), l1 + l2 * np.cos(relative))
        angle = _into(-foot, joint_range(thigh))
        miss = abs(_wrap(angle + foot)) + abs(_wrap(relative + turn * bend))
        poses.append((miss, np.array([hip_angle, angle, knee])))
    preferred, other = poses
    return (other if other[0] < preferred[0] - 1e-3 else preferred)[1]


def unit(axis: np.ndarray) -> np.ndarray:
    """`axis` (3,) with length 1: URDF does not ask for normalised axes."""
    return np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)


def _wrap(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def _into(angle: float, limits: tuple[float, float]) -> float:
    """The angle, whole turns apart from `angle`, that is nearest to lying within `limits`."""
    turns = [_wrap(angle) + 2 * np.pi * k for k in (-1, 0, 1)]
    best = min(turns, key=lambda a: (abs(a - np.clip(a, *limits)), abs(a)))
    return float(np.clip(best, *limits))
