"""Steps that gave numbers that are not finite, or speeds that no robot has: kept, and replayed.

    python -m quadwalk.train.nan runs/NAME/nan/step_000000123456.npz

steps the physics again from the state that was kept, and says what comes out. A file holds `qpos`
(19,), `qvel` (18,), `warmstart` (18,), `last_action` (12,) and `steps` before the control step,
the `action` (12,), and `model`, the MuJoCo model stepped, as the bytes of an MJB file.
"""

import dataclasses
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from quadwalk.errors import UsageError, UserError, run_command
from quadwalk.files import os_reason
from quadwalk.train.runs import checkpoint
from quadwalk.train.runs.directory import Run
from quadwalk.train.serialise import from_dict, to_dict
from quadwalk.train.settings import TrainConfig

KEPT = 20  # files of a run: enough to see what they have in common
_MODEL = "model.mjb"


def keep(
    run: Run, before: Any, action: Any, model: mujoco.MjModel, config: TrainConfig, steps: int
) -> Path | None:
    """Write down a step from the `EnvState` `before` with `action`; None if there are enough.

    `steps` of training, after the iteration that met it, give it its name.
    """
    try:
        run.nan.mkdir(exist_ok=True)
        if sum(1 for _ in run.nan.glob("*.npz")) >= KEPT:
            return None
    except OSError as error:
        raise UserError(f"cannot write {run.nan}: {os_reason(error)}") from error
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    arrays = {
        **before.physics._asdict(),
        "last_action": before.last_action,
        "steps": before.steps,
        "action": action,
        "model": content,
    }
    path = run.nan / f"step_{steps:012d}.npz"
    checkpoint.save(path, arrays, {"kind": "nan", "config": to_dict(config), "steps": steps})
    return path


def replay(path: Path | str) -> tuple[np.ndarray, np.ndarray]:
    """Step again what `keep` wrote to `path`, in a run's folder.

    Returns qpos (n + 1, 19) and qvel (n + 1, 18): before, and after each of the control step's n
    physics steps. Raises `UserError` for a file that cannot be used.
    """
    import jax
    import jax.numpy as jnp

    from quadwalk.physics.engines import ENGINES
    from quadwalk.physics.motor import Physics, make_motor
    from quadwalk.task.robot_arrays import robot_arrays, task_robot
    from quadwalk.train.robot import load_run_robot

    path = Path(path)
    arrays, metadata = checkpoint.load(path, "nan")
    try:
        config = from_dict(TrainConfig, metadata["config"], path.parent.parent)
        model = mujoco.MjModel.from_binary_path(_MODEL, {_MODEL: arrays["model"].tobytes()})
        physics = Physics(*(jnp.asarray(arrays[name]) for name in Physics._fields))
        action = jnp.asarray(arrays["action"])
    except (KeyError, ValueError, UserError) as error:
        raise UserError(f"{path} holds a step that cannot be used: {error}") from None
    env = config.env
    quadruped = task_robot(load_run_robot(Run(path.parent.parent), config.robot), env)
    target = env.action(robot_arrays(quadruped, model), action, physics.qpos[7:])
    # The target holds for the whole control step, so its physics steps can be taken one by one.
    once = dataclasses.replace(env.stepping, substeps=1)
    engine = ENGINES[env.engine]
    motor = make_motor(model, quadruped, env.motor)
    constants = engine.make_model(model, quadruped, motor)
    step = jax.jit(lambda physics: engine.control_step(constants, once, physics, target)[0])
    course = [physics]
    for _ in range(env.substeps):
        course.append(step(course[-1]))
    return np.stack([p.qpos for p in course]), np.stack([p.qvel for p in course])


def main() -> None:
    """Replay the file named on the command line, and print its course."""
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        raise UsageError("expected one argument: a file of a run's nan folder")
    for number, (qpos, qvel) in enumerate(zip(*replay(sys.argv[1]), strict=True)):
        finite = np.isfinite(qpos).all() and np.isfinite(qvel).all()
        height = f"height {qpos[2]:.3g} m, fastest velocity {np.abs(qvel).max():.3g}"
        print(f"after {number} physics steps: {height if finite else 'not finite'}")


if __name__ == "__main__":
    run_command(main)
