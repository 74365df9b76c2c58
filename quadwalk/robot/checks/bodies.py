"""Checks of bodies: those that move have mass, and an inertia that can exist.

What moves is a link with all that is fixed to it, and only their sum acts. So a link that is fixed
to others may be a point or nearly nothing, whatever its numbers; what moves may not.
"""

from dataclasses import dataclass
from decimal import Decimal

import numpy as np
import yourdfpy
from lxml import etree

from quadwalk.robot.inertia import SMALLEST, compute_inertia, find_nearest_valid, find_principal
from quadwalk.robot.report import Report, UrdfError
from quadwalk.robot.structure.tree import Tree, to_matrix

# Room for rounding when principal moments are compared, relative to the largest.
_ROUNDING = 1e-10
# What the digits of a file explain is believed up to this share of an inertia's norm: a single
# digit, as in "1", would explain anything.
_MOST_ROUNDING = 0.02
# Share of the smallest principal moment of the rest of its body that a part may be off by:
# Unitree's frame `base`, of 1e-6 kg, has 3e-6 kg m^2 that no body can have, ANYmal C a hatch.
_NEGLIGIBLE = 1e-2
# kg, of what moves without mass, when asked to repair it: Unitree's own for a frame.
_LEAST_MASS = 1e-6
# m, how thick a point or a rod that moves is made (root mean square), for MuJoCo divides by its
# moments: too little to be seen at the 1e-5 at which conversions are compared.
_THIN = 1e-5


@dataclass(frozen=True)
class _Repair:
    """An inertia that no body can have, and the valid one in its place, kg m^2."""

    tensor: np.ndarray
    valid: np.ndarray

    @property
    def change(self) -> float:
        """Frobenius norm of the difference."""
        return float(np.linalg.norm(self.valid - self.tensor))

    def describe(self) -> str:
        """Describe moments before and after, and the relative size of the change."""
        share = self.change / max(float(np.linalg.norm(self.tensor)), SMALLEST)
        moments = f"{_show_moments(self.tensor)} -> {_show_moments(self.valid)}"
        return f"principal moments {moments} kg m^2, a change by {share:.2g} of its norm"


