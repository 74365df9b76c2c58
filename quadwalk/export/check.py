"""Whether an export does in each step what its policy does here, and where it differs first."""

import io
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import onnx
from rich.console import Console

from quadwalk.env.command import Command
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.state import EnvState
from quadwalk.errors import UserError
from quadwalk.evaluation.loaded import LoadedRun
from quadwalk.export.controller import read_list
from quadwalk.export.description import describe
from quadwalk.export.joint_targets import find_targets
from quadwalk.export.policy_graph import input_labels, input_order
from quadwalk.files import read_bytes
from quadwalk.physics.engines import ENGINES
from quadwalk.physics.motor import PhysicsState
from quadwalk.settings.registry import to_current_name

SECONDS = 2.0  # of a replay
COMMAND = (0.5, 0.2, 0.3)  # m/s ahead and left, rad/s: no two are alike
# Of an observation, an action, rad of a target; of a state after a step, whose robot.xml has six
# digits: m and rad, then m/s and rad/s.
EXACT, PLACE, RATE = 1e-4, 1e-4, 0.01
HAIR = 1e-6  # m
# What differs where a policy was not changed.
_ORIGIN = ("run_path", "quadwalk_version")
_TRUNK = ("x", "y", "z", "qw", "qx", "qy", "qz")
_RATES = ("vx", "vy", "vz", "roll_rate", "pitch_rate", "yaw_rate")


@dataclass(frozen=True)
class Stage:
    """One kind of number in all control steps: as recorded, and as the environment has it."""

    name: str
    labels: list[str]  # n
    found: np.ndarray  # (T, n)
    expected: np.ndarray  # (T, n)
    tolerance: np.ndarray  # (n,)

    @property
    def excess(self) -> np.ndarray:
        """(T, n) how many times the tolerance they differ; infinite where not finite."""
        excess: np.ndarray = np.nan_to_num(
            np.abs(self.found - self.expected) / self.tolerance, nan=np.inf
        )
        return excess


def check_export(loaded: LoadedRun, folder: Path, recording: Path | None, console: Console) -> None:
    """Compare the export in `folder` with the policy and environment of `loaded`.

    Its run_policy.py is run, or, where another runtime wrote a `recording`, that is compared, but
    for its physics. Raises `UserError` that names the first difference.
    """
    wrong = list(differing_entries(loaded, folder / "policy.onnx"))
    path = recording or folder / "run_policy.py"
    columns = read_recording(recording, loaded) if recording else replay(folder, loaded)
    found = stages(loaded, columns)
    if recording is not None:
        found = [stage for stage in found if stage.name != "physics"]
    first = first_difference(found)
    for stage in found:
        most = float(np.max(np.abs(stage.found - stage.expected)))
        console.print(f"{stage.name}: at most {most:.1e} off in {len(stage.found)} steps")
    if first or wrong:
        raise UserError(f"{path}: {'; '.join(filter(None, [first, *wrong]))}")


def differing_entries(loaded: LoadedRun, file: Path) -> Iterator[str]:
    """A clause for each entry of the metadata that is not what an export would write now."""
    model = onnx.load(file)
    found = {entry.key: entry.value for entry in model.metadata_props}
    expected = describe(loaded, find_targets(loaded.env.config.action, loaded.env.robot))
    for name, value in expected.items():
        mine, theirs = (_to_words(text) for text in (found.get(name, "missing"), value))
        if name not in _ORIGIN and mine != theirs:
            pairs = list(zip(mine, theirs, strict=False))
            at = next((i for i, (a, b) in enumerate(pairs) if a != b), 0)
            yield f"its {name} is {mine[at]} at number {at}; expected {theirs[at]}"


def _to_words(text: str) -> list[str]:
    """Return the parts of an entry of the metadata, the same for exports of all versions."""
    parts = read_list(text)
    return [to_current_name(part) if isinstance(part, str) else f"{part:.9g}" for part in parts]


