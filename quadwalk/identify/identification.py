"""The command's work: read a log, fit the joints, and write and print the result."""

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from quadwalk.cli.arguments import make_console
from quadwalk.cli.shell import make_command
from quadwalk.errors import UserError
from quadwalk.evaluation.report.tables import print_table
from quadwalk.files import make_folder, open_atomic, write_json
from quadwalk.identify import found
from quadwalk.identify.config import IdentifyConfig
from quadwalk.identify.fit import DELAY, MOST_UNEXPLAINED, OFFSETS, Fit, fit_joints
from quadwalk.identify.joint_log import Log, find_followed_target, read_log
from quadwalk.identify.plot import draw_fit
from quadwalk.identify.stand import Joints
from quadwalk.learn.devices import set_up_devices
from quadwalk.physics.fast import make_model
from quadwalk.physics.model import Model
from quadwalk.physics.motor import FRICTION_SPEED, MotorConfig, make_motor
from quadwalk.render.figures import save_figure
from quadwalk.robot.load import load_robot
from quadwalk.robot.quadruped import Quadruped
from quadwalk.settings.environment import PHYSICS

_FOLLOWS = 0.8  # the correlation of angles with the targets that they follow


def identify(config: IdentifyConfig) -> dict[str, Any]:
    """Identify as `config` says; return what identified.json holds.

    Raise `UserError` where the log is no use, or where the fit leaves most of its motion
    unexplained: then there is a picture of the fit, and no URDF.
    """
    assert config.log is not None
    quadruped = load_robot(config.robot)
    log = read_log(config.log, quadruped.joints, quadruped.lower, quadruped.upper)
    out = config.out or config.log.with_name(f"{config.log.stem}_identified")
    make_folder(out)
    set_up_devices()
    console = make_console()
    console.print(f"{config.log}: {log.time[-1] - log.time[0]:.1f} s")
    for note in log.notes:
        console.print(f"{config.log}: {note}")
    with console.status("fitting"):
        fit = fit_log(log, quadruped, config)
    return _write(config, fit, log, quadruped, out, console)


def fit_log(log: Log, quadruped: Quadruped, config: IdentifyConfig) -> Fit:
    """Fit what `config` names, and offsets; its log and files do not matter."""
    names = [*config.fit, *(["friction_speed"] if "friction" in config.fit else []), *OFFSETS]
    count = 12 if config.per_joint else 3
    groups = [tuple(range(first, 12, count)) for first in range(count)]
    return fit_joints(*describe(quadruped, config), log, names, groups, config.hold_out)


def describe(quadruped: Quadruped, config: IdentifyConfig) -> tuple[Model, Joints]:
    """Return the robot's equations, and the described joints, at which the search begins."""
    model = quadruped.make_training_model(PHYSICS["physics_dt"])
    motor = make_motor(model, quadruped, MotorConfig(kp=config.kp, kd=config.kd))
    constants = {
        "armature": model.dof_armature[6:],
        "friction": quadruped.friction,
        "damping": model.dof_damping[6:].reshape(12, -1)[:, 0],
        "kp": motor.kp,
        "kd": motor.kd,
        "delay": DELAY,
        "friction_speed": FRICTION_SPEED,
        "offset": 0.0,
        "target_offset": 0.0,
    }
    whole = {name: np.array(np.broadcast_to(x, 12), float) for name, x in constants.items()}
    return make_model(model, quadruped, motor), Joints(**whole)


def _write(
    config: IdentifyConfig, fit: Fit, log: Log, quadruped: Quadruped, out: Path, console: Console
) -> dict[str, Any]:
    """Print the table and the flags, write all files, and return what identified.json holds."""
    assert config.log is not None
    urdf = out / "robot.urdf"
    meshes = config.robot.mesh_dirs
    if "<mesh" in quadruped.urdf:
        meshes = (config.robot.urdf.resolve().parent, *meshes)
    flags = found.make_flags(fit, urdf, meshes) if fit.explains else []
    rest = {
        f"{name}_{rows}": float(np.sqrt(np.mean((angles - log.position)[getattr(fit, rows)] ** 2)))
        for name, angles in (("described", fit.before), ("found", fit.after))
        for rows in ("fitted", "held_out")
        if getattr(fit, rows).any()
    }
    results = {
        "log": str(config.log),
        "robot": quadruped.name,
        "kp": fit.described.kp.tolist(),
        "kd": fit.described.kd.tolist(),
        "constants": found.to_json(fit, quadruped),
        "rms_rad": rest,
        "unexplained": dict(zip(quadruped.joints, fit.unexplained.tolist(), strict=True)),
        "flags": flags,
    }
    write_json(out / "identified.json", results)
    save_figure(
        draw_fit(fit, log, quadruped, f"{quadruped.name}, {config.log.name}"), out / "fit.png"
    )
    _print(fit, quadruped, rest)
    if not fit.explains:
        # One of an earlier fit would be taken for this one's.
        urdf.unlink(missing_ok=True)
        raise UserError(f"{config.log}: {_describe_failure(fit, log, quadruped)}")
    with open_atomic(urdf) as file:
        file.write(found.make_urdf(fit, quadruped).encode())
    console.print(f"written to {out}: robot.urdf, identified.json, fit.png; train with:")
    print(make_command("train", "walk", *flags))
    return results


def _describe_failure(fit: Fit, log: Log, quadruped: Quadruped) -> str:
    """Return what a fit leaves unexplained, with a likely cause."""
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


def _print(fit: Fit, quadruped: Quadruped, rest: dict[str, float]) -> None:
    kp, kd = fit.described.kp[0], fit.described.kd[0]
    constants = [value for value in fit.values if value.name not in OFFSETS]
    rows = [
        (
            f"{value.name.replace('_', ' ')}, {found.labels_of(value, quadruped)}",
            f"{value.described:.4g}",
            f"{value.found:.4g}",
            f"{value.interval:.2g}" + ("" if found.is_sure(fit, value) else " (unsure)"),
            found.UNITS[value.name],
        )
        for value in constants
    ]
    title = f"recorded with kp {kp:g} Nm/rad and kd {kd:g} Nm s/rad"
    print_table(title, ("", "described", "found", "± 95 %", "unit"), rows)
    texts: list[list[str]] = [[joint] for joint in quadruped.joints]
    for value in fit.values:
        if value.name in OFFSETS:
            numbers = f"{1e3 * value.found:z.2f}", f"{1e3 * value.interval:.2g}"
            texts[value.joints[0]] += numbers
    headings = ("", "of the angle", "± 95 %", "of the target", "± 95 %")
    print_table("offsets, mrad", headings, texts)
    sizes = ", ".join(f"{name.replace('_', ' ')} {1e3 * size:.2f}" for name, size in rest.items())
    print(f"rms of what is left, mrad: {sizes}")
    if fit.explains and not all(found.is_sure(fit, value) for value in constants):
        print("unsure: the log does not show it; the description's value stays")
