"""The command's work: read a log, fit the joints, and write and print the result."""

from typing import Any

import numpy as np

from quadwalk.cli.arguments import make_console
from quadwalk.cli.shell import make_command
from quadwalk.errors import UserError
from quadwalk.files import make_folder, open_atomic, write_json
from quadwalk.identify import results
from quadwalk.identify.config import IdentifyConfig
from quadwalk.identify.fit import DELAY, OFFSETS, Fit, fit_joints
from quadwalk.identify.log import read_log
from quadwalk.identify.log_files import Log
from quadwalk.identify.plot import draw_fit
from quadwalk.identify.simulation import Joints
from quadwalk.learn.devices import set_up_devices
from quadwalk.physics.fast import make_model
from quadwalk.physics.model import Model
from quadwalk.physics.motor import FRICTION_SPEED, MotorConfig, make_motor
from quadwalk.render.figures import save_figure
from quadwalk.robot.load import load_robot
from quadwalk.robot.quadruped import Quadruped
from quadwalk.settings.environment import PHYSICS


def identify(config: IdentifyConfig) -> dict[str, Any]:
    """Identify the joints as `config` says, write all files, and return identified.json's content.

    Raises `UserError` if the log cannot be used, or if the fit leaves most of its motion
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
    urdf = out / "robot.urdf"
    content = results.to_json(fit, log, quadruped, config, urdf)
    write_json(out / "identified.json", content)
    figure = draw_fit(fit, log, quadruped, f"{quadruped.name}, {config.log.name}")
    save_figure(figure, out / "fit.png")
    results.print_results(fit, quadruped, content["rms_rad"])
    if not fit.explains:
        # One of an earlier fit would be taken for this one's.
        urdf.unlink(missing_ok=True)
        raise UserError(f"{config.log}: {results.describe_failure(fit, log, quadruped)}")
    with open_atomic(urdf) as file:
        file.write(results.make_urdf(fit, quadruped).encode())
    console.print(f"written to {out}: robot.urdf, identified.json, fit.png; train with:")
    print(make_command("train", "walk", *content["flags"]))
    return content


def fit_log(log: Log, quadruped: Quadruped, config: IdentifyConfig) -> Fit:
    """Fit the constants that `config` names to a log, and constant errors of angles and targets."""
    names = [*config.fit, *(["friction_speed"] if "friction" in config.fit else []), *OFFSETS]
    count = 12 if config.per_joint else 3
    groups = [tuple(range(first, 12, count)) for first in range(count)]
    return fit_joints(*describe(quadruped, config), log, names, groups, config.hold_out)


def describe(quadruped: Quadruped, config: IdentifyConfig) -> tuple[Model, Joints]:
    """Return the robot's equations of motion, and the constants of its joints by its description.

    The fit begins with those.
    """
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
    joints = {name: np.array(np.broadcast_to(x, 12), float) for name, x in constants.items()}
    return make_model(model, quadruped, motor), Joints(**joints)
