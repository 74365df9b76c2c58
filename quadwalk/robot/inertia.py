"""Rigid-body inertia: composing the links of a body, and principal axes for MuJoCo."""

from dataclasses import dataclass

import mujoco
import numpy as np
import yourdfpy

from quadwalk.robot.tree import matrix


@dataclass(frozen=True)
class Inertia:
    """Mass (kg), centre of mass (3,) in m, and inertia (3, 3) in kg m^2 about that centre."""

    mass: float
    com: np.ndarray
    about_com: np.ndarray


def link_inertia(link: yourdfpy.Link, placement: np.ndarray) -> Inertia | None:
    """The link's inertia, in the axes of the frame that `placement` (4, 4) is given in.

    None when the link has no `<inertial>`: then it has no mass, and none is invented.
    """
    if link.inertial is None:
        return None
    frame = placement @ matrix(link.inertial.origin)
    turn = frame[:3, :3]
    return Inertia(link.inertial.mass, frame[:3, 3], turn @ link.inertial.inertia @ turn.T)


def compose(parts: list[Inertia]) -> Inertia | None:
    """The inertia of rigidly joined parts, all given in one frame (parallel-axis theorem)."""
    mass = sum(part.mass for part in parts)
    if mass == 0:
        return None
    com = sum(part.mass * part.com for part in parts) / mass
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
