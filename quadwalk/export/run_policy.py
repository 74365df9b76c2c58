"""Drive the robot with policy.onnx in MuJoCo C: python run_policy.py [--command 1 0 0] [--view].

Needs numpy, mujoco and onnxruntime, and the files policy.onnx and robot.xml beside it.
"""

import argparse
import json
import sys
import time
from collections import deque
from pathlib import Path

import mujoco
import numpy as np
import onnxruntime

TIMESTEP, FRICTION_SPEED = 0.002, 0.1  # s; rad/s, over which joint friction passes through zero
TAU, LAG = 2 * np.pi, np.array([0, np.pi / 2])  # of a clock's sine and cosine
# What the policy sees, by the function it was trained with. R turns the trunk's frame into the
# world's; q, v are qpos, qvel; home and last action are (12,), command (3,); k counts steps.
OBSERVATIONS: dict = {
    "task.observation:velocity": lambda R, q, v, *_: R.T @ v[:3],
    "task.observation:angular_velocity": lambda R, q, v, *_: v[3:6],
    "task.observation:gravity": lambda R, q, v, *_: -R[2],
    "task.observation:heading": lambda R, q, v, *_: np.arctan2(R[1, 0], R[0, 0]),
    "task.observation:offset": lambda R, q, *_, reach: np.clip(q[1], -reach, reach),
    "task.observation:command": lambda R, q, v, home, last, command, *_: command,
    "task.observation:trot_clock": lambda *s, stride: any(s[5]) * np.sin(s[6] * TAU / stride + LAG),
    "task.observation:joint_positions": lambda R, q, v, home, *_: q[7:] - home,
    "task.observation:joint_velocities": lambda R, q, v, *_: v[6:],
    "task.observation:last_action": lambda R, q, v, home, last, *_: last,
    "task.observation:height": lambda R, q, v, *_: q[2],
    "tasks.blog:world_position": lambda R, q, v, *_: q[:3],
    "tasks.blog:world_orientation": lambda R, q, v, *_: q[[4, 5, 6, 3]],
    "tasks.blog:world_velocity": lambda R, q, v, *_: v[:3],
    "tasks.blog:world_angular_velocity": lambda R, q, v, *_: R @ v[3:6],
    "tasks.blog:joint_angles": lambda R, q, v, *_: q[7:],
}

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
add = parser.add_argument
add("--seconds", type=float, default=20.0)
add("--command", type=float, nargs=3, default=[1, 0, 0], help="m/s ahead and left, rad/s left")
add("--view", action="store_true", help="show it in MuJoCo's viewer, in real time")
add("--save", metavar="NPZ", help="write time, qpos, qvel and joint targets")
options = parser.parse_args()

folder = Path(__file__).resolve().parent
session = onnxruntime.InferenceSession(folder / "policy.onnx", providers=["CPUExecutionProvider"])
about = session.get_modelmeta().custom_metadata_map
names = "joint_stiffness joint_damping default_joint_pos effort_limit velocity_limit joint_friction"
numbers = {k: np.array(about[k].split(","), float) for k in (*names.split(), "start_qpos")}
kp, kd, home, effort, limit, friction, start = numbers.values()
functions = about["observation_functions"].replace("quadwalk.", "").split(",")
if unknown := sorted(set(functions) - set(OBSERVATIONS)):
    sys.exit(f"error: add {', '.join(unknown)} to OBSERVATIONS in {__file__}")
params = json.loads(about["observation_params"]).values()
past: list = [deque(maxlen=1 + int(n)) for n in about["observation_history"].split(",")]
ranges = list(json.loads(about["command_ranges"]).values())
command = np.clip(options.command, *np.transpose(ranges)) if ranges else np.zeros(3)

model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
substeps = max(1, round((period := float(about["control_period"])) / TIMESTEP))
model.opt.timestep = period / substeps
model.dof_frictionloss[:] = 0.0  # it is applied below, as in training
data = mujoco.MjData(model)
data.qpos[:] = start
q, v, last, rotation = data.qpos, data.qvel, np.zeros(12), np.zeros(9)
viewer, began, fell, saved = None, time.time(), False, list[tuple]()
if options.view:
    import mujoco.viewer

    viewer = mujoco.viewer.launch_passive(model, data)
while data.time < options.seconds - 1e-6 and not fell and (not viewer or viewer.is_running()):
    mujoco.mju_quat2Mat(rotation, q[3:7])
    R, k = rotation.reshape(3, 3), len(saved)
    for kept, function, extra in zip(past, functions, params, strict=True):
        seen = OBSERVATIONS[function](R, q, v, home, last, command, k, **extra)
        kept.extend([np.array(seen, ndmin=1)] * (1 if kept else kept.maxlen))
    given = {"obs": np.concatenate([seen for kept in past for seen in kept]), "joint_pos": q[7:]}
    given = {x.name: given[x.name].astype(np.float32)[None] for x in session.get_inputs()}
    (last,), (target,) = session.run(["actions", "joint_targets"], given)
    saved.append((data.time, q.copy(), v.copy(), target))
    for _ in range(substeps):  # the joint controller, within the motors' torque-speed lines
        upper = effort * np.clip(1 - v[6:] / limit, 0, 1)
        lower = -effort * np.clip(1 + v[6:] / limit, 0, 1)
        data.ctrl[:] = np.clip(kp * (target - q[7:]) - kd * v[6:], lower, upper)
        data.qfrc_applied[6:] = -friction * np.tanh(v[6:] / FRICTION_SPEED)
        mujoco.mj_step(model, data)
    fell = R[2, 2] < 0.5  # tipped over by 60 degrees
    if viewer:
        viewer.sync()
        time.sleep(max(0.0, began + data.time - time.time()))
x, y = q[:2] - start[:2]
print(f"{about['robot']}, {about['task']}: {x / data.time:.3f} m/s along x for {data.time:.2f} s, "
      f"{y:.2f} m to the left, {'fell' if fell else 'no fall'}")  # fmt: skip
if options.save:
    when, qpos, qvel, targets = map(np.array, zip(*saved, strict=True))
    np.savez(options.save, time=when, qpos=qpos, qvel=qvel, target=targets)
