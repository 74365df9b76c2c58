"""Which policy is the best, and what is kept of it."""

import dataclasses
import json
from types import SimpleNamespace

import jax
import numpy as np
import optax
import pytest
from brax.training.acme import running_statistics, specs

from quadwalk.errors import UserError
from quadwalk.tasks import sprint
from quadwalk.train.learner.iteration import TrainState
from quadwalk.train.learner.networks import make_networks
from quadwalk.train.learner.ppo import Learner
from quadwalk.train.runs.directory import Run, create_run, list_checkpoints
from quadwalk.train.runs.log import read_metrics
from quadwalk.train.runs.policy import load_policy, load_score
from quadwalk.train.runs.writer import KEPT_CHECKPOINTS, RunWriter

CONFIG = dataclasses.replace(sprint.TASK, ppo=dataclasses.replace(sprint.TASK.ppo, hidden=(4,)))
JOINTS = tuple(f"joint_{index}" for index in range(12))


class Scores:
    """Stands for the metrics of a training whose score is told."""

    score = 0.0

    def state(self):
        return {}


@pytest.fixture
def state() -> TrainState:
    networks = make_networks(CONFIG.ppo, 3, 12)
    params = networks.init(jax.random.PRNGKey(0))
    normalizer = running_statistics.init_state(specs.Array((3,), np.dtype("float32")))
    return TrainState(Learner(params, optax.EmptyState(), normalizer, np.int32(0)), np.zeros(2))


@pytest.fixture
def training():
    return SimpleNamespace(
        config=CONFIG,
        quadruped=SimpleNamespace(joints=JOINTS),
        networks=make_networks(CONFIG.ppo, 3, 12),
        metrics=Scores(),
        steps=0,
        resumed=False,
    )


@pytest.fixture
def run(tmp_path):
    return create_run(tmp_path, "a")


def save(writer, training, state, *scores):
    """A checkpoint for each score, after 10, 20, ... steps more."""
    for score in scores:
        training.metrics.score = score
        training.steps += 10
        # What a checkpoint holds does not matter here, and an empty state is quickly written.
        assert writer.save(state, training.steps, 1.0)


@pytest.fixture(autouse=True)
def _small_checkpoints(monkeypatch):
    from quadwalk.train.runs import checkpoint

    whole = checkpoint.save

    def small(path, tree, metadata):
        whole(path, tree if metadata["kind"] == "policy" else {}, metadata)

    monkeypatch.setattr(checkpoint, "save", small)


def test_the_best_policy_and_its_checkpoint_outlive_later_ones(run, training, state):
    with RunWriter(training, run, pytest.fail) as writer:
        save(writer, training, state, 1.0, 3.0, 3.0, 2.0, 1.0, 2.5, 0.0)
    assert load_score(run.best) == (20, 3.0)
    assert load_policy(run.best).steps == 20
    assert load_score(run.policy) == (70, 0.0)
    kept = [run.checkpoint(steps) for steps in (20, 50, 60, 70)]
    assert list_checkpoints(run) == kept
    assert len(kept) == KEPT_CHECKPOINTS + 1


def test_what_has_not_been_judged_is_not_the_best(run, training, state):
    with RunWriter(training, run, pytest.fail) as writer:
        assert writer.save(state, 0, 1.0)
        assert not run.best.exists()
        save(writer, training, state, -2.0, -1.0, -3.0)
    assert load_score(run.best) == (20, -1.0)


def test_a_run_that_goes_on_remembers_the_best(run, training, state):
    with RunWriter(training, run, pytest.fail) as writer:
        save(writer, training, state, 1.0, 3.0)
    with RunWriter(training, run, pytest.fail) as writer:
        assert writer.best == (20, 3.0)
        save(writer, training, state, 2.0, 2.0, 2.0, 2.0)
        assert load_score(run.best) == (20, 3.0)
        assert run.checkpoint(20).exists()
        save(writer, training, state, 3.5, 1.0)
    assert load_score(run.best) == (70, 3.5)
    assert list_checkpoints(run) == [run.checkpoint(steps) for steps in (60, 70, 80)]


def test_a_best_policy_that_is_damaged_is_told_and_replaced(run, training, state):
    run.best.write_bytes(b"half")
    said = []
    with RunWriter(training, run, said.append) as writer:
        save(writer, training, state, 1.0)
    assert "best.npz is damaged" in said[0]
    assert load_score(run.best) == (10, 1.0)


def test_a_policy_remembers_in_what_order_it_sees(run, training, state):
    # Alphabetical order would give each weight another number of the observation.
    with RunWriter(training, run, pytest.fail) as writer:
        save(writer, training, state, 1.0)
    found = load_policy(run.policy).config.env
    assert list(found.observation) == list(training.config.env.observation)
    assert list(found.observation) != sorted(found.observation)
    assert list(found.critic) == list(training.config.env.critic)


def test_a_policy_that_tells_no_score_is_named(tmp_path):
    from quadwalk.train.runs import checkpoint

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
    said = capsys.readouterr().out
    assert f"best.npz ({'the same' if steps == 768 else f'after {steps} steps'})" in said


def test_who_watches_is_told_each_row_once_it_is_written(tmp_path, flags, train):
    watched, written = [], []

    def watch(row):
        watched.append(row)
        written.append(read_metrics(Run(tmp_path / "a"))[-1])

    train(*flags(tmp_path, "a", 5), watch=watch)
    assert [row["steps"] for row in watched] == [64, 128, 192, 256, 320]
    for row, same in zip(watched, written, strict=True):
        np.testing.assert_equal({**row}, same)
