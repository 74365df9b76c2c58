"""Everything that must be ready before a training can iterate."""

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from urllib.parse import unquote

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from optax.tree_utils import tree_get, tree_set

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.numbers import list_numbers
from quadwalk.errors import UserError
from quadwalk.files import DAMAGE, remove_on_error, resolve_path
from quadwalk.learn import distributed
from quadwalk.learn.devices import choose_devices, make_mesh, place_like
from quadwalk.learn.networks import Networks, make_env_networks
from quadwalk.learn.ppo import RATE, Iteration, TrainState, init_state
from quadwalk.learn.warm_start import warm_start_from
from quadwalk.progress.display import Progress
from quadwalk.progress.metrics import TrainingMetrics
from quadwalk.robot.bodies import make_bodies
from quadwalk.robot.load import load_robot
from quadwalk.robot.quadruped import Quadruped
from quadwalk.runs import checkpoint, directory
from quadwalk.runs.changes import (
    STEPS,
    Change,
    apply_change,
    format_changes,
    list_standing,
    read_changes,
    write_changes,
)
from quadwalk.runs.directory import Run
from quadwalk.runs.resume import describe_training, make_run, update_run
from quadwalk.settings.serialize import to_dict
from quadwalk.settings.training import DistributedConfig, TrainConfig, set_files

_METRICS = "workers/envs/metrics/"  # where a checkpoint has a step's metrics


@dataclass
class Training:
    """A training that is ready to iterate."""

    config: TrainConfig  # as it is now, with the numbers of devices and environments filled in
    start: TrainConfig  # as it was before any change at the desk
    quadruped: Quadruped
    env: QuadrupedEnv
    networks: Networks
    iterate: Iteration
    run: Run | None  # None in all processes but the first
    resumed: bool  # whether the run was there before
    metrics: TrainingMetrics  # counts over all iterations
    state: TrainState
    steps: int  # control steps behind `state`
    seconds: float  # of training behind `state`
    batch: int  # control steps in an iteration
    mesh: Mesh
    plan: int  # iterations over which the learner anneals
    changes: list[Change] | None = None  # those of the run's desk.jsonl; None: there is no desk

    def make_iteration(self, env: QuadrupedEnv) -> Iteration:
        """Make the programs of the same training in another environment."""
        return Iteration(env, self.networks, self.config.ppo, self.mesh, self.plan)


Say = Callable[[str], None]


def prepare(
    config: TrainConfig,
    previous: Run | None,
    progress: Progress,
    stack: ExitStack,
    with_desk: bool = False,
) -> Training:
    """Prepare everything up to the compiled iteration, in every process; raises `UserError`.

    The run is this training's until `stack` is closed. Programs have the task's numbers as
    arguments `with_desk`.
    """
    say = progress.say
    robot = config.robot
    config = set_files(config, robot.urdf, robot.mesh_dirs, config.env.ground.file)
    config, devices = choose_devices(config)
    envs = config.envs
    assert envs is not None
    path = None if previous is None else find_checkpoint(previous, say)
    start, changes = config, read_desk(config, previous) if with_desk else None
    program, config = change_settings_until(path, start, changes or [])
    env = make_env(program, say)
    if changes is not None:
        env = set_numbers(env, program, config)
    networks = make_env_networks(env, config.ppo, say)
    mesh = make_mesh(devices)
    state = init_state(env, networks, config.ppo, mesh, envs, config.seed)
    # A run that was stopped before its first checkpoint starts once more, as it did.
    if config.init is not None and path is None:
        init, state = init_from_run(config, env, networks, state, say)
        config, start = replace(config, init=init), replace(start, init=init)
    batch = envs * config.ppo.unroll
    plan = math.ceil(start.steps / batch)
    iterate = Iteration(env, networks, config.ppo, mesh, plan)
    iterate.trace(state)  # before there is a run: a task whose functions fail leaves none
    main = config.distributed.process == 0
    run = distributed.run_together(
        lambda: open_run(start, previous, env.quadruped, changes, say, stack) if main else None
    )
    say(
        f"{env.quadruped.name}: {envs} environments on {len(devices)} "
        f"{devices[0].platform.upper()} devices, into {run.path if run else 'process 0'}"
    )
    progress.show_phase("compiling", 25.0)
    training = Training(
        config=config,
        start=start,
        quadruped=env.quadruped,
        env=env,
        networks=networks,
        iterate=iterate,
        run=run,
        resumed=previous is not None,
        metrics=TrainingMetrics(config.env.reward),
        state=state,
        steps=0,
        seconds=0.0,
        batch=batch,
        mesh=mesh,
        plan=plan,
        changes=changes,
    )
    if path is not None:
        restore(training, path)
        say(f"going on from {path}, after {training.steps:,} steps")
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
    bodies = make_bodies(config.env.bodies.number, config.env.bodies.seed)
    env = QuadrupedEnv(quadruped, config.env, bodies=bodies)
    if bodies:
        say(f"{len(bodies)} bodies, of seed {config.env.bodies.seed}")
    if env.gains_note:
        say(env.gains_note)
    return env


