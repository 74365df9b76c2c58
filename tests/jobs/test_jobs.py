"""Many trainings in processes of this machine: how each ends, and that none disturbs another."""

import subprocess
import sys

import pytest
from judges import dies_once, fails, last_reward

from quadwalk.cores import cpu_cores
from quadwalk.jobs.place import PlaceConfig
from quadwalk.jobs.runner import place_of, run_jobs
from quadwalk.train.runs.policy import load_score

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

    place = place_of(PlaceConfig(cores=1))
    ended = {found.job.name: found for found in run_jobs(jobs, place, len(jobs), watch)}
    assert isinstance(ended["dies"].value, float)
    assert ended["fails"].error == "nothing can be made of it"
    assert ended["stopped"].stopped
    said = capsys.readouterr().err
    assert "dies: its process died; it goes on from its last checkpoint" in said
    assert "fails failed: nothing can be made of it" in said
    steps, _ = load_score(jobs[2].work.run.policy)
    assert stopped_at <= steps < 1000 * 64
    more = job("runs", "stopped", steps // 64 + 2, last_reward)
    (found,) = run_jobs([more], place_of(PlaceConfig(cores=1)), 1)
    assert isinstance(found.value, float)
    assert load_score(more.work.run.policy)[0] == steps + 2 * 64


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