def replay(folder: Path, loaded: LoadedRun) -> dict[str, np.ndarray]:
    """What the export's run_policy.py does, in a process of its own."""
    with tempfile.TemporaryDirectory() as made:
        saved = Path(made) / "replay.npz"
        command = [sys.executable, str(folder / "run_policy.py"), f"--seconds={SECONDS}"]
        command += ["--save", str(saved), "--command", *map(str, COMMAND)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            reason = (done.stderr.strip().splitlines() or ["no word"])[-1]
            raise UserError(f"{folder / 'run_policy.py'} failed: {reason.removeprefix('error: ')}")
        return read_recording(saved, loaded)


def read_recording(file: Path, loaded: LoadedRun) -> dict[str, np.ndarray]:
    """The columns (T, n) of a file as run_policy.py --save writes it."""
    sizes = {"qpos": 19, "qvel": 18, "obs": loaded.env.policy_size, "action": 12, "target": 12}
    sizes |= {"command": 3}
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


def stages(loaded: LoadedRun, columns: dict[str, np.ndarray]) -> list[Stage]:
    """Each stage of the recorded steps, beside what the environment makes of the stage before it.

    So a difference shows where it arises, and nowhere after.
    """
    env, names = loaded.env, ("qpos", "qvel", "obs", "action", "target")
    qpos, qvel, obs, action, target = (columns[name] for name in names)
    joints, order = list(env.quadruped.joints), input_order(env)
    seen = np.empty_like(obs)
    seen[:, order] = observed(env, columns)
    acts = loaded.policy.act(jnp.asarray(obs[:, order], jnp.float32))
    aims = jax.vmap(lambda a, q: env.config.action(env.robot, a, q))(
        jnp.asarray(action, jnp.float32), jnp.asarray(qpos[:, 7:], jnp.float32)
    )
    places, reached = np.r_[np.full(19, PLACE), np.full(18, RATE)], np.hstack([qpos, qvel])[1:]
    candidates = stepped(env, qpos[:-1], qvel[:-1], target[:-1])
    worst = np.max(np.abs(candidates - reached) / places, axis=2)
    after = candidates[worst.argmin(axis=0), np.arange(len(reached))]
    state = [*_TRUNK, *joints, *_RATES, *(f"rate of {joint}" for joint in joints)]
    exact = np.full(12, EXACT)
    return [
        Stage("observation", input_labels(env), obs, seen, np.full(obs.shape[1], EXACT)),
        Stage("action", joints, action, np.asarray(acts), exact),
        Stage("target", joints, target, np.asarray(aims), exact),
        Stage("physics", state, reached, after, places),
    ]


def observed(env: QuadrupedEnv, columns: dict[str, np.ndarray]) -> np.ndarray:
    """(T, n) what the environment observes in the recorded states, in its own order."""
    names = ("qpos", "qvel", "action", "command")
    rows = {name: jnp.asarray(columns[name], jnp.float32) for name in names}
    sensors, given = env.sensors, env.config.command.given

    def at(row: dict[str, jax.Array], last: jax.Array, steps: jax.Array) -> EnvState:
        command = Command(row["command"], jax.random.PRNGKey(0)) if given else None
        physics = PhysicsState(row["qpos"], row["qvel"])
        return EnvState(physics, last, steps, command)

    def step(
        before: EnvState, moved: tuple[jax.Array, dict[str, jax.Array]]
    ) -> tuple[EnvState, jax.Array]:
        after = at(moved[1], moved[0], before.steps + 1)._replace(
            frames=before.frames, contact=before.contact
        )
        after = sensors.measured(after)
        return after, sensors.observation(after)

    @jax.jit
    def scanned(rows: dict[str, jax.Array]) -> jax.Array:
        first, others = ({k: v[part] for k, v in rows.items()} for part in (0, slice(1, None)))
        start = sensors.started(at(first, jnp.zeros(12), jnp.zeros((), jnp.int32)))
        _, seen = jax.lax.scan(step, start, (rows["action"][:-1], others))
        return jnp.concatenate([sensors.observation(start)[None], seen])

    return np.asarray(scanned(rows))[:, : env.policy_size]


def stepped(
    env: QuadrupedEnv, qpos: np.ndarray, qvel: np.ndarray, target: np.ndarray
) -> np.ndarray:
    """(3, T, 37) qpos and qvel after a control step from each state with each target."""
    # Also from a `HAIR` higher and lower: a foot may touch the floor in the last digit.

    def step(state: PhysicsState, target: jax.Array) -> PhysicsState:
        return ENGINES[env.engine].control_step(env.model, env.stepping, state, target)[0]

    shift = HAIR * np.arange(-1, 2)[:, None, None] * (np.arange(19) == 2)
    rows = (np.concatenate(qpos + shift), *(np.tile(x, (3, 1)) for x in (qvel, target)))
    *state, aims = (jnp.asarray(x, jnp.float32) for x in rows)
    after = jax.vmap(step)(PhysicsState(*state), aims)
    return np.hstack([after.qpos, after.qvel]).reshape(3, len(qpos), 37)


def first_difference(found: list[Stage]) -> str:
    """A clause that names the first number that is off, step by step and stage by stage; or ""."""
    off = [np.flatnonzero((stage.excess > 1.0).any(axis=1)) for stage in found]
    places = [(int(steps[0]), which) for which, steps in enumerate(off) if len(steps)]
    if not places:
        return ""
    step, which = min(places)
    stage = found[which]
    number = int(np.argmax(stage.excess[step]))
    return (
        f"the first difference is in step {step}, {stage.name}, {stage.labels[number]}: "
        f"{stage.found[step, number]:.6g}; expected {stage.expected[step, number]:.6g}"
    )
