"""How near `quadwalk identify` comes to joints that are known, from logs made in MuJoCo C.

    python benchmarks/identification.py [--seconds 30] [--cases plain stiff]

Prints the error of what is found, in percent, for each case: the plain one, and those in which the
recording or the robot is not as the fit supposes.
"""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.shared import make_parser
from quadwalk.identify.config import IdentifyConfig
from quadwalk.identify.fit import OF_URDF, OFFSETS
from quadwalk.identify.identification import fit_log
from quadwalk.identify.log_files import Log
from quadwalk.identify.results import label_joints
from quadwalk.identify.targets import make_targets
from quadwalk.learn.devices import set_up_devices
from quadwalk.robot.quadruped import Quadruped, load_quadruped

DT, EVERY = 1e-4, 50  # s, a physics step; those between two rows of the log
PARTS = tuple[float, float, float]  # of hip, thigh and calf


@dataclass(frozen=True)
class LogSetup:
    """An AlienGo on a stand, and how it is recorded."""

    armature: PARTS = (0.007, 0.0137, 0.0148)  # kg m^2
    friction: PARTS = (0.46, 0.32, 0.42)  # Nm
    damping: PARTS = (0.286, 0.256, 0.3)  # Nm s/rad
    friction_speed: float = 0.1  # rad/s
    delay: float = 0.0083  # s
    kp: float = 25.0  # Nm/rad
    kd: float = 0.5  # Nm s/rad
    noise: float = 5e-4  # rad
    legs: float = 1.0  # factor of the legs' masses
    tilt: float = 0.0  # rad, of the trunk, nose down
    offset: PARTS = (0.0, 0.0, 0.0)  # rad, measured angles less the joints' own
    shared: bool = False  # True: the controller regulates the measured angles, offsets and all


CASES = {
    "plain": LogSetup(),
    "sharp friction": LogSetup(friction_speed=0.01),
    "stiff": LogSetup(kp=120.0, kd=3.0),
    "noise x4": LogSetup(noise=2e-3),
    "legs +5 %": LogSetup(legs=1.05),
    "tilt 0.05 rad": LogSetup(tilt=0.05),
    "offsets": LogSetup(offset=(0.02, -0.03, 0.05)),
    "offsets that the controller has too": LogSetup(offset=(0.02, -0.03, 0.05), shared=True),
}


def record_log(quadruped: Quadruped, setup: LogSetup, seconds: float) -> Log:
    """Simulate a robot on a stand that follows the targets of `make_targets`; return its log.

    MuJoCo C simulates the robot of `setup` for `seconds`.
    """
    spec = quadruped.spec.copy()
    spec.delete(spec.joints[0])
    spec.delete(spec.keys[0])
    spec.option.timestep = DT
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    spec.option.gravity = [9.81 * np.sin(setup.tilt), 0.0, -9.81 * np.cos(setup.tilt)]
    for index, name in enumerate(quadruped.joints):
        joint = spec.joint(name)
        joint.armature, joint.frictionloss = setup.armature[index % 3], 0.0
        joint.damping[0] = setup.damping[index % 3]
    model = spec.compile()
    legs = model.jnt_bodyid
    model.body_mass[legs] *= setup.legs
    model.body_inertia[legs] *= setup.legs
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    places = [model.joint(name).qposadr[0] for name in quadruped.joints]
    times, targets = make_targets(quadruped)
    offset = np.tile(setup.offset, 4)
    data.qpos[places] = targets[0] - offset * setup.shared
    friction, angles = np.tile(setup.friction, 4), []
    for step in range(round(seconds / DT)):
        q, qd = data.qpos[places], data.qvel[places]
        if step % EVERY == 0:
            angles.append(q + offset)
        target = targets[max(int((data.time - setup.delay) / times[1] + 1e-6), 0)]
        regulated = q + offset if setup.shared else q
        torque = setup.kp * (target - regulated) - setup.kd * qd
        data.qfrc_applied[places] = torque - friction * np.tanh(qd / setup.friction_speed)
        mujoco.mj_step(model, data)
    measured = np.array(angles)
    measured += setup.noise * np.random.default_rng(1).standard_normal(measured.shape)
    rows = slice(len(measured))
    return Log(times[rows], measured, times[rows], targets[rows])


def print_case(case: str, quadruped: Quadruped, seconds: float) -> None:
    """Simulate a log of a case, `seconds` long, fit it, and print the errors of what was found."""
    setup = CASES[case]
    config = IdentifyConfig(Path("made in MuJoCo C"), kp=setup.kp, kd=setup.kd)
    log = record_log(quadruped, setup, seconds)
    fit = fit_log(log, quadruped, config)
    residual = np.sqrt(np.mean((fit.after - log.position)[fit.held_out] ** 2))
    print(f"{case}: {1e3 * residual:.2f} mrad left of the part that is held out")
    offsets = []
    for value in fit.values:
        if value.name in OFFSETS:
            offsets += [value] * (value.name == "offset")
            continue
        constants = np.ravel(getattr(setup, value.name))
        constant = constants[value.joints[0] if value.name in OF_URDF else 0]
        error = 100 * (value.estimate / constant - 1)
        interval = 100 * value.interval / constant
        name = f"{value.name}, {label_joints(value, quadruped)}"
        figures = f"{constant:10.4g}{value.estimate:10.4g}{error:+8.1f} % ± {interval:.1f}"
        print(f"  {name:22}{figures}", flush=True)
    errors = [1e3 * (v.estimate - setup.offset[v.joints[0] % 3]) for v in offsets]
    interval = 1e3 * max(value.interval for value in offsets)
    print(f"  offsets: {max(errors, key=abs):+.2f} mrad at worst ± {interval:.2f}", flush=True)


def main() -> None:
    """Print the errors of identification in each case."""
    parser = make_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    options = parser.parse_args()
    set_up_devices()
    quadruped = load_quadruped()
    for case in options.cases:
        print_case(case, quadruped, options.seconds)


if __name__ == "__main__":
    main()
