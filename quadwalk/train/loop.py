"""A training from start to end: set up, iterate, keep what is learnt, show how it goes."""

import contextlib
import dataclasses
import math
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

from quadwalk.errors import UsageError
from quadwalk.files import replacing
from quadwalk.train.config import RobotConfig, TrainConfig, to_dict
from quadwalk.train.log import MetricsLog, read_history
from quadwalk.train.metrics import TrainingMetrics
from quadwalk.train.progress import Progress
from quadwalk.train.resume import changed_settings, read_config
from quadwalk.train.run import (
    Run,
    create_run,
    find_run,
    keep_last,
    latest_checkpoint,
    write_json_atomic,
)
from quadwalk.train.versions import versions

KEPT_CHECKPOINTS = 3
CURVE_SECONDS = 30.0  # the learning curve is drawn anew this often


def train(config: TrainConfig) -> Run:
    """Train as `config` says; return the run, whose directory holds everything.

    Ctrl-C, SIGTERM or the time limit end training after the iteration at hand, with everything
    saved; `config.resume` goes on from there.
    """
    started = time.monotonic()
    # Absolute, so that mesh files are found from wherever the run is used.
    folders = tuple(folder.resolve() for folder in config.robot.mesh_dirs)
    robot = RobotConfig(config.robot.urdf.resolve(), folders)
    config = dataclasses.replace(config, robot=robot)
    with Progress(config.steps, quiet=config.quiet) as progress, _stop_on_signal() as stop:
        progress.phase("loading")
        # Imported here, after the first sign of life: these take seconds.
        from quadwalk.train.devices import device_count, set_up_devices

        devices = config.devices or device_count(
            config.envs, config.ppo.minibatches, config.ppo.judges
        )
        set_up_devices(devices)
        from quadwalk.env.quadruped import QuadrupedEnv
        from quadwalk.train import checkpoint, ppo
        from quadwalk.train.networks import make_networks
        from quadwalk.train.policy import save_policy
        from quadwalk.train.robot import load_robot, load_run_robot

        _check_split(config, devices)
        if config.resume is None:
            quadruped = load_robot(config.robot)
        else:
            quadruped = load_run_robot(find_run(config.runs, config.resume), config.robot)
        env = QuadrupedEnv(quadruped, config.env)
        networks = make_networks(config.ppo, env.observation_size, env.action_size)
        run, changes = _open_run(config, quadruped.urdf)
        progress.message(
            f"{quadruped.name}: {config.envs} environments on {devices} devices, into {run.path}"
        )
        for change in changes:
            progress.message(f"changed {change}")

        metrics = TrainingMetrics(config.env.reward)
        steps, seconds = 0, 0.0
        mesh = ppo.make_mesh()
        progress.phase("compiling the reset", 5.0)
        state = ppo.init_state(env, networks, config.ppo, mesh, config.envs, config.seed)
        if config.resume is not None:
            path = latest_checkpoint(run)
            saved_state, metadata = checkpoint.load(path, "checkpoint", like=state)
            state = ppo.placed_like(saved_state, state)
            steps, seconds = metadata["steps"], metadata["seconds"]
            metrics.restore(metadata["metrics"])
            progress.message(f"going on from {path}, after {steps:,} steps")
        progress.phase("compiling the training step", 25.0)
        batch = config.envs * config.ppo.unroll
        program = ppo.make_iteration(
            env, networks, config.ppo, mesh, iterations=math.ceil(config.steps / batch)
        )
        iterate = program.lower(state).compile()

        def save() -> None:
            log.sync()  # a checkpoint counts on the rows before it
            metadata = {
                "kind": "checkpoint",
                "config": to_dict(config),
                "steps": steps,
                "seconds": seconds,
                "metrics": metrics.state(),
            }
            # The policy first: should the disk be full, it is the smaller and the dearer.
            save_policy(run.policy, state.learner, config, quadruped.joints, steps)
            checkpoint.save(run.checkpoint(steps), state, metadata)
            keep_last(run, KEPT_CHECKPOINTS)

        progress.phase("training")
        saved = steps
        began = time.monotonic() - seconds
        drawn = time.monotonic()
        limit = math.inf if config.minutes is None else started + 60.0 * config.minutes
        with MetricsLog(run, resume_at=steps if config.resume is not None else None) as log:
            while steps < config.steps and time.monotonic() < limit and not stop.is_set():
                state, numbers = iterate(state)
                steps += batch
                row = metrics.row(steps, numbers)
                seconds = time.monotonic() - began
                log.append(row, {"time/elapsed": seconds, "time/steps_per_second": steps / seconds})
                progress.update(steps, row, seconds)
                if steps - saved >= config.checkpoint_steps:
                    save()
                    saved = steps
                if time.monotonic() - drawn > CURVE_SECONDS:
                    _draw_curve(run)
                    drawn = time.monotonic()
            progress.phase("saving")
            save()
        _draw_curve(run)
    if steps < config.steps:
        progress.end(f"stopped after {steps:,} of {config.steps:,} steps; the policy is saved")
        progress.end(f"go on with      python train.py --resume {_run_argument(run)}")
    progress.end(f"policy          {run.policy}")
    progress.end(f"learning curve  {run.learning_curve}")
    progress.end(f"evaluate with   python eval.py {_run_argument(run)}")
    return run


def _open_run(config: TrainConfig, urdf: str) -> tuple[Run, list[str]]:
    """The run to train, made or found, and which settings have changed in it."""
    settings = {"config": to_dict(config), "versions": versions()}
    if config.resume is not None:
        run = find_run(config.runs, config.resume)
        changes = changed_settings(read_config(run), config)
        write_json_atomic(run.config, settings)
        return run, changes
    run = create_run(config.runs, config.name, label=config.preset)
    # The run keeps its own copy: what it learnt stays true to it when the original changes.
    with replacing(run.urdf) as file:
        file.write(urdf.encode())
    write_json_atomic(run.config, settings)
    return run, []


def _check_split(config: TrainConfig, devices: int) -> None:
    if config.ppo.judges % devices:
        raise UsageError(
            f"--ppo.judges is {config.ppo.judges}; expected a multiple of {devices}, the devices"
        )
    share = devices * config.ppo.minibatches
    if config.envs % share:
        raise UsageError(
            f"--envs is {config.envs}; expected a multiple of {share} "
            f"({devices} devices times {config.ppo.minibatches} minibatches)"
        )


@contextlib.contextmanager
def _stop_on_signal() -> Iterator[threading.Event]:
    """An event that Ctrl-C or SIGTERM sets; a second Ctrl-C interrupts at once."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _draw_curve(run: Run) -> None:
    from quadwalk.train.curves import plot_learning_curve

    plot_learning_curve(read_history(run), run.learning_curve)


def _run_argument(run: Run) -> str:
    return run.name if run.path.parent == Path("runs") else str(run.path)