def read_resolutions(root: etree._Element) -> dict[str, np.ndarray]:
    """Return how far off each entry (3, 3) of a link's inertia may be by its digits, kg m^2.

    Half a unit in the last digit that each is written with; an entry of 0 is as fine as the finest.
    """
    resolutions = {}
    for link in root.iterfind("link"):
        inertia = link.find("inertial/inertia")
        if inertia is None:
            continue
        words = {name: inertia.get(name) for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
        digits = {name: Decimal(word).as_tuple() for name, word in words.items() if float(word)}
        units = {name: 10.0 ** int(number.exponent) for name, number in digits.items()}
        finest = min(units.values(), default=0.0)
        xx, xy, xz, yy, yz, zz = (units.get(name, finest) / 2 for name in words)
        resolutions[link.get("name")] = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return resolutions


def check_bodies(
    tree: Tree, resolutions: dict[str, np.ndarray], may_repair: bool, report: Report
) -> None:
    """Raise `UrdfError` for an inertia that no rigid body can have, unless it `may_repair` it.

    A repair takes the nearest valid inertia.

    A moment of inertia is a sum of squares over the mass: the tensor is positive definite, and no
    principal moment exceeds the sum of the others. What is beyond that only by rounding, or in a
    part that is next to nothing, is taken as it was meant, with a note in `report`. Inertias of the
    `tree` are changed in place; `resolutions` are from `read_resolutions`.
    """
    for body in tree.bodies:
        parts = [name for name in tree.parts[body] if tree.links[name].inertial is not None]
        massive = [name for name in parts if tree.links[name].inertial.mass > 0]
        if body == tree.root and not massive:
            continue  # a root without any mass stands still, whatever its inertia
        negligible: list[tuple[str, _Repair]] = []
        for name in parts:
            mass, tensor = tree.links[name].inertial.mass, tree.links[name].inertial.inertia
            if _is_sound(tensor) or (mass == 0 and not massive):
                continue  # what moves without any mass is looked at below
            repair = _Repair(tensor, find_nearest_valid(1.0, tensor, thinnest=0.0))
            if _is_negligible(repair, tree, body, name):
                negligible.append((name, repair))
                continue
            if _is_rounding(repair, mass, resolutions[name]):
                tree.links[name].inertial.inertia = repair.valid
                report.add("repaired", f"inertia of '{name}' by rounding, {repair.describe()}")
            elif may_repair:
                repair = _Repair(tensor, find_nearest_valid(mass, tensor))
                tree.links[name].inertial.inertia = repair.valid
                report.add("repaired", f"inertia of '{name}', {repair.describe()}")
            else:
                positive = np.linalg.eigvalsh(tensor)[0] >= 0
                expected = "none above the sum of the others" if positive else "positive ones"
                raise UrdfError(
                    f"{tree.source}: link '{name}': <inertia> has principal moments "
                    f"{_show_moments(tensor)}; expected {expected} "
                    "(or pass --robot.repair-inertia)"
                )
        _decide_on_negligible(tree, body, negligible, report)
        _make_thick(tree, body, massive, report)
        if body != tree.root:
            _check_moving(tree, body, may_repair, report)


def _is_sound(tensor: np.ndarray) -> bool:
    """Return True if a body can have an inertia (3, 3), but for the last bits."""
    smallest, middle, largest = np.linalg.eigvalsh(tensor)
    room = _ROUNDING * abs(largest)
    return bool(smallest >= -room and smallest + middle >= largest - room)


def _is_rounding(repair: _Repair, mass: float, resolution: np.ndarray) -> bool:
    """Return True if digits explain each entry's change, or it is nothing for a body of `mass`."""
    explained = np.abs(repair.valid - repair.tensor) <= resolution
    small = repair.change <= _MOST_ROUNDING * float(np.linalg.norm(repair.tensor))
    return bool(small and explained.all()) or repair.change <= mass * _THIN**2


def _is_negligible(repair: _Repair, tree: Tree, body: str, name: str) -> bool:
    """Return True if the link's fault is next to nothing in the body that it is part of."""
    rest = compute_inertia(tree, body, [part for part in tree.parts[body] if part != name])
    if rest is None:
        return False
    smallest = float(np.linalg.eigvalsh(rest.about_com)[0])
    return repair.change <= _NEGLIGIBLE * smallest


def _decide_on_negligible(
    tree: Tree, body: str, repairs: list[tuple[str, _Repair]], report: Report
) -> None:
    """Leave negligible faults as they are if their body's sum is valid; else repair them."""
    if not repairs:
        return
    whole = compute_inertia(tree, body)
    assert whole is not None
    is_sound = _is_sound(whole.about_com)
    for name, repair in repairs:
        if is_sound:
            note = f"an inertia that no body can have, next to nothing in '{body}', as it is"
            report.add("assumed", note, f"{name} {_show_moments(repair.tensor)}")
        else:
            tree.links[name].inertial.inertia = repair.valid
            report.add("repaired", f"inertia of '{name}', {repair.describe()}")


def _make_thick(tree: Tree, body: str, massive: list[str], report: Report) -> None:
    """Give a body that is a point or a rod, as a whole, a little thickness, in its first part."""
    whole = compute_inertia(tree, body)
    if whole is None or np.linalg.eigvalsh(whole.about_com)[0] > whole.mass * _THIN**2:
        return
    valid = find_nearest_valid(whole.mass, whole.about_com, _THIN)
    inertial = tree.links[massive[0]].inertial
    turn = (tree.placement[massive[0]] @ to_matrix(inertial.origin))[:3, :3]
    inertial.inertia = inertial.inertia + turn.T @ (valid - whole.about_com) @ turn
    repair = _Repair(whole.about_com, valid)
    report.add("repaired", f"body '{body}' is as thick as {_THIN:g} m, {repair.describe()}")


def _check_moving(tree: Tree, body: str, may_repair: bool, report: Report) -> None:
    """Raise `UrdfError` where a body that a joint moves has no mass or inertia.

    A body for which `tree.is_between_joints` holds may lack both. If it `may_repair`, a body
    without mass gets a small one, with a note in `report`.
    """
    whole = compute_inertia(tree, body)
    if whole is None or whole.mass < SMALLEST:
        if tree.is_between_joints(body):
            return
        if not may_repair:
            raise UrdfError(
                f"{tree.source}: link '{body}' moves (joint '{tree.joint_above[body].name}') and "
                "has no mass; expected <inertial> with a mass above 0 "
                "(or pass --robot.repair-inertia)"
            )
        least = find_nearest_valid(_LEAST_MASS, np.zeros((3, 3)))
        tree.links[body].inertial = yourdfpy.Inertial(mass=_LEAST_MASS, inertia=least)
        report.add("repaired", f"a mass of {_LEAST_MASS:g} kg for what moves without any", body)
        return
    if find_principal(whole.about_com)[0][2] < SMALLEST:
        raise UrdfError(
            f"{tree.source}: link '{body}' moves, and its <inertia> is too small for MuJoCo; "
            f"expected principal moments above {SMALLEST:g} kg m^2 (or pass --robot.repair-inertia)"
        )


def _show_moments(tensor: np.ndarray) -> str:
    return "(" + ", ".join(f"{moment:.4g}" for moment in np.linalg.eigvalsh(tensor)) + ")"
