"""A training that is watched saves its policy often, and changes nothing else."""

import contextlib

from quadwalk.train.progress.watch import WATCHED
from quadwalk.train.runs.directory import Run
from quadwalk.train.runs.policy import load_score


def test_a_watched_training_saves_its_policy_often(train, flags, tmp_path, monkeypatch):
    pages, policies = [], []

    @contextlib.contextmanager
    def page(run, say):
        pages.append((run.name, load_score(run.policy)[0]))
        yield

    monkeypatch.setattr("quadwalk.train.loop.watched", page)
    monkeypatch.setattr("quadwalk.train.loop.check_watch", lambda: None)
    often = f"--checkpoint-steps={64 * WATCHED}"

    def look(row: dict[str, float]) -> None:
        policies.append((row["steps"], load_score(Run(tmp_path / "seen").policy)[0]))

    train(*flags(tmp_path, "seen", 3, "--watch", often), watch=look)
    assert pages == [("seen", 0)]  # it has a policy from the first moment
    assert policies == [(64, 0), (128, 64), (192, 128)]
    assert load_score(Run(tmp_path / "seen").policy)[0] == 192
    train(*flags(tmp_path, "unseen", 3, often))
    assert (tmp_path / "seen" / "metrics.jsonl").read_bytes() == (
        tmp_path / "unseen" / "metrics.jsonl"
    ).read_bytes()
