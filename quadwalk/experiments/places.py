"""Where jobs are computed: processes of this machine, or a Ray cluster.

Both give a `concurrent.futures.Future` for each job. A run's folder is where the job's process
writes and this one reads; on a cluster it lies on storage that all machines share.
"""

import contextlib
import logging
import math
import multiprocessing
import re
import signal
import socket
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing.process import BaseProcess
from typing import Any, Protocol, Self

from quadwalk.cli.shell import import_extra
from quadwalk.cores import cpu_cores
from quadwalk.errors import UsageError, UserError
from quadwalk.experiments.job import Job, compute_job, get_stop_file
from quadwalk.experiments.options import PlaceConfig

RETRIES = 5  # of a job on a cluster whose worker or machine has died
_PATIENCE = 5.0  # s for an address to answer
_ADDRESS = re.compile(r"(?P<host>[\w.-]+):(?P<port>\d{1,5})")


class Place(Protocol):
    """Where jobs are computed; a context manager, which ends those that still are."""

    slots: int  # jobs that it can compute at a time
    most: float  # jobs that it takes at a time

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def submit(self, job: Job) -> Future[Any]:
        """Begin or resume a job, whose run is there."""

    def result(self, future: Future[Any]) -> Any:
        """Return the evaluation of a job that has ended, or raise what it raised."""

    def stop(self, future: Future[Any], job: Job, trains: bool) -> None:
        """Have a job end early; what it trains is saved if it `trains` already."""


def make_place(config: PlaceConfig) -> Place:
    """Return the place that a command's flags ask for; `UserError` where it cannot be."""
    return ThisMachine(config) if config.cluster is None else Cluster(config)


class ThisMachine(Place):
    """Processes of this machine, each kept to cores of its own."""

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
        self._running: dict[Future[Any], tuple[ProcessPoolExecutor, BaseProcess]] = {}
        self._stopped: set[Future[Any]] = set()

    def __exit__(self, *_: object) -> None:
        for future in self._running:
            self._terminate(future)
        for executor, _process in self._running.values():
            executor.shutdown()

    def submit(self, job: Job) -> Future[Any]:
        # An executor for each: when a process dies, its executor takes no more jobs.
        executor = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))
        before = multiprocessing.active_children()
        with _block_interrupts():
            future = executor.submit(compute_job, job.work(self._cores))
        (process,) = set(multiprocessing.active_children()) - set(before)
        self._running[future] = executor, process
        return future

    def result(self, future: Future[Any]) -> Any:
        executor, _ = self._running.pop(future)
        executor.shutdown()  # its cores are free then
        return future.result()

    def stop(self, future: Future[Any], job: Job, trains: bool) -> None:
        self._terminate(future)

    def _terminate(self, future: Future[Any]) -> None:
        """Have a process save and end; a second signal would not let it save."""
        if future not in self._stopped:
            self._stopped.add(future)
            self._running[future][1].terminate()


@contextlib.contextmanager
def _block_interrupts() -> Iterator[None]:
    """Keep Ctrl-C and a terminal's end from processes that start in here: this one stops them."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Cluster(Place):
    """A Ray cluster, which places jobs, has them wait, and begins those again whose worker died."""

    most = math.inf

    def __init__(self, config: PlaceConfig) -> None:
        self._ray = connect(str(config.cluster))
        # A training uses GPUs, or cores.
        self._cores = 0 if config.gpus else config.cores_each
        kind, each = ("GPU", config.gpus) if config.gpus else ("CPU", self._cores)
        nodes = [node["Resources"] for node in self._ray.nodes() if node["Alive"]]
        counts = [int(node.get(kind, 0)) for node in nodes]
        if max(counts) < each:
            flag = "--gpus" if config.gpus else "--cores"
            raise UsageError(
                f"{flag} is {each}; expected at most {max(counts)}, as one machine has"
            )
        self.slots = sum(count // each for count in counts)
        self._compute = self._ray.remote(
            num_cpus=self._cores,
            num_gpus=config.gpus,
            max_retries=RETRIES,
            max_calls=1,  # JAX is set up once in a process
        )(compute_job)
        self._references: dict[Future[Any], Any] = {}

    def __exit__(self, *_: object) -> None:
        self._ray.shutdown()  # which ends what is left of the jobs

    def submit(self, job: Job) -> Future[Any]:
        reference = self._compute.options(name=job.name).remote(job.work(self._cores))
        future: Future[Any] = reference.future()
        self._references[future] = reference
        return future

    def result(self, future: Future[Any]) -> Any:
        self._references.pop(future)
        try:
            return future.result()
        except self._ray.exceptions.RayTaskError as error:
            raise error.cause from None

    def stop(self, future: Future[Any], job: Job, trains: bool) -> None:
        if trains:
            get_stop_file(job.run).touch()
        else:
            self._ray.cancel(self._references[future], force=True)


def connect(address: str) -> Any:
    """Return the module `ray`, connected to the cluster at `address`; `UserError` if it is not."""
    parts = _ADDRESS.fullmatch(address)
    if not parts and address not in ("auto", "local"):
        raise UsageError(f"--cluster is {address!r}; expected HOST:PORT, auto or local")
    ray = import_extra("ray", "--cluster", "cluster")
    if parts:  # Ray itself would try for minutes
        try:
            socket.create_connection((parts["host"], int(parts["port"])), _PATIENCE).close()
        except (OSError, OverflowError) as error:
            raise UserError(
                f"no Ray cluster answers at {address}: {error}; expected the HOST:PORT that "
                "`ray start --head` says, or auto"
            ) from None
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (ConnectionError, RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise UserError(f"cannot use the Ray cluster at {address}: {reason}") from None
    return ray
