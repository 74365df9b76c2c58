"""A training from start to end: prepare, iterate, save what is learned, show how it goes."""

import contextlib
import io
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import Any

from quadwalk.cli.shell import make_command
from quadwalk.errors import UserError
from quadwalk.learn import distributed
from quadwalk.learn.desk import Desk, OnIteration
from quadwalk.learn.prepare import Training, prepare
from quadwalk.learn.writer import RunWriter
from quadwalk.progress.display import Progress
from quadwalk.progress.watch import WATCHED, check_watch, show_page
from quadwalk.runs.directory import Run
from quadwalk.runs.wandb import check_wandb
from quadwalk.settings.training import TrainConfig

# Training ends where so many states were not finite, and this share of an iteration's.
MANY_DIVERGED = 1000
DIVERGED_SHARE = 0.01

Watch = Callable[[dict[str, float]], object]


class NullWriter:
    """The writer of the processes that write nothing, all but the first."""

    def log_iteration(self, row: dict[str, float], nan_step: Any, seconds: float) -> None:
        """Write nothing."""

    def draw_curve(self) -> None:
        """Draw nothing."""

    def publish(self, state: Any, steps: int) -> bool:
        """Do nothing in place of `RunWriter.publish`; return True, since nothing failed."""
        return True

    def save(self, state: Any, steps: int, seconds: float) -> bool:
        """Do nothing in place of `RunWriter.save`; return True, since nothing failed."""
        return True


def train(
    config: TrainConfig,
    previous: Run | None = None,
    watch: Watch | None = None,
    on_iteration: OnIteration | None = None,
) -> Run | None:
    """Train as `config` says; return the run, whose directory holds everything.

    With `previous` it resumes that run, whose settings `read_config_to_resume` gives.
    `watch` is called with each iteration's row of metrics, to show it in another way. So is
    `on_iteration` with a `DeskIteration`; what it returns are numbers to change before the next.

    Once it iterates, Ctrl-C, SIGTERM, SIGHUP or the time limit end training after the current
    iteration. Everything is saved then, and the run can be resumed. A full disk does not end it;
    that is a `UserError` only if the state at the end could not be saved. Weights that are no
    longer finite are one too: nothing is saved then, and what was saved before stays. Of several
    processes, all but the first return None.
    """
    is_main = config.distributed.process == 0
    with_page = config.watch or config.desk
    with_desk = config.desk or config.replay is not None or on_iteration is not None
    with_desk |= previous is not None and previous.desk.exists()
    if with_page:
        check_watch()
    if config.log == "wandb" and is_main:
        check_wandb()
    deadline = math.inf if config.minutes is None else time.monotonic() + 60.0 * config.minutes
    stream = None if is_main else io.StringIO()
    with contextlib.ExitStack() as stack:
        progress = stack.enter_context(Progress(config.steps, config.quiet, stream, deadline))
        progress.show_phase("loading")
        training = prepare(config, previous, progress, stack, with_desk)
        stop = stack.enter_context(stop_on_signal())
        writer: RunWriter | NullWriter = NullWriter()
        desk = None
        if training.run is not None:
            writer = stack.enter_context(RunWriter(training, training.run, progress.say))
            page = None
            if with_page:
                writer.publish(training.state, training.steps)
                page = stack.enter_context(show_page(training.run.path, progress.say))
            if with_desk:
                desk = Desk(training, writer, progress, stop, page, on_iteration)
        saved = iterate(
            training,
            writer,
            progress,
            lambda: stop.is_set() or time.monotonic() >= deadline,
            watch,
            desk,
        )
        progress.stopped = stop.is_set() and training.steps < training.config.steps
    if isinstance(writer, NullWriter):
        return None
    print_result(progress, training, writer, saved)
    if not saved:
        last = describe_last_checkpoint(writer)
        raise UserError(f"not everything could be saved: {writer.trouble}; {last}")
    return writer.run


