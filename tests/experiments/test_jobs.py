"""Many trainings in processes of this machine: how each ends, and that none disturbs another."""

import json
import math
import subprocess
import sys

import pytest
from judges import dies_once, fails, last_reward

from quadwalk.cores import cpu_cores
from quadwalk.errors import UserError
from quadwalk.experiments import board
from quadwalk.experiments.job import compute_job
from quadwalk.experiments.options import PlaceConfig
from quadwalk.experiments.places import make_place
from quadwalk.experiments.runner import read_last_row, run_jobs
from quadwalk.runs.directory import Run
from quadwalk.runs.policy import load_score

ROW = {"steps": 640, "eval/speed": 1.5, "eval/fall_rate": None}
HOLD = "from quadwalk.cores import pin, cpu_cores; import os; pin(1); "


def test_each_job_ends_in_its_own_way_and_a_stopped_one_goes_on(job, task, capsys):
    task[1].touch()
    jobs = [
        job("runs", "dies", 2, dies_once),
        job("runs", "fails", 2, fails),
        job("runs", "stopped", 1000, last_reward),
    ]
    stopped_at = 3 * 64

    def watch(job, row):
        return job.name == "stopped" and row["steps"] >= stopped_at

    place = make_place(PlaceConfig(cores=1))
    ended = {found.job.name: found for found in run_jobs(jobs, place, len(jobs), watch)}
    assert isinstance(ended["dies"].value, float)
    assert ended["fails"].error == "nothing can be made of it"
    assert ended["stopped"].stopped
    said = capsys.readouterr().err
    assert "dies: its process died; it goes on from its last checkpoint" in said
    assert "fails failed: nothing can be made of it" in said
    steps, _ = load_score(jobs[2].run.policy)
    assert stopped_at <= steps < 1000 * 64
    more = job("runs", "stopped", steps // 64 + 2, last_reward)
    (found,) = run_jobs([more], make_place(PlaceConfig(cores=1)), 1)
    assert isinstance(found.value, float)
    assert load_score(more.run.policy)[0] == steps + 2 * 64


def test_a_machine_that_lacks_what_a_job_needs_says_so(job):
    work = job("runs", "none", 1, last_reward).work(cores=0)
    with pytest.raises(UserError, match=r"has no .*none; expected --runs in a folder that all"):
        compute_job(work)
    other = {**work.versions, "jax": "0.1"}
    with pytest.raises(UserError, match=r"has jax [\d.]+ in place of 0\.1$"):
        compute_job(work._replace(versions=other))


def test_the_last_row_is_the_last_that_is_whole(tmp_path):
    run = Run(tmp_path)
    assert read_last_row(run) is None
    run.metrics.write_text('{"steps": 6')
    assert read_last_row(run) is None
    run.metrics.write_text(
        "".join(f"{json.dumps({'steps': n, 'x': 'y' * 300})}\n" for n in range(300))
    )
    assert read_last_row(run)["steps"] == 299
    with open(run.metrics, "a") as file:
        file.write(f'{json.dumps(ROW)}\n{{"steps": 704, "eva')
    row = read_last_row(run)
    assert (row["steps"], row["eval/speed"]) == (640, 1.5)
    assert math.isnan(row["eval/fall_rate"])


def test_where_there_is_no_terminal_a_line_says_how_far_all_are(monkeypatch, capsys):
    monkeypatch.setattr(board, "_PLAIN_SECONDS", -1.0)
    with board.Board(4) as shown:
        for name in ("a", "b", "c"):
            shown.start(name, 1000)
        shown.update("a", {**ROW, "eval/fall_rate": math.nan})
        shown.update("b", {"steps": 1000})
        shown.end("c", "it is broken", stopped=False)
        shown.show()
    said = capsys.readouterr().err.splitlines()
    assert said[0].endswith("c failed: it is broken")
    assert "0 of 4 done, 1 evaluating, 1 failed, 1 training, 1 waiting  " in said[1]


def test_an_interrupt_leaves_all_to_be_gone_on_with(assert_resumable):
    assert_resumable(PlaceConfig(cores=1))


@pytest.mark.skipif(cpu_cores() < 2, reason="a single core is nobody's own")
def test_processes_have_cores_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))  # of the locks, which other tests hold as well
    code = HOLD + "print(*os.sched_getaffinity(0), flush=True); input()"
    pipe, cores = subprocess.PIPE, cpu_cores()
    held = [
        subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe, text=True)
        for _ in range(cores)
    ]
    lists = [process.stdout.readline().split() for process in held]
    assert [len(own) for own in lists] == [1] * cores
    assert len({own[0] for own in lists}) == cores
    # One more finds none free, and may use all.
    code = HOLD + "print(len(os.sched_getaffinity(0)))"
    more = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(more.stdout) == cores
    for process in held:
        process.communicate("")
