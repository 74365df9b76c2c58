"""Everything that must be ready before a training can iterate."""

import math
from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import jax
from optax.tree_utils import tree_get, tree_set

from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UserError
from quadwalk.files import DAMAGE, remove_on_error, resolve_path
from quadwalk.learn import distributed
from quadwalk.learn.devices import choose_devices, make_mesh, place_like
from quadwalk.learn.networks import Networks, make_env_networks
from quadwalk.learn.ppo import RATE, Iteration, TrainState, init_state
from quadwalk.learn.warm_start import warm_start_from
from quadwalk.progress.display import Progress
from quadwalk.progress.metrics import TrainingMetrics
from quadwalk.robot.load import load_robot
from quadwalk.robot.quadruped import Quadruped
from quadwalk.runs import checkpoint, directory
from quadwalk.runs.directory import Run
from quadwalk.runs.resume import describe_training, make_run, update_run
from quadwalk.settings.serialize import to_dict
from quadwalk.settings.training import DistributedConfig, TrainConfig, set_files


@dataclass
class Training:
    """A training that is ready to iterate."""

    config: TrainConfig  # with the numbers of devices and environments filled in
    quadruped: Quadruped
    networks: Networks
    iterate: Iteration
    run: Run | None  # None in all processes but the first
    resumed: bool  # whether the run was there before
    metrics: TrainingMetrics  # counts over all iterations
    state: TrainState
    steps: int  # control steps behind `state`
    seconds: float  # of training behind `state`
    batch: int  # control steps in an iteration


Say = Callable[[str], None]


def prepare(
    config: TrainConfig, previous: Run | None, progress: Progress, stack: ExitStack
) -> Training:
    """Prepare everything up to the compiled iteration, in every process; raises `UserError`.

    The run is this training's until `stack` is closed.
    """
    say = progress.say
    robot = config.robot
    config = set_files(config, robot.urdf, robot.mesh_dirs, config.env.ground.file)
    config, devices = choose_devices(config)
    envs = config.envs
    assert envs is not None
    env = make_env(config, say)
    networks = make_env_networks(env, config.ppo, say)
    mesh = make_mesh(devices)
    state = init_state(env, networks, config.ppo, mesh, envs, config.seed)
    # A run that was stopped before its first checkpoint starts once more, as it did.
    if config.init is not None and (previous is None or not directory.list_checkpoints(previous)):
        config, state = init_from_run(config, env, networks, state, say)
    batch = envs * config.ppo.unroll
    iterate = Iteration(env, networks, config.ppo, mesh, math.ceil(config.steps / batch))
    iterate.trace(state)  # before there is a run: a task whose functions fail leaves none
    main = config.distributed.process == 0
    run = distributed.run_together(
        lambda: open_run(config, previous, env.quadruped, say, stack) if main else None
    )
    say(
        f"{env.quadruped.name}: {envs} environments on {len(devices)} "
        f"{devices[0].platform.upper()} devices, into {run.path if run else 'process 0'}"
    )
    progress.show_phase("compiling", 25.0)
    training = Training(
        config=config,
        quadruped=env.quadruped,
        networks=networks,
        iterate=iterate,
        run=run,
        resumed=previous is not None,
        metrics=TrainingMetrics(config.env.reward),
        state=state,
        steps=0,
        seconds=0.0,
        batch=batch,
    )
    if previous is not None:
        resume(training, previous, say)
    # A new run that never began leaves its name to the next.
    with remove_on_error(run.path) if run and previous is None else nullcontext():
        iterate.compile()
    return training


def make_env(config: TrainConfig, say: Say) -> QuadrupedEnv:
    """Make the environment, after a check that all processes make the same."""
    quadruped = load_robot(config.robot)
    for note in quadruped.notes:
        say(note)
    if config.distributed.processes > 1:
        shared = replace(
            config, distributed=DistributedConfig(), runs=TrainConfig.runs, quiet=False
        )
        if config.init is not None:
            shared = replace(shared, init=Path(config.init).name)
        distributed.check_same(f"{to_dict(shared) | describe_training(config, quadruped)}")
    env = QuadrupedEnv(quadruped, config.env)
    if env.gains_note:
        say(env.gains_note)
    return env


def init_from_run(
    config: TrainConfig, env: QuadrupedEnv, networks: Networks, state: TrainState, say: Say
) -> tuple[TrainConfig, TrainState]:
    """Return `config` with the whole path of its `init`, and `state` with that run's networks."""
    assert config.init is not None
    source = directory.find_any_run(config.runs, config.init)
    config = replace(config, init=str(resolve_path(source.path)))
    learner, notes = warm_start_from(source, config, env, networks, jax.device_get(state.learner))
    for note in (f"begins with the networks of {source.path}", *notes):
        say(note)
    return config, state._replace(learner=place_like(learner, state.learner))


def open_run(
    config: TrainConfig, previous: Run | None, quadruped: Quadruped, say: Say, stack: ExitStack
) -> Run:
    """Make the run to train, or update `previous`; it is claimed until `stack` is closed."""
    run = previous or make_run(config, quadruped)
    stack.enter_context(directory.claim(run))
    if previous is not None:
        for note in update_run(previous, config, quadruped):
            say(note)
    return run


def resume(training: Training, previous: Run, say: Say) -> None:
    """Resume `training` from the newest checkpoint of `previous`, where there is one."""
    path = directory.find_latest_checkpoint(previous, lambda text: say(f"warning: {text}"))
    if path is None:
        say(f"{previous.path} has no checkpoint yet: it starts at its beginning")
        return
    restore(training, path)
    say(f"going on from {path}, after {training.steps:,} steps")


def restore(training: Training, path: Path) -> None:
    """Set the state of `training` to that in the checkpoint `path`; raises `UserError`.

    With another number of devices each device gets a new random key. If the settings have another
    learning rate than the checkpoint's, theirs counts. All else continues as it was.
    """
    state = training.state
    leaves, metadata = checkpoint.load(path, "checkpoint")
    if metadata.get("mirrors") != training.networks.mirrors:
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
        training.metrics.restore(metadata["metrics"])
        training.steps, training.seconds = int(metadata["steps"]), float(metadata["seconds"])
        rate = metadata["config"]["ppo"]["learning_rate"]
    except DAMAGE:
        raise UserError(f"{path} does not say where its training was: expected another") from None
    if rate != training.config.ppo.learning_rate:
        start_rate = tree_get(jax.device_get(state.learner.optimizer), RATE)
        optimizer = tree_set(saved.learner.optimizer, **{RATE: start_rate})
        saved = saved._replace(learner=saved.learner._replace(optimizer=optimizer))
    training.state = place_like(saved, state)
