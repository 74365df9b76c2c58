"""What a fit says of the robot: its URDF with the joints that were found, and flags to train it."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import lxml.etree

from quadwalk.identify.fit import OF_URDF, Fit, Value
from quadwalk.robot.quadruped import Quadruped

PARTS = ("hip", "thigh", "calf")
UNITS = {
    "armature": "kg m^2",
    "friction": "Nm",
    "damping": "Nm s/rad",
    "kp": "Nm/rad",
    "kd": "Nm s/rad",
    "delay": "s",
    "friction_speed": "rad/s",
}
LEAST_SPREAD = 0.1  # share: one robot's joints differ by it from day to day, from leg to leg
LEAST_JITTER = 0.005  # s that the delay is randomized by, to both sides
_MOST_SPREAD = 0.9
# The range that each constant is randomized in: a factor of the description's.
_FACTORS = {"armature": "armature", "friction": "joint-friction", "damping": "damping"}
_FACTORS |= {"kp": "kp", "kd": "kd"}


def is_sure(value: Value) -> bool:
    """Whether the log shows a constant: its interval is small beside it or the description's."""
    return value.interval <= 0.5 * max(value.found, value.described)


def with_joints(urdf: str, joints: Iterable[str], constants: Mapping[str, Iterable[float]]) -> str:
    """A URDF's text whose `joints` have these constants of `OF_URDF`, one for each joint."""
    root = lxml.etree.fromstring(urdf.encode())
    elements = {joint.get("name"): joint for joint in root.iterfind("joint")}
    for name, values in constants.items():
        for joint, value in zip(joints, values, strict=True):
            dynamics = elements[joint].find("dynamics")
            if dynamics is None:
                dynamics = lxml.etree.SubElement(elements[joint], "dynamics")
            dynamics.set(name, f"{value:.4g}")
    return lxml.etree.tostring(root, encoding="unicode")


def found_urdf(fit: Fit, quadruped: Quadruped) -> str:
    """The robot's URDF with all that the fit is sure of."""
    text = quadruped.urdf
    for value in filter(is_sure, fit.values):
        if value.name in OF_URDF:
            own = [quadruped.joints[joint] for joint in value.joints]
            text = with_joints(text, own, {value.name: [value.found] * len(own)})
    return text


def training_flags(fit: Fit, urdf: Path, meshes: tuple[Path, ...]) -> list[str]:
    """Flags of `quadwalk train` for the robot of the file `urdf`, and for how sure the fit is."""
    flags = ["--robot.urdf", str(urdf)]
    if meshes:
        flags += ["--robot.mesh-dirs", *map(str, meshes)]
    sure = [value for value in fit.values if is_sure(value)]
    for value in sure:
        if value.name in ("kp", "kd"):
            flags += [f"--env.motor.{value.name}", f"{value.found:.4g}"]
        elif value.name == "delay":
            aside = max(value.interval, LEAST_JITTER)
            ends = max(value.found - aside, 0.0), value.found + aside
            flags += ["--env.randomization.latency", *(f"{end:.4f}" for end in ends)]
    for name, setting in _FACTORS.items():
        shares = [v.interval / v.found for v in sure if v.name == name and v.found > 0]
        if shares:
            spread = min(max(*shares, LEAST_SPREAD), _MOST_SPREAD)
            ends = 1.0 - spread, 1.0 + spread
            flags += [f"--env.randomization.{setting}", *(f"{end:.2f}" for end in ends)]
    return flags


def labels_of(value: Value, quadruped: Quadruped) -> str:
    if len(value.joints) == 1:
        return quadruped.joints[value.joints[0]]
    return PARTS[value.joints[0]] if len(value.joints) == 4 else "all"


def as_data(fit: Fit, quadruped: Quadruped) -> list[dict[str, Any]]:
    return [
        {
            "constant": value.name,
            "unit": UNITS[value.name],
            "joints": [quadruped.joints[joint] for joint in value.joints],
            "described": value.described,
            "found": value.found,
            "interval95": value.interval,
            "sure": is_sure(value),
        }
        for value in fit.values
    ]
