"""`deploy.yaml` with the fields that unitree_rl_lab's runtime reads.

They are those of its export_deploy_cfg.py; its deploy/include/isaaclab reads them on the robot.
"""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from quadwalk.env.env import QuadrupedEnv
from quadwalk.export.joint_targets import JointTargets
from quadwalk.task_files import reference

SDK_LEGS = ("FR", "FL", "RR", "RL")  # of unitree_sdk2's motors, hip thigh calf in each
# What that runtime calls the observations that it has (deploy/.../envs/mdp/observations.h).
_NAMES = {
    "observation:angular_velocity": "base_ang_vel",
    "observation:gravity": "projected_gravity",
    "observation:command": "velocity_commands",
    "observation:joint_pos": "joint_pos_rel",
    "observation:joint_vel": "joint_vel_rel",
    "observation:last_action": "last_action",
}


def deploy_config(env: QuadrupedEnv, targets: JointTargets) -> dict[str, Any]:
    """The content of deploy.yaml; gains are in the order of Unitree's motors, not the policy's."""
    config, motor = env.config, env.motor
    joint_ids = [
        3 * SDK_LEGS.index(leg) + joint for leg in env.quadruped.legs for joint in range(3)
    ]
    gains = np.zeros((2, 12))
    gains[:, joint_ids] = np.broadcast_to(motor.kp, 12), np.broadcast_to(motor.kd, 12)
    command = config.command
    ranges = {
        "lin_vel_x": list(command.forward),
        "lin_vel_y": list(command.lateral),
        "ang_vel_z": list(command.yaw_rate),
        "heading": None,
    }
    limited = np.all(np.isfinite(targets.lower))
    return {
        "joint_ids_map": joint_ids,
        "step_dt": round(config.control_dt, 9),
        "stiffness": _rounded(gains[0]),
        "damping": _rounded(gains[1]),
        "default_joint_pos": _rounded(env.robot.home_joints),
        "commands": {"base_velocity": {"ranges": ranges}} if command.given else {},
        "actions": {
            "JointPositionAction": {
                "clip": _rounded(np.stack([targets.lower, targets.upper], 1)) if limited else None,
                "joint_names": [".*"],
                "scale": _rounded(targets.scale),
                "offset": _rounded(targets.offset),
                "joint_ids": None,
            }
        },
        "observations": {
            _NAMES.get(reference(part.function), name): {
                "params": {"command_name": "base_velocity"}
                if part.function.__name__ == "command"
                else part.params or {},
                "clip": None,
                "scale": [1.0] * len(env.sensors.part_names[name]),
                "history_length": 1 + part.history,
            }
            for name, part in config.observation.items()
        },
    }


def missing_terms(env: QuadrupedEnv) -> list[str]:
    """The observations that unitree_rl_lab's runtime does not have."""
    parts = env.config.observation.items()
    return [name for name, part in parts if reference(part.function) not in _NAMES]


def as_yaml(config: Mapping[str, Any]) -> str:
    """`config` as YAML: indented groups, with lists and values as JSON, which is YAML too."""
    return "".join(f"{line}\n" for line in _lines(config, ""))


def _lines(group: Mapping[str, Any], indent: str) -> Iterator[str]:
    for key, value in group.items():
        if isinstance(value, Mapping) and value:
            yield f"{indent}{key}:"
            yield from _lines(value, indent + "  ")
        else:
            yield f"{indent}{key}: {json.dumps(value)}"


def _rounded(values: np.ndarray) -> Any:
    """As a list, with the digits that a float32 has."""
    return [_rounded(v) for v in values] if np.ndim(values) else float(f"{values:.7g}")
