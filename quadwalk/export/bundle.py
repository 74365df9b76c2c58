"""All files of an exported policy, written to a folder."""

from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import onnx
import onnxruntime
from rich.console import Console

from quadwalk.errors import UserError
from quadwalk.evaluation.load import LoadedRun, find_robot_for, load_run
from quadwalk.export.deploy_yaml import make_deploy_yaml
from quadwalk.export.description import make_policy_model
from quadwalk.export.policy_graph import (
    JointTargets,
    compute_input_order,
    find_joint_targets,
)
from quadwalk.files import make_folder, open_atomic
from quadwalk.learn.devices import set_up_devices
from quadwalk.robot.mjcf import write_xml
from quadwalk.runs.directory import Run
from quadwalk.settings.training import RobotConfig
from quadwalk.terrain.terrain import FLAT

# They run where they are copied to, without quadwalk.
SCRIPTS = [Path(__file__).with_name(name) for name in ("run_policy.py", "controller.py")]
TOLERANCE = 1e-5  # of actions and, in rad, of joint targets
_ROWS = 64  # random observations that ONNX Runtime and JAX are compared on


def load_flat(run: Run, which: str, robot: RobotConfig | None = None) -> LoadedRun:
    """Return the "last" or "best" policy of `run` in MuJoCo C, as exported: on a flat floor.

    A policy of many bodies becomes one of its robot alone, or of another `robot`.
    """
    set_up_devices()
    return load_run(run, 20.0, which, "mujoco", ground=FLAT, robot=robot).to_one_robot()


def export_run(
    run: Run,
    which: str,
    out: Path,
    console: Console,
    getup: Run | None = None,
    robot: RobotConfig | None = None,
) -> list[Path]:
    """Write the "last" or "best" policy of `run` to the folder `out`; return the files.

    The last policy of `getup`, if named, is exported too: run_policy.py switches to it after a
    fall, and back. A policy of many bodies drives another `robot`, if named. Raises `UserError` if
    a policy cannot be read or exported, or `out` not written.
    """
    loaded = load_flat(run, which, robot)
    env = loaded.env
    model, targets = convert_policy(loaded, console)
    files = {
        "policy.onnx": model.SerializeToString(),
        "robot.xml": write_xml(env.quadruped.spec).encode(),
        "robot.urdf": env.quadruped.urdf.encode(),
        **{script.name: script.read_bytes() for script in SCRIPTS},
    }
    if getup is not None:
        riser = load_flat(getup, "last", find_robot_for(getup, loaded))
        if not riser.has_same_robot(loaded):
            raise UserError(
                f"{getup.path} is of another robot or control period; expected those of {run.path}"
            )
        model, _ = convert_policy(riser, console)
        files["getup.onnx"] = model.SerializeToString()
    if targets.scale is None:
        console.print("no deploy.yaml: it cannot state that a thigh's target follows two actions")
    else:
        files["deploy.yaml"] = make_deploy_yaml(env, targets).encode()
    make_folder(out)
    for name, content in files.items():
        with open_atomic(out / name) as file:
            file.write(content)
    return [out / name for name in files]


def convert_policy(loaded: LoadedRun, console: Console) -> tuple[onnx.ModelProto, JointTargets]:
    """Return the policy as an ONNX model, and the action map as numbers.

    Raises `UserError` if its outputs differ from JAX's; prints by how much.
    """
    for note in loaded.notes:
        console.print(note)
    env = loaded.env
    targets = find_joint_targets(env.config.action, env.robot)
    model = make_policy_model(loaded, targets)
    error = compute_largest_error(model, loaded)
    if error > TOLERANCE:
        raise UserError(f"the exported policy is {error:.1e} off; expected less than {TOLERANCE}")
    console.print(f"ONNX and JAX agree to {error:.1e} on {_ROWS} random observations")
    return model, targets


def compute_largest_error(model: onnx.ModelProto, loaded: LoadedRun) -> float:
    """Return the largest difference of the ONNX model's outputs from JAX's, on random observations.

    The outputs are actions and joint targets, rad.
    """
    env = loaded.env
    normalizer, _ = loaded.policy.act.args  # type: ignore[attr-defined]
    rng = np.random.default_rng(0)
    deviations = np.asarray(normalizer.std) * rng.standard_normal((_ROWS, env.policy_size))
    observations = (np.asarray(normalizer.mean) + deviations).astype(np.float32)
    joints = rng.uniform(env.robot.lower, env.robot.upper, (_ROWS, 12)).astype(np.float32)
    actions = loaded.policy.act(jnp.asarray(observations))
    targets = jax.vmap(partial(env.config.action, env.robot))(actions, joints)
    inputs = np.empty_like(observations)
    inputs[:, compute_input_order(env)] = observations

    session = onnxruntime.InferenceSession(
        model.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    error = 0.0
    for row in range(_ROWS):
        outputs = session.run(None, {"obs": inputs[row : row + 1]})
        for output, expected in zip(outputs, (actions[row], targets[row]), strict=True):
            error = max(error, float(np.max(np.abs(output[0] - np.asarray(expected)))))
    return error
