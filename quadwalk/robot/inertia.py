"""Rigid-body inertia: what is physical, the nearest that is, and composing links to bodies."""

from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np
import yourdfpy

from quadwalk.robot.report import Report
from quadwalk.robot.tree import Tree, matrix
from quadwalk.robot.validate import UrdfError

# Room for rounding when principal moments are compared, relative to the largest.
ROUNDING = 1e-10
# MuJoCo takes a smaller mass (kg) or moment (kg m^2) of a moving body for none (mjMINVAL).
SMALLEST = 1e-15
# A repaired body extends at least this far (m, root mean square) along each principal axis.
THINNEST = 1e-3


@dataclass(frozen=True)
class Inertia:
    """Mass (kg), centre of mass (3,) in m, and inertia (3, 3) in kg m^2 about that centre."""

    mass: float
    com: np.ndarray
    about_com: np.ndarray


def check_inertias(tree: Tree, source: str, repair: bool, report: Report) -> None:
    """Refuse what no rigid body can have; with `repair`, put the nearest valid inertia instead.

    A moment of inertia is a sum of squares over the mass: the tensor is positive definite, and no
    principal moment exceeds the sum of the others. A link that is fused with another may be a
    point (moments 0) or have no mass; a body that moves may not.
    """
    root = body_inertia(tree, tree.root)
    for name, link in tree.links.items():
        if link.inertial is None or (root is None and tree.body_of[name] == tree.root):
            continue  # a root without any mass stands still, whatever its inertia
        mass, tensor = link.inertial.mass, link.inertial.inertia
        # Whether the root moves is decided later; where it is asked for, it is made fit to.
        moves = name == tree.body_of[name] and (name != tree.root or repair)
        where = f"{source}: link '{name}'"
        if moves and mass == 0 and name != tree.root:
            raise UrdfError(f"{where} moves, and its <mass> is 0; expected a mass above 0")
        problem = _problem(mass, tensor, moves)
        if problem is None:
            continue
        if not repair:
            raise UrdfError(f"{where}: <inertia> {problem} (or pass --repair-inertia)")
        valid = nearest_valid(mass, tensor)
        change = np.linalg.norm(valid - tensor) / max(float(np.linalg.norm(tensor)), SMALLEST)
        link.inertial.inertia = valid
        report.add(
            "repaired",
            f"inertia of '{name}', principal moments {_moments(tensor)} -> {_moments(valid)} "
            f"kg m^2, a change by {change:.2g} of its norm",
        )
    for body in tree.bodies[1:]:
        whole = body_inertia(tree, body)
        if whole is None or whole.mass < SMALLEST:
            raise UrdfError(
                f"{source}: link '{body}' moves (joint '{tree.joint_above[body].name}') and has "
                "no mass; expected <inertial> with a mass above 0"
            )
        if principal(whole.about_com)[0][2] < SMALLEST:
            raise UrdfError(
                f"{source}: link '{body}' moves, and its <inertia> is too small for MuJoCo; "
                f"expected principal moments above {SMALLEST:g} kg m^2"
            )


def _problem(mass: float, tensor: np.ndarray, moves: bool) -> str | None:
    """What is wrong with a link's inertia (3, 3), and what is expected; None if it is valid."""
    if mass == 0:
        return None if not tensor.any() else "is not 0 and the mass is; expected both or neither"
    smallest, middle, largest = np.linalg.eigvalsh(tensor)
    room = ROUNDING * abs(largest)
    shown = _moments(tensor)
    if smallest < -room or (moves and smallest <= 0):
        return f"has principal moments {shown}; expected positive ones"
    if smallest + middle < largest - room:
        return f"has principal moments {shown}; expected none above the sum of the others"
    return None


def _moments(tensor: np.ndarray) -> str:
    return "(" + ", ".join(f"{moment:.4g}" for moment in np.linalg.eigvalsh(tensor)) + ")"


def nearest_valid(mass: float, tensor: np.ndarray) -> np.ndarray:
    """The (3, 3) inertia nearest to `tensor` (Frobenius norm) that a body of `mass` kg can have.

    Principal axes stay. Moments are sums of second moments of mass, I = (s2+s3, s1+s3, s1+s2) with
    s >= 0, so that the valid ones are a cone; the nearest point of it is found on each of its
    faces. s is kept at `mass * THINNEST**2` or more, so that the result is positive definite.
    """
    moments, axes = np.linalg.eigh((tensor + tensor.T) / 2)
    spread = 1.0 - np.eye(3)
    floor = mass * THINNEST**2
    target = moments - spread @ np.full(3, floor)
    best = np.zeros(3)
    for free in product((False, True), repeat=3):
        columns = np.flatnonzero(free)
        second = np.zeros(3)
        if columns.size:
            second[columns] = np.linalg.lstsq(spread[:, columns], target, rcond=None)[0]
        miss = np.linalg.norm(spread @ second - target)
        if (second >= 0).all() and miss < np.linalg.norm(spread @ best - target):
            best = second
    return axes @ np.diag(spread @ (best + floor)) @ axes.T


def link_inertia(link: yourdfpy.Link, placement: np.ndarray) -> Inertia | None:
    """The link's inertia, in the axes of the frame that `placement` (4, 4) is given in.

    None when the link has no `<inertial>`: then it has no mass, and none is invented.
    """
    if link.inertial is None:
        return None
    frame = placement @ matrix(link.inertial.origin)
    turn = frame[:3, :3]
    return Inertia(link.inertial.mass, frame[:3, 3], turn @ link.inertial.inertia @ turn.T)


def body_inertia(tree: Tree, body: str) -> Inertia | None:
    """The inertia of a moving link and what is fused with it, in its frame; None without mass."""
    links = [(tree.links[name], tree.placement[name]) for name in tree.parts[body]]
    parts = [link_inertia(link, placement) for link, placement in links]
    return compose([part for part in parts if part is not None])


def compose(parts: list[Inertia]) -> Inertia | None:
    """The inertia of rigidly joined parts, all given in one frame (parallel-axis theorem)."""
    mass = sum(part.mass for part in parts)
    if mass == 0:
        return None
    if len(parts) == 1:
        return parts[0]
    com = np.sum([part.mass * part.com for part in parts], axis=0) / mass
    about_com = np.zeros((3, 3))
    for part in parts:
        arm = part.com - com
        about_com += part.about_com + part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertia(mass, com, about_com)


def principal(about_com: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Principal moments (3,), largest first, and the quaternion wxyz (4,) of their axes."""
    moments, axes, quat = np.zeros(3), np.zeros(9), np.zeros(4)
    mujoco.mju_eig3(moments, axes, quat, about_com.ravel())
    # MuJoCo refuses A + B < C to the last bit; a flat body meets it with equality, give or take
    # rounding. What is truly outside was refused when the URDF was checked.
    moments[0] = min(moments[0], moments[1] + moments[2])
    return moments, quat


def printable(moments: np.ndarray) -> np.ndarray:
    """Principal moments (3,), largest first, as 6 digits hold them, still valid to the last bit."""
    first, second, third = (float(f"{moment:.6g}") for moment in moments)
    while first > second + third:
        # One unit less in the last digit.
        unit = 10.0 ** (np.floor(np.log10(first)) - 5)
        first = float(f"{first - unit:.6g}")
    return np.array([first, second, third])
