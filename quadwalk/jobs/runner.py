"""Compute many jobs, wherever they are computed: the one loop of compare, tune and the studies."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from quadwalk.errors import UserError
from quadwalk.jobs.board import Board
from quadwalk.jobs.cluster import Cluster
from quadwalk.jobs.job import Job, Place, check_same, opened
from quadwalk.jobs.news import Event, Row
from quadwalk.jobs.place import PlaceConfig
from quadwalk.jobs.processes import Processes
from quadwalk.train.loop import stop_on_signal


class Outcome(NamedTuple):
    """How a job ended."""

    job: Job
    value: Any  # what its `judge` returned; None unless it is done
    error: str | None = None  # why it failed, in one line
    stopped: bool = False  # by `watch`


def place_of(config: PlaceConfig) -> Place:
    """The place that a command's flags ask for; `UserError` where it cannot be."""
    return Processes(config) if config.cluster is None else Cluster(config)


def run_jobs(
    jobs: Iterable[Job],
    place: Place,
    count: int,
    watch: Callable[[Job, Row], bool] | None = None,
) -> Iterator[Outcome]:
    """Train and evaluate `count` jobs; of each how it ended, as soon as it did.

    A sequence of jobs is checked before anything is trained. Others are asked for only when there
    is a slot. A run that is there is resumed, or only evaluated. `watch` is called with each row of
    metrics, and stops the job by True. On Ctrl-C all save what they have, to be resumed by the
    same call, and `KeyboardInterrupt` is raised.
    """
    known: dict[str, Job] = {}
    most: float = place.slots
    if isinstance(jobs, Sequence):
        most = place.most
        for job in jobs:
            check_same(job.config)
    waiting = iter(jobs)
    with stop_on_signal() as stop, place, Board(count) as board:
        told = False
        while True:
            while len(known) < most and not stop.is_set():
                job = next(waiting, None)
                if job is None:
                    most = 0
                    break
                opened(job.config)
                place.start(job)
                known[job.name] = job
                board.start(job)
            if stop.is_set() and not told:
                told = True
                for name in known:
                    place.stop(name)
            if not known:
                break
            for event in place.events():
                outcome = _took(event, known, board, place, watch)
                if outcome is not None and not (outcome.stopped and stop.is_set()):
                    yield outcome
            board.show()
        if stop.is_set():
            raise KeyboardInterrupt


def _took(
    event: Event,
    known: dict[str, Job],
    board: Board,
    place: Place,
    watch: Callable[[Job, Row], bool] | None,
) -> Outcome | None:
    """Show an event and act on it; the job's outcome if that was its end."""
    name, kind, value = event
    job = known[name]
    if kind == "row":
        board.row(name, value)
        if watch and watch(job, value):
            place.stop(name)
        return None
    if kind == "again":
        board.again(name)
        return None
    del known[name]
    board.end(name, kind, value if kind == "failed" else "")
    if kind == "failed":
        return Outcome(job, None, value)
    return Outcome(job, value, stopped=kind == "stopped")


def values(outcomes: Iterable[Outcome]) -> Iterator[tuple[Job, Any]]:
    """The jobs that are done, each with its value; at the end a `UserError` if others failed."""
    failed = []
    for outcome in outcomes:
        if outcome.stopped or outcome.error is not None:
            failed.append(f"{outcome.job.name}: {outcome.error or 'it was stopped'}")
        else:
            yield outcome.job, outcome.value
    if failed:
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise UserError(f"training failed, {failed[0]}{more}")
