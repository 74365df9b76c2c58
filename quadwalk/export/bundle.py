"""All files of an exported policy, written to a folder."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import onnx
import onnxruntime
from rich.console import Console

from quadwalk.errors import UserError
from quadwalk.evaluation.loaded import LoadedRun, load_run
from quadwalk.export import scripts
from quadwalk.export.deploy_yaml import as_yaml, deploy_config, missing_terms
from quadwalk.export.description import describe
from quadwalk.export.joint_targets import JointTargets, find_targets
from quadwalk.export.policy_graph import Weights, build_model, input_order
from quadwalk.files import atomic_write, make_folder
from quadwalk.learn.devices import set_up_devices
from quadwalk.robot.mjcf import write_xml
from quadwalk.runs.directory import Run

TOLERANCE = 1e-5  # of actions and, in rad, of joint targets
_ROWS = 64
_YAML_HEAD = """\
# For unitree_rl_lab: policy.onnx belongs in exported/, this file in params/.
# Observations that its runtime does not have: {missing}.
"""


def load_flat(run: Run, which: str) -> LoadedRun:
    """The "last" or "best" policy of `run` in MuJoCo C on a flat floor, as it is exported."""
    set_up_devices()
    return load_run(run, 20.0, which, "mujoco", flat=True)


def export_run(
    run: Run, which: str, out: Path, console: Console, getup: Run | None = None
) -> list[Path]:
    """Write the "last" or "best" policy of `run` to the folder `out`; return the files.

    The last policy of `getup` gets its robot up; run_policy.py hands over to it and back. Raises
    `UserError` where a policy cannot be read or exported, or `out` not written.
    """
    loaded = load_flat(run, which)
    for note in loaded.notes:
        console.print(note)
    env, (model, targets) = loaded.env, as_onnx(loaded, console)
    files = {
        "policy.onnx": model.SerializeToString(),
        "robot.xml": write_xml(env.quadruped.spec).encode(),
        "robot.urdf": env.quadruped.urdf.encode(),
        **{script.name: script.read_bytes() for script in scripts()},
    }
    if getup is not None:
        riser = load_flat(getup, "last")
        for note in riser.notes:
            console.print(note)
        if not riser.can_take_turns(loaded):
            raise UserError(
                f"{getup.path} is of another robot or control period; expected those of {run.path}"
            )
        files["getup.onnx"] = as_onnx(riser, console)[0].SerializeToString()
    missing = ", ".join(missing_terms(env)) or "none"
    if targets.reach is None:
        head = _YAML_HEAD.format(missing=missing)
        files["deploy.yaml"] = (head + as_yaml(deploy_config(env, targets))).encode()
    else:
        console.print("no deploy.yaml: its format has no targets that depend on the joints' angles")
    make_folder(out)
    for name, content in files.items():
        with atomic_write(out / name) as file:
            file.write(content)
    return [out / name for name in files]


def as_onnx(loaded: LoadedRun, console: Console) -> tuple[onnx.ModelProto, JointTargets]:
    """The policy as a graph that gives joint targets, compared with JAX; its action map."""
    env = loaded.env
    targets = find_targets(env.config.action, env.robot)
    weights = Weights.of(loaded.policy.act, loaded.policy.config.ppo)
    model = build_model(weights, input_order(env), targets, describe(loaded, targets))
    off = largest_difference(model, loaded, targets)
    if off > TOLERANCE:
        raise UserError(f"the exported policy is {off:.1e} off; expected less than {TOLERANCE}")
    console.print(f"ONNX and JAX agree to {off:.1e} on {_ROWS} random observations")
    return model, targets


def largest_difference(model: onnx.ModelProto, loaded: LoadedRun, targets: JointTargets) -> float:
    """Between ONNX Runtime and JAX: of actions and joint targets, rad, on random observations."""
    env = loaded.env
    normalizer, _ = loaded.policy.act.args  # type: ignore[attr-defined]
    rng = np.random.default_rng(0)
    size = env.policy_size
    wide = np.asarray(normalizer.std) * rng.standard_normal((_ROWS, size))
    seen = (np.asarray(normalizer.mean) + wide).astype(np.float32)
    joints = rng.uniform(env.robot.lower, env.robot.upper, (_ROWS, 12)).astype(np.float32)
    actions = loaded.policy.act(jnp.asarray(seen))
    expected = jax.vmap(lambda a, q: env.config.action(env.robot, a, q))(actions, joints)
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    obs = np.empty_like(seen)
    obs[:, input_order(env)] = seen
    off = 0.0
    for row in range(_ROWS):
        given = {"obs": obs[row : row + 1]}
        if targets.reach is not None:
            given["joint_pos"] = joints[row : row + 1]
        found = session.run(None, given)
        for mine, theirs in zip(found, (actions, expected), strict=True):
            off = max(off, float(np.max(np.abs(mine[0] - np.asarray(theirs[row])))))
    return off
