"""How near a robot is to the bodies that a policy of many bodies was trained on, as a table."""

import math
from typing import Any, NamedTuple

import numpy as np

from quadwalk.env.constants import Description
from quadwalk.env.env import QuadrupedEnv
from quadwalk.robot.bodies import HEAVIEST, LIGHTEST, RANGES
from quadwalk.robot.quadruped import Quadruped

SPARE = 0.02  # share by which a figure may be beyond the range


class Figure(NamedTuple):
    """A figure of a robot, and its range among bodies of training."""

    name: str
    value: float
    low: float
    high: float  # infinite where more is no harm

    @property
    def excess(self) -> str:
        """What there is to say of a figure beyond the range; "" within it."""
        spare = SPARE * max(abs(self.low), min(abs(self.high), 1.0))
        if self.low - spare <= self.value <= self.high + spare:
            return ""
        end, word = (self.low, "less") if self.value < self.low else (self.high, "more")
        if end <= 0.0:
            return f"{self.name} {abs(self.value - end):.2g} {word}"
        return f"{self.name} {abs(self.value / end - 1.0):.0%} {word}".replace("%", " %")


def list_figures(env: QuadrupedEnv) -> list[Figure]:
    """Return the figures of an environment's robot that training varies."""
    robot = env.robot
    described = Description(*np.asarray(robot.description, float))
    figures = [
        Figure("mass, kg", robot.mass, LIGHTEST, HEAVIEST),
        Figure("leg length L, m", robot.leg, *RANGES["leg"]),
        Figure("mass / L^3, kg/m^3", robot.mass / robot.leg**3, *RANGES["density"]),
    ]
    names = {
        "height": "standing height / L",
        "thigh": "thigh / L",
        "length": "length / L",
        "width": "width of the hips / L",
        "foot": "radius of the feet / L",
        "legs": "share of the legs' mass",
        "ahead": "center of mass ahead / L",
        "above": "center of mass above / L",
    }
    for field, name in names.items():
        figures.append(Figure(name, getattr(described, field), *RANGES[field]))
    for kind, unit in (("effort", "torque / (m g L)"), ("speed", "speed * sqrt(L / g)")):
        least = RANGES[kind][0]
        for joint in ("hip", "thigh", "calf"):
            share = 1.0 if joint == "thigh" else RANGES[f"{joint}_{kind}"][0]
            value = math.exp(getattr(described, f"{joint}_{kind}"))
            figures.append(Figure(f"{joint} {unit}", value, share * least, math.inf))
    return figures


def describe_robot(env: QuadrupedEnv) -> list[str]:
    """Return lines on what was read of an environment's robot, and a table of its figures."""
    quadruped, motor = env.quadruped, env.motor
    home = np.reshape(quadruped.home[7:], (4, 3))
    joints = zip(("hip", "thigh", "calf"), home.T, *_split(quadruped), strict=True)
    figures = list_figures(env)
    beyond = [figure.excess for figure in figures if figure.excess]
    knees = np.where(env.robot.knees_ahead, "ahead", "behind")
    return [
        f"{quadruped.name}: legs {' '.join(quadruped.legs)}, feet {' '.join(quadruped.feet)}, "
        f"front knees {knees[0]}, hind knees {knees[2]}",
        *(
            f"{joint}: at home {_span(angles)} rad, limits {lower.min():.2f} to {upper.max():.2f} "
            f"rad, {_span(effort)} Nm, {_span(speed)} rad/s"
            for joint, angles, lower, upper, effort, speed in joints
        ),
        f"gains: kp {_span(motor.kp)} Nm/rad, kd {_span(motor.kd)} Nm s/rad",
        *_format_table(figures),
        f"beyond the bodies trained on: {', '.join(beyond)}"
        if beyond
        else "within the bodies trained on, figure by figure",
    ]


def _split(quadruped: Quadruped) -> tuple[np.ndarray, ...]:
    """Return lower and upper limits, efforts and speeds of a robot, by kind of joint (3, 4)."""
    limits = quadruped.lower, quadruped.upper, quadruped.effort, quadruped.velocity
    return tuple(numbers.reshape(4, 3).T for numbers in limits)


def _span(numbers: Any) -> str:
    """Return the least and the greatest of an array, or the number that all are."""
    low, high = (f"{number:.3g}" for number in (np.min(numbers), np.max(numbers)))
    return low if low == high else f"{low} to {high}"


def _format_table(figures: list[Figure]) -> list[str]:
    """Return the lines of a table of figures, with their ranges in training."""
    rows = [("", "this robot", "trained on", "")]
    for figure in figures:
        most = "more" if math.isinf(figure.high) else f"{figure.high:.3g}"
        bounds = f"{figure.low:.3g} to {most}"
        rows.append((figure.name, f"{figure.value:.3g}", bounds, "beyond" * bool(figure.excess)))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            [row[0].ljust(widths[0]), row[1].rjust(widths[1]), row[2].rjust(widths[2]), row[3]]
        ).rstrip()
        for row in rows
    ]
