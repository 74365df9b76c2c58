"""`deploy.yaml` with the fields that unitree_rl_lab's runtime reads.

They are those of its export_deploy_cfg.py; its deploy/include/isaaclab reads them on the robot.
"""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from quadwalk.env.env import QuadrupedEnv
from quadwalk.export.policy_graph import JointTargets
from quadwalk.settings.registry import get_term_name

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


def make_deploy_yaml(env: QuadrupedEnv, targets: JointTargets) -> str:
    """Return the text of deploy.yaml, which begins with a list of terms the runtime lacks."""
    parts = env.config.observation.items()
    missing = [name for name, part in parts if get_term_name(part.function) not in _NAMES]
    return (
        "# For unitree_rl_lab: policy.onnx belongs in exported/, this file in params/.\n"
        f"# Observations that its runtime does not have: {', '.join(missing) or 'none'}.\n"
    ) + to_yaml(make_deploy_config(env, targets))


def make_deploy_config(env: QuadrupedEnv, targets: JointTargets) -> dict[str, Any]:
    """Return the content of deploy.yaml: gains in the order of Unitree's motors, others in ours.

    Each joint's target follows from its own action. `joint_ids_map` holds the place of each of our
    joints among Unitree's motors.
    """
    config, motor, command = env.config, env.motor, env.config.command
    joint_ids = [
        3 * SDK_LEGS.index(leg) + joint for leg in env.quadruped.legs for joint in range(3)
    ]
    stiffness, damping = np.zeros(12), np.zeros(12)
    stiffness[joint_ids] = np.broadcast_to(motor.kp, 12)
    damping[joint_ids] = np.broadcast_to(motor.kd, 12)
    ranges = {
        "lin_vel_x": list(command.forward),
        "lin_vel_y": list(command.lateral),
        "ang_vel_z": list(command.yaw_rate),
        "heading": None,
    }
    limits = np.stack([targets.lower, targets.upper], 1)
    observations = {}
    for name, part in config.observation.items():
        function = get_term_name(part.function)
        is_command = function == "observation:command"
        observations[_NAMES.get(function, name)] = {
            "params": {"command_name": "base_velocity"} if is_command else part.params or {},
            "clip": None,
            "scale": [1.0] * len(env.sensors.part_names[name]),
            "history_length": 1 + part.history,
        }
    return {
        "joint_ids_map": joint_ids,
        "step_dt": round(config.control_dt, 9),
        "stiffness": _round(stiffness),
        "damping": _round(damping),
        "default_joint_pos": _round(env.robot.home_joints),
        "commands": {"base_velocity": {"ranges": ranges}} if command.active else {},
        "actions": {
            "JointPositionAction": {
                "clip": _round(limits) if np.all(np.isfinite(limits)) else None,
                "joint_names": [".*"],
                "scale": _round(np.diag(targets.matrix)),
                "offset": _round(targets.offset),
                "joint_ids": None,
            }
        },
        "observations": observations,
    }


def to_yaml(config: Mapping[str, Any]) -> str:
    """Return `config` as YAML: indented groups, with lists and values as JSON."""
    return "".join(f"{line}\n" for line in _iterate_lines(config, ""))


def _iterate_lines(group: Mapping[str, Any], indent: str) -> Iterator[str]:
    """Yield the lines of `group` in YAML, each after `indent`."""
    for key, value in group.items():
        if isinstance(value, Mapping) and value:
            yield f"{indent}{key}:"
            yield from _iterate_lines(value, indent + "  ")
        else:
            yield f"{indent}{key}: {json.dumps(value)}"


def _round(values: np.ndarray) -> Any:
    """Return an array as nested lists of numbers with the seven digits that a float32 has."""
    return [_round(v) for v in values] if np.ndim(values) else float(f"{values:.7g}")
