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

    source: str  # what error messages call the URDF
    root: str  # name of the link that no joint moves
    links: dict[str, yourdfpy.Link]  # by name, in the file's order
    joint_above: dict[str, yourdfpy.Joint]  # whose child is that link; the root has none
    joints_below: dict[str, tuple[yourdfpy.Joint, ...]]  # whose parent it is, in the file's order
    body_of: dict[str, str]  # name of the moving link (or root) that each link is rigidly part of
    placement: dict[str, np.ndarray]  # (4, 4) frame of each link in that of the one `body_of` names
    bodies: tuple[str, ...]  # names of the moving links, root first, parents before children

    @cached_property
    def parts(self) -> dict[str, tuple[str, ...]]:
        """Links of each body, by its name: the moving link first, then those fixed to it."""
        parts: dict[str, list[str]] = {body: [] for body in self.bodies}
        for link, body in self.body_of.items():
            parts[body].append(link)
        return {body: tuple(links) for body, links in parts.items()}

    def find_moving_joints(self, body: str) -> list[yourdfpy.Joint]:
        """Return the joints that move other bodies against this one, in the order of the parts."""
        return [
            joint
            for link in self.parts[body]
            for joint in self.joints_below[link]
            if joint.type != "fixed"
        ]

    def is_between_joints(self, body: str) -> bool:
        """Return True for a moving link without mass that only leads from joint to joint.

        A ball joint written as three hinges has two such links. Nothing that could touch or weigh
        anything is fixed to them, and each has one joint below it.
        """
        parts = [self.links[name] for name in self.parts[body]]
        if any(link.collisions or (link.inertial and link.inertial.mass) for link in parts):
            return False
        below = self.find_moving_joints(body)
        joints = [self.joint_above.get(body), *below]
        return len(below) == 1 and all(j is not None and j.type in ONE_WAY for j in joints)

    def follow_joint(self, joint: yourdfpy.Joint) -> str:
        """Return the first body with mass that `joint` moves, past links without any."""
        body = joint.child
        while self.is_between_joints(body):
            (below,) = self.find_moving_joints(body)
            body = below.child
        return body

    def find_joints_above(self, body: str) -> list[yourdfpy.Joint]:
        """Return the joints that move `body` against the next body with mass above it."""
        joint = self.joint_above.get(body)
        if joint is None:
            return []
        above = self.body_of[joint.parent]
        return [*(self.find_joints_above(above) if self.is_between_joints(above) else []), joint]

    def compute_frame(self, joint: yourdfpy.Joint) -> np.ndarray:
        """Return the frame (4, 4) of the joint's child in the body above it, at position 0."""
        return self.placement[joint.parent] @ to_matrix(joint.origin)


def build_tree(robot: yourdfpy.Robot, source: str) -> Tree:
    """Return the tree of a checked robot: one root, no cycle, no unknown names."""
    links = {link.name: link for link in robot.links}
    joint_above = {joint.child: joint for joint in robot.joints}
    below: dict[str, list[yourdfpy.Joint]] = {name: [] for name in links}
    for joint in robot.joints:
        below[joint.parent].append(joint)
    (root,) = (name for name in links if name not in joint_above)
    body_of, placement, bodies = {root: root}, {root: np.eye(4)}, [root]
    pending = [*reversed(below[root])]
    while pending:
        joint = pending.pop()
        link = joint.child
        pending.extend(reversed(below[link]))
        if joint.type == "fixed":
            body_of[link] = body_of[joint.parent]
            placement[link] = placement[joint.parent] @ to_matrix(joint.origin)
        else:
            body_of[link], placement[link] = link, np.eye(4)
            bodies.append(link)
    return Tree(
        source=source,
        root=root,
        links=links,
        joint_above=joint_above,
        joints_below={name: tuple(joints) for name, joints in below.items()},
        body_of=body_of,
        placement=placement,
        bodies=tuple(bodies),
    )


def to_matrix(origin: np.ndarray | None) -> np.ndarray:
    """Return the frame (4, 4) of a URDF origin, which may be left out."""
    return np.eye(4) if origin is None else np.asarray(origin, dtype=np.float64)


def to_roll_pitch_yaw(rotation: np.ndarray) -> np.ndarray:
    """Return a rotation (3, 3) as a URDF's `rpy` (3,), rad."""
    ahead, left, up = rotation.T
    yaw = np.arctan2(ahead[1], ahead[0])
    pitch = np.arctan2(-ahead[2], np.hypot(ahead[0], ahead[1]))
    # With yaw known, roll is exact at a pitch of 90 degrees too.
    side = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    roll = np.arctan2(-(side @ up), side @ left)
    return np.array([roll, pitch, yaw])


def is_limited(joint: yourdfpy.Joint) -> bool:
    """Return True if a joint of one direction has position limits."""
    return joint.type != "continuous" and joint.limit is not None and joint.limit.lower is not None


def get_range(joint: yourdfpy.Joint) -> tuple[float, float]:
    """Return the position limits, rad or m; -pi and pi for a joint without."""
    return (joint.limit.lower, joint.limit.upper) if is_limited(joint) else (-np.pi, np.pi)


def normalize(axis: np.ndarray) -> np.ndarray:
    """Return `axis` (3,) with length 1, which URDF does not ask for."""
    return np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)


def name_axis(direction: np.ndarray) -> str:
    """Return the axis nearest to `direction` (3,): +x, -x, +y, -y, +z or -z."""
    index = int(np.argmax(np.abs(direction)))
    return ("-" if direction[index] < 0 else "+") + "xyz"[index]


def make_unique(name: str, others: Container[str]) -> str:
    """Return `name`, with the first number from 2 on that sets it apart from `others`."""
    candidate, count = name, 1
    while candidate in others:
        count += 1
        candidate = f"{name}_{count}"
    return candidate
