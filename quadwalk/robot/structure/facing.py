"""Which way a quadruped faces in its root link's frame, inferred from its hips, thighs and names.

The conventions of ROS (REP 103) put x ahead, y left and z up, and training relies on them. A root
frame of another tool may have y ahead, or z down; its robot is turned, or refused if in doubt.
"""

import re
from collections.abc import Iterable
from itertools import pairwise, product

import numpy as np
from trimesh.transformations import rotation_matrix

from quadwalk.robot.meshes import Meshes
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.feet import find_foot
from quadwalk.robot.structure.legs import LEGS, Chain, find_chains, name_corners
from quadwalk.robot.structure.tree import Tree, get_range, name_axis, normalize

# A direction counts as along an axis of the root link up to this angle.
MOST_SKEW = np.radians(25)
# Feet are clearly above or below the thighs' joints from this share of a leg's length on.
CLEAR_HEIGHT = 0.3
# A knee bends one way if its limits let it bend so many times farther than the other way.
CLEAR_BEND = 3.0
# Knees of all legs point one way if their mean direction is at least so long.
CLEAR_KNEES = 0.9

_ENDS = {"f": "F", "front": "F", "fore": "F"} | dict.fromkeys(
    ("r", "h", "b", "rear", "hind", "back"), "R"
)
_SIDES = {"l": "L", "left": "L", "r": "R", "right": "R"}
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


class _Evidence:
    """Signs of a quadruped's front in its geometry and names, in the root link's frame.

    A turn (3, 3) is a rotation from the root link's frame to one with x ahead, y left and z up.
    """

    def __init__(self, tree: Tree, chains: list[Chain], meshes: Meshes | None) -> None:
        poses = [_Pose(tree, chain, meshes) for chain in chains]
        self.hips = np.array([pose.hip for pose in poses])
        self.names = read_names(chains)
        self.normal = _find_normal(np.array([pose.thigh for pose in poses]))
        self.vertical = np.eye(3)[np.argmax(np.abs(self.normal))]
        along = self.vertical @ np.mean([pose.reach for pose in poses], axis=0)
        # 1: `vertical` points up; -1: it points down; 0: feet are as high as thighs
        self.up = -np.sign(along) if abs(along) > CLEAR_HEIGHT else 0.0
        # of the thighs' axes, to either side; None where legs splay, as a spider's
        self.lateral = _find_lateral(poses, self.vertical)
        # of where knees point, (3,); near 0 where they differ or may bend either way
        self.knees = np.mean([pose.find_knee(self.vertical * (self.up or 1)) for pose in poses], 0)

    def fits_thighs(self, turn: np.ndarray) -> bool:
        """Return True if after `turn` (3, 3) the thighs turn about y, or if legs splay."""
        return self.lateral is None or abs(turn[1] @ self.lateral) > np.cos(MOST_SKEW)

    def fits_feet(self, turn: np.ndarray) -> bool:
        """Return True if after `turn` (3, 3) feet are below thighs, or if they are as high."""
        return self.up == 0 or bool(turn[2] @ self.vertical * self.up > 0)

    def fits_names(self, turn: np.ndarray) -> bool:
        """Return True if after `turn` (3, 3) each hip is at the corner that its leg's names say."""
        return self.names == name_corners(self.hips @ turn.T)

    def fits_knees(self, turn: np.ndarray) -> bool:
        """Return True if after `turn` (3, 3) the knees point backward."""
        return bool(turn[0] @ self.knees < -CLEAR_KNEES)

    def describe(self) -> str:
        """Describe the legs' geometry in one line."""
        signs = []
        if self.lateral is not None:
            signs.append(f"thighs turn about {name_axis(self.lateral)[1:]}")
        if self.up:
            signs.append(f"feet lie toward {name_axis(-self.up * self.vertical)}")
        if np.linalg.norm(self.knees) > CLEAR_KNEES:
            signs.append(f"knees point to {name_axis(self.knees)}")
        return ", ".join(signs)


class _Pose:
    """A leg's joints in the root link's frame, each at 0 or at the limit nearest to it."""

    def __init__(self, tree: Tree, chain: Chain, meshes: Meshes | None) -> None:
        foot = find_foot(tree, chain[2].child, meshes)
        center = np.zeros(3) if foot is None else foot.center
        frame = np.eye(4)
        anchors, self.axes = [], []
        for joint in chain:
            frame = frame @ tree.compute_frame(joint)
            anchors.append(frame[:3, 3])
            self.axes.append(frame[:3, :3] @ normalize(joint.axis))
            angle = np.clip(0, *get_range(joint))
            frame = frame @ rotation_matrix(angle, joint.axis)
        self.hip, self.thigh, knee = anchors
        self._upper, self._lower = knee - self.thigh, frame[:3, :3] @ center
        length = np.linalg.norm(self._upper) + np.linalg.norm(self._lower)
        self.reach = (self._upper + self._lower) / max(length, 1e-9)  # of the foot, in leg lengths
        self._calf = chain[2]

    def find_knee(self, up: np.ndarray) -> np.ndarray:
        """Return the direction (3,) of a standing leg's knee; 0 if it may bend either way."""
        axis, low_high = self.axes[2], np.array(get_range(self._calf))
        upper, lower = (v - axis * (axis @ v) for v in (self._upper, self._lower))
        bend = np.arctan2(axis @ np.cross(upper, lower), upper @ lower)
        low, high = bend + low_high - np.clip(0, *low_high)
        turns = 2 * np.pi * np.round((low + high) / (4 * np.pi))
        forth, back = max(high - turns, 0.0), max(turns - low, 0.0)
        if max(forth, back) < CLEAR_BEND * min(forth, back):
            return np.zeros(3)
        return np.sign(forth - back) * np.cross(axis, up)


