"""The tree of links: which links move, and which are fixed to another and fused with it."""

from collections.abc import Container
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import yourdfpy

ONE_WAY = ("revolute", "continuous", "prismatic")  # joints of one direction of motion


class Capsule(yourdfpy.Cylinder):
    """A cylinder whose `length` ends in half spheres, as URDF 1.1 has it."""


@dataclass(frozen=True)
class Tree:
    """The kinematic tree of a valid URDF.

    A moving link (or the root) carries the links that fixed joints attach to it: they are one
    rigid body, named after the moving link.
    """

    root: str  # name of the link that no joint moves
    links: dict[str, yourdfpy.Link]  # by name, in the file's order
    joint_above: dict[str, yourdfpy.Joint]  # whose child is that link; the root has none
    joints_below: dict[str, tuple[yourdfpy.Joint, ...]]  # whose parent it is, in the file's order
    body_of: dict[str, str]  # name of the moving link (or root) that each link is rigidly part of
    placement: dict[str, np.ndarray]  # (4, 4) frame of each link in that of the one `body_of` names
    bodies: tuple[str, ...]  # names of the moving links, root first, parents before children

    @cached_property
    def parts(self) -> dict[str, tuple[str, ...]]:
        """Names of the links that each body is made of, the moving link itself first."""
        parts: dict[str, list[str]] = {body: [] for body in self.bodies}
        for link, body in self.body_of.items():
            parts[body].append(link)
        return {body: tuple(links) for body, links in parts.items()}

    def moving_joints(self, body: str) -> list[yourdfpy.Joint]:
        """The joints that move other bodies against this one, in the order of the parts."""
        return [
            joint
            for link in self.parts[body]
            for joint in self.joints_below[link]
            if joint.type != "fixed"
        ]

    def passes_on(self, body: str) -> bool:
        """Whether a moving link without mass only leads from its joint on to the next.

        A ball joint written as three hinges has two such links. Nothing that could touch or weigh
        anything is fixed to them, and each has one joint below it.
        """
        parts = [self.links[name] for name in self.parts[body]]
        if any(link.collisions or (link.inertial and link.inertial.mass) for link in parts):
            return False
        below = self.moving_joints(body)
        joints = [self.joint_above.get(body), *below]
        return len(below) == 1 and all(j is not None and j.type in ONE_WAY for j in joints)

    def chain_from(self, joint: yourdfpy.Joint) -> list[yourdfpy.Joint]:
        """`joint` and those after it, through links without mass, up to a body that has some."""
        chain = [joint]
        while self.passes_on(chain[-1].child):
            chain += self.moving_joints(chain[-1].child)
        return chain

    def joints_to(self, body: str) -> list[yourdfpy.Joint]:
        """The joints that move `body` against the one above it that has mass; the root has none."""
        joint = self.joint_above.get(body)
        if joint is None:
            return []
        above = self.body_of[joint.parent]
        return [*(self.joints_to(above) if self.passes_on(above) else []), joint]

    def frame_of(self, joint: yourdfpy.Joint) -> np.ndarray:
        """(4, 4) frame of the joint's child, at joint position 0, in the body above it."""
        return self.placement[joint.parent] @ to_matrix(joint.origin)


def build_tree(robot: yourdfpy.Robot) -> Tree:
    """The tree of a robot that has been checked: one root, no cycle, no unknown names."""
    links = {link.name: link for link in robot.links}
    joint_above = {joint.child: joint for joint in robot.joints}
    below: dict[str, list[yourdfpy.Joint]] = {name: [] for name in links}
    for joint in robot.joints:
        below[joint.parent].append(joint)
    (root,) = (name for name in links if name not in joint_above)
    body_of, placement, bodies = {root: root}, {root: np.eye(4)}, [root]
    pending = [root]
    while pending:
        link = pending.pop()
        pending.extend(joint.child for joint in reversed(below[link]))
        joint = joint_above.get(link)
        if joint is None:
            continue
        if joint.type == "fixed":
            body_of[link] = body_of[joint.parent]
            placement[link] = placement[joint.parent] @ to_matrix(joint.origin)
        else:
            body_of[link], placement[link] = link, np.eye(4)
            bodies.append(link)
    return Tree(
        root=root,
        links=links,
        joint_above=joint_above,
        joints_below={name: tuple(joints) for name, joints in below.items()},
        body_of=body_of,
        placement=placement,
        bodies=tuple(bodies),
    )


def to_matrix(origin: np.ndarray | None) -> np.ndarray:
    """(4, 4) of a URDF origin, which may be left out."""
    return np.eye(4) if origin is None else np.asarray(origin, dtype=np.float64)


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """(4, 4) rotation by `angle` rad about the unit `axis` (3,) (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    out = np.eye(4)
    out[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return out


def to_roll_pitch_yaw(turn: np.ndarray) -> np.ndarray:
    """Return (3,) rad, as in a URDF's `rpy`, of a rotation (3, 3)."""
    ahead, left, up = turn.T
    yaw = np.arctan2(ahead[1], ahead[0])
    pitch = np.arctan2(-ahead[2], np.hypot(ahead[0], ahead[1]))
    # With yaw known, roll is exact at a pitch of 90 degrees too.
    side = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    roll = np.arctan2(-(side @ up), side @ left)
    return np.array([roll, pitch, yaw])


def is_limited(joint: yourdfpy.Joint) -> bool:
    """Whether a joint of one direction has position limits."""
    return joint.type != "continuous" and joint.limit is not None and joint.limit.lower is not None


def joint_range(joint: yourdfpy.Joint) -> tuple[float, float]:
    """(lower, upper) position limits in rad or m; one without turns once, -pi .. pi."""
    return (joint.limit.lower, joint.limit.upper) if is_limited(joint) else (-np.pi, np.pi)


def unit(axis: np.ndarray) -> np.ndarray:
    """`axis` (3,) with length 1: URDF does not ask for normalized axes."""
    return np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)


def name_axis(direction: np.ndarray) -> str:
    """Return +x, -x, +y, -y, +z or -z: the axis that `direction` (3,) is nearest to."""
    index = int(np.argmax(np.abs(direction)))
    return ("-" if direction[index] < 0 else "+") + "xyz"[index]


def find_free_name(name: str, taken: Container[str]) -> str:
    """Return `name`, with as many underscores at its end as make it none of those `taken`."""
    while name in taken:
        name += "_"
    return name
