"""Policies and checkpoints that a training saves: the newest, the best and a few before."""

import contextlib
import json

import crash
import numpy as np
import pytest

from quadwalk.errors import UserError
from quadwalk.learn.acting import load_policy
from quadwalk.learn.writer import KEPT_CHECKPOINTS, RunWriter
from quadwalk.progress.watch import WATCHED
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run, create_run, list_checkpoints
from quadwalk.runs.log import read_metrics
from quadwalk.runs.policy import load_score
from quadwalk.task_files import load_task


@pytest.fixture
def run(tmp_path):
    return create_run(tmp_path, "a")


@pytest.fixture
def write(run):
    """Save a checkpoint for each score, each so many steps after the one before."""
    training = crash.make_training(0)

    def save(*scores: float, steps: int = 10, warn=pytest.fail) -> None:
        with RunWriter(training, run, warn) as writer:
            for score in scores:
                training.metrics.score = score
                training.steps += steps
                assert writer.save(crash.make_state(training.steps), training.steps, 1.0)

    return save


def test_the_best_policy_and_its_checkpoint_outlive_later_ones(run, write):
    write(1.0, 3.0, 3.0, 2.0, 1.0, 2.5, 0.0)
    assert load_score(run.best) == (20, 3.0)
    assert load_score(run.policy) == (70, 0.0)
    steps = (20, *range(80 - 10 * KEPT_CHECKPOINTS, 80, 10))
    assert list_checkpoints(run) == list(map(run.locate_checkpoint, steps))


def test_a_policy_without_a_score_is_not_the_best(run, write):
    write(0.0, steps=0)
    assert not run.best.exists()
    write(-2.0, -1.0, -3.0)
    assert load_score(run.best) == (20, -1.0)


def test_a_run_that_is_resumed_remembers_the_best(run, write):
    write(1.0, 3.0)
    write(2.0, 2.0, 2.0, 2.0)
    assert load_score(run.best) == (20, 3.0)
    assert run.locate_checkpoint(20).exists()
    write(3.5, 1.0)
    assert load_score(run.best) == (70, 3.5)
    assert list_checkpoints(run) == [run.locate_checkpoint(steps) for steps in (60, 70, 80)]


def test_a_best_policy_that_is_damaged_is_reported_and_replaced(run, write):
    run.best.write_bytes(b"half")
    warnings = []
    write(1.0, warn=warnings.append)
    assert "best.npz is damaged" in warnings[0]
    assert load_score(run.best) == (10, 1.0)


def test_a_policy_that_tells_no_score_is_named(tmp_path):
    checkpoint.save(tmp_path / "old.npz", {"a": np.zeros(1)}, {"kind": "policy", "steps": 3})
    with pytest.raises(UserError, match=r"old\.npz does not say how good"):
        load_score(tmp_path / "old.npz")


def test_the_end_says_which_policy_is_the_best(tmp_path, flags, train, capsys):
    train(*flags(tmp_path, "a", 12, "--checkpoint-steps=256"))
    steps, score = load_score(tmp_path / "a" / "best.npz")
    rows = [json.loads(line) for line in (tmp_path / "a" / "metrics.jsonl").open()]
    scores = {row["steps"]: np.mean([r["eval/speed"] for r in rows[: k + 1]])
              for k, row in enumerate(rows)}  # fmt: skip
    saved = {steps: scores[steps] for steps in (256, 512, 768)}
    assert saved[steps] == max(saved.values())
    assert score == pytest.approx(saved[steps])
    output = capsys.readouterr().out
    assert f"best.npz ({'the same' if steps == 768 else f'after {steps} steps'})" in output


def test_a_policy_remembers_in_what_order_it_sees(tmp_path, flags, train):
    # Alphabetical order would give each weight another number of the observation.
    train(*flags(tmp_path, "a", 1))
    saved, task = load_policy(Run(tmp_path / "a").policy).config.env, load_task("run").env
    assert list(saved.observation) == list(task.observation)
    assert list(saved.observation) != sorted(saved.observation)
    assert list(saved.critic) == list(task.critic)


def test_a_callback_gets_each_row_once_it_is_written(tmp_path, flags, train):
    callback_rows, file_rows = [], []

    def watch(row):
        callback_rows.append(row)
        file_rows.append(read_metrics(Run(tmp_path / "a"))[-1])

    train(*flags(tmp_path, "a", 5), watch=watch)
    assert [row["steps"] for row in callback_rows] == [64, 128, 192, 256, 320]
    for row, same in zip(callback_rows, file_rows, strict=True):
        np.testing.assert_equal({**row}, same)


def test_a_watched_training_saves_its_policy_often(train, flags, tmp_path, monkeypatch):
    pages, policies = [], []

    @contextlib.contextmanager
    def page(path, say):
        pages.append((path.name, load_score(Run(path).policy)[0]))
        yield

    monkeypatch.setattr("quadwalk.learn.loop.show_page", page)
    monkeypatch.setattr("quadwalk.learn.loop.check_watch", lambda: None)
    often = f"--checkpoint-steps={64 * WATCHED}"

    def look(row: dict[str, float]) -> None:
        policies.append((row["steps"], load_score(Run(tmp_path / "seen").policy)[0]))

    train(*flags(tmp_path, "seen", 3, "--watch", often), watch=look)
    assert pages == [("seen", 0)]  # it has a policy from the first moment
    assert policies == [(64, 0), (128, 64), (192, 128)]
    assert load_score(Run(tmp_path / "seen").policy)[0] == 192
    train(*flags(tmp_path, "unseen", 3, often))
    watched_metrics, plain_metrics = (
        Run(tmp_path / name).metrics.read_bytes() for name in ("seen", "unseen")
    )
    assert watched_metrics == plain_metrics
