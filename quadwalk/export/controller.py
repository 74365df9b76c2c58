"""policy.onnx as a robot's controller, for run_policy.py and for a runtime of your own.

Needs numpy and onnxruntime. States are MuJoCo's: q (19,) is the trunk's place, its quaternion wxyz
and the joints' angles, v (18,) its velocity in the world's axes, its rates in its own, the joints'.
"""

import json
import sys
from collections import deque
from pathlib import Path

import numpy as np
import onnxruntime

FRICTION_SPEED = 0.1  # rad/s, over which joint friction passes through zero
TAU, LAG = 2 * np.pi, np.array([0, np.pi / 2])  # of a clock's sine and cosine
# What the policy sees, by the names in its metadata. R turns the trunk's frame into the world's;
# home and last action are (12,), command (3,); k counts steps.
OBSERVATIONS: dict = {
    "observation:velocity": lambda R, q, v, *_: R.T @ v[:3],
    "observation:angular_velocity": lambda R, q, v, *_: v[3:6],
    "observation:gravity": lambda R, q, v, *_: -R[2],
    "observation:heading": lambda R, q, v, *_: np.arctan2(R[1, 0], R[0, 0]),
    "observation:offset": lambda R, q, *_, reach: np.clip(q[1], -reach, reach),
    "observation:command": lambda R, q, v, home, last, command, *_: command,
    "observation:trot_clock": lambda *s, stride: any(s[5]) * np.sin(s[6] * TAU / stride + LAG),
    "observation:joint_pos": lambda R, q, v, home, *_: q[7:] - home,
    "observation:joint_vel": lambda R, q, v, *_: v[6:],
    "observation:last_action": lambda R, q, v, home, last, *_: last,
    "observation:height": lambda R, q, v, *_: q[2],
    "observation:world_position": lambda R, q, v, *_: q[:3],
    "observation:world_orientation": lambda R, q, v, *_: q[[4, 5, 6, 3]],
    "observation:world_velocity": lambda R, q, v, *_: v[:3],
    "observation:world_angular_velocity": lambda R, q, v, *_: R @ v[3:6],
    "observation:joint_angles": lambda R, q, v, *_: q[7:],
}


def read_list(text: str) -> list:
    """Return a list of the metadata: JSON, or as older exports have it, words between commas.

    null stands for a number without limit, which JSON cannot state.
    """
    if not text.startswith("["):
        return text.split(",")
    return [np.inf if value is None else value for value in json.loads(text)]


def to_current_name(name: str) -> str:
    """Return the name in `OBSERVATIONS` of what an older export calls by its place in quadwalk."""
    module, _, function = name.partition(":")
    if module not in ("quadwalk.env.observations", "quadwalk.tasks.blog"):
        return name
    renamed = {"joint_positions": "joint_pos", "joint_velocities": "joint_vel"}
    return "observation:" + renamed.get(function, function)


def rotation(quat: np.ndarray) -> np.ndarray:
    """(3, 3), from the frame that a unit quaternion wxyz turns into the world's."""
    w, x, y, z = quat
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * (w * cross + cross @ cross)


class Controller:
    """The policy of one episode, and the joint controller that obeys it."""

    def __init__(self, file: Path) -> None:
        (one := onnxruntime.SessionOptions()).intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(file, one, providers=["CPUExecutionProvider"])
        self.about = about = self.session.get_modelmeta().custom_metadata_map
        names = "joint_stiffness joint_damping effort_limit velocity_limit joint_friction"
        self.motor = np.array([read_list(about[name]) for name in names.split()], float)
        self.home = np.array(read_list(about["default_joint_pos"]), float)
        self.functions = [
            to_current_name(name) for name in read_list(about["observation_functions"])
        ]
        if unknown := sorted(set(self.functions) - set(OBSERVATIONS)):
            sys.exit(f"error: add {', '.join(unknown)} to OBSERVATIONS in {__file__}")
        self.params = json.loads(about["observation_params"]).values()
        self.history = [1 + int(n) for n in read_list(about["observation_history"])]
        self.restart()

    def restart(self) -> None:
        """Begin an episode: no step was done, and none is remembered."""
        self.past: list[deque] = [deque(maxlen=steps) for steps in self.history]
        self.action, self.steps = np.zeros(12), 0

    def targets(self, q: np.ndarray, v: np.ndarray, command: np.ndarray) -> np.ndarray:
        """(12,) rad, of a control step; keeps what it saw and did as `obs` and `action`."""
        state = rotation(q[3:7]), q, v, self.home, self.action, command, self.steps
        for kept, function, extra in zip(self.past, self.functions, self.params, strict=True):
            seen = np.array(OBSERVATIONS[function](*state, **extra), ndmin=1)
            kept.extend([seen] * (1 if kept else kept.maxlen or 1))
        self.obs = np.concatenate([seen for kept in self.past for seen in kept])
        given = {"obs": self.obs, "joint_pos": q[7:]}
        given = {x.name: given[x.name].astype(np.float32)[None] for x in self.session.get_inputs()}
        (self.action,), (target,) = self.session.run(["actions", "joint_targets"], given)
        self.steps += 1
        return target

    def torque(self, target: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(12,) Nm in a physics step: the motors', within their torque-speed lines, and friction's.

        A simulator's own joint friction has to be off.
        """
        kp, kd, effort, limit, friction = self.motor
        upper = effort * np.clip(1 - v[6:] / limit, 0, 1)
        lower = -effort * np.clip(1 + v[6:] / limit, 0, 1)
        motor = np.clip(kp * (target - q[7:]) - kd * v[6:], lower, upper)
        return motor - friction * np.tanh(v[6:] / FRICTION_SPEED)
