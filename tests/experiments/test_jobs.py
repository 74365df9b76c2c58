"""Many trainings in processes of this machine: how each ends, and that none disturbs another."""

import contextlib
import math
import subprocess
import sys
from concurrent.futures import Future

import pytest
from measures import die_once, get_last_reward

from quadwalk.cores import count_cores
from quadwalk.errors import UserError
from quadwalk.experiments import board
from quadwalk.experiments.job import compute_job
from quadwalk.experiments.options import PlaceConfig
from quadwalk.experiments.places import make_place
from quadwalk.experiments.runner import collect_values, run_jobs
from quadwalk.runs.policy import load_score

ROW = {"steps": 640, "eval/speed": 1.5, "eval/fall_rate": math.nan}
HOLD = "from quadwalk.cores import pin, count_cores; import os; pin(1); "


def test_each_job_ends_in_its_own_way(job, task, capsys, same_result, train_alone):
    task[1].touch()
    dying, endless = job("runs", "dies", 2, die_once), job("runs", "endless", 1000, get_last_reward)

    def watch(job, row):
        return job is endless and row["steps"] >= 3 * 64

    place = make_place(PlaceConfig(cores=1))
    outcomes = {end.job.name: end for end in run_jobs([dying, endless], place, 2, watch)}
    assert isinstance(outcomes["dies"].value, float)
    assert outcomes["endless"].stopped
    assert "dies: its process died; it resumes its last checkpoint" in capsys.readouterr().err
    steps, _ = load_score(endless.run.policy)
    assert 3 * 64 <= steps < 1000 * 64
    assert endless.run.locate_checkpoint(steps).exists()
    same_result(dying.run.path, train_alone(2).path)


class Refusal(contextlib.nullcontext):
    """A place where all jobs fail."""

    limit = slots = 1

    def submit(self, job) -> Future:
        future = Future()
        future.set_exception(UserError("nothing can be made of it"))
        return future


def test_trainings_that_fail_are_said_at_once_and_at_the_end(job, capsys):
    jobs = [job("runs", name, 2, get_last_reward) for name in ("a", "b")]
    with pytest.raises(UserError, match=r"failed, a: nothing can be made of it \(and 1 more\)$"):
        list(collect_values(run_jobs(jobs, Refusal(), len(jobs))))
    assert "b failed: nothing can be made of it" in capsys.readouterr().err


def test_an_interrupt_leaves_all_to_be_resumed(assert_resumable):
    assert_resumable(PlaceConfig(cores=1))


def test_a_machine_of_other_versions_says_so(job):
    work = job("runs", "none", 1, get_last_reward).make_work()
    other = {**work.versions, "jax": "0.1"}
    with pytest.raises(UserError, match=r" has .*'jax': '[1-9.]*0\.[0-9.]+'.*; expected .*'0\.1'"):
        compute_job(work._replace(versions=other))


def test_where_there_is_no_terminal_a_line_says_how_far_all_are(monkeypatch, capsys):
    monkeypatch.setattr(board, "_PLAIN_SECONDS", -1.0)
    with board.Board(4) as display:
        for name in ("a", "b", "c"):
            display.start(name, 1000)
        display.update("a", ROW)
        display.update("b", {"steps": 1000, "eval/velocity_error": 0.25})
        texts = [task.fields["text"] for task in display._progress.tasks]
        display.end("c", "it is broken", stopped=False)
        display.refresh()
    lines = capsys.readouterr().err.splitlines()
    assert texts[1:] == [
        "- steps/s  - left  speed 1.50 m/s  falls -",
        "evaluating  velocity error 0.25 m/s  falls -",
        "starting",
    ]
    assert lines[0].endswith("c failed: it is broken")
    assert "0 of 4 done, 1 failed, 2 running, 1 waiting  " in lines[1]


@pytest.mark.skipif(count_cores() < 2, reason="a single core is nobody's own")
def test_processes_have_cores_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))  # of the locks, which other tests hold as well
    code = HOLD + "print(*os.sched_getaffinity(0), flush=True); input()"
    pipe, cores = subprocess.PIPE, count_cores()
    processes = [
        subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe, text=True)
        for _ in range(cores)
    ]
    lists = [process.stdout.readline().split() for process in processes]
    assert [len(affinity) for affinity in lists] == [1] * cores
    assert len({affinity[0] for affinity in lists}) == cores
    # One more finds none free, and may use all.
    code = HOLD + "print(len(os.sched_getaffinity(0)))"
    more = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(more.stdout) == cores
    for process in processes:
        process.communicate("")
