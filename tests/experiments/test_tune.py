"""`quadwalk tune`: a search finds what is best and survives a kill."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadwalk.errors import UsageError, UserError
from quadwalk.evaluation.metrics import compute_metrics
from quadwalk.experiments import search
from quadwalk.experiments.commands import tune
from quadwalk.experiments.options import TuneConfig
from quadwalk.experiments.runner import Outcome
from quadwalk.experiments.search import read_space, search_settings
from quadwalk.task_files import load_task
from tests.experiments.conftest import TINY, write_task
from tests.studies.test_gecko import still

ROOT = Path(__file__).parents[2]
OVER = ("env.reward.energy.scale=-1:0", "ppo.learning-rate=1e-4:1e-2:log")


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ([], "no setting to search is given"),
        (["--over", "env.reward.fidgit=-4:-1"], "did you mean 'env.reward.fidget'"),
        (["--over", "env.reward.fidget=-1:-4"], "expected LOW below HIGH"),
        (["--over", "env.reward.fidget=-1:4:log"], "above 0 with log"),
        (["--over", "env.reward.fidget=low"], "expected NAME=LOW:HIGH"),
        (["--over", "ppo.discount=0.9:1.5"], "ppo.discount is 1.5"),
        (["--over", *2 * ["ppo.discount=0.9:0.99"]], "ppo.discount twice"),
        (["--over", "ppo.discount=0.9:0.99", "--objective", "speed"], "--objective is 'speed'"),
        (["--over", "ppo.discount=0.9:0.99", "--flags=--nothing"], "unknown option --nothing"),
        (["--over", "ppo.discount=0.9:0.99", "--cores", "4096"], "--cores is 4096"),
    ],
)
def test_what_cannot_be_searched_is_said_before_anything_is_trained(args, message, tmp_path):
    with pytest.raises(UserError, match=message):
        tune(["drive", *args, "--runs", str(tmp_path)])
    assert not list(tmp_path.iterdir())


def test_settings_have_ranges_or_choices():
    kinds = pytest.importorskip("optuna").distributions
    texts = [
        "ppo.epochs=1:4",
        "--ppo.activation=swish,relu",
        "env.reward.energy.scale=-1:0",
        "ppo.learning-rate=1e-4:1e-2:log",
    ]
    assert read_space(texts, load_task("run")) == {
        "ppo.epochs": kinds.IntDistribution(1, 4),
        "ppo.activation": kinds.CategoricalDistribution(("swish", "relu")),
        "env.reward.energy": kinds.FloatDistribution(-1.0, 0.0),
        "ppo.learning_rate": kinds.FloatDistribution(1e-4, 1e-2, log=True),
    }


@pytest.fixture
def toy(monkeypatch):
    """Replace trainings: each is better, from its start on, the nearer its energy is to -0.3."""
    pytest.importorskip("optuna")

    def run_jobs(jobs, place, count, watch):
        for job in jobs:
            value = 2.0 - abs(job.config.env.reward["energy"].scale + 0.3)
            job.run.path.mkdir()
            for steps in range(0, job.config.steps, job.config.steps // 12):
                row = {"steps": steps, "eval/speed": value, "eval/fall_rate": 0.0}
                with open(job.run.metrics, "a") as file:
                    file.write(f"{json.dumps(row)}\n")
                if watch(job, row):
                    yield Outcome(job, None, stopped=True)
                    break
            else:
                yield Outcome(job, value)

    monkeypatch.setattr(search, "run_jobs", run_jobs)


def test_a_search_nears_the_best_stops_the_hopeless_and_goes_on(toy, tmp_path, capsys):
    config = TuneConfig(task="run", over=OVER, trials=8, runs=tmp_path)
    search_settings(config)
    search_settings(TuneConfig(task="run", over=OVER, trials=20, runs=tmp_path))
    text = capsys.readouterr().out.split("\n20 trials")
    assert len(text) == 2
    assert "pruned" in text[1]
    assert (tmp_path / "run" / "tune.md").read_text().count("20 trials") == 1
    best = text[0].strip().splitlines()[-10].split("|")
    assert float(best[2]) > 1.9
    command = next(line for line in text[1].splitlines() if line.startswith("train the best"))
    assert f"--env.reward.energy={best[3].strip()}" in command
    with pytest.raises(UserError, match=r"--trials|--steps None; expected the same"):
        search_settings(TuneConfig(task="run", over=OVER, steps=1, runs=tmp_path))


@pytest.mark.parametrize("task", ["run", "drive"])
def test_what_a_task_is_measured_by_can_be_its_objective(task, quadruped):
    """Check objectives against the figures of an episode of such a task."""
    base = load_task(task)
    rollout = still(quadruped, quadruped.home, np.ones((100, 4)))
    if task == "drive":
        rollout = replace(rollout, command=np.tile([1.0, 0.0, 0.0], (100, 1)))
    figures = compute_metrics(rollout, base.env.reward, 100.0, np.full(12, 10.0))
    for name in ("speed", "heading_error", "velocity_error", "path_speed", "power", "reward"):
        if name in figures:
            search.check_objective(name, base)
        else:
            with pytest.raises(UsageError, match=f"--objective is '{name}'; expected for {task}"):
                search.check_objective(name, base)


def test_a_search_that_goes_on_elsewhere_is_left_alone(toy, tmp_path):
    (tmp_path / "run").mkdir()
    config = TuneConfig(task="run", over=OVER, trials=1, runs=tmp_path)
    code = (
        "import pathlib, sys; from quadwalk.files import hold_file\n"
        "with hold_file(pathlib.Path(sys.argv[1]), 'taken'): print(flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, tmp_path / "run" / "lock"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(ROOT)},
    ) as other:  # fmt: skip
        other.stdout.readline()
        with pytest.raises(UserError, match="run is being searched by another process"):
            search_settings(config)
        assert [path.name for path in (tmp_path / "run").iterdir()] == ["lock"]
        other.kill()
    search_settings(config)  # a kill frees it


def test_a_study_that_is_damaged_is_said_in_one_line(toy, tmp_path):
    config = TuneConfig(task="run", over=OVER, trials=1, runs=tmp_path)
    search_settings(config)
    (tmp_path / "run" / "study.db").write_bytes(b"no database" * 100)
    with pytest.raises(UserError, match=r"study\.db cannot be used as a study"):
        search_settings(config)


def is_running(process: str) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_a_trial_whose_search_was_killed_is_resumed(tmp_path):
    pytest.importorskip("optuna")
    flags = f"{TINY} --devices=1 --checkpoint-steps=640"
    _, go = write_task(tmp_path)
    args = [
        *("tune", "toy_task.py", "--over", "ppo.discount=0.9:0.99", f"--flags={flags}"),
        *("--trials", "1", "--steps", str(64 * 40), "--name", "toy", "--no-prune"),
    ]
    command = [sys.executable, "-m", "quadwalk", *args]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    first = subprocess.Popen(command, cwd=tmp_path, env=environment)
    checkpoints = tmp_path / "runs" / "tune" / "toy" / "trial_000" / "checkpoints"
    end = time.monotonic() + 300
    while not list(checkpoints.glob("*.npz")):
        assert first.poll() is None
        assert time.monotonic() < end
        time.sleep(0.1)
    children = Path(f"/proc/{first.pid}/task/{first.pid}/children").read_text().split()
    assert children
    first.kill()  # its training finds that out, saves and ends
    first.wait()
    go.touch()
    again = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert again.returncode == 0, again.stderr
    assert "1 trials: 1 complete" in again.stdout
    end = time.monotonic() + 60
    while any(map(is_running, children)):
        assert time.monotonic() < end
        time.sleep(0.1)
    rows = (checkpoints.parent / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(row)["steps"] for row in rows] == [64 * (1 + n) for n in range(40)]
