"""What must be ready before a training can iterate."""

import math
from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
from optax.tree_utils import tree_get, tree_set

from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UserError
from quadwalk.files import (
    DAMAGE,
    atomic_write,
    format_json,
    read_bytes,
    real_path,
    remove_on_error,
    write_json,
)
from quadwalk.learn import distributed
from quadwalk.learn.devices import choose_devices
from quadwalk.learn.iteration import (
    Iteration,
    TrainState,
    init_state,
    make_mesh,
    placed_like,
)
from quadwalk.learn.networks import Networks, networks_for
from quadwalk.learn.ppo import RATE
from quadwalk.learn.warm_start import begun_from
from quadwalk.progress.display import Progress
from quadwalk.progress.metrics import TrainingMetrics
from quadwalk.robot.load import hash_robot, load_robot
from quadwalk.robot.quadruped import Quadruped
from quadwalk.runs import checkpoint, directory
from quadwalk.runs.directory import Run
from quadwalk.runs.resume import (
    ROBOT_HASH,
    compare_robot,
    describe_training,
    list_changes,
    read_config,
)
from quadwalk.settings.serialize import task_source, to_dict
from quadwalk.settings.training import DistributedConfig, TrainConfig, with_files
from quadwalk.task_files import OWN


@dataclass
class Training:
    config: TrainConfig  # with the numbers of devices and environments filled in
    run: Run | None  # None in all processes but the first
    resumed: bool
    quadruped: Quadruped
    networks: Networks
    metrics: TrainingMetrics
    state: TrainState
    steps: int  # control steps behind it
    seconds: float  # of training behind it
    batch: int  # control steps in an iteration
    iterate: Callable[[TrainState], tuple[TrainState, dict[str, Any]]]


def prepare(
    config: TrainConfig, previous: Run | None, progress: Progress, stack: ExitStack
) -> Training:
    """Prepare everything up to the compiled iteration, in every process; raises `UserError`.

    The run is this training's until `stack` is closed.
    """
    robot = config.robot
    config = with_files(config, robot.urdf, robot.mesh_dirs, config.env.ground.file)
    config, devices = choose_devices(config)
    assert config.envs is not None
    quadruped = load_robot(config.robot)
    for note in quadruped.notes:
        progress.message(note)
    _check_processes(config, quadruped)
    env = QuadrupedEnv(quadruped, config.env)
    if env.gains_note:
        progress.message(env.gains_note)
    networks = networks_for(env, config.ppo, progress.message)
    mesh = make_mesh(devices)
    state = init_state(env, networks, config.ppo, mesh, config.envs, config.seed)
    batch = config.envs * config.ppo.unroll
    # One that was stopped before its first checkpoint begins once more, as it did.
    if config.init is not None and (previous is None or not directory.list_checkpoints(previous)):
        source = directory.find_any_run(config.runs, config.init)
        config = replace(config, init=str(real_path(source.path)))
        learner, notes = begun_from(source, config, env, networks, jax.device_get(state.learner))
        state = state._replace(learner=placed_like(learner, state.learner))
        progress.message(f"begins with the networks of {source.path}")
        for note in notes:
            progress.message(note)
    iterate = Iteration(env, networks, config.ppo, mesh, iterations=math.ceil(config.steps / batch))
    iterate.trace(state)  # before there is a run: a task whose functions fail leaves none
    main = config.distributed.process == 0
    run = distributed.together(
        lambda: _open_run(config, previous, quadruped, progress, stack) if main else None
    )
    progress.message(
        f"{quadruped.name}: {config.envs} environments on {len(devices)} "
        f"{devices[0].platform.upper()} devices, into {run.path if run else 'process 0'}"
    )

    progress.phase("compiling", 25.0)
    metrics = TrainingMetrics(config.env.reward)
    steps, seconds = 0, 0.0
    if previous is not None:
        path = directory.find_latest_checkpoint(
            previous, lambda text: progress.message(f"warning: {text}")
        )
        if path is None:
            progress.message(f"{previous.path} has no checkpoint yet: it starts at its beginning")
        else:
            state, steps, seconds = _restore(path, config, networks, state, metrics)
            progress.message(f"going on from {path}, after {steps:,} steps")
    # A new run that never began leaves its name to the next.
    with remove_on_error(run.path) if run and previous is None else nullcontext():
        iterate.compile()
    return Training(
        config, run, previous is not None, quadruped, networks,
        metrics, state, steps, seconds, batch, iterate,
    )  # fmt: skip


