"""What a user of an exported policy must know, as ONNX metadata: names, units, gains, limits."""

import json
from collections.abc import Iterable
from importlib.metadata import version
from typing import Any

import numpy as np
import onnx

from quadwalk.env.reset import compute_nominal_start
from quadwalk.evaluation.load import LoadedRun
from quadwalk.export.policy_graph import (
    JointTargets,
    build_model,
    compute_input_order,
    extract_weights,
)
from quadwalk.settings.environment import COMMANDED
from quadwalk.settings.registry import get_term_name

UNITS = (
    "m, s, rad, m/s, rad/s, Nm; stiffness Nm/rad, damping Nm s/rad; "
    "x ahead, y left, z up; quaternions wxyz"
)
LAYOUT = (
    "one part after another, each from its oldest step to its newest; "
    "at the start all of a part's history is its first reading"
)


def make_policy_model(loaded: LoadedRun, targets: JointTargets) -> onnx.ModelProto:
    """Return the policy as an ONNX model that gives joint targets, with its metadata."""
    loaded = loaded.to_one_robot()
    weights = extract_weights(loaded.policy.act, loaded.policy.config.ppo)
    return build_model(weights, compute_input_order(loaded.env), targets, describe(loaded, targets))


def describe(loaded: LoadedRun, targets: JointTargets) -> dict[str, str]:
    """Return the metadata of an exported policy, texts by key; lists are JSON.

    The first eight keys are mjlab's (mjlab/rl/exporter_utils.py), the others quadwalk's own: all
    that `run_policy.py` and another simulator need.
    """
    loaded = loaded.to_one_robot()
    env, policy = loaded.env, loaded.policy
    config, motor, command = env.config, env.motor, env.config.command
    parts = config.observation
    ranges = {name: list(getattr(command, name)) for name in COMMANDED if command.active}
    # Limits of the command's numbers together.
    limits = {name: getattr(command, name) for name in ("lateral_until", "turning")}
    start = compute_nominal_start(env.make_mj_model(env.quadruped), env.quadruped, config.reset)
    return {
        "run_path": loaded.run.name,
        "joint_names": _to_list(env.quadruped.joints),
        "joint_stiffness": _to_joint_list(motor.kp),
        "joint_damping": _to_joint_list(motor.kd),
        "default_joint_pos": _to_joint_list(env.robot.home_joints),
        "command_names": "velocity" if command.active else "",
        "observation_names": _to_list(parts),
        "action_scale": _to_list(
            targets.matrix.ravel() if targets.scale is None else targets.scale
        ),
        "action_offset": _to_joint_list(targets.offset),
        "joint_target_lower": _to_joint_list(targets.lower),
        "joint_target_upper": _to_joint_list(targets.upper),
        "observation_sizes": _to_list(len(names) for names in env.sensors.part_names.values()),
        "observation_history": _to_list(part.history for part in parts.values()),
        "observation_functions": _to_list(get_term_name(part.function) for part in parts.values()),
        "observation_params": json.dumps({name: part.params or {} for name, part in parts.items()}),
        "observation_meaning": json.dumps(
            {n: (part.function.__doc__ or "").partition("\n")[0] for n, part in parts.items()}
        ),
        "observation_layout": LAYOUT,
        "command_ranges": json.dumps(ranges),
        "command_limits": json.dumps({name: x for name, x in limits.items() if x is not None}),
        "units": UNITS,
        "control_period": _to_text(config.control_dt),
        "robot": env.quadruped.name,
        "start_qpos": _to_list(start),
        "effort_limit": _to_joint_list(motor.effort),
        "velocity_limit": _to_joint_list(np.inf if motor.velocity is None else motor.velocity),
        "joint_friction": _to_joint_list(0.0 if motor.friction is None else motor.friction),
        "joint_viscous_damping": _to_joint_list(env.mj_model.dof_damping[6:]),
        "joint_armature": _to_joint_list(env.mj_model.dof_armature[6:]),
        "ground_friction": _to_text(env.friction),
        "gravity": _to_text(config.gravity),
        "training_steps": str(policy.steps),
        "task": policy.config.task,
        "desk": json.dumps(policy.changed),
        "quadwalk_version": version("quadwalk"),
    }


def _to_joint_list(value: Any) -> str:
    """Return a JSON list of twelve numbers, from as many or from one for all joints."""
    return _to_list(np.broadcast_to(value, 12))


def _to_list(values: Iterable[Any]) -> str:
    """Return a JSON list of texts or numbers."""
    return f"[{', '.join(map(_to_text, values))}]"


def _to_text(value: Any) -> str:
    """Return a text or number as JSON; null is a number that is not finite: no limit."""
    if isinstance(value, str):
        return json.dumps(value)
    return f"{float(value):.9g}" if np.isfinite(value) else "null"
