"""A fit's results: the URDF with the fitted constants, and flags to train the robot."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import lxml.etree

from quadwalk.identify.fit import OF_URDF, OFFSETS, Fit, Value
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
    "offset": "rad",
    "target_offset": "rad",
}
LEAST_SPREAD = 0.1  # share: one robot's joints differ by it from day to day, from leg to leg
LEAST_JITTER = 0.005  # s that the delay is randomized by, to both sides
_MOST_SPREAD = 0.9
_SMALL_OFFSET = 0.01  # rad: an offset whose interval is small beside this is sure, as one of zero
# The range that each constant is randomized in: a factor of the description's.
_FACTORS = {"armature": "armature", "friction": "joint-friction", "damping": "damping"}
_FACTORS |= {"kp": "kp", "kd": "kd"}


def is_sure(fit: Fit, value: Value) -> bool:
    """Return True if the log shows a constant.

    Its interval is small beside it or the description's, in a fit that explains the motion.
    """
    least = _SMALL_OFFSET if value.name in OFFSETS else 0.0
    size = max(abs(value.found), value.described, least)
    return fit.explains and value.interval <= 0.5 * size


def with_joints(urdf: str, joints: Iterable[str], constants: Mapping[str, Iterable[float]]) -> str:
    """Return a URDF's text in which `joints` have these constants of `OF_URDF`, one a joint."""
    root = lxml.etree.fromstring(urdf.encode())
    elements = {joint.get("name"): joint for joint in root.iterfind("joint")}
    for name, values in constants.items():
        for joint, value in zip(joints, values, strict=True):
            dynamics = elements[joint].find("dynamics")
            if dynamics is None:
                dynamics = lxml.etree.SubElement(elements[joint], "dynamics")
            dynamics.set(name, f"{value:.4g}")
    return lxml.etree.tostring(root, encoding="unicode")


def make_urdf(fit: Fit, quadruped: Quadruped) -> str:
    """Return the robot's URDF with all constants that are sure."""
    text = quadruped.urdf
    for value in fit.values:
        if value.name in OF_URDF and is_sure(fit, value):
            joints = [quadruped.joints[joint] for joint in value.joints]
            text = with_joints(text, joints, {value.name: [value.found] * len(joints)})
    return text


def make_flags(fit: Fit, urdf: Path, meshes: tuple[Path, ...]) -> list[str]:
    """Return flags of `quadwalk train` for the robot of the file `urdf`, randomized as is sure."""
    flags = ["--robot.urdf", str(urdf)]
    if meshes:
        flags += ["--robot.mesh-dirs", *map(str, meshes)]
    sure = [value for value in fit.values if is_sure(fit, value)]
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
    """Return the name of a constant's joint, of its kind of joint, or "all"."""
    if len(value.joints) == 1:
        return quadruped.joints[value.joints[0]]
    return PARTS[value.joints[0]] if len(value.joints) == 4 else "all"


def to_json(fit: Fit, quadruped: Quadruped) -> list[dict[str, Any]]:
    """Return the constants as identified.json holds them."""
    return [
        {
            "constant": value.name,
            "unit": UNITS[value.name],
            "joints": [quadruped.joints[joint] for joint in value.joints],
            "described": value.described,
            "found": value.found,
            "interval95": value.interval,
            "sure": is_sure(fit, value),
        }
        for value in fit.values
    ]
