"""Weights & Biases: the rows that are sent, also of a resumed run; by default none."""

import sys
from types import ModuleType, SimpleNamespace

import pytest

from quadwalk.errors import UserError
from quadwalk.runs.directory import Run
from quadwalk.runs.log import read_metrics
from quadwalk.runs.wandb import check_wandb


@pytest.fixture
def calls(monkeypatch):
    """Replace the module wandb; return its calls by function."""
    calls = {"login": [], "init": [], "log": [], "finish": [], "define_metric": []}

    def record(name, answer=None):
        def call(*args, **kwargs):
            calls[name].append(kwargs or args)
            return answer

        return call

    module = ModuleType("wandb")
    module.__spec__ = SimpleNamespace(name="wandb")  # find_spec looks for it
    run = SimpleNamespace(**{name: record(name) for name in ("log", "finish", "define_metric")})
    module.login, module.init, module.Settings = record("login"), record("init", run), dict
    monkeypatch.setitem(sys.modules, "wandb", module)
    return calls


def test_the_rows_are_sent_and_a_resumed_run_continues(calls, train, flags, tmp_path):
    train(*flags(tmp_path, "sent", 2, "--log=wandb"))
    run = Run(tmp_path / "sent")
    sent = [args[0] for args in calls["log"]]
    rows = read_metrics(run)
    for row, expected in zip(sent, rows, strict=True):
        assert {name: row[name] for name in expected} == pytest.approx(expected, nan_ok=True)
    (init,) = calls["init"]
    assert (init["name"], init["id"], init["dir"]) == ("sent", None, str(run.path))
    assert init["config"]["seed"] == "0"
    assert init["settings"]["console"] == "off"
    assert len(calls["finish"]) == 1
    (run.path / "wandb" / "offline-run-20260101_000000-ab12cd").mkdir(parents=True)
    train("--resume=sent", f"--runs={tmp_path}", "--steps=192", "--log=wandb")
    assert calls["init"][1]["id"] == "ab12cd"
    assert calls["log"][-1][0]["steps"] == 192


def test_a_refused_row_is_reported_and_training_continues(calls, train, flags, tmp_path, capsys):
    def refuse(row):
        raise ConnectionError("no network")

    sys.modules["wandb"].init().log = refuse
    train(*flags(tmp_path, "alone", 2, "--log=wandb"))
    assert capsys.readouterr().out.count("warning: Weights & Biases: no network") == 1
    assert len(read_metrics(Run(tmp_path / "alone"))) == 2


def test_nothing_is_imported_unless_asked_for(calls, train, flags, tmp_path):
    train(*flags(tmp_path, "quiet", 1))
    assert not any(calls.values())


def test_a_missing_package_is_one_line(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"--log wandb needs wandb.*\[wandb\]"):
        check_wandb()
