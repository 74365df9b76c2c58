"""A fit's results: tables, the URDF with the fitted constants, and flags to train the robot."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import lxml.etree
import numpy as np

from quadwalk.evaluation.report.tables import print_table
from quadwalk.identify.config import IdentifyConfig
from quadwalk.identify.fit import MOST_UNEXPLAINED, OF_URDF, OFFSETS, Fit, Value
from quadwalk.identify.log import find_followed_target
from quadwalk.identify.log_files import Log
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
_FOLLOWS = 0.8  # the correlation of angles with the targets that they follow
# The range that each constant is randomized in: a factor of the description's.
_FACTORS = {"armature": "armature", "friction": "joint-friction", "damping": "damping"}
_FACTORS |= {"kp": "kp", "kd": "kd"}


def is_sure(fit: Fit, value: Value) -> bool:
    """Return True if the log determines the constant `value`.

    It does if the fit explains the motion, and the constant's interval is at most half of the
    constant or of the description's.
    """
    least = _SMALL_OFFSET if value.name in OFFSETS else 0.0
    size = max(abs(value.estimate), value.described, least)
    return fit.explains and value.interval <= 0.5 * size


def set_dynamics(urdf: str, joints: Iterable[str], constants: Mapping[str, Iterable[float]]) -> str:
    """Return the text of a URDF with constants of `OF_URDF` set: for each, one number per joint."""
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
    """Return the robot's URDF with all fitted constants that are sure."""
    text = quadruped.urdf
    for value in fit.values:
        if value.name in OF_URDF and is_sure(fit, value):
            joints = [quadruped.joints[joint] for joint in value.joints]
            text = set_dynamics(text, joints, {value.name: [value.estimate] * len(joints)})
    return text


def make_flags(fit: Fit, urdf: Path, meshes: tuple[Path, ...]) -> list[str]:
    """Return flags of `quadwalk train` for the fitted robot, whose URDF is the file `urdf`.

    Each constant that is sure is set, or randomized within its interval. `meshes` are the folders
    of the URDF's meshes.
    """
    flags = ["--robot.urdf", str(urdf)]
    if meshes:
        flags += ["--robot.mesh-dirs", *map(str, meshes)]
    sure = [value for value in fit.values if is_sure(fit, value)]
    for value in sure:
        if value.name in ("kp", "kd"):
            flags += [f"--env.motor.{value.name}", f"{value.estimate:.4g}"]
        elif value.name == "delay":
            aside = max(value.interval, LEAST_JITTER)
            ends = max(value.estimate - aside, 0.0), value.estimate + aside
            flags += ["--env.randomization.latency", *(f"{end:.4f}" for end in ends)]
    for name, setting in _FACTORS.items():
        shares = [v.interval / v.estimate for v in sure if v.name == name and v.estimate > 0]
        if shares:
            spread = min(max(*shares, LEAST_SPREAD), _MOST_SPREAD)
            ends = 1.0 - spread, 1.0 + spread
            flags += [f"--env.randomization.{setting}", *(f"{end:.2f}" for end in ends)]
    return flags


def label_joints(value: Value, quadruped: Quadruped) -> str:
    """Return which joints have this constant: one joint's name, "hip", "thigh", "calf" or "all"."""
    if len(value.joints) == 1:
        return quadruped.joints[value.joints[0]]
    return PARTS[value.joints[0]] if len(value.joints) == 4 else "all"


def to_json(
    fit: Fit, log: Log, quadruped: Quadruped, config: IdentifyConfig, urdf: Path
) -> dict[str, Any]:
    """Return the content of identified.json: constants, errors, and flags for training.

    The flags name `urdf`, the file of the URDF with the fitted constants.
    """
    meshes = config.robot.mesh_dirs
    if "<mesh" in quadruped.urdf:
        meshes = (config.robot.urdf.resolve().parent, *meshes)
    constants = [
        {
            "constant": value.name,
            "unit": UNITS[value.name],
            "joints": [quadruped.joints[joint] for joint in value.joints],
            "described": value.described,
            "found": value.estimate,
            "interval95": value.interval,
            "sure": is_sure(fit, value),
        }
        for value in fit.values
    ]
    rms = {
        f"{name}_{rows}": float(np.sqrt(np.mean((angles - log.position)[getattr(fit, rows)] ** 2)))
        for name, angles in (("described", fit.before), ("found", fit.after))
        for rows in ("fitted", "held_out")
        if getattr(fit, rows).any()
    }
    return {
        "log": str(config.log),
        "robot": quadruped.name,
        "kp": fit.described.kp.tolist(),
        "kd": fit.described.kd.tolist(),
        "constants": constants,
        "rms_rad": rms,
        "unexplained": dict(zip(quadruped.joints, fit.unexplained.tolist(), strict=True)),
        "flags": make_flags(fit, urdf, meshes) if fit.explains else [],
    }


def print_results(fit: Fit, quadruped: Quadruped, rms: dict[str, float]) -> None:
    """Print the constants, the offsets, and the errors `rms` by parts of the log, rad."""
    kp, kd = fit.described.kp[0], fit.described.kd[0]
    constants = [value for value in fit.values if value.name not in OFFSETS]
    rows = [
        (
            f"{value.name.replace('_', ' ')}, {label_joints(value, quadruped)}",
            f"{value.described:.4g}",
            f"{value.estimate:.4g}",
            f"{value.interval:.2g}" + ("" if is_sure(fit, value) else " (unsure)"),
            UNITS[value.name],
        )
        for value in constants
    ]
    title = f"recorded with kp {kp:g} Nm/rad and kd {kd:g} Nm s/rad"
    print_table(title, ("", "described", "found", "± 95 %", "unit"), rows)
    texts: list[list[str]] = [[joint] for joint in quadruped.joints]
    for value in fit.values:
        if value.name in OFFSETS:
            numbers = f"{1e3 * value.estimate:z.2f}", f"{1e3 * value.interval:.2g}"
            texts[value.joints[0]] += numbers
    headings = ("", "of the angle", "± 95 %", "of the target", "± 95 %")
    print_table("offsets, mrad", headings, texts)
    sizes = ", ".join(f"{name.replace('_', ' ')} {1e3 * size:.2f}" for name, size in rms.items())
    print(f"rms of what is left, mrad: {sizes}")
    if fit.explains and not all(is_sure(fit, value) for value in constants):
        print("unsure: the log does not show it; the description's value stays")


def describe_failure(fit: Fit, log: Log, quadruped: Quadruped) -> str:
    """Return a text on the motion that a fit leaves unexplained, with a likely cause."""
    worst = int(fit.unexplained.argmax())
    joint = quadruped.joints[worst]
    followed, correlation = find_followed_target(log, worst)
    cause = ""
    if followed != worst and abs(correlation) > _FOLLOWS:
        other = quadruped.joints[followed]
        cause = f"; its angles follow target_{other}: are columns in another order?"
    elif correlation < -_FOLLOWS:
        cause = "; its angles move against its target: has one the other sign?"
    return (
        f"the fit leaves {fit.unexplained[worst]:.0%} of the motion of {joint}, so no URDF is "
        f"written; expected {MOST_UNEXPLAINED:.0%} or less of every joint{cause}"
    )
