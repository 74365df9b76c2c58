"""Jobs in processes of this machine, each kept to cores of its own."""

import contextlib
import multiprocessing
import signal
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from quadwalk.cores import cpu_cores
from quadwalk.errors import UsageError
from quadwalk.jobs.job import Job, Place, Work, compute
from quadwalk.jobs.news import Event, Row
from quadwalk.jobs.place import PlaceConfig

TRIES = 3  # that a job whose process dies begins, in all


@dataclass
class _Running:
    job: Job
    process: BaseProcess
    tries: int = 1
    stopped: bool = False


class Processes(Place):
    """Processes of this machine, as many at a time as have cores."""

    def __init__(self, config: PlaceConfig) -> None:
        if config.gpus:
            raise UsageError(
                f"--gpus is {config.gpus} without --cluster; expected --cluster local for the "
                "GPUs of this machine"
            )
        if config.cores_each > cpu_cores():
            raise UsageError(f"--cores is {config.cores}; expected at most {cpu_cores()}, all here")
        self._cores = config.cores_each
        self.slots = cpu_cores() // self._cores
        self.most: float = self.slots
        self._running: dict[Connection, _Running] = {}

    def __exit__(self, *_: object) -> None:
        for running in self._running.values():
            _stop(running)
        for connection, running in self._running.items():
            connection.close()
            running.process.join()
        self._running.clear()

    def start(self, job: Job) -> None:
        self._begin(_Running(job, multiprocessing.current_process()))

    def stop(self, name: str) -> None:
        for running in self._running.values():
            if running.job.name == name:
                _stop(running)

    def events(self) -> list[Event]:
        found = []
        for connection in wait(list(self._running), timeout=1.0):
            assert isinstance(connection, Connection)
            try:
                event = connection.recv()
            except (EOFError, ConnectionResetError):
                event = None
            if event is None or event.kind != "row":
                event = self._ended(connection, event)
            found.append(event)
        return found

    def _begin(self, running: _Running) -> None:
        context = multiprocessing.get_context("spawn")  # JAX is set up once in a process
        ours, theirs = context.Pipe()
        arguments = theirs, running.job.work, self._cores
        running.process = context.Process(target=_work, args=arguments)
        with _unheard():
            running.process.start()
        theirs.close()
        self._running[ours] = running

    def _ended(self, connection: Connection, event: Event | None) -> Event:
        """What a job's process ended with, or that it begins again, since that died."""
        running = self._running.pop(connection)
        connection.close()
        running.process.join()  # its cores are free then
        if event is not None:
            return event
        name = running.job.name
        if running.stopped:
            return Event(name, "stopped")
        if running.tries == TRIES:
            code = running.process.exitcode
            return Event(name, "failed", f"its process died {TRIES} times, last with status {code}")
        running.tries += 1
        self._begin(running)
        return Event(name, "again")


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """Block Ctrl-C and a terminal's end in processes that start in here: this one stops them."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _stop(running: _Running) -> None:
    """Have a process save what it trains, or end at once; a second signal would not let it save."""
    if not running.stopped:
        running.stopped = True
        running.process.terminate()


def _work(connection: Connection, work: Work, cores: int) -> None:
    """Compute a job, in a process of its own."""
    name = work.run.name

    def tell(row: Row) -> None:
        connection.send(Event(name, "row", row))

    try:
        connection.send(compute(work, cores, tell))
    except BrokenPipeError:  # nobody waits for it any more
        return
    except Exception:
        traceback.print_exc()
        connection.send(Event(name, "failed", "an error of quadwalk's, which stands above"))
