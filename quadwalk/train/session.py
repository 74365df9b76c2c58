"""A training from start to end: set up, iterate, keep what is learnt, show how it goes."""

import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from quadwalk.errors import UsageError
from quadwalk.files import replacing
from quadwalk.train.config import TrainConfig, to_dict
from quadwalk.train.log import MetricsLog, read_history
from quadwalk.train.metrics import TrainingMetrics
from quadwalk.train.progress import Progress
from quadwalk.train.run import Run, create_run, keep_last, write_json_atomic
from quadwalk.train.versions import versions

KEPT_CHECKPOINTS = 3
CURVE_SECONDS = 30.0  # the learning curve is drawn anew this often


def train(config: TrainConfig) -> Run:
    """Train as `config` says; return the run, whose directory holds everything.

    Ctrl-C ends training after the iteration at hand, with the policy saved.
    """
    with Progress(config.steps, quiet=config.quiet) as progress, _stop_on_signal() as stop:
        progress.phase("loading")
        # Imported here, after the first sign of life: these take seconds.
        from quadwalk.train.devices import set_up_devices

        devices = set_up_devices(config.devices)
        from quadwalk.env.quadruped import QuadrupedEnv
        from quadwalk.robot.quadruped import load_quadruped
        from quadwalk.train import checkpoint, ppo
        from quadwalk.train.networks import make_networks
        from quadwalk.train.policy import save_policy

        quadruped = load_quadruped(config.robot.urdf)
        _check_split(config, devices)
        env = QuadrupedEnv(quadruped, config.env)
        networks = make_networks(config.ppo, env.observation_size, env.action_size)
        run = create_run(config.runs, config.name, label=config.preset)
        # The run keeps its own copy: what it learnt stays true to it when the original changes.
        with replacing(run.urdf) as file:
            file.write(quadruped.urdf.encode())
        write_json_atomic(run.config, {"config": to_dict(config), "versions": versions()})
        progress.message(
            f"{quadruped.name}: {config.envs} environments on {devices} devices, into {run.path}"
        )

        def save(state: Any, steps: int) -> None:
            metadata = {"kind": "checkpoint", "config": to_dict(config), "steps": steps}
            checkpoint.save(run.checkpoint(steps), state, metadata)
            keep_last(run, KEPT_CHECKPOINTS)
            save_policy(run.policy, state.learner, config, quadruped.joints, steps)

        progress.phase("compiling the reset", 5.0)
        mesh = ppo.make_mesh()
        state = ppo.init_state(env, networks, config.ppo, mesh, config.envs, config.seed)
        progress.phase("compiling the training step", 25.0)
        iterate = ppo.make_iteration(env, networks, config.ppo, mesh).lower(state).compile()

        progress.phase("training")
        batch = config.envs * config.ppo.unroll
        steps, saved = 0, 0
        began = time.monotonic()
        drawn = began
        metrics = TrainingMetrics(config.env.reward)
        with MetricsLog(run) as log:
            while steps < config.steps and not stop.is_set():
                state, numbers = iterate(state)
                steps += batch
                row = metrics.row(steps, numbers)
                elapsed = time.monotonic() - began
                log.append(row, {"time/elapsed": elapsed, "time/steps_per_second": steps / elapsed})
                progress.update(steps, row, elapsed)
                if steps - saved >= config.checkpoint_steps:
                    save(state, steps)
                    saved = steps
                if time.monotonic() - drawn > CURVE_SECONDS:
                    _draw_curve(run)
                    drawn = time.monotonic()
        progress.phase("saving")
        save(state, steps)
        _draw_curve(run)
    if stop.is_set():
        progress.end(f"stopped after {steps:,} of {config.steps:,} steps; the policy is saved")
    progress.end(f"policy          {run.policy}")
    progress.end(f"learning curve  {run.learning_curve}")
    progress.end(f"evaluate with   python eval.py {_run_argument(run)}")
    return run


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
