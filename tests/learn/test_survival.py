"""Signals, kills, damage and full disks during a training: nothing is lost."""

import contextlib
import json
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import crash
import numpy as np
import pytest
import toy

from quadwalk.errors import UserError
from quadwalk.learn.acting import load_policy
from quadwalk.learn.writer import RunWriter
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import (
    Run,
    create_run,
    delete_partial_files,
    find_latest_checkpoint,
    list_checkpoints,
)
from quadwalk.runs.log import read_metrics
from quadwalk.terrain.terrain import make_terrain
from tests.settings.test_registry import to_module_names

ITERATIONS = 60
OFTEN = "--checkpoint-steps=128"  # after every second iteration


@pytest.fixture(scope="session")
def whole(tmp_path_factory, flags, start) -> Path:
    """Return the folder of a training that was not disturbed."""
    runs = tmp_path_factory.mktemp("whole")
    process = start(runs / "output", *flags(runs, "whole", ITERATIONS, OFTEN))
    process.join(200)
    assert process.exitcode == 0, (runs / "output").read_text()
    return runs / "whole"


@pytest.fixture
def copied(whole, tmp_path) -> Run:
    """Return a copy of that training, named "copy"."""
    return Run(shutil.copytree(whole, tmp_path / "copy"))


@pytest.fixture
def resume(copied, train) -> Callable[..., None]:
    """Return a function that resumes `copied` with flags."""
    return lambda *flags: train(f"--runs={copied.path.parent}", "--resume=copy", *flags)


def test_the_same_seed_gives_the_same_files(whole, tmp_path, flags, train, same_result):
    train(*flags(tmp_path, "again", ITERATIONS, OFTEN))
    same_result(tmp_path / "again", whole)


@pytest.mark.parametrize(
    ("name", "handler", "steps"),
    [
        ("SIGINT", signal.default_int_handler, 128),
        ("SIGTERM", signal.SIG_DFL, 128),
        ("SIGHUP", signal.SIG_DFL, 128),
        ("SIGHUP", signal.SIG_IGN, 256),  # as nohup has it
    ],
)
def test_a_signal_that_is_not_ignored_ends_training_with_everything_saved(
    name, handler, steps, tmp_path, flags, train
):
    number = getattr(signal, name)

    def end(row: dict[str, float]) -> None:
        if row["steps"] == 128:
            signal.raise_signal(number)
            if name == "SIGHUP":  # from the shell, and from the system
                signal.raise_signal(number)

    before = signal.signal(number, handler)
    try:
        train(*flags(tmp_path, "a", 4), watch=end)
        assert signal.getsignal(number) == handler
    finally:
        signal.signal(number, before)
    assert load_policy(tmp_path / "a" / "policy.npz").steps == steps
    assert count_rows(tmp_path / "a") == steps / 64


def count_rows(run: Path) -> int:
    with contextlib.suppress(FileNotFoundError):
        return (run / "metrics.jsonl").read_bytes().count(b"\n")
    return 0


def test_a_run_killed_again_and_again_ends_as_if_it_never_was(
    whole, tmp_path, flags, start, same_result
):
    chance = random.Random(5)
    run, output = tmp_path / "killed", tmp_path / "output"
    arguments = flags(tmp_path, "killed", ITERATIONS, OFTEN)
    kills = 0
    for attempt in range(20):
        process = start(output, *arguments)
        before, goal = count_rows(run), 0 if attempt == 0 else chance.randint(1, 18)
        while process.is_alive() and (
            # First before there is any checkpoint, later at any moment of training and saving.
            not (run / "config.json").exists() if attempt == 0 else count_rows(run) < before + goal
        ):
            time.sleep(0.001)
        time.sleep(0.02 * chance.random())
        process.kill()
        process.join(60)
        if process.exitcode == 0:
            break
        assert process.exitcode == -9, output.read_text()
        kills += 1
        arguments = [f"--runs={tmp_path}", "--resume=killed"]
    assert kills >= 4
    same_result(run, whole)


