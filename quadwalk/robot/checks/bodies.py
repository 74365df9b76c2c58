"""What a URDF's bodies must be like: massive where they move, of an inertia that can exist.

What moves is a link with all that is fixed to it, and only their sum acts. So a link that is fixed
to others may be a point or nearly nothing, whatever its numbers; what moves may not.
"""

from dataclasses import dataclass
from decimal import Decimal

import numpy as np
import yourdfpy
from lxml import etree

from quadwalk.robot.checks.validate import UrdfError
from quadwalk.robot.inertia import SMALLEST, body_inertia, nearest_valid, principal
from quadwalk.robot.report import Report
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
class _Finding:
    """An inertia that no body can have, the valid one in its place, and how far that is, kg m^2."""

    tensor: np.ndarray
    valid: np.ndarray

    @property
    def change(self) -> float:
        """Frobenius norm of the difference."""
        return float(np.linalg.norm(self.valid - self.tensor))

    def shown(self) -> str:
        """Moments before and after, and the relative size of the change."""
        share = self.change / max(float(np.linalg.norm(self.tensor)), SMALLEST)
        moments = f"{_moments(self.tensor)} -> {_moments(self.valid)}"
        return f"principal moments {moments} kg m^2, a change by {share:.2g} of its norm"


def resolutions(root: etree._Element) -> dict[str, np.ndarray]:
    """By link, how far the entries (3, 3) of its inertia may be from what was meant, kg m^2.

    Half a unit in the last digit that each is written with; an entry of 0 is as fine as the finest.
    """
    found = {}
    for link in root.iterfind("link"):
        inertia = link.find("inertial/inertia")
        if inertia is None:
            continue
        given = {name: inertia.get(name) for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
        digits = {name: Decimal(value).as_tuple() for name, value in given.items() if float(value)}
        units = {name: 10.0 ** int(number.exponent) for name, number in digits.items()}
        finest = min(units.values(), default=0.0)
        xx, xy, xz, yy, yz, zz = (units.get(name, finest) / 2 for name in given)
        found[link.get("name")] = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return found


def check_bodies(
    tree: Tree, resolution: dict[str, np.ndarray], source: str, repair: bool, report: Report
) -> None:
    """Refuse what no rigid body can have; with `repair`, put the nearest valid inertia instead.

    A moment of inertia is a sum of squares over the mass: the tensor is positive definite, and no
    principal moment exceeds the sum of the others. What is beyond that only by rounding, or in a
    part that is next to nothing, is taken as it was meant, with a note in `report`. Inertias of the
    `tree` are changed in place; `resolution` is from `resolutions`.
    """
    for body in tree.bodies:
        parts = [name for name in tree.parts[body] if tree.links[name].inertial is not None]
        massive = [name for name in parts if tree.links[name].inertial.mass > 0]
        whole = body_inertia(tree, body)
        if body == tree.root and whole is None:
            continue  # a root without any mass stands still, whatever its inertia
        passed: list[tuple[str, _Finding]] = []
        for name in parts:
            mass, tensor = tree.links[name].inertial.mass, tree.links[name].inertial.inertia
            if _is_sound(tensor) or (mass == 0 and not massive):
                continue  # what moves without any mass is looked at below
            finding = _Finding(tensor, nearest_valid(1.0, tensor, thinnest=0.0))
            if _negligible(finding, tree, body, name):
                passed.append((name, finding))
                continue
            if _is_rounding(finding, mass, resolution[name]):
                tree.links[name].inertial.inertia = finding.valid
                report.add("repaired", f"inertia of '{name}' by rounding, {finding.shown()}")
            elif repair:
                finding = _Finding(tensor, nearest_valid(mass, tensor))
                tree.links[name].inertial.inertia = finding.valid
                report.add("repaired", f"inertia of '{name}', {finding.shown()}")
            else:
                positive = np.linalg.eigvalsh(tensor)[0] >= 0
                expected = "none above the sum of the others" if positive else "positive ones"
                raise UrdfError(
                    f"{source}: link '{name}': <inertia> has principal moments {_moments(tensor)}; "
                    f"expected {expected} (or pass --robot.repair-inertia)"
                )
        _settle(tree, body, passed, report)
        _thicken(tree, body, massive, report)
        if body != tree.root:
            _check_moving(tree, body, source, repair, report)


def _is_sound(tensor: np.ndarray) -> bool:
    """Whether a body can have an inertia (3, 3), but for the last bits."""
    smallest, middle, largest = np.linalg.eigvalsh(tensor)
    room = _ROUNDING * abs(largest)
    return bool(smallest >= -room and smallest + middle >= largest - room)


def _is_rounding(finding: _Finding, mass: float, resolution: np.ndarray) -> bool:
    """Whether each entry's digits explain its change, or that is nothing for a body of `mass`."""
    explained = np.abs(finding.valid - finding.tensor) <= resolution
    few = finding.change <= _MOST_ROUNDING * float(np.linalg.norm(finding.tensor))
    return bool(few and explained.all()) or finding.change <= mass * _THIN**2


def _negligible(finding: _Finding, tree: Tree, body: str, name: str) -> bool:
    """Whether the link's fault is next to nothing in the body that it is part of."""
    others = [part for part in tree.parts[body] if part != name]
    rest = body_inertia(tree, body, others)
    if rest is None:
        return False
    smallest = float(np.linalg.eigvalsh(rest.about_com)[0])
    return finding.change <= _NEGLIGIBLE * smallest


def _settle(tree: Tree, body: str, passed: list[tuple[str, _Finding]], report: Report) -> None:
    """Leave the inertias that were let pass as they are, if their body's sum is valid."""
    if not passed:
        return
    whole = body_inertia(tree, body)
    assert whole is not None
    exact = _is_sound(whole.about_com)
    for name, finding in passed:
        if exact:
            what = f"an inertia that no body can have, next to nothing in '{body}', as it is"
            report.add("assumed", what, f"{name} {_moments(finding.tensor)}")
        else:
            tree.links[name].inertial.inertia = finding.valid
            report.add("repaired", f"inertia of '{name}', {finding.shown()}")


def _thicken(tree: Tree, body: str, massive: list[str], report: Report) -> None:
    """Give a body that is a point or a rod, as a whole, a little thickness, in its first part."""
    whole = body_inertia(tree, body)
    if whole is None or np.linalg.eigvalsh(whole.about_com)[0] > whole.mass * _THIN**2:
        return
    valid = nearest_valid(whole.mass, whole.about_com, _THIN)
    inertial = tree.links[massive[0]].inertial
    turn = (tree.placement[massive[0]] @ to_matrix(inertial.origin))[:3, :3]
    inertial.inertia = inertial.inertia + turn.T @ (valid - whole.about_com) @ turn
    finding = _Finding(whole.about_com, valid)
    report.add("repaired", f"body '{body}' is as thick as {_THIN:g} m, {finding.shown()}")


def _check_moving(tree: Tree, body: str, source: str, repair: bool, report: Report) -> None:
    """A body that a joint moves has mass and inertia, or is one of several joints of the next."""
    whole = body_inertia(tree, body)
    if whole is None or whole.mass < SMALLEST:
        if tree.passes_on(body):
            return
        if not repair:
            raise UrdfError(
                f"{source}: link '{body}' moves (joint '{tree.joint_above[body].name}') and has "
                "no mass; expected <inertial> with a mass above 0 (or pass --robot.repair-inertia)"
            )
        least = nearest_valid(_LEAST_MASS, np.zeros((3, 3)))
        tree.links[body].inertial = yourdfpy.Inertial(mass=_LEAST_MASS, inertia=least)
        report.add("repaired", f"a mass of {_LEAST_MASS:g} kg for what moves without any", body)
        return
    if principal(whole.about_com)[0][2] < SMALLEST:
        raise UrdfError(
            f"{source}: link '{body}' moves, and its <inertia> is too small for MuJoCo; "
            f"expected principal moments above {SMALLEST:g} kg m^2 (or pass --robot.repair-inertia)"
        )


def _moments(tensor: np.ndarray) -> str:
    return "(" + ", ".join(f"{moment:.4g}" for moment in np.linalg.eigvalsh(tensor)) + ")"
