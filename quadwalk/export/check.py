"""A check that an export does in each step what its policy does here, or where it differs first."""

import io
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import onnx
from rich.console import Console

from quadwalk.env.command import Command
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.state import EnvState, start_strides
from quadwalk.errors import UserError
from quadwalk.evaluation.load import LoadedRun
from quadwalk.export.controller import read_list
from quadwalk.export.description import describe
from quadwalk.export.policy_graph import compute_input_order, find_joint_targets, list_inputs
from quadwalk.files import read_bytes
from quadwalk.physics.engines import ENGINES
from quadwalk.physics.motor import PhysicsState
from quadwalk.settings.registry import to_current_name

SECONDS = 2.0  # of a replay
COMMAND = (0.5, 0.2, 0.3)  # m/s ahead and left, rad/s: no two are alike
# Tolerance of observations, actions and targets.
EXACT = 1e-4
# Tolerances of a state after a step, whose robot.xml has six digits: m and rad, m/s and rad/s.
POSITION, VELOCITY = 1e-4, 0.01
SHIFT = 1e-6  # m, a height in which two physics may differ in the last digit
# What differs where a policy was not changed.
_ORIGIN = ("run_path", "quadwalk_version")
_TRUNK = ("x", "y", "z", "qw", "qx", "qy", "qz")
_RATES = ("vx", "vy", "vz", "roll_rate", "pitch_rate", "yaw_rate")


@dataclass(frozen=True)
class Stage:
    """One kind of numbers in all control steps, as recorded and as computed here.

    The kinds are observations, actions, joint targets and states of the physics.
    """

    name: str
    labels: list[str]  # n
    recorded: np.ndarray  # (T, n)
    expected: np.ndarray  # (T, n)
    tolerance: np.ndarray | float  # (n,) or of all

    @property
    def excess(self) -> np.ndarray:
        """Differences in units of the tolerance (T, n), at most 1 if right; infinite for NaN."""
        excess = np.abs(self.recorded - self.expected) / self.tolerance
        return np.asarray(np.nan_to_num(excess, nan=np.inf))


def check_export(loaded: LoadedRun, folder: Path, recording: Path | None, console: Console) -> None:
    """Compare the export in `folder` with the policy and environment of `loaded`.

    Its run_policy.py is run and recorded. If another runtime wrote a `recording`, that is compared
    instead, without its physics. Raises a `UserError` that names the first difference.
    """
    differences = list(find_changed_entries(loaded, folder / "policy.onnx"))
    if recording is None:
        path = folder / "run_policy.py"
        stages = compute_stages(loaded, replay(folder, loaded))
    else:
        path = recording
        stages = compute_stages(loaded, read_recording(recording, loaded))
        stages = [stage for stage in stages if stage.name != "physics"]
    for stage in stages:
        largest = float(np.max(np.abs(stage.recorded - stage.expected)))
        console.print(f"{stage.name}: at most {largest:.1e} off in {len(stage.recorded)} steps")
    if first := describe_first_difference(stages):
        differences.insert(0, first)
    if differences:
        raise UserError(f"{path}: {'; '.join(differences)}")


def find_changed_entries(loaded: LoadedRun, file: Path) -> Iterator[str]:
    """Yield a clause for each entry of the metadata in `file` that an export of now would change.

    `file` is a policy.onnx.
    """
    entries = {entry.key: entry.value for entry in onnx.load(file).metadata_props}
    targets = find_joint_targets(loaded.env.config.action, loaded.env.robot)
    for name, text in describe(loaded, targets).items():
        values = _to_values(entries.get(name, "missing"))
        expected = _to_values(text)
        if name not in _ORIGIN and values != expected:
            pairs = list(zip(values, expected, strict=False))
            index = next((i for i, (a, b) in enumerate(pairs) if a != b), 0)
            yield f"its {name} is {values[index]} at number {index}; expected {expected[index]}"


def _to_values(text: str) -> list[str]:
    """Return the values in an entry of the metadata as texts that exports of all versions share."""
    parts = read_list(text)
    return [to_current_name(part) if isinstance(part, str) else f"{part:.9g}" for part in parts]


def replay(folder: Path, loaded: LoadedRun) -> dict[str, np.ndarray]:
    """Run the export's run_policy.py in a process of its own, and return its recording."""
    with tempfile.TemporaryDirectory() as temporary:
        recording = Path(temporary) / "replay.npz"
        command = [sys.executable, str(folder / "run_policy.py"), f"--seconds={SECONDS}"]
        command += ["--save", str(recording), "--command", *map(str, COMMAND)]
        process = subprocess.run(command, capture_output=True, text=True)
        if process.returncode:
            reason = (process.stderr.strip().splitlines() or ["no word"])[-1]
            raise UserError(f"{folder / 'run_policy.py'} failed: {reason.removeprefix('error: ')}")
        return read_recording(recording, loaded)


