"""Compute many jobs, wherever that is: the one loop of compare, tune and the studies."""

import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from typing import Any, NamedTuple

from quadwalk.errors import UserError
from quadwalk.experiments.board import Board
from quadwalk.experiments.job import Job, open_run
from quadwalk.experiments.places import Place
from quadwalk.learn.loop import stop_on_signal
from quadwalk.runs.log import Row, read_last_row

TRIES = 3  # that a job whose process dies begins on this machine, in all
_POLL = 1.0  # s between looks at the runs

Watch = Callable[[Job, Row], bool]


class Outcome(NamedTuple):
    """The end of a job."""

    job: Job
    value: Any = None  # its evaluation
    error: str | None = None  # why there is none, in one line
    stopped: bool = False  # by `watch` or Ctrl-C: it can be resumed


def run_jobs(
    jobs: Iterable[Job], place: Place, count: int, watch: Watch | None = None
) -> Iterator[Outcome]:
    """Train and evaluate `count` jobs; yield the outcome of each as soon as it ends.

    The runs of a sequence of jobs are made before anything is trained. Other jobs are asked for
    only when there is a slot. A run that is there is resumed, or only evaluated. `watch` is called
    with new rows of metrics about once a second, and stops the job by True. On Ctrl-C all save what
    they have, to be resumed by the same call, and `KeyboardInterrupt` is raised.
    """
    limit: float = place.slots
    if isinstance(jobs, Sequence):
        limit = place.limit
        for job in jobs:
            open_run(job)
    waiting = iter(jobs)
    with stop_on_signal() as interrupted, place, Board(count) as board:
        runner = _Runner(place, board, watch)
        while True:
            if interrupted.is_set():
                runner.stop_all()
            while len(runner.running) < limit and not interrupted.is_set():
                job = next(waiting, None)
                if job is None:
                    break
                runner.start(job)
            if not runner.running:
                break
            ended, _ = wait(runner.running, _POLL, FIRST_COMPLETED)
            runner.read_rows()
            for future in ended:
                outcome = runner.finish(future)
                if outcome is not None:
                    yield outcome
            board.refresh()
        if interrupted.is_set():
            raise KeyboardInterrupt


class _Runner:
    """The jobs that are being computed."""

    def __init__(self, place: Place, board: Board, watch: Watch | None) -> None:
        self.running: dict[Future[Any], Job] = {}
        self._place = place
        self._board = board
        self._watch = watch
        self._rows: dict[str, Row | None] = {}  # the newest of each run
        self._tries: dict[str, int] = {}
        self._stopped: set[str] = set()

    def start(self, job: Job) -> None:
        """Start or resume a job."""
        self._rows[job.name] = read_last_row(open_run(job))
        self._tries[job.name] = self._tries.get(job.name, 0) + 1
        self._board.start(job.name, job.config.steps)
        self.running[self._place.submit(job)] = job

    def stop_all(self) -> None:
        """Have all jobs save and end."""
        for future, job in self.running.items():
            self._stop(future, job)

    def _stop(self, future: Future[Any], job: Job) -> None:
        if job.name not in self._stopped:
            self._stopped.add(job.name)
            self._place.stop(future)

    def read_rows(self) -> None:
        """Show each job's newest row of metrics; stop the jobs for which `watch` returns True."""
        for future, job in self.running.items():
            row = read_last_row(job.run)
            if row is None or row == self._rows[job.name]:
                continue
            self._rows[job.name] = row
            self._board.update(job.name, row)
            if self._watch and self._watch(job, row):
                self._stop(future, job)

    def finish(self, future: Future[Any]) -> Outcome | None:
        """Return the outcome of a job that has ended; None if it starts again."""
        job = self.running.pop(future)
        stopped = job.name in self._stopped
        value, error = None, None
        try:
            value = future.result()
        except BrokenExecutor:
            if not stopped and self._tries[job.name] < TRIES:
                self._board.say(f"{job.name}: its process died; it resumes its last checkpoint")
                self.start(job)
                return None
            error = f"its process died {self._tries[job.name]} times"
        except Exception as problem:
            cause = getattr(problem, "cause", problem)  # Ray wraps what a job raises
            error = str(cause)
            if not isinstance(cause, UserError) and not stopped:
                traceback.print_exception(cause)
                error = f"{type(cause).__name__}, which stands above"
        outcome = Outcome(job, value, error, stopped and error is not None)
        self._board.end(job.name, outcome.error, outcome.stopped)
        return outcome


def collect_values(outcomes: Iterable[Outcome]) -> Iterator[tuple[Job, Any]]:
    """Yield (job, value) of each job that succeeds, as it ends.

    Raises `UserError` at the end, with the first error, if any job failed or was stopped.
    """
    problems = []
    for outcome in outcomes:
        if outcome.error is None:
            yield outcome.job, outcome.value
        else:
            problems.append(f"{outcome.job.name}: {outcome.error}")
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise UserError(f"training failed, {problems[0]}{more}")
