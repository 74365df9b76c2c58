"""Rigid-body inertia: the nearest that is physical, and links composed to bodies."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import nnls

from quadwalk.robot.structure.tree import Tree, to_matrix

# MuJoCo takes a smaller mass (kg) or moment (kg m^2) of a moving body for none (mjMINVAL).
SMALLEST = 1e-15
# A repaired body extends at least this far (m, root mean square) along each principal axis.
THINNEST = 1e-3


@dataclass(frozen=True)
class Inertia:
    """Mass (kg), center of mass (3,) in m, and inertia (3, 3) in kg m^2 about that center."""

    mass: float
    com: np.ndarray
    about_com: np.ndarray


def find_nearest_valid(mass: float, tensor: np.ndarray, thinnest: float = THINNEST) -> np.ndarray:
    """Return the inertia (3, 3) nearest to `tensor` (Frobenius) that a body of `mass` kg can have.

    Principal axes stay. Moments are sums of second moments of mass, I = (s2+s3, s1+s3, s1+s2) with
    s >= 0: the nearest valid ones are a least-squares problem. s is kept at `mass * thinnest**2` or
    more: above 0 the result is positive definite.
    """
    moments, axes = np.linalg.eigh((tensor + tensor.T) / 2)
    sums = 1.0 - np.eye(3)
    floor = np.full(3, mass * thinnest**2)
    second, _ = nnls(sums, moments - sums @ floor)
    return axes @ np.diag(sums @ (second + floor)) @ axes.T


def compute_inertia(tree: Tree, body: str, links: Sequence[str] | None = None) -> Inertia | None:
    """Return the inertia of a body, or of those of its `links`, in its frame; None without mass."""
    parts = []
    for name in tree.parts[body] if links is None else links:
        inertial = tree.links[name].inertial
        if inertial is not None:  # else it has no mass, and none is invented
            frame = tree.placement[name] @ to_matrix(inertial.origin)
            turn = frame[:3, :3]
            parts.append(Inertia(inertial.mass, frame[:3, 3], turn @ inertial.inertia @ turn.T))
    return compose(parts)


def compose(parts: list[Inertia]) -> Inertia | None:
    """Return the inertia of rigidly joined parts, all in one frame, by the parallel-axis theorem.

    None without mass.
    """
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


def find_principal(about_com: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return principal moments (3,), largest first, and the quaternion wxyz (4,) of their axes."""
    moments, axes, quat = np.zeros(3), np.zeros(9), np.zeros(4)
    mujoco.mju_eig3(moments, axes, quat, about_com.ravel())
    # MuJoCo refuses A + B < C to the last bit; a flat body meets it with equality, give or take
    # rounding. What is truly outside was refused when the URDF was checked.
    moments[0] = min(moments[0], moments[1] + moments[2])
    return moments, quat


def round_moments(moments: np.ndarray) -> np.ndarray:
    """Round principal moments (3,), largest first, kg m^2, to 6 significant digits.

    The largest is rounded down where it would exceed the sum of the others, as in no rigid body.
    """
    first, second, third = (float(f"{moment:.6g}") for moment in moments)
    while first > second + third:
        # One unit less in the last digit.
        unit = 10.0 ** (np.floor(np.log10(first)) - 5)
        first = float(f"{first - unit:.6g}")
    return np.array([first, second, third])