def _restore(
    path: Path,
    config: TrainConfig,
    networks: Networks,
    state: TrainState,
    metrics: TrainingMetrics,
) -> tuple[TrainState, int, float]:
    """The state in checkpoint `path`, placed as `state` is; its control steps and seconds.

    `state` is that of a start with `config`; `metrics` go on counting from there. On another number
    of devices than before, each draws from a random key of its own anew; a learning rate other than
    before is begun with again; all else goes on as it was. Raises `UserError` in one line.
    """
    leaves, metadata = checkpoint.load(path, "checkpoint")
    if metadata.get("mirrors") != networks.mirrors:
        raise UserError(
            f"{path} has networks whose observations mirror otherwise: expected the robot and "
            "the terms that it was trained with"
        )
    keys, devices = leaves.get("workers/key"), len(state.workers.key)
    like = state
    if keys is not None and keys.ndim == 2 and len(keys) != devices:
        like = state._replace(workers=state.workers._replace(key=keys))
    saved, _ = checkpoint.load(path, "checkpoint", like=like)
    if like is not state:
        split = jax.device_get(jax.random.split(saved.workers.key[0], devices))
        saved = saved._replace(workers=saved.workers._replace(key=split))
    try:
        metrics.restore(metadata["metrics"])
        steps, seconds = int(metadata["steps"]), float(metadata["seconds"])
        rate = metadata["config"]["ppo"]["learning_rate"]
    except DAMAGE:
        raise UserError(f"{path} does not say where its training was: expected another") from None
    if rate != config.ppo.learning_rate:
        learner, fresh = saved.learner, tree_get(jax.device_get(state.learner.optimizer), RATE)
        begun = tree_set(learner.optimizer, **{RATE: fresh})
        saved = saved._replace(learner=learner._replace(optimizer=begun))
    return placed_like(saved, state), steps, seconds


def _check_processes(config: TrainConfig, quadruped: Quadruped) -> None:
    """All processes must run the same program on the same robot, wherever each has its files."""
    if config.distributed.processes > 1:
        own = DistributedConfig()
        shared = replace(config, distributed=own, runs=TrainConfig.runs, quiet=False)
        if config.init is not None:
            shared = replace(shared, init=Path(config.init).name)
        distributed.check_same(f"{to_dict(shared) | describe_training(config, quadruped)}")


def _open_run(
    config: TrainConfig,
    previous: Run | None,
    quadruped: Quadruped,
    progress: Progress,
    stack: ExitStack,
) -> Run:
    """The run to train, made or resumed, and claimed until `stack` is closed."""
    if previous is None:
        run = new_run(config, quadruped)
        stack.enter_context(directory.claim(run))
        return run
    stack.enter_context(directory.claim(previous))
    changes = list_changes(read_config(previous), config)
    directory.delete_partial_files(previous)
    for line in compare_robot(previous, quadruped):
        progress.message(line)
    write_json(previous.config, _settings(config, quadruped))
    for change in changes:
        progress.message(f"changed {change}")
    heights = config.env.ground.file
    if heights is not None and heights != real_path(previous.locate_heights(heights)):
        copy = read_bytes(heights)
        with atomic_write(previous.locate_heights(heights)) as file:
            file.write(copy)
    return previous


def new_run(config: TrainConfig, quadruped: Quadruped) -> Run:
    """The folder of a run, with copies of its own of all that its training begins with."""
    files = {
        "robot.urdf": quadruped.urdf.encode(),
        "config.json": format_json(_settings(config, quadruped)),
    }
    source, heights = task_source(config), config.env.ground.file
    if source is not None:
        files[OWN] = source
    if heights is not None:
        files[Run(Path()).locate_heights(heights).name] = read_bytes(heights)
    return directory.create_run(config.runs, config.name, label=config.task, files=files)


def _settings(config: TrainConfig, quadruped: Quadruped) -> dict[str, Any]:
    return {
        "config": to_dict(config),
        "versions": directory.get_versions(),
        ROBOT_HASH: hash_robot(quadruped),
    }