def iterate(
    training: Training,
    writer: RunWriter | NullWriter,
    progress: Progress,
    is_over: Callable[[], bool],
    watch: Watch | None,
    desk: Desk | None = None,
) -> bool:
    """Iterate until the steps are done or it `is_over`; return True if everything is saved."""
    config = training.config
    saved_steps = published_steps = training.steps
    start = time.monotonic() - training.seconds
    if desk is not None:
        start += desk.update(is_over)
    progress.show_phase("training")
    while training.steps < training.config.steps and not distributed.is_true_anywhere(is_over()):
        training.state, numbers = training.iterate(training.state)
        training.steps += training.batch
        row = training.metrics.make_row(training.steps, numbers)
        training.seconds = time.monotonic() - start
        progress.update(training.steps, row)
        writer.log_iteration(row, numbers["nan_step"], training.seconds)
        if watch is not None:
            watch(row)
        try:
            check_finite(training, writer, numbers, row)
        except UserError as error:
            if desk is None or not desk.take_back(error):
                raise
            continue
        with_page = config.watch or config.desk
        if with_page and training.steps - published_steps >= config.checkpoint_steps // WATCHED:
            writer.publish(distributed.gather(training.state), training.steps)
            published_steps = training.steps
        if (
            training.steps - saved_steps >= config.checkpoint_steps
            and training.steps < training.config.steps
        ):
            save(training, writer, progress)
            saved_steps = training.steps
            progress.show_phase("training")
        if desk is not None:
            desk.report(row)
            start += desk.update(is_over)
            progress.show_phase("training")
            # An undo goes back.
            saved_steps = min(saved_steps, training.steps)
            published_steps = min(published_steps, training.steps)
    if desk is not None:
        desk.end()
    saved = save(training, writer, progress)
    writer.draw_curve()
    return saved


def save(training: Training, writer: RunWriter | NullWriter, progress: Progress) -> bool:
    """Save policy and checkpoint; return True if both were saved."""
    progress.show_phase("saving")
    return writer.save(distributed.gather(training.state), training.steps, training.seconds)


def check_finite(
    training: Training,
    writer: RunWriter | NullWriter,
    numbers: Mapping[str, Any],
    row: dict[str, float],
) -> None:
    """Raise a `UserError` where the weights, or too many states, are not finite."""
    config, steps, nan = training.config, training.steps, row["train/nan"]
    many = nan > MANY_DIVERGED and numbers["count/nan"] > DIVERGED_SHARE * training.batch
    hint = ""
    if not numbers["learner/finite"]:
        text = f"the networks' weights are no longer finite numbers after {steps:,} steps"
        rate = f"--ppo.max-learning-rate {min(1e-3, row['learning_rate'] / 10.0):.0e}"
        if training.run is not None:
            again = format_command("train", training.run, "--resume")
            hint = f"; go on from there with smaller changes, such as {again} {rate}"
    elif many:
        text = (
            f"physics diverged: {nan:,.0f} states of {steps:,} were not finite; expected finite "
            f"numbers: try smaller physics steps (--env.physics-dt {config.env.physics_dt / 2:g} "
            f"--env.substeps {2 * config.env.substeps}) or lower gains (--env.motor.kp, "
            "--env.motor.kd)"
        )
    else:
        return
    writer.draw_curve()
    if isinstance(writer, RunWriter):
        text += f"; {describe_last_checkpoint(writer)}{hint}"
    raise UserError(text)


def print_result(progress: Progress, training: Training, writer: RunWriter, saved: bool) -> None:
    """Print where everything is, and what can be done with it."""
    run, steps, total = writer.run, training.steps, training.config.steps
    if steps < total:
        note = "; the policy is saved" if saved else ""
        progress.end(f"stopped after {steps:,} of {total:,} steps{note}")
        progress.end(f"resume with     {format_command('train', run, '--resume')}")
    progress.end(f"policy          {run.policy}")
    if writer.best is not None:
        note = "the same" if writer.best[0] == steps else f"after {writer.best[0]:,} steps"
        progress.end(f"best policy     {run.best} ({note})")
    if run.learning_curve.exists():
        progress.end(f"learning curve  {run.learning_curve}")
    progress.end(f"evaluate with   {format_command('eval', run)}")


def describe_last_checkpoint(writer: RunWriter) -> str:
    """Return a clause that names the last checkpoint, or says that there is none yet."""
    if writer.saved is None:
        return f"{writer.run.path} has no checkpoint yet"
    return f"the last good checkpoint is {writer.run.locate_checkpoint(writer.saved)}"


def format_command(command: str, run: Run, *flags: str) -> str:
    """Return the line to type for a command on `run`."""
    name = run.name if run.path.parent == Path("runs") else run.path
    return make_command(command, *flags, name)


@contextlib.contextmanager
def stop_on_signal() -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C, SIGTERM or a closed terminal sets; a second Ctrl-C interrupts."""
    stop = threading.Event()
    hangup = getattr(signal, "SIGHUP", None)  # Windows has none

    def handle(number: int, frame: FrameType | None) -> None:
        # A shell and the system may both tell that the terminal has closed.
        if stop.is_set() and number != hangup:
            raise KeyboardInterrupt
        stop.set()

    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in filter(None, (signal.SIGINT, signal.SIGTERM, hangup)):
            if signal.getsignal(number) != signal.SIG_IGN:  # as under nohup
                before[number] = signal.signal(number, handle)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
