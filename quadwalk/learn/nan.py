"""Steps that gave numbers that are not finite, or speeds that no robot has: saved, and replayed.

    quadwalk nan runs/NAME/nan/step_000000123456.npz

steps the physics again from the saved state, under its conditions, and prints what comes out.
A file holds the `EnvState` before the control step, its parts named as `before/physics/qpos`, and
the `action` (12,).
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from quadwalk.cli.arguments import parse
from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UserError
from quadwalk.files import get_os_reason
from quadwalk.physics.engines import ENGINES
from quadwalk.robot.bodies import make_bodies
from quadwalk.robot.load import load_robot
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run
from quadwalk.runs.resume import restore_config
from quadwalk.settings.serialize import to_dict
from quadwalk.settings.training import TrainConfig

KEPT = 20  # files of a run: enough to see what they have in common


def keep(run: Run, before: Any, action: Any, config: TrainConfig, steps: int) -> Path | None:
    """Save the step from `before` with `action` in the run, and return the file.

    `steps` of training were done by then. Returns None if the run has enough of them.
    """
    try:
        run.nan.mkdir(exist_ok=True)
        if sum(1 for _ in run.nan.glob("*.npz")) >= KEPT:
            return None
    except OSError as error:
        raise UserError(f"cannot write {run.nan}: {get_os_reason(error)}") from error
    path = run.nan / f"step_{steps:012d}.npz"
    metadata = {"kind": "nan", "config": to_dict(config), "steps": steps}
    checkpoint.save(path, {"before": before, "action": action}, metadata)
    return path


def replay(path: Path | str) -> tuple[np.ndarray, np.ndarray]:
    """Repeat the step that `keep` saved in `path`, in a run's folder.

    Returns qpos (n + 1, 19) and qvel (n + 1, 18): before, and after each of the control step's n
    physics steps. Raises `UserError` for a file that cannot be used.
    """
    path = Path(path)
    _, metadata = checkpoint.load(path, "nan")
    run = Run(path.parent.parent)
    try:
        config = restore_config(metadata["config"], run, str(path))
        bodies = make_bodies(config.env.bodies.number, config.env.bodies.seed)
        env = QuadrupedEnv(load_robot(config.robot), config.env, bodies=bodies)
    except (KeyError, ValueError, UserError) as error:
        raise UserError(f"{path} holds a step that cannot be used: {error}") from None
    start = jax.eval_shape(env.reset, jax.random.PRNGKey(0)).pipeline_state
    like = {"before": start, "action": jax.ShapeDtypeStruct((env.action_size,), np.float32)}
    saved, _ = checkpoint.load(path, "nan", like)
    engine, once = ENGINES[env.engine], dataclasses.replace(env.stepping, substeps=1)

    def step_through(env: QuadrupedEnv, before: Any, action: jax.Array) -> Any:
        model, physics, _, target = env.apply_action(before, action)

        def step_once(physics: Any, target: jax.Array) -> Any:
            after, _ = engine.step(model, once, physics, target)
            return after, after

        targets = jnp.broadcast_to(target, (env.stepping.substeps, *target.shape[-1:]))
        return jax.lax.scan(step_once, physics, targets)[1]

    first = saved["before"].physics
    after = jax.jit(step_through)(env, saved["before"], saved["action"])
    return np.stack([first.qpos, *after.qpos]), np.stack([first.qvel, *after.qvel])


@dataclasses.dataclass(frozen=True)
class ReplayConfig:
    """Replay a step of a training that gave no finite numbers."""

    # a file of a run's folder nan
    file: Annotated[Path, tyro.conf.Positional]


def main(args: Sequence[str], prog: str = "quadwalk nan") -> None:
    """Replay the file named on the command line, and print its course."""
    file = parse(ReplayConfig, args, prog).file
    for number, (qpos, qvel) in enumerate(zip(*replay(file), strict=True)):
        finite = np.isfinite(qpos).all() and np.isfinite(qvel).all()
        height = f"height {qpos[2]:.3g} m, fastest velocity {np.abs(qvel).max():.3g}"
        print(f"after {number} physics steps: {height if finite else 'not finite'}")
