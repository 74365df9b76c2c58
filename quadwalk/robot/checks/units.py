"""Checks that a quadruped's numbers are in URDF's units: radians, meters, kilograms.

Nothing in a file says so, and one in degrees, millimeters or grams converts into a robot that
cannot be. What no quadruped has is refused, with the unit that would make it one.
"""

import numpy as np

from quadwalk.robot.inertia import compute_inertia
from quadwalk.robot.report import Report, UrdfError
from quadwalk.robot.structure.legs import Chain, Leg
from quadwalk.robot.structure.tree import Tree, is_limited

TURN = 2 * np.pi  # rad
# Limits as wide as +-3 pi (ANYmal) or +-10 rad (Solo12) stand for none at all.
WIDEST = 2 * TURN
# m, thigh and calf together; published robots have 0.1 to 1.1
LEGS_FROM, LEGS_TO = 0.01, 2.5
# kg/m^3, of mass over the cube of length; published robots have 5 to 60. Twice that of water is
# more than a block of the robot's size weighs.
LIGHTEST, HEAVIEST = 0.1, 2000.0
USUAL = 20.0  # kg/m^3
# A body's radius of gyration is below this share of the robot's length; published ones' up to 0.3.
WIDE = 2.0
LENGTH_UNITS = {"millimeters": 1e-3, "centimeters": 1e-2, "inches": 0.0254}


def check_limits(tree: Tree, chains: list[Chain]) -> None:
    """Raise `UrdfError` for position limits of legs beyond a turn, which are likely degrees."""
    for joint in (joint for chain in chains for joint in chain):
        if not is_limited(joint):
            continue
        lower, upper = joint.limit.lower, joint.limit.upper
        beyond = max(-lower, upper)
        if beyond > WIDEST or (beyond > TURN and lower != -upper):
            raise UrdfError(
                f"{tree.source}: joint '{joint.name}' has limits of {lower:g} and {upper:g} rad; "
                "expected them within 2 pi, 6.28 (are they in degrees?)"
            )


def check_size(tree: Tree, legs: tuple[Leg, ...], report: Report) -> None:
    """Raise `UrdfError` for a length of legs, or a mass for that length, that no quadruped has.

    Inertias of bodies that would be far larger than the robot are noted in `report`: published
    robots have such, and stand with them.
    """
    leg = _measure_leg(tree, legs[0])
    hips = np.array([tree.compute_frame(tree.joint_above[leg.links[0]])[:3, 3] for leg in legs])
    length = leg + float(np.linalg.norm(np.ptp(hips, axis=0)))
    inertias = ((name, compute_inertia(tree, name)) for name in tree.bodies)
    bodies = {name: inertia for name, inertia in inertias if inertia is not None}
    mass = sum(body.mass for body in bodies.values())
    if not LEGS_FROM <= leg <= LEGS_TO:
        raise UrdfError(
            f"{tree.source}: legs are {leg:g} m long; expected {LEGS_FROM:g} to {LEGS_TO:g} m "
            f"({_guess_unit(length, mass)})"
        )
    lightest, heaviest = LIGHTEST * length**3, HEAVIEST * length**3
    if not lightest <= mass <= heaviest:
        unit = "grams" if mass > heaviest else "tonnes"
        raise UrdfError(
            f"{tree.source}: masses add up to {mass:g} kg, of a robot {length:.2g} m long; "
            f"expected {lightest:.2g} to {heaviest:.2g} kg (are they in {unit}?)"
        )
    for name, body in bodies.items():
        gyration = np.sqrt(np.trace(body.about_com) / 2 / body.mass)
        if gyration > WIDE * length:
            note = "inertias, as they are, of bodies wider than the robot (are they in kg m^2?)"
            report.add("assumed", note, f"{name} {float(f'{gyration:.2g}'):g} m")


def _measure_leg(tree: Tree, leg: Leg) -> float:
    """Return the length of thigh and calf, m."""
    calf = tree.compute_frame(tree.joint_above[leg.links[2]])[:3, 3]
    return float(np.linalg.norm(calf) + np.linalg.norm(leg.foot.center))


def _guess_unit(length: float, mass: float) -> str:
    """Ask for the unit in which a robot's length, m if it were meters, suits its `mass`, kg."""
    usual = float(np.clip((mass / USUAL) ** (1 / 3), 0.2, 2.0))  # m
    if length < usual:
        return f"{usual / length:.0e} times too short?"
    misses = {unit: abs(np.log(length * size / usual)) for unit, size in LENGTH_UNITS.items()}
    return f"are they in {min(misses, key=misses.__getitem__)}?"
