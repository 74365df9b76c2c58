"""The two commands as a user runs them on a task of their own: train, stop, evaluate, resume."""

import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from quadwalk.errors import UserError
from quadwalk.learn.cli import main as train
from tests.evaluation.conftest import count_messages
from tests.programs import ROOT
from tests.test_shown_commands import OWN_TASK

ITERATIONS = 150
TINY = [
    *(f"--steps={64 * ITERATIONS}", "--envs=16", "--ppo.eval-envs=2", "--ppo.unroll=4"),
    *("--ppo.epochs=1", "--ppo.minibatches=2", "--ppo.hidden=16", "--devices=2"),
]


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("my runs")


@pytest.fixture(scope="module")
def task(tmp_path_factory) -> Path:
    """Return the task's file of docs/extend.md, with a reward, observation and termination."""
    (content,) = OWN_TASK.findall((ROOT / "docs/extend.md").read_text())
    file = tmp_path_factory.mktemp("task") / "my_task.py"
    file.write_text(content)
    return file


@pytest.fixture(scope="module")
def stopped(runs, task) -> tuple[Path, str]:
    """Train until Ctrl-C; return the folder of the training, and what it printed."""
    flags = [f"--runs={runs}", "--name=tiny", *TINY]
    command = [sys.executable, "train.py", str(task), *flags]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        metrics = runs / "tiny" / "metrics.jsonl"
        while not (metrics.exists() and metrics.stat().st_size):
            assert process.poll() is None, "training ended before its first iteration"
            time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
        assert process.wait(timeout=60) == 0
    return runs / "tiny", first + rest


def test_a_stopped_training_leaves_everything(stopped):
    folder, output = stopped
    assert "loading" in output.splitlines()[0]
    assert "compiling" in output
    assert "stopped after" in output
    names = {path.name for path in folder.iterdir()}
    assert names >= {"config.json", "metrics.jsonl", "tensorboard", "checkpoints", "policy.npz"}
    assert names >= {"learning_curve.png", "robot.urdf"}
    assert not list(folder.rglob("*.part"))
    config = json.loads((folder / "config.json").read_text())["config"]
    assert config["envs"] == 16
    assert config["env"]["reward"]["bounce"] == {
        "function": "task.py:bounce", "params": {"most": 2.0}, "scale": 0.3,
    }  # fmt: skip
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert [row["steps"] for row in rows] == [64 * (i + 1) for i in range(len(rows))]
    assert rows[0]["train/reward/bounce"] > 0
    total = sum(value for name, value in rows[0].items() if name.startswith("train/reward/"))
    assert total == pytest.approx(rows[0]["train/reward"], abs=1e-4)


def run_shown(label: str, output: str, *flags: str) -> subprocess.CompletedProcess[str]:
    """Run the command that `output` shows after `label`, as pasted into a shell, with `flags`."""
    (command,) = re.findall(rf"^{label} +(.*)$", output, re.MULTILINE)
    line = f"{command} {shlex.join(flags)}"
    return subprocess.run(line, shell=True, capture_output=True, text=True, cwd=ROOT)


@pytest.mark.parametrize("engine", ["mjx", "mujoco"])
def test_evaluation_measures_and_writes_every_episode(stopped, tmp_path, engine):
    flags = ["--episodes=2", "--seconds=1", f"--engine={engine}", f"--out={tmp_path}"]
    done = run_shown("evaluate with", stopped[1], *flags)
    assert done.returncode == 0, done.stderr
    assert "speed along x" in done.stdout
    results = json.loads((tmp_path / "metrics.json").read_text())
    assert results["engine"] == engine
    assert results["summary"]["episodes"] == len(results["episodes"]) == 2
    for episode in results["episodes"]:
        assert episode["distance"] == pytest.approx(episode["speed"] * episode["duration"])
        terms = [value for name, value in episode.items() if name.startswith("reward/")]
        assert sum(terms) == pytest.approx(episode["reward"], abs=1e-4)
    files = sorted(tmp_path.glob("*.mcap"))
    assert [file.name for file in files] == ["episode_000.mcap", "episode_001.mcap"]
    for file, episode in zip(files, results["episodes"], strict=True):
        assert count_messages(file) > 8 * episode["duration"] / 0.02  # eight topics in each step


def test_a_stopped_training_goes_on_to_its_end(stopped, runs):
    resumed = runs / "resumed"
    shutil.copytree(stopped[0], resumed)
    before = (resumed / "metrics.jsonl").read_bytes()
    assert before.count(b"\n") < ITERATIONS
    output = stopped[1].replace(str(stopped[0]), str(resumed))
    done = run_shown("resume with", output, "--devices=2")
    assert done.returncode == 0, done.stderr
    after = (resumed / "metrics.jsonl").read_bytes()
    assert after.startswith(before)
    assert after.count(b"\n") == ITERATIONS
    assert (resumed / f"checkpoints/step_{64 * ITERATIONS:012d}.npz").exists()


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--resume=nobody"], "nobody"),
        (["--resume=tiny", "--ppo.hidden=32"], "ppo.hidden"),
        (["--resume=tiny", "--seed=5"], "seed"),
        (["--resume=tiny", "--name=other"], "--name"),
        (["--name=tiny"], "run 'tiny' exists"),
        (["--robot.urdf=none.urdf"], "none.urdf"),
    ],
)
def test_a_training_that_cannot_start_is_one_line_and_changes_nothing(
    stopped, runs, flags, message
):
    files = {path: path.stat().st_mtime_ns for path in runs.rglob("*")}
    with pytest.raises(UserError, match=message):
        train([f"--runs={runs}", *flags, "--devices=2"])
    assert {path: path.stat().st_mtime_ns for path in runs.rglob("*")} == files