def test_a_death_at_any_moment_of_saving_leaves_what_was_saved(tmp_path, processes):
    sound = create_run(tmp_path, "sound")
    crash.save(sound.path, 0, 30)
    for moment in range(1, 200):
        run = Run(tmp_path / f"died-{moment}")
        shutil.copytree(sound.path, run.path)
        process = processes.Process(target=crash.save, args=(run.path, 30, 40, moment))
        process.start()
        process.join(60)
        last = find_latest_checkpoint(run, pytest.fail)  # none is damaged
        leaves, metadata = checkpoint.load(last, "checkpoint")
        steps = metadata["steps"]
        assert steps in (30, 40)
        assert set(leaves["workers"]) == {steps}
        rows = [row for row in read_metrics(run) if row["steps"] <= steps]
        assert [row["x"] for row in rows] == list(range(10, steps + 1, 10))
        for policy in (run.policy, run.best):
            arrays, metadata = checkpoint.load(policy, "policy")
            assert set(arrays["policy/w"]) == {metadata["steps"]}
            assert metadata["steps"] in (steps, 40)
        delete_partial_files(run)
        assert not list(run.path.rglob("*.part"))
        if process.exitcode == 0:
            break
        assert process.exitcode == -9
    assert moment > 25
    assert steps == 40


def cut_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1000])


def test_the_checkpoint_before_a_truncated_one_is_resumed(
    whole, copied, resume, same_result, capsys
):
    """Check also that files of earlier versions, which name terms by module, are read."""
    last = list_checkpoints(copied)[-1]
    cut_short(last)
    config = copied.config.read_text()
    copied.config.write_text(to_module_names(config))
    assert config.count('"reward:') == copied.config.read_text().count('"quadwalk.task.reward:') > 5
    resume()
    output = capsys.readouterr().out
    assert f"{last} is damaged or foreign" in output
    assert f"after {64 * (ITERATIONS - 2):,} steps" in output
    same_result(copied.path, whole)
    assert copied.config.read_text().count('"reward:') > 5


def test_a_run_with_nothing_but_truncated_checkpoints_is_not_resumed(copied, resume):
    for path in list_checkpoints(copied):
        cut_short(path)
    before = copied.metrics.read_bytes()
    with pytest.raises(UserError, match="copy has no checkpoint that can be read"):
        resume()
    assert copied.metrics.read_bytes() == before


def test_a_run_keeps_its_ground(tmp_path, flags, train, monkeypatch):
    """Check that its file may go, and that the run and the working folder may move."""
    monkeypatch.chdir(tmp_path)
    hills, other = np.arange(12.0).reshape(3, 4), np.ones((2, 2))
    np.save("hills.npy", hills)
    np.save("other.npy", other)

    def load_ground() -> np.ndarray:
        (policy,) = Path().rglob("policy.npz")
        return make_terrain(load_policy(policy).config.env.ground, 0.5).field.heights

    train(*flags(Path("runs"), "a", 1, "--env.ground.file=hills.npy"))
    Path("hills.npy").unlink()
    np.testing.assert_array_equal(load_ground(), hills)
    Path("moved").mkdir()
    Path("runs").rename("moved/runs")
    monkeypatch.chdir("moved")
    np.testing.assert_array_equal(load_ground(), hills)
    train("--resume=a", "--steps=128")
    np.testing.assert_array_equal(load_ground(), hills)
    train("--resume=a", "--steps=192", "--env.ground.file=../other.npy")
    np.testing.assert_array_equal(load_ground(), other)
    Path("runs/a/ground-other.npy").unlink()  # as an older version left it
    np.testing.assert_array_equal(load_ground(), other)


def test_a_run_that_could_not_be_resumed_is_free_while_its_error_is_held(copied, resume):
    """Hold the last error with its traceback and all its frames refer to, as a notebook does."""
    with pytest.raises(UserError, match="cannot change") as caught:
        resume("--seed=8")
    resume(f"--steps={64 * (ITERATIONS + 1)}")
    assert count_rows(copied.path) == ITERATIONS + 1
    assert caught.tb is not None


def test_it_resumes_with_another_number_of_devices(copied, resume, capsys):
    resume("--devices=1", "--steps=4160")
    assert "changed devices: 2 -> 1" in capsys.readouterr().out
    assert read_metrics(copied)[-1]["steps"] == 4160
    config = json.loads(copied.config.read_text())["config"]
    assert (config["devices"], config["steps"]) == (1, 4160)


