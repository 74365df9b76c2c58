"""Where jobs are computed: processes of this machine, or a Ray cluster.

Both give a `concurrent.futures.Future` for each job. A run's folder is where the job's process
writes and this one reads; on a cluster it lies on storage that all machines share.
"""

import contextlib
import logging
import math
import multiprocessing
import os
import re
import signal
import socket
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from typing import Any

from quadwalk.cli.shell import import_extra
from quadwalk.cores import count_cores, prepare_worker
from quadwalk.errors import UsageError, UserError
from quadwalk.experiments.job import Job, compute_job
from quadwalk.experiments.options import PlaceConfig

RETRIES = 5  # of a job on a cluster whose worker or machine has died
_PATIENCE = 5.0  # s for an address to answer
_ADDRESS = re.compile(r"(?P<host>[\w.-]+):(?P<port>\d{1,5})")


class ThisMachine(contextlib.AbstractContextManager["ThisMachine"]):
    """Processes of this machine, each kept to cores of its own; a context manager."""

    def __init__(self, config: PlaceConfig) -> None:
        if config.gpus:
            raise UsageError(
                f"--gpus is {config.gpus} without --cluster; expected --cluster local for the "
                "GPUs of this machine"
            )
        if config.cores_each > count_cores():
            raise UsageError(
                f"--cores is {config.cores}; expected at most {count_cores()}, all here"
            )
        self._cores = config.cores_each
        self.slots = count_cores() // self._cores  # jobs that it can compute at a time
        self.limit: float = self.slots  # jobs that it takes at a time
        self._pids: dict[Future[Any], Future[int]] = {}

    def __exit__(self, *_: object) -> None:
        for future in self._pids:
            self.stop(future)

    def submit(self, job: Job) -> Future[Any]:
        """Start or resume a job in a new process; `open_run` has made the folder of its run."""
        # An executor for each: when a process dies, its executor takes no more jobs.
        spawn = multiprocessing.get_context("spawn")
        executor = ProcessPoolExecutor(1, spawn, prepare_worker, (self._cores,))
        pid = executor.submit(os.getpid)
        future = executor.submit(compute_job, job.make_work())
        executor.shutdown(wait=False)  # the process ends with the job
        self._pids[future] = pid
        return future

    def stop(self, future: Future[Any]) -> None:
        """Stop a job early, without waiting; what it has trained is saved."""
        if not future.done():
            with contextlib.suppress(BrokenExecutor, ProcessLookupError):
                os.kill(self._pids[future].result(), signal.SIGTERM)


class Cluster(contextlib.AbstractContextManager["Cluster"]):
    """A Ray cluster, which queues jobs and repeats those whose worker died; a context manager."""

    limit = math.inf

    def __init__(self, config: PlaceConfig) -> None:
        self._ray = connect(str(config.cluster))
        # A training uses GPUs, or cores.
        kind, flag, count = "CPU", "--cores", config.cores_each
        if config.gpus:
            kind, flag, count = "GPU", "--gpus", config.gpus
        nodes = [node["Resources"] for node in self._ray.nodes() if node["Alive"]]
        available = [int(node.get(kind, 0)) for node in nodes]
        if max(available) < count:
            raise UsageError(
                f"{flag} is {count}; expected at most {max(available)}, as one machine has"
            )
        self.slots = sum(number // count for number in available)
        self._on_cpu = not config.gpus
        self._compute = self._ray.remote(
            num_cpus=count if self._on_cpu else 0,
            num_gpus=config.gpus,
            max_retries=RETRIES,
            max_calls=1,  # JAX is set up once in a process
        )(compute_job)
        self._references: dict[Future[Any], Any] = {}

    def __exit__(self, *_: object) -> None:
        self._ray.shutdown()  # which ends what is left of the jobs

    def submit(self, job: Job) -> Future[Any]:
        """Start or resume a job, once a machine has room for it.

        `open_run` has made the folder of its run, which all machines share.
        """
        reference = self._compute.options(name=job.name).remote(job.make_work(self._on_cpu))
        future: Future[Any] = reference.future()
        self._references[future] = reference
        return future

    def stop(self, future: Future[Any]) -> None:
        """Stop a job early, as by Ctrl-C, without waiting; what it has trained is saved."""
        self._ray.cancel(self._references[future])


Place = ThisMachine | Cluster


def make_place(config: PlaceConfig) -> Place:
    """Return the place that a command's flags ask for; `UserError` where it cannot be."""
    return ThisMachine(config) if config.cluster is None else Cluster(config)


def connect(address: str) -> Any:
    """Import `ray`, connect it to the cluster at `address` and return the module.

    Raises `UserError` where it is not installed or no cluster answers, `UsageError` for an address
    of another form.
    """
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