def find_turn(tree: Tree, meshes: Meshes | None = None) -> tuple[np.ndarray, str]:
    """Return the turn (3, 3) from the root link's frame to x ahead, y left, z up, and the reasons.

    It is the identity unless evidence speaks against that. Raise `UrdfError` where the evidence
    contradicts itself, or calls for a turn without telling front from rear.
    """
    chains = find_chains(tree)
    evidence = _Evidence(tree, chains, meshes)
    turns = _list_turns(evidence)
    upright = np.eye(3)
    thighs = [turn for turn in turns if evidence.fits_thighs(turn)]
    if not thighs or np.abs(evidence.normal).max() < np.cos(MOST_SKEW):
        raise UrdfError(
            f"{tree.source}: link '{tree.root}' stands askew, by more than "
            f"{np.degrees(MOST_SKEW):.0f} degrees, to the axes of the thighs or to the plane of "
            "their joints; expected x ahead"
        )
    if not any(sorted(name_corners(evidence.hips @ turn.T)) == sorted(LEGS) for turn in turns):
        return upright, ""  # `find_legs` says that the hips are at no corners
    if evidence.names:
        return _choose_by_names(tree, evidence, thighs, chains)
    feet = [turn for turn in thighs if evidence.fits_feet(turn)]
    if _is_among(upright, feet):
        return upright, ""
    candidates = [turn for turn in feet if evidence.fits_knees(turn)]
    if len(candidates) == 1:
        return candidates[0], "thighs and knees"
    raise UrdfError(
        f"{tree.source}: link '{tree.root}' does not have x ahead and z up "
        f"({evidence.describe()}), and neither names nor knees tell front from rear; expected "
        "names of legs such as FR, FL, RR and RL"
    )


def _choose_by_names(
    tree: Tree, evidence: _Evidence, turns: list[np.ndarray], chains: list[Chain]
) -> tuple[np.ndarray, str]:
    """Choose one of the `turns` that fit the thighs, as `find_turn`, where legs have names."""
    upright = np.eye(3)
    candidates = [turn for turn in turns if evidence.fits_names(turn)]
    if _is_among(upright, candidates):
        return upright, ""
    matches = [turn for turn in candidates if evidence.fits_feet(turn)]
    hips = ", ".join(
        f"{chain[0].name} ({x:.3g}, {y:.3g}, {z:.3g})"
        for chain, (x, y, z) in zip(chains, evidence.hips, strict=True)
    )
    expected = "expected FR, FL, RR, RL with x ahead, y left, z up"
    if len(matches) != 1:
        raise UrdfError(
            f"{tree.source}: names and places of the legs of '{tree.root}' contradict each other: "
            f"{hips}, {evidence.describe()}; {expected}"
        )
    if np.linalg.norm(evidence.knees) > CLEAR_KNEES and not evidence.fits_knees(matches[0]):
        raise UrdfError(
            f"{tree.source}: names and knees of the legs of '{tree.root}' contradict each other: "
            f"{hips} face {name_axis(matches[0][0])}, where knees would bend forward; {expected}"
        )
    return matches[0], "names and thighs"


def read_names(chains: Iterable[Chain]) -> list[str]:
    """Read FR, FL, RR or RL of each leg from its joints' and links' names; [] if unclear."""
    names = []
    for chain in chains:
        corners = {
            corner
            for joint in chain
            for name in (joint.name, joint.child)
            for corner in _find_corners(name)
        }
        names.append(corners.pop() if len(corners) == 1 else "")
    return names if sorted(names) == sorted(LEGS) else []


def _find_corners(name: str) -> set[str]:
    """Return the corners in a name: FL for FL, LF, front_left, leftFront and the like."""
    corners = set()
    words = [word.lower() for word in _WORD.findall(name)]
    pairs = [*pairwise(words), *((w[0], w[1]) for w in words if len(w) == 2)]
    for first, second in pairs:
        for end, side in ((first, second), (second, first)):
            if end in _ENDS and side in _SIDES:
                corners.add(_ENDS[end] + _SIDES[side])
                break
    return corners


def _find_normal(thighs: np.ndarray) -> np.ndarray:
    """Return the normal (3,) to the plane of the thighs' joints (4, 3), m; z if there is none."""
    _, spread, axes = np.linalg.svd(thighs - thighs.mean(axis=0))
    return axes[2] if spread[2] < 0.5 * spread[1] else np.array([0.0, 0.0, 1.0])


def _find_lateral(poses: list[_Pose], vertical: np.ndarray) -> np.ndarray | None:
    """Return the level direction (3,) that thighs turn about; None where hips are upright."""
    total = np.zeros((3, 3))
    for pose in poses:
        hip, thigh, _ = pose.axes
        # A hip that swings the leg sideways lies ahead, whatever angle its 0 is.
        axis = np.cross(vertical, hip) if abs(hip @ thigh) < 0.5 else thigh
        axis = axis - vertical * (vertical @ axis)
        total += np.outer(axis, axis)
    values, axes = np.linalg.eigh(total)
    return axes[:, 2] if values[2] > 2.0 else None


def _list_turns(evidence: _Evidence) -> list[np.ndarray]:
    """Return the turns (3, 3), rows ahead, left and up, that make an axis vertical."""
    ahead = [axis for axis in (*np.eye(3), *-np.eye(3)) if axis @ evidence.vertical == 0]
    ups = (evidence.vertical, -evidence.vertical)
    return [np.array([x, np.cross(z, x), z]) for z, x in product(ups, ahead)]


def _is_among(turn: np.ndarray, turns: list[np.ndarray]) -> bool:
    return any(np.array_equal(turn, other) for other in turns)
