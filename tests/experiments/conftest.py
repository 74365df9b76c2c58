"""Jobs of a second each: trainings on the toy, as a task of one's own."""

import signal
import sys
from pathlib import Path

import pytest

import quadwalk.learn.prepare
from quadwalk.api import train
from quadwalk.experiments.job import Job, fix_sizes, open_run
from quadwalk.experiments.options import PlaceConfig
from quadwalk.experiments.places import make_place
from quadwalk.experiments.runner import run_jobs
from quadwalk.learn.flags import parse_config
from quadwalk.learn.writer import RunWriter
from quadwalk.runs.directory import Run
from quadwalk.runs.policy import load_score

HERE = Path(__file__).parent
LEARN = HERE.parent / "learn"
sys.path[:0] = [str(HERE), str(LEARN)]  # for `measures` and `toy`

from measures import get_last_reward  # noqa: E402
from toy import BATCH, TINY, Toy  # noqa: E402, F401

PAUSE = 20  # iterations after which a training waits for the file `go` beside its task's
# Whoever reads its settings trains on the toy, slowly.
TASK = f"""
import dataclasses, pathlib, sys, time
sys.path.insert(0, {str(LEARN)!r})
import toy
import quadwalk.learn.prepare
from quadwalk.settings.terms import Reward
from quadwalk.tasks import sprint
from quadwalk.learn.writer import RunWriter

quadwalk.learn.prepare.QuadrupedEnv = toy.Toy
iteration = RunWriter.log_iteration
def slow(writer, row, *others):
    iteration(writer, row, *others)
    time.sleep(0.02)
    while row["steps"] >= {PAUSE * BATCH} and not pathlib.Path(GO).exists():
        time.sleep(0.05)
if iteration.__name__ != "slow":
    RunWriter.log_iteration = slow

def own(robot, step):
    return 0.0

TASK = dataclasses.replace(sprint.TASK, task="toy", env=dataclasses.replace(
    sprint.TASK.env, reward={{**sprint.TASK.env.reward, "own": Reward(own, scale=0.0)}}))
"""


def write_task(folder: Path) -> tuple[Path, Path]:
    """Write toy_task.py; return its path, and that of a file for which its trainings wait.

    They wait after `PAUSE` iterations until the second file is there.
    """
    file, go = folder / "toy_task.py", folder / "go"
    file.write_text(f"GO = {str(go)!r}\n{TASK}")
    return file, go


@pytest.fixture
def task(tmp_path) -> tuple[Path, Path]:
    """Return the paths of a task's file, and of the file for which its trainings wait."""
    return write_task(tmp_path)


@pytest.fixture
def job(task, tmp_path, monkeypatch):
    """Return a function that makes a job: a training on the toy of so many iterations.

    Its run is `name` in the folder `runs`, with a checkpoint after every ten iterations; `evaluate`
    is the job's.
    """
    # What reading the task changes in this process is put back.
    monkeypatch.setattr(quadwalk.learn.prepare, "QuadrupedEnv", quadwalk.learn.prepare.QuadrupedEnv)
    monkeypatch.setattr(RunWriter, "log_iteration", RunWriter.log_iteration)
    file, _ = task

    def make(runs: str, name: str, iterations: int, evaluate, seed: int = 0) -> Job:
        sizes = f"--devices=2 --seed={seed} --checkpoint-steps={10 * BATCH}"
        where = f"--runs={tmp_path / runs} --name={name} --steps={BATCH * iterations}"
        flags = f"{file} {TINY} {sizes} {where}"
        return Job(fix_sizes(parse_config(flags.split())[0], PlaceConfig(cores=1)), evaluate)

    return make


@pytest.fixture
def train_alone(job):
    """Return a function that trains on the toy with a seed in this process, and returns the run."""

    def train_seed(iterations: int, seed: int = 0) -> Run:
        run = open_run(job("alone", f"s{seed}", iterations, get_last_reward, seed))
        return train(resume=run, quiet=True)

    return train_seed


@pytest.fixture
def assert_resumable(job, task):
    """Return a function that interrupts trainings at a place, and asserts that they can resume.

    Ctrl-C comes once all that have a slot train. Then each has saved its last row.
    """

    def interrupt(config: PlaceConfig) -> None:
        task[1].touch()
        place = make_place(config)
        seeds = range(place.slots + 1)
        jobs = [job("runs", f"s{seed}", 10_000, get_last_reward, seed) for seed in seeds]
        steps: dict[str, float] = {}

        def watch(job: Job, row: dict[str, float]) -> bool:
            is_new = job.name not in steps
            steps[job.name] = row["steps"]
            if is_new and len(steps) == place.slots:
                signal.raise_signal(signal.SIGINT)
            return False

        with pytest.raises(KeyboardInterrupt):
            list(run_jobs(jobs, place, len(jobs), watch))
        trained = [job.run for job in jobs if job.run.policy.exists()]
        assert [run.name for run in trained] == sorted(steps)
        for run in trained:
            saved, _ = load_score(run.policy)
            assert saved >= steps[run.name]  # not a row is lost
            assert run.locate_checkpoint(saved).exists()

    return interrupt
