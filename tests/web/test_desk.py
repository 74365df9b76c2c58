"""The arithmetic of the reward desk: its sliders' scale, its messages and its curves."""

import itertools
from typing import Any

import pytest


def make_job(**changes: Any) -> dict[str, Any]:
    """Return a job of run_desk.mjs that does nothing but these `changes`."""
    job = {"start": 1.0, "values": [], "positions": [], "moves": [], "most": 8, "figures": []}
    return job | changes


def test_a_slider_has_both_signs_and_switches_off_in_its_middle(run_node):
    positions = [-1, -0.5, -0.06, 0, 0.05, 0.53, 0.765, 1]
    answer = run_node(make_job(start=-0.2, positions=positions), "run_desk.mjs")
    assert answer["top"] == 10
    # Beyond the middle's 0.06 each of four decades takes a quarter of 0.94: 0.53 is halfway.
    assert answer["values"] == [-10, -0.075, 0, 0, 0, 0.1, 1, 10]


def test_a_value_is_where_its_slider_was(run_node):
    values = [-9.3, -0.2, -0.002, 0.0015, 0.05, 4.4]
    positions = run_node(make_job(values=values), "run_desk.mjs")["positions"]
    answer = run_node(make_job(positions=positions), "run_desk.mjs")
    assert answer["values"] == pytest.approx(values)
    # What is beyond the slider stands at its end, and what is too small is not off.
    ends = run_node(make_job(values=[1e4, -1e-9, 0]), "run_desk.mjs")["positions"]
    assert ends[0] == 1
    assert -0.07 < ends[1] < -0.06
    assert ends[2] == 0


def test_a_drag_sends_few_messages_and_the_last_value(run_node):
    moves = [[10 * k, k] for k in range(100)] + [[1400, 200]]
    sent = run_node(make_job(moves=moves), "run_desk.mjs")["sent"]
    assert [value for _, value in sent] == [99, 200]
    assert sent[1][0] - sent[0][0] > 100


def test_a_long_course_is_thinned_over_all_of_its_length(run_node):
    course = run_node(make_job(most=8, figures=list(range(100))), "run_desk.mjs")["course"]
    assert 4 <= len(course) < 8
    assert all(step == value for step, value in course)
    steps = [step for step, _ in course]
    assert steps[0] == 0
    assert steps[-1] > 80
    assert {b - a for a, b in itertools.pairwise(steps)} == {16}
