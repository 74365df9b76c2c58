"""policy.onnx as a robot's controller, for run_policy.py and for a runtime of your own.

Needs numpy and onnxruntime. States are MuJoCo's. q (19,) holds the trunk's position, its quaternion
wxyz and the joints' angles. v (18,) holds the trunk's linear velocity in the world's frame, its
angular velocity in its own frame and the joints' velocities. Units are m, s, rad and Nm.
"""

import json
import sys
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime

FRICTION_SPEED = 0.1  # rad/s, over which joint friction passes through zero


@dataclass
class Situation:
    """What the policy's observations are computed from."""

    q: np.ndarray  # (19,)
    v: np.ndarray  # (18,)
    rotation: np.ndarray  # (3, 3), from the trunk's frame to the world's
    home: np.ndarray  # (12,) joint angles of the home pose
    last_action: np.ndarray  # (12,)
    command: np.ndarray  # (3,) velocity ahead and to the left, yaw rate
    steps: int  # control steps since the episode's start


def compute_clock(situation: Situation, stride: float) -> np.ndarray:
    """Return sine and cosine of a trot's phase (2,); 0 at the command to stand."""
    if not np.any(situation.command):
        return np.zeros(2)
    phase = 2 * np.pi * situation.steps / stride
    return np.array([np.sin(phase), np.sin(phase + np.pi / 2)])


# The parts of the observation by their names in the metadata. Add those of your own task here.
OBSERVATIONS: dict = {
    "observation:velocity": lambda s: s.rotation.T @ s.v[:3],
    "observation:angular_velocity": lambda s: s.v[3:6],
    "observation:gravity": lambda s: -s.rotation[2],
    "observation:heading": lambda s: np.arctan2(s.rotation[1, 0], s.rotation[0, 0]),
    "observation:offset": lambda s, reach: np.clip(s.q[1], -reach, reach),
    "observation:command": lambda s: s.command,
    "observation:trot_clock": compute_clock,
    "observation:joint_pos": lambda s: s.q[7:] - s.home,
    "observation:joint_vel": lambda s: s.v[6:],
    "observation:last_action": lambda s: s.last_action,
    "observation:height": lambda s: s.q[2],
}


class Controller:
    """A policy in one episode, and the joint controller that follows its targets."""

    def __init__(self, file: Path) -> None:
        session_options = onnxruntime.SessionOptions()
        session_options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(
            file, session_options, providers=["CPUExecutionProvider"]
        )
        self.about = self.session.get_modelmeta().custom_metadata_map

        self.kp = self.read_numbers("joint_stiffness")
        self.kd = self.read_numbers("joint_damping")
        self.effort_limit = self.read_numbers("effort_limit")
        self.velocity_limit = self.read_numbers("velocity_limit")
        self.friction = self.read_numbers("joint_friction")
        self.home = self.read_numbers("default_joint_pos")

        names = [to_current_name(name) for name in read_list(self.about["observation_functions"])]
        unknown = [name for name in names if name not in OBSERVATIONS]
        if unknown:
            sys.exit(f"error: add {', '.join(unknown)} to OBSERVATIONS in {__file__}")
        self.observations = [OBSERVATIONS[name] for name in names]
        self.params = list(json.loads(self.about["observation_params"]).values())
        self.history = [int(steps) for steps in read_list(self.about["observation_history"])]
        self.restart()

    def read_numbers(self, key: str) -> np.ndarray:
        """Return the numbers of the metadata's list `key`; infinite where there is no limit."""
        return np.array(read_list(self.about[key]), float)

    def restart(self) -> None:
        """Begin an episode: forget the last action and all observations."""
        self.steps = 0
        self.action = np.zeros(12)
        self.obs = np.zeros(0)
        self.readings: list[deque] = [deque(maxlen=1 + steps) for steps in self.history]

    def compute_targets(self, q: np.ndarray, v: np.ndarray, command: np.ndarray) -> np.ndarray:
        """Return joint targets (12,), rad, for one control step in the state `q`, `v`.

        `command` (3,) are forward and lateral velocity, m/s, and yaw rate, rad/s. The observation
        and the action that led to the targets are kept as `obs` and `action`.
        """
        self.obs = self.observe(q, v, command)
        inputs = {"obs": self.obs.astype(np.float32)[None]}
        actions, targets = self.session.run(["actions", "joint_targets"], inputs)
        self.action = actions[0]
        self.steps += 1
        return targets[0]

    def observe(self, q: np.ndarray, v: np.ndarray, command: np.ndarray) -> np.ndarray:
        """Return the observation (n,): term after term, each from its oldest step to the newest."""
        rotation = to_matrix(q[3:7])
        situation = Situation(q, v, rotation, self.home, self.action, command, self.steps)
        parts: list = []
        for index, function in enumerate(self.observations):
            reading = np.atleast_1d(function(situation, **self.params[index]))
            readings = self.readings[index]
            readings.append(reading)
            while len(readings) < 1 + self.history[index]:  # at the start all are the first
                readings.append(reading)
            parts.extend(readings)
        return np.concatenate(parts)

    def compute_torque(self, target: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return joint torques (12,), Nm, for one physics step: the motors' less joint friction.

        `target` (12,), rad, are the joint targets. A motor's torque falls with its speed. A
        simulator's own joint friction has to be off.
        """
        angle = q[7:]
        speed = v[6:]
        torque = self.kp * (target - angle) - self.kd * speed
        upper = self.effort_limit * np.clip(1 - speed / self.velocity_limit, 0, 1)
        lower = -self.effort_limit * np.clip(1 + speed / self.velocity_limit, 0, 1)
        friction = self.friction * np.tanh(speed / FRICTION_SPEED)
        return np.clip(torque, lower, upper) - friction


def read_list(text: str) -> list:
    """Return the list in an entry of the metadata: JSON or, in older exports, words between commas.

    A null in JSON becomes infinity: it stands for no limit.
    """
    if not text.startswith("["):
        return text.split(",")
    return [np.inf if value is None else value for value in json.loads(text)]


def to_current_name(name: str) -> str:
    """Return the key in `OBSERVATIONS` of a term, which older exports name by its module."""
    module, _, function = name.partition(":")
    if module != "quadwalk.task.observation":
        return name
    if function == "joint_positions":
        return "observation:joint_pos"
    if function == "joint_velocities":
        return "observation:joint_vel"
    return f"observation:{function}"


def to_matrix(quat: np.ndarray) -> np.ndarray:
    """Return the matrix (3, 3) of a unit quaternion wxyz, from the trunk's frame to the world's."""
    w, x, y, z = quat
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * (w * cross + cross @ cross)
