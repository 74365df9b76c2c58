"""What a user of an exported policy must know, as ONNX metadata: names, units, gains, limits."""

import json
from collections.abc import Iterable
from importlib.metadata import version
from typing import Any

import numpy as np

from quadwalk.env.reset import nominal_start
from quadwalk.evaluation.loaded import LoadedRun
from quadwalk.export.joint_targets import JointTargets
from quadwalk.settings.environment import COMMANDED
from quadwalk.task_files import reference

UNITS = (
    "m, s, rad, m/s, rad/s, Nm; stiffness Nm/rad, damping Nm s/rad; "
    "x ahead, y left, z up; quaternions wxyz"
)


def describe(loaded: LoadedRun, targets: JointTargets) -> dict[str, str]:
    """Return the metadata of a policy; lists are JSON, for a joint's name may hold a comma.

    The first eight keys are mjlab's (mjlab/rl/exporter_utils.py), the others quadwalk's own:
    all that `run_policy.py` and another simulator need.
    """
    env, policy = loaded.env, loaded.policy
    config, motor, command = env.config, env.motor, env.config.command
    parts = config.observation
    # Of the command's numbers together.
    limits = {name: getattr(command, name) for name in ("lateral_until", "turning")}
    return {
        "run_path": loaded.run.name,
        "joint_names": _listed(env.quadruped.joints),
        "joint_stiffness": _joints(motor.kp),
        "joint_damping": _joints(motor.kd),
        "default_joint_pos": _joints(env.robot.home_joints),
        "command_names": "velocity" if command.given else "",
        "observation_names": _listed(parts),
        "action_scale": _joints(targets.scale),
        "action_offset": _joints(targets.offset),
        "joint_target_lower": _joints(targets.lower),
        "joint_target_upper": _joints(targets.upper),
        "joint_target_reach": _joints(np.inf if targets.reach is None else targets.reach),
        "observation_sizes": _listed(len(labels) for labels in env.sensors.part_names.values()),
        "observation_history": _listed(part.history for part in parts.values()),
        "observation_functions": _listed(reference(part.function) for part in parts.values()),
        "observation_params": json.dumps({name: part.params or {} for name, part in parts.items()}),
        "observation_meaning": json.dumps(
            {n: (part.function.__doc__ or "").partition("\n")[0] for n, part in parts.items()}
        ),
        "observation_layout": "one part after another, each from its oldest step to its newest; "
        "at the start all of a part's history is its first reading",
        "command_ranges": json.dumps(
            {name: list(getattr(command, name)) for name in COMMANDED if command.given}
        ),
        "command_limits": json.dumps({name: x for name, x in limits.items() if x is not None}),
        "units": UNITS,
        "control_period": f"{config.control_dt:.9g}",
        "robot": env.quadruped.name,
        "start_qpos": _listed(
            nominal_start(env.mj_model_of(env.quadruped), env.quadruped, config.reset)
        ),
        "effort_limit": _joints(motor.effort),
        "velocity_limit": _joints(np.inf if motor.velocity is None else motor.velocity),
        "joint_friction": _joints(0.0 if motor.friction is None else motor.friction),
        "joint_viscous_damping": _joints(env.mj_model.dof_damping[6:]),
        "joint_armature": _joints(env.mj_model.dof_armature[6:]),
        "ground_friction": f"{env.friction:.9g}",
        "gravity": f"{config.gravity:.9g}",
        "training_steps": str(policy.steps),
        "task": policy.config.task,
        "quadwalk_version": version("quadwalk"),
    }


def _joints(value: Any) -> str:
    """One number for each joint, of twelve or of one for all."""
    return _listed(np.broadcast_to(value, 12))


def _listed(values: Iterable[Any]) -> str:
    """Return a JSON list of texts or numbers; null is a number that is not finite: no limit."""
    return f"[{', '.join(map(_as_json, values))}]"


def _as_json(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value)
    return f"{float(value):.9g}" if np.isfinite(value) else "null"