@pytest.fixture
def small_disk(tmp_path):
    """Yield a folder on a disk of its own, of 700 kB, and functions that fill and empty it."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=700k", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("mounting a small disk is not permitted")
    ballast = folder / "ballast"

    def fill():
        with contextlib.suppress(OSError), open(ballast, "wb", buffering=0) as file:
            while True:
                file.write(bytes(512))

    yield folder, fill, lambda: ballast.unlink(missing_ok=True)
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.mark.parametrize("freed", [40, None], ids=["for a time", "for good"])
def test_a_full_disk_ends_no_training(
    whole, tmp_path, small_disk, flags, train, same_result, capsys, monkeypatch, freed
):
    folder, fill, empty = small_disk
    log_iteration = RunWriter.log_iteration

    def log(self, row, *others):
        if row["steps"] == 64 * 20:
            fill()
        if freed and row["steps"] == 64 * freed:
            empty()
        log_iteration(self, row, *others)

    monkeypatch.setattr(RunWriter, "log_iteration", log)
    run = folder / "full"
    arguments = flags(folder, "full", ITERATIONS, OFTEN)
    if freed:
        train(*arguments)
        output = capsys.readouterr().out
        assert "metrics: written again" in output
        assert "checkpoint: written again" in output
    else:
        with pytest.raises(UserError, match="No space left on device") as caught:
            train(*arguments)
        assert "the last good checkpoint is" in str(caught.value)
        assert caught.value.exit_status == 1
        output = capsys.readouterr().out
        last = find_latest_checkpoint(Run(run), pytest.fail)
        assert checkpoint.load(last, "checkpoint")[1]["steps"] >= 64 * 18
        assert load_policy(run / "policy.npz").steps >= 64 * 18
        assert len(read_metrics(Run(run))) >= 18
        empty()
        monkeypatch.setattr(RunWriter, "log_iteration", log_iteration)
        train(f"--runs={folder}", "--resume=full")
    warnings = [line for line in output.splitlines() if "No space left on device" in line]
    assert 1 <= len(warnings) <= 8
    assert all("training continues and will retry" in line for line in warnings)
    same_result(run, whole)


def test_a_limit_on_file_sizes_is_said_in_one_line(tmp_path, flags, processes):
    output = tmp_path / "output"
    arguments = flags(tmp_path, "limited", 32, OFTEN, "--envs=128")
    process = processes.Process(target=toy.run_train_without_space, args=(output, *arguments))
    process.start()
    process.join(200)
    text = output.read_text()
    assert process.exitcode == 1, text
    assert "Traceback" not in text
    errors = [line for line in text.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert "File too large" in errors[0]
    assert "step_" in errors[0]
    assert "no checkpoint yet" in errors[0]
    assert load_policy(tmp_path / "limited" / "policy.npz").steps == 32 * 64


def test_a_learner_that_is_lost_leaves_what_was_good(tmp_path, flags, train):
    run = Run(tmp_path / "lost")
    train(*flags(tmp_path, "lost", 4))
    good = {path: path.read_bytes() for path in (run.policy, run.best, run.locate_checkpoint(256))}
    arguments = [f"--runs={tmp_path}", "--resume=lost", "--steps=1280", OFTEN]
    with pytest.raises(UserError, match="no longer finite") as caught:
        train(*arguments, "--ppo.learning-rate=1e12", "--ppo.max-learning-rate=1e12")
    assert str(run.locate_checkpoint(256)) in str(caught.value)
    assert caught.value.exit_status == 1
    assert {path: path.read_bytes() for path in good} == good
    assert list_checkpoints(run) == [run.locate_checkpoint(256)]
    advice = str(caught.value).split()[-2:]
    assert advice == ["--ppo.max-learning-rate", "1e-03"]
    train(*arguments, *advice)
    rows = read_metrics(run)
    assert rows[-1]["steps"] == 1280
    assert max(row["learning_rate"] for row in rows[4:]) <= 1.0001e-3


@pytest.mark.parametrize("which", ["", "max-"])
def test_a_run_resumes_at_the_learning_rate_that_it_is_given(copied, resume, which):
    resume(f"--steps={(ITERATIONS + 1) * 64}", f"--ppo.{which}learning-rate=2e-5")
    before, after = (row["learning_rate"] for row in read_metrics(copied)[-2:])
    assert before > 1e-4
    # It has two minibatches to adapt in, but no bound to pass.
    assert after <= 2.0001e-5 * (1.0 if which else 1.5**2)
