"""A training from start to end: set up, iterate, keep what is learned, show how it goes."""

import contextlib
import io
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

from quadwalk.cli.shell import as_typed
from quadwalk.errors import UserError
from quadwalk.learn import distributed
from quadwalk.learn.prepare import Training, prepare
from quadwalk.learn.writer import RunWriter
from quadwalk.progress.display import Progress
from quadwalk.progress.watch import WATCHED, check_watch, watched
from quadwalk.runs.directory import Run
from quadwalk.runs.wandb import check_wandb
from quadwalk.settings.training import TrainConfig

# Training ends where so many states were not finite, and this share of an iteration's.
MANY_DIVERGED = 1000
DIVERGED_SHARE = 0.01


def train(
    config: TrainConfig,
    previous: Run | None = None,
    watch: Callable[[dict[str, float]], object] | None = None,
) -> Run | None:
    """Train as `config` says; return the run, whose directory holds everything.

    With `previous`, a run, it resumes that one, whose settings `read_config_to_resume` gives.
    `watch` is called with each iteration's row of metrics, to show it in another way.

    Once it iterates, Ctrl-C, SIGTERM, SIGHUP or the time limit end training after the iteration at
    hand, with everything saved, to be resumed. A disk that is full does not end it; only if
    the state at the end could not be saved is that a `UserError`. So are weights that are no longer
    finite: nothing is saved then, and what was saved before stays. Of several processes, all but
    the first return None.
    """
    if config.watch:
        check_watch()
    if config.log == "wandb" and config.distributed.process == 0:
        check_wandb()
    limit = math.inf if config.minutes is None else time.monotonic() + 60.0 * config.minutes
    stream = None if config.distributed.process == 0 else io.StringIO()
    with (
        Progress(config.steps, quiet=config.quiet, stream=stream, ends=limit) as progress,
        contextlib.ExitStack() as stack,
    ):
        progress.phase("loading")
        training = prepare(config, previous, progress, stack)
        stop, writer = stack.enter_context(stop_on_signal()), None
        if training.run is not None:
            writer = stack.enter_context(RunWriter(training, training.run, progress.message))
            if config.watch:
                writer.publish(training.state, training.steps)
                stack.enter_context(watched(training.run, progress.message))
        steps, well = _iterate(
            training, writer, progress, lambda: stop.is_set() or time.monotonic() >= limit, watch
        )
        progress.stopped = stop.is_set() and steps < config.steps
    if writer is None:
        return None
    _tell(progress, writer, config, steps, well)
    if not well:
        raise UserError(f"not everything could be saved: {writer.trouble}; {_last(writer)}")
    return writer.run


def _iterate(
    training: Training,
    writer: RunWriter | None,
    progress: Progress,
    over: Callable[[], bool],
    watch: Callable[[dict[str, float]], object] | None,
) -> tuple[int, bool]:
    """Iterate until the steps are done or it is `over`; the steps, and whether all is saved."""
    config, state = training.config, training.state
    steps, seconds = training.steps, training.seconds
    tried = steps  # when it was last tried to save
    shown = steps  # when the policy was last saved for the page

    def save() -> bool:
        progress.phase("saving")
        whole = distributed.gathered(state)
        return writer.save(whole, steps, seconds) if writer else True

    progress.phase("training")
    began = time.monotonic() - seconds
    while steps < config.steps and not distributed.any_process(over()):
        state, numbers = training.iterate(state)
        steps += training.batch
        row = training.metrics.row(steps, numbers)
        seconds = time.monotonic() - began
        progress.update(steps, row)
        if writer:
            writer.iteration(row, numbers["nan_step"], seconds)
        if watch:
            watch(row)
        if not numbers["learner/finite"]:
            if writer:
                writer.draw()
            raise UserError(_lost(writer, steps, row["learning_rate"]))
        many = row["train/nan"] > MANY_DIVERGED
        if many and numbers["count/nan"] > DIVERGED_SHARE * training.batch:
            if writer:
                writer.draw()
            raise UserError(_diverged(training, writer, steps, row["train/nan"]))
        if config.watch and steps - shown >= config.checkpoint_steps // WATCHED:
            whole = distributed.gathered(state)
            if writer:
                writer.publish(whole, steps)
            shown = steps
        if steps - tried >= config.checkpoint_steps and steps < config.steps:
            save()
            tried = steps
            progress.phase("training")
    well = save()
    if writer:
        writer.draw()
    return steps, well


def _tell(
    progress: Progress, writer: RunWriter, config: TrainConfig, steps: int, well: bool
) -> None:
    """Where everything is, and what can be done with it; `well` if all of it was saved."""
    run = writer.run
    if steps < config.steps:
        saved = "; the policy is saved" if well else ""
        progress.end(f"stopped after {steps:,} of {config.steps:,} steps{saved}")
        progress.end(f"resume with     {_typed('train', run, '--resume')}")
    progress.end(f"policy          {run.policy}")
    if writer.best is not None:
        which = "the same" if writer.best[0] == steps else f"after {writer.best[0]:,} steps"
        progress.end(f"best policy     {run.best} ({which})")
    if run.learning_curve.exists():
        progress.end(f"learning curve  {run.learning_curve}")
    progress.end(f"evaluate with   {_typed('eval', run)}")


def _lost(writer: RunWriter | None, steps: int, rate: float) -> str:
    """What to say when the learner's weights are not finite, at that learning rate."""
    what = f"the networks' weights are no longer finite numbers after {steps:,} steps"
    if writer is None:
        return what
    again = (
        f"{_typed('train', writer.run, '--resume')} "
        f"--ppo.max-learning-rate {min(1e-3, rate / 10.0):.0e}"
    )
    return f"{what}; {_last(writer)}; go on from there with smaller changes, such as {again}"


def _diverged(training: Training, writer: RunWriter | None, steps: int, count: float) -> str:
    """Return what to say when `count` states were not finite."""
    config = training.config
    what = (
        f"physics diverged: {count:,.0f} states of {steps:,} were not finite; expected finite "
        f"numbers: try smaller physics steps (--env.physics-dt {config.env.physics_dt / 2:g} "
        f"--env.substeps {2 * config.env.substeps}) or lower gains (--env.motor.kp, --env.motor.kd)"
    )
    return what if writer is None else f"{what}; {_last(writer)}"


def _last(writer: RunWriter) -> str:
    if writer.saved is None:
        return f"{writer.run.path} has no checkpoint yet"
    return f"the last good checkpoint is {writer.run.locate_checkpoint(writer.saved)}"


def _typed(command: str, run: Run, *before: str) -> str:
    return as_typed(command, *before, run.name if run.path.parent == Path("runs") else run.path)


@contextlib.contextmanager
def stop_on_signal() -> Iterator[threading.Event]:
    """An event that Ctrl-C, SIGTERM or a closed terminal sets; a second Ctrl-C interrupts."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    hangup = getattr(signal, "SIGHUP", None)  # Windows has none

    def handle(number: int, frame: FrameType | None) -> None:
        # A shell and the system may both tell that the terminal has closed.
        if stop.is_set() and number != hangup:
            raise KeyboardInterrupt
        stop.set()

    numbers = filter(None, (signal.SIGINT, signal.SIGTERM, hangup))
    before = {
        number: signal.signal(number, handle)
        for number in numbers
        if signal.getsignal(number) != signal.SIG_IGN  # as under nohup
    }
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
