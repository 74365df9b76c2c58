"""The packaged policies on an AlienGo whose joints were identified, in MuJoCo C.

    python benchmarks/identified.py [--policies run walk drive] [--episodes 256] [--only armature]

The constants are those of `gym_quadruped/robot_model/aliengo/isaaclab_identified_parameters.py` in
github.com/iit-DLSLab/gym-quadruped, commit 326b0f5, identified by the Dynamic Legged Systems Lab.
Their delay is 2.64 steps of a simulation whose step they do not name: 5 ms are assumed, the longest
in use. Each policy runs on the model that it was trained on and on the identified robot: without
disturbances, but for that delay, and with all that training randomizes about either.
"""

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.shared import make_parser
from quadwalk.evaluation.load import load_run
from quadwalk.evaluation.results import evaluate_policy
from quadwalk.identify.results import set_dynamics
from quadwalk.learn.devices import set_up_devices
from quadwalk.paths import PRETRAINED
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.runs.directory import Run
from quadwalk.settings.environment import NO_RANDOMIZATION

LEGS = ("FL", "FR", "RL", "RR")
JOINTS = [f"{leg}_{part}_joint" for leg in LEGS for part in ("hip", "thigh", "calf")]
IDENTIFIED = {  # rounded to four digits; kg m^2, Nm s/rad and Nm
    "armature": [
        *(0.001716, 0.01386, 0.01513, 0.002666, 0.01341, 0.01525),
        *(0.003196, 0.01341, 0.01443, 0.001774, 0.01364, 0.01455),
    ],
    "damping": [
        *(0.2754, 0.2406, 0.3018, 0.2695, 0.2563, 0.3043),
        *(0.2853, 0.2598, 0.3056, 0.3123, 0.2689, 0.2910),
    ],
    "friction": [
        *(0.4001, 0.3346, 0.4287, 0.4254, 0.3108, 0.3119),
        *(0.3663, 0.2976, 0.3801, 0.6556, 0.3268, 0.5650),
    ],
}
DELAY = 2.642 * 0.005  # s
FIGURES = ("speed", "velocity_error", "yaw_rate_error", "cost_of_transport", "torque_limit")


def main() -> None:
    """Evaluate packaged policies on their own robot and on the identified one; print both."""
    parser = make_parser(__doc__)
    parser.add_argument("--policies", nargs="+", default=["run", "walk", "drive"])
    parser.add_argument("--episodes", type=int, default=256)
    parser.add_argument("--only", nargs="+", default=list(IDENTIFIED), choices=list(IDENTIFIED))
    options = parser.parse_args()
    set_up_devices()
    constants = {name: IDENTIFIED[name] for name in options.only}
    late = replace(NO_RANDOMIZATION, enabled=True, latency=(DELAY, DELAY))
    heads = (f"{name:>18}" for name in FIGURES)
    print(f"{'policy':8}{'robot':12}{'conditions':12}{'falls, %':>10}", *heads)
    with tempfile.TemporaryDirectory() as folder:
        for name in options.policies:
            runs = {
                "model": Run(PRETRAINED / name),
                "identified": copy_identified(name, Path(folder), constants),
            }
            for robot, run in runs.items():
                for conditions in ("delay", "randomized"):
                    loaded = load_run(run, 20.0, engine="mujoco", randomized=True)
                    if conditions == "delay":
                        loaded = loaded.to_mujoco(randomization=late)
                    summary = evaluate_policy(loaded, options.episodes, seed=0, keep=0).summary
                    falls = f"{100 * summary['fall_rate']:10.1f}"
                    figures = (f"{format_figure(summary.get(figure)):>18}" for figure in FIGURES)
                    print(f"{name:8}{robot:12}{conditions:12}{falls}", *figures, flush=True)


def copy_identified(name: str, folder: Path, constants: dict[str, list[float]]) -> Run:
    """Copy the packaged policy `name` to `folder`, with a robot of other constants; return it.

    `constants` are values for `JOINTS` by name, as in `IDENTIFIED`.
    """
    run = Run(folder / name)
    shutil.copytree(PRETRAINED / name, run.path)
    run.urdf.write_text(set_dynamics(load_quadruped(run.urdf).urdf, JOINTS, constants))
    return run


def format_figure(figure: dict[str, Any] | None) -> str:
    """Return the mean of a figure ± its 95 % interval as a cell of the table; "-" for None."""
    return "-" if figure is None else f"{figure['mean']:.3f} ± {figure['ci95']:.3f}"


if __name__ == "__main__":
    main()
