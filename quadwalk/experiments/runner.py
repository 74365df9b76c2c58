"""Compute many jobs, wherever that is: the one loop of compare, tune and the studies."""

import json
import math
import os
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, NamedTuple

from quadwalk.errors import UserError
from quadwalk.experiments.board import Board
from quadwalk.experiments.job import (
    Job,
    Row,
    StoppedError,
    check_same,
    get_stop_file,
    open_run,
)
from quadwalk.experiments.places import Place
from quadwalk.learn.loop import stop_on_signal
from quadwalk.runs.directory import Run

TRIES = 3  # that a job whose process dies begins on this machine, in all
_POLL = 1.0  # s between looks at the runs
_LAST = 1 << 16  # bytes at the end of metrics.jsonl that hold its last row

Watch = Callable[[Job, Row], bool]


class Outcome(NamedTuple):
    """The end of a job."""

    job: Job
    value: Any  # its evaluation; None unless it is done
    error: str | None = None  # why it failed, in one line
    stopped: bool = False  # by `watch`


def run_jobs(
    jobs: Iterable[Job], place: Place, count: int, watch: Watch | None = None
) -> Iterator[Outcome]:
    """Train and evaluate `count` jobs; yield the outcome of each as soon as it ends.

    A sequence of jobs is checked before anything is trained. Others are asked for only when there
    is a slot. A run that is there is resumed, or only evaluated. `watch` is called with the newest
    row of metrics about once a second, and stops the job by True. On Ctrl-C all save what they
    have, to be resumed by the same call, and `KeyboardInterrupt` is raised.
    """
    most: float = place.slots
    if isinstance(jobs, Sequence):
        most = place.most
        for job in jobs:
            check_same(job.config)
    waiting = iter(jobs)
    with stop_on_signal() as stop, place, Board(count) as board:
        runner = _Runner(place, board, watch)
        interrupted = False
        while True:
            while len(runner.running) < most and not stop.is_set():
                job = next(waiting, None)
                if job is None:
                    most = 0
                    break
                runner.start(job)
            if stop.is_set() and not interrupted:
                interrupted = True
                runner.stop_all()
            if not runner.running:
                break
            ended, _ = wait(runner.running, _POLL, FIRST_COMPLETED)
            runner.read_rows()
            for future in ended:
                outcome = runner.collect(future)
                if outcome is not None and not (outcome.stopped and stop.is_set()):
                    yield outcome
            board.show()
        if stop.is_set():
            raise KeyboardInterrupt


class _Runner:
    """The jobs that are being computed, each with its newest row of metrics."""

    def __init__(self, place: Place, board: Board, watch: Watch | None) -> None:
        self.running: dict[Future[Any], Job] = {}
        self._place = place
        self._board = board
        self._watch = watch
        self._before: dict[str, Row | None] = {}  # the row that a run had when it was started
        self._rows: dict[str, Row] = {}
        self._tries: dict[str, int] = {}
        self._stopped: set[str] = set()

    def start(self, job: Job) -> None:
        """Begin or resume a job."""
        run = open_run(job.config)
        get_stop_file(run).unlink(missing_ok=True)
        self._before[job.name] = read_last_row(run)
        self._tries[job.name] = self._tries.get(job.name, 0) + 1
        self._board.start(job.name, job.config.steps)
        self.running[self._place.submit(job)] = job

    def stop_all(self) -> None:
        """Have all jobs save and end."""
        for future, job in self.running.items():
            if job.name not in self._stopped:
                self._stopped.add(job.name)
                self._place.stop(future, job, trains=job.name in self._rows)

    def read_rows(self) -> None:
        """Show and watch the newest rows of all jobs."""
        for job in self.running.values():
            row = read_last_row(job.run)
            if row is None or row == self._rows.get(job.name, self._before[job.name]):
                continue
            self._rows[job.name] = row
            self._board.update(job.name, row)
            if self._watch and self._watch(job, row) and job.name not in self._stopped:
                get_stop_file(job.run).touch()
                self._stopped.add(job.name)

    def collect(self, future: Future[Any]) -> Outcome | None:
        """Return the outcome of a job that has ended; None if it begins again."""
        job = self.running.pop(future)
        outcome = Outcome(job, None)
        try:
            outcome = Outcome(job, self._place.result(future))
        except BrokenProcessPool:
            if job.name not in self._stopped and self._tries[job.name] < TRIES:
                self._board.say(
                    f"{job.name}: its process died; it goes on from its last checkpoint"
                )
                self.start(job)
                return None
            outcome = Outcome(job, None, f"its process died {self._tries[job.name]} times")
        except StoppedError:
            outcome = Outcome(job, None, "it was stopped")
        except UserError as error:
            outcome = Outcome(job, None, str(error))
        except Exception as error:
            if job.name not in self._stopped:
                traceback.print_exception(error)
            outcome = Outcome(job, None, f"{type(error).__name__}, which stands above")
        get_stop_file(job.run).unlink(missing_ok=True)
        if outcome.error is not None and job.name in self._stopped:
            outcome = Outcome(job, None, stopped=True)
        self._board.end(job.name, outcome.error, outcome.stopped)
        return outcome


def read_last_row(run: Run) -> Row | None:
    """Return the last complete row of a run's metrics, null as NaN; None if there is none."""
    try:
        with open(run.metrics, "rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - _LAST))
            lines = file.read().split(b"\n")[:-1]
    except FileNotFoundError:
        return None
    if not lines:
        return None
    row = json.loads(lines[-1])
    return {name: math.nan if value is None else value for name, value in row.items()}


def collect_values(outcomes: Iterable[Outcome]) -> Iterator[tuple[Job, Any]]:
    """Yield each job that is done with its value; `UserError` at the end if others failed."""
    failed = []
    for outcome in outcomes:
        if outcome.stopped or outcome.error is not None:
            failed.append(f"{outcome.job.name}: {outcome.error or 'it was stopped'}")
        else:
            yield outcome.job, outcome.value
    if failed:
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise UserError(f"training failed, {failed[0]}{more}")
