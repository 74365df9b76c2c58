"""The printed evaluation, in terminals of any width."""

import pytest

from quadwalk.evaluation.report import tables as tables

FIGURE = {"mean": 1253.871, "ci95": 13.259, "median": 1256.514, "worst": -0.0001}
SUMMARY = {
    "episodes": 16,
    "fall_rate": 0.0,
    "fall_rate_ci95": [0.0, 0.19],
    **dict.fromkeys(("speed", "torque_limit", "peak_power"), FIGURE),
    "reward/roll_pitch_rate": {"mean": -0.0002, "ci95": 0.0, "median": 0.0, "worst": -0.0004},
}
WORDS = {"(0", "episodes)", "mechanical", "roll_pitch_rate", "1253.871", "1256.514", "median"}


@pytest.fixture(params=[30, 60, 80, 120])
def width(request, monkeypatch) -> int:
    monkeypatch.setenv("COLUMNS", str(request.param))
    return request.param


def test_no_word_of_a_table_is_broken(width, capsys):
    tables.print_summary(SUMMARY, "run")
    output = capsys.readouterr().out
    assert set(output.split()) >= WORDS
    if width >= 80:
        assert max(map(len, output.splitlines())) <= width


@pytest.mark.parametrize("other", [1.0, 0.999])
def test_engines_side_by_side_fit_80_columns(monkeypatch, capsys, other):
    monkeypatch.setenv("COLUMNS", "80")
    slower = {**FIGURE, "mean": other * FIGURE["mean"]}
    second = {**SUMMARY, **dict.fromkeys(("speed", "torque_limit", "peak_power"), slower)}
    tables.print_engines(SUMMARY, second)
    output = capsys.readouterr().out
    assert {"mechanical", "difference", "MJX's", "1254"} <= set(output.split())
    assert max(map(len, output.splitlines())) <= 80


def test_nothing_is_minus_zero(capsys):
    tables.print_summary(SUMMARY, "run")
    assert "-0.000" not in capsys.readouterr().out
    assert tables.format_value({"mean": -0.00004, "ci95": None}) == "0.000"


def test_a_paragraph_ends_its_lines_between_words(width, capsys, monkeypatch):
    text = "the gait of an episode, " * 8
    tables.print_text(text)
    assert capsys.readouterr().out == f"{text}\n"  # a file has it as it is
    monkeypatch.setenv("FORCE_COLOR", "1")
    tables.print_text(text)
    output = capsys.readouterr().out
    assert output.split() == text.split()
    assert max(map(len, output.splitlines())) <= width