def read_recording(file: Path, loaded: LoadedRun) -> dict[str, np.ndarray]:
    """Read the columns (T, n), by name, of an NPZ file as run_policy.py --save writes it."""
    sizes = {"qpos": 19, "qvel": 18, "obs": loaded.env.policy_size, "action": 12, "target": 12}
    sizes["command"] = 3
    try:
        with np.load(io.BytesIO(read_bytes(file)), allow_pickle=False) as saved:
            columns = {name: saved[name] for name in sizes if name in saved}
    except (ValueError, OSError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise UserError(f"{file} cannot be read; expected NPZ, as run_policy.py --save") from error
    for name, size in sizes.items():
        shape = np.shape(columns.get(name, 0.0))
        if len(shape) != 2 or shape[0] < 2 or shape[1] != size:
            raise UserError(f"{file}: {name} has the shape {shape}; expected (steps, {size})")
        if shape[0] != len(columns["qpos"]):
            raise UserError(
                f"{file}: {name} has {shape[0]} steps; expected {len(columns['qpos'])}, as qpos has"
            )
    return columns


def compute_stages(loaded: LoadedRun, columns: dict[str, np.ndarray]) -> list[Stage]:
    """Return the four stages of a control step: observation, action, target, physics.

    `columns` (T, n) are recorded. Each stage is computed from what is recorded of the stage before.
    So a difference shows where it arises, and in no later stage.
    """
    env = loaded.env
    qpos, qvel, obs = columns["qpos"], columns["qvel"], columns["obs"]
    action, target = columns["action"], columns["target"]
    joints, order = list(env.quadruped.joints), compute_input_order(env)

    expected_obs = np.empty_like(obs)
    expected_obs[:, order] = compute_observations(env, columns)
    expected_action = loaded.policy.act(jnp.asarray(obs[:, order], jnp.float32))
    expected_target = jax.vmap(partial(env.config.action, env.robot))(
        jnp.asarray(action, jnp.float32), jnp.asarray(qpos[:, 7:], jnp.float32)
    )

    states = np.hstack([qpos, qvel])[1:]
    tolerance = np.concatenate([np.full(19, POSITION), np.full(18, VELOCITY)])
    candidates = compute_next_states(env, qpos[:-1], qvel[:-1], target[:-1])
    error = np.max(np.abs(candidates - states) / tolerance, axis=2)
    expected_states = candidates[error.argmin(axis=0), np.arange(len(states))]
    labels = [*_TRUNK, *joints, *_RATES, *(f"rate of {joint}" for joint in joints)]
    return [
        Stage("observation", list_inputs(env), obs, expected_obs, EXACT),
        Stage("action", joints, action, np.asarray(expected_action), EXACT),
        Stage("target", joints, target, np.asarray(expected_target), EXACT),
        Stage("physics", labels, states, expected_states, tolerance),
    ]


def compute_observations(env: QuadrupedEnv, columns: dict[str, np.ndarray]) -> np.ndarray:
    """Return the observations (T, n) of `env` in the recorded states, in the order of `env`."""
    names = ("qpos", "qvel", "action", "command")
    rows = {name: jnp.asarray(columns[name], jnp.float32) for name in names}
    sensors = env.sensors

    def make_state(row: dict[str, jax.Array], last_action: jax.Array, steps: jax.Array) -> EnvState:
        command = None
        if env.config.command.active:
            command = Command(row["command"], jax.random.PRNGKey(0))
        # The value network's numbers are computed with the policy's, and left out.
        strides = start_strides() if env.has_strides else None
        physics = PhysicsState(row["qpos"], row["qvel"])
        return EnvState(physics, last_action, steps, command, strides=strides)

    def step(
        before: EnvState, inputs: tuple[jax.Array, dict[str, jax.Array]]
    ) -> tuple[EnvState, jax.Array]:
        last_action, row = inputs
        after = make_state(row, last_action, before.steps + 1)
        after = after._replace(frames=before.frames, contact=before.contact)
        after = sensors.measure(env.robot, after)
        return after, sensors.observe(env.robot, after)

    @jax.jit
    def scan(rows: dict[str, jax.Array]) -> jax.Array:
        first = {name: values[0] for name, values in rows.items()}
        others = {name: values[1:] for name, values in rows.items()}
        start = make_state(first, jnp.zeros(12), jnp.zeros((), jnp.int32))
        start = sensors.start_history(env.robot, start)
        _, observations = jax.lax.scan(step, start, (rows["action"][:-1], others))
        return jnp.concatenate([sensors.observe(env.robot, start)[None], observations])

    return np.asarray(scan(rows))[:, : env.policy_size]


def compute_next_states(
    env: QuadrupedEnv, qpos: np.ndarray, qvel: np.ndarray, target: np.ndarray
) -> np.ndarray:
    """Return qpos and qvel, (3, T, 37), one control step after each of T states.

    `qpos` (T, 19) and `qvel` (T, 18) are the states, `target` (T, 12), rad, the joint targets. The
    three begin `SHIFT` lower, as recorded, and `SHIFT` higher: by the last digit of its height a
    foot touches the floor or not.
    """

    def step(state: PhysicsState, target: jax.Array) -> PhysicsState:
        return ENGINES[env.engine].step(env.model, env.stepping, state, target)[0]

    is_height = np.arange(19) == 2
    qpos = np.concatenate([qpos - SHIFT * is_height, qpos, qpos + SHIFT * is_height])
    qvel, target = np.tile(qvel, (3, 1)), np.tile(target, (3, 1))
    state = PhysicsState(jnp.asarray(qpos, jnp.float32), jnp.asarray(qvel, jnp.float32))
    after = jax.vmap(step)(state, jnp.asarray(target, jnp.float32))
    return np.hstack([after.qpos, after.qvel]).reshape(3, -1, 37)


def describe_first_difference(stages: list[Stage]) -> str:
    """Return a clause that names the first number beyond its tolerance; "" if there is none.

    The first is that of the earliest step, and there of the earliest stage.
    """
    first = None
    for stage in stages:
        steps = np.flatnonzero((stage.excess > 1.0).any(axis=1))
        if len(steps) and (first is None or steps[0] < first[0]):
            first = int(steps[0]), stage
    if first is None:
        return ""
    step, stage = first
    number = int(np.argmax(stage.excess[step]))
    return (
        f"the first difference is in step {step}, {stage.name}, {stage.labels[number]}: "
        f"{stage.recorded[step, number]:.6g}; expected {stage.expected[step, number]:.6g}"
    )
