"""Jobs on a Ray cluster: Ray decides where each is computed, and begins it again where one dies.

A job travels as the files of its run. Each checkpoint comes back as soon as it is there, through
the `Keeper`, an actor beside this process: what is lost with a machine is lost work, and no run.
"""

import logging
import math
import re
import signal
import socket
import tempfile
from pathlib import Path
from typing import Any

from quadwalk.command.shell import extra
from quadwalk.errors import UsageError, UserError
from quadwalk.files import atomic_write
from quadwalk.jobs.job import Job, Place, Work, compute
from quadwalk.jobs.news import Event, Files, Keeper, Row
from quadwalk.jobs.place import PlaceConfig
from quadwalk.train.runs.directory import Run, list_checkpoints, versions

TRIES = 5  # that Ray begins a job again, where its worker or its machine has died
_PATIENCE = 5.0  # s for an address to answer
_TCP = re.compile(r"(?P<host>[\w.-]+):(?P<port>\d{1,5})")

Stats = dict[str, tuple[int, int]]  # of a run's files: size in bytes, time of writing in ns


class Cluster(Place):
    """A Ray cluster, as a place of jobs."""

    most = math.inf  # Ray has them wait

    def __init__(self, config: PlaceConfig) -> None:
        self._ray = ray = connected(str(config.cluster))
        # The jobs' resources: a training uses a GPU, or cores.
        self._cores = 0 if config.gpus else config.cores_each
        self._gpus = config.gpus
        kind, each = ("GPU", self._gpus) if self._gpus else ("CPU", self._cores)
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        have = [int(node.get(kind, 0)) for node in nodes]
        if max(have) < each:
            flag = "--gpus" if self._gpus else "--cores"
            raise UsageError(f"{flag} is {each}; expected at most {max(have)}, as one machine has")
        self.slots = sum(count // each for count in have)
        here = ray.get_runtime_context().get_node_id()
        beside = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(here, soft=False)
        self._keeper = ray.remote(num_cpus=0, scheduling_strategy=beside)(Keeper).remote()
        self._jobs: dict[Any, Job] = {}
        self._trains: set[str] = set()
        self._stopped: set[str] = set()

    def __exit__(self, *_: object) -> None:
        self._ray.shutdown()  # which ends what is left of the jobs

    def start(self, job: Job) -> None:
        ray, work = self._ray, job.work
        ray.get(self._keeper.hand.remote(job.name, _read(work.run.path, {})))
        task = ray.remote(
            num_cpus=self._cores,
            num_gpus=self._gpus,
            max_retries=TRIES,
            max_calls=1,  # JAX is set up once in a process
        )(_work).options(name=job.name)
        self._jobs[task.remote(self._keeper, work, self._cores, versions())] = job

    def stop(self, name: str) -> None:
        self._stopped.add(name)
        self._ray.get(self._keeper.stop.remote(name))
        for task, job in self._jobs.items():
            if job.name == name and name not in self._trains:
                self._ray.cancel(task, force=True)

    def events(self) -> list[Event]:
        ray = self._ray
        ready, _ = ray.wait(list(self._jobs), timeout=1.0)
        found = self._news()
        for task in ready:
            job = self._jobs.pop(task)
            try:
                found.append(ray.get(task))
            except (ray.exceptions.RayError, ray.exceptions.RayTaskError) as error:
                found.append(self._failed(job.name, error))
            ray.get(self._keeper.drop.remote(job.name))
        return found

    def _failed(self, name: str, error: Exception) -> Event:
        if name in self._stopped:
            return Event(name, "stopped")
        lines = str(error).strip().splitlines() or [type(error).__name__]
        # What a task raises is the last line of its traceback.
        return Event(name, "failed", lines[-1 if hasattr(error, "cause") else 0])

    def _news(self) -> list[Event]:
        """Write the files that have come back; the events that came with them."""
        folders = {job.name: job.work.run.path for job in self._jobs.values()}
        found = []
        for event, files, kept in self._ray.get(self._keeper.news.remote()):
            if event.name not in folders:
                continue
            if files:
                _write(folders[event.name], files, kept)
            if event.kind == "again":
                self._trains.discard(event.name)
            if event.value:
                self._trains.add(event.name)
            if event.kind == "again" or event.value:
                found.append(event)
        return found


def _ray() -> Any:
    extra("ray.util.scheduling_strategies", "--cluster", "cluster")  # which `ray` itself leaves out
    return extra("ray", "--cluster", "cluster")


def connected(address: str) -> Any:
    """The module `ray`, connected to the cluster at `address`; `UserError` in one line if not."""
    tcp = _TCP.fullmatch(address)
    if not tcp and address not in ("auto", "local"):
        raise UsageError(f"--cluster is {address!r}; expected HOST:PORT, auto or local")
    ray = _ray()
    if tcp:  # Ray itself would try for minutes
        try:
            socket.create_connection((tcp["host"], int(tcp["port"])), _PATIENCE).close()
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


def _work(keeper: Any, work: Work, cores: int, expected: dict[str, str]) -> Event:
    """Compute a job, in a worker's process of its own."""
    if versions() != expected:
        differ = ", ".join(
            f"{name} {version} in place of {expected[name]}"
            for name, version in versions().items()
            if version != expected[name]
        )
        return Event(work.run.name, "failed", f"{socket.gethostname()} has {differ}")
    name = work.run.name
    number, files = _answer(keeper.begin.remote(name))
    with tempfile.TemporaryDirectory(prefix="quadwalk-") as folder:
        run = Run(Path(folder) / name)
        for place in (run.checkpoints, run.tensorboard):
            place.mkdir(parents=True)
        _write(run.path, files, list(files))
        sent, seen = _stats(run.path), set(list_checkpoints(run))

        def tell(row: Row | None, files: bool) -> bool:
            nonlocal sent
            before, sent = sent, _stats(run.path) if files else sent
            news = _read(run.path, before) if files else {}
            stop: bool = _answer(keeper.tell.remote(name, number, row, news, list(sent)))
            return stop

        def watch(row: Row) -> None:
            """Report a row of the training, with the files after each checkpoint."""
            nonlocal seen
            now = set(list_checkpoints(run))
            if tell(row, now != seen):
                signal.raise_signal(signal.SIGTERM)  # it saves and ends
            seen = now

        event = compute(work._replace(run=run), cores, watch)
        tell(None, True)
    return event


def _answer(reference: Any) -> Any:
    """What a job asked for. While `ray.get` waits, Ray gives the job's cores to another one."""
    return reference.future().result()


def _stats(folder: Path) -> Stats:
    """Size and time of each file of a run that is whole, by its path in the folder."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix != ".part" and path.is_file():
            stat = path.stat()
            found[path.relative_to(folder).as_posix()] = stat.st_size, stat.st_mtime_ns
    return found


def _read(folder: Path, sent: Stats) -> Files:
    """The files of a run but those that are as in `sent`."""
    return {
        name: (folder / name).read_bytes()
        for name, stat in _stats(folder).items()
        if sent.get(name) != stat
    }


def _write(folder: Path, files: Files, kept: list[str]) -> None:
    """Write files to a run's folder, and delete checkpoints that are not `kept`."""
    # Checkpoints come last: each counts on the rows of metrics before it.
    for name in sorted(files, key=lambda name: (name.startswith("checkpoints/"), name)):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            file.write(files[name])
    for path in list_checkpoints(Run(folder)):
        if path.relative_to(folder).as_posix() not in kept:
            path.unlink()
