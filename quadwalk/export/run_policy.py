"""Drive the robot with policy.onnx in MuJoCo C: python run_policy.py [--command 1 0 0] [--view].

Needs numpy, mujoco and onnxruntime, and controller.py, policy.onnx and robot.xml beside it. Where
getup.onnx is there too, that policy gets a fallen robot up.
"""

import argparse
import json
import time
from pathlib import Path

import mujoco
import numpy as np
from controller import Controller, read_list, rotation

TIMESTEP = 0.002  # s, of physics
FALLEN = np.cos(np.radians(60))  # cosine of the trunk's tilt beyond which it has fallen
LOW = 0.4  # share of its height at the start below which it has fallen too
UPRIGHT, HIGH = np.cos(np.radians(18)), 0.85  # within that, and above that share of its height,
STEADY = 0.5  # s long, it stands again
parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
add = parser.add_argument
add("--seconds", type=float, default=20.0)
add("--command", type=float, nargs=3, default=[1, 0, 0], help="m/s ahead and left, rad/s left")
add("--fallen", action="store_true", help="begin on its back, for getup.onnx")
add("--view", action="store_true", help="show it in MuJoCo's viewer, in real time")
add("--save", metavar="NPZ", help="write time, qpos, qvel, obs, action, target and command")
options = parser.parse_args()

folder = Path(__file__).resolve().parent
driver = controller = Controller(folder / "policy.onnx")
about = driver.about
riser = Controller(folder / "getup.onnx") if (folder / "getup.onnx").exists() else None
unseen = np.full(driver.session.get_inputs()[0].shape[1], np.nan)  # while the other one acts
ranges = list(json.loads(about["command_ranges"]).values())
command = np.clip(options.command, *np.transpose(ranges)) if ranges else np.zeros(3)
model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
substeps = max(1, round((period := float(about["control_period"])) / TIMESTEP))
model.opt.timestep = period / substeps
model.dof_frictionloss[:] = 0.0  # it is part of the controller's torque, as in training
data = mujoco.MjData(model)
data.qpos[:] = start = np.array(read_list(about["start_qpos"]), float)
q, v, viewer, began, fell, saved = data.qpos, data.qvel, None, time.time(), False, list[tuple]()
steady, rises = 0.0, 0
if options.fallen:
    q[3:7] = 0, 1, 0, 0
if options.view:
    import mujoco.viewer

    viewer = mujoco.viewer.launch_passive(model, data)


def is_fallen() -> bool:
    """Return True for a trunk that is tipped over or low."""
    return bool(rotation(q[3:7])[2, 2] < FALLEN or q[2] < LOW * start[2])


while data.time < options.seconds - 1e-6 and not fell and (not viewer or viewer.is_running()):
    if riser and controller is driver and is_fallen():
        controller, steady = riser, 0.0
        riser.restart()
    elif controller is riser:
        stands = rotation(q[3:7])[2, 2] > UPRIGHT and q[2] > HIGH * start[2]
        steady = steady + period if stands else 0.0
        if steady > STEADY:
            controller, rises = driver, rises + 1
            driver.restart()
    before = data.time, q.copy(), v.copy()
    target = controller.targets(q, v, command)
    seen = controller.obs if controller is driver else unseen
    saved.append((*before, seen, controller.action, target, command))
    for _ in range(substeps):
        data.qfrc_applied[6:] = controller.torque(target, q, v)
        mujoco.mj_step(model, data)
    fell = not riser and is_fallen()
    if viewer:
        viewer.sync()
        time.sleep(max(0.0, began + data.time - time.time()))
x, y = q[:2] - start[:2]
times = "once" if rises == 1 else f"{rises} times"
end = "fell" if fell else f"got up {times}" if rises else "no fall"
print(f"{about['robot']}, {about['task']}: {x / data.time:.3f} m/s along x for {data.time:.2f} s, "
      f"{y:.2f} m to the left, {end}")  # fmt: skip
if options.save:
    names = ("time", "qpos", "qvel", "obs", "action", "target", "command")
    columns: dict = dict(zip(names, map(np.array, zip(*saved, strict=True)), strict=True))
    np.savez(options.save, **columns)