def init_from_run(
    config: TrainConfig, env: QuadrupedEnv, networks: Networks, state: TrainState, say: Say
) -> tuple[str, TrainState]:
    """Return the whole path of the `init` of `config`, and `state` with that run's networks."""
    assert config.init is not None
    source = directory.find_any_run(config.runs, config.init)
    config = replace(config, init=str(resolve_path(source.path)))
    learner, notes = warm_start_from(source, config, env, networks, jax.device_get(state.learner))
    for note in (f"begins with the networks of {source.path}", *notes):
        say(note)
    assert config.init is not None
    return config.init, state._replace(learner=place_like(learner, state.learner))


def read_desk(config: TrainConfig, previous: Run | None) -> list[Change]:
    """Return the changes at the desk of the run to resume or to replay; none of a new run."""
    if config.distributed.processes > 1:
        raise UserError("--desk is for one process; expected no --distributed.processes")
    if previous is not None:
        return read_changes(previous) if previous.desk.exists() else []
    if config.replay is None:
        return []
    return list_standing(read_changes(directory.find_run(config.runs, config.replay)))


def change_settings_until(
    path: Path | None, start: TrainConfig, changes: list[Change]
) -> tuple[TrainConfig, TrainConfig]:
    """Return settings as programs are made for, and as they are at a checkpoint.

    The first has the numbers of the `start` and the terms that were added. So what numbers decide
    on in a program stays what it was.
    """
    steps = 0 if path is None else directory.get_checkpoint_steps(path)
    program = present = start
    for change in list_standing(changes):
        if change.steps <= steps or change.name == STEPS:
            present = apply_change(present, change)
            program = apply_change(program, change) if change.adds_term else program
    return program, present


def set_numbers(env: QuadrupedEnv, program: TrainConfig, present: TrainConfig) -> QuadrupedEnv:
    """Return `env` with the numbers of `present`, those that programs have as arguments."""
    return env.set_numbers(present.env, [number.name for number in list_numbers(program.env)])


def find_checkpoint(previous: Run, say: Say) -> Path | None:
    """Return the newest checkpoint of a run to resume; None where there is none yet."""
    path = directory.find_latest_checkpoint(previous, lambda text: say(f"warning: {text}"))
    if path is None:
        say(f"{previous.path} has no checkpoint yet: it starts at its beginning")
    return path


def open_run(
    config: TrainConfig,
    previous: Run | None,
    quadruped: Quadruped,
    changes: list[Change] | None,
    say: Say,
    stack: ExitStack,
) -> Run:
    """Make the run to train, or update `previous`; it is claimed until `stack` is closed."""
    content = None if changes is None else format_changes(changes)
    run = previous or make_run(config, quadruped, content)
    stack.enter_context(directory.claim(run))
    if previous is not None:
        for note in update_run(previous, config, quadruped):
            say(note)
        if changes is not None and not run.desk.exists():
            write_changes(run, changes)
    return run


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
    state = like = match_metrics(state, list_metrics(leaves))
    if keys is not None and keys.ndim == 2 and len(keys) != devices:
        like = state._replace(workers=state.workers._replace(key=keys))
    saved, _ = checkpoint.load(path, "checkpoint", like=like)
    if like is not state:
        split = jax.device_get(jax.random.split(saved.workers.key[0], devices))
        saved = saved._replace(workers=saved.workers._replace(key=split))
    training.metrics = TrainingMetrics(training.config.env.reward)
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
    metrics = training.state.workers.envs.metrics
    training.state = match_metrics(place_like(saved, state), metrics)


def list_metrics(leaves: Mapping[str, np.ndarray]) -> list[str]:
    """Return the names of a step's metrics in the arrays of a checkpoint."""
    return [unquote(name.removeprefix(_METRICS)) for name in leaves if name.startswith(_METRICS)]


def match_metrics(state: TrainState, names: Iterable[str]) -> TrainState:
    """Return `state` with metrics of these names, 0 where it had none: the next step has them.

    A checkpoint from before a term was added has no metric of the term.
    """
    envs = state.workers.envs
    zeros = partial(jnp.zeros_like, envs.reward, device=envs.reward.sharding)
    metrics = {name: envs.metrics[name] if name in envs.metrics else zeros() for name in names}
    return state._replace(workers=state.workers._replace(envs=envs.replace(metrics=metrics)))
