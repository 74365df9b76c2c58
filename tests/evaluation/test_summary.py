"""Intervals against tables and the equations that define them, and figures over several engines."""

import math

import numpy as np
import pytest

from quadwalk.evaluation.metrics import (
    compute_mean_interval,
    compute_share_interval,
    to_json_number,
)

# Two-sided 95 % points of Student's t by degrees of freedom, as tables print them (Fisher,
# "Statistical Methods for Research Workers", 1925, table IV).
STUDENT = {1: 12.706, 2: 4.303, 3: 3.182, 7: 2.365, 15: 2.131, 29: 2.045}
NORMAL = 1.959964


@pytest.mark.parametrize("freedom", STUDENT)
def test_the_interval_of_a_mean(freedom):
    values = np.random.default_rng(freedom).normal(3.0, 2.0, freedom + 1)
    mean, half_width = compute_mean_interval(values)
    variance = sum((value - mean) ** 2 for value in values) / freedom
    assert mean == pytest.approx(math.fsum(values) / len(values))
    error = math.sqrt(variance / len(values))
    assert half_width == pytest.approx(STUDENT[freedom] * error, rel=3e-4)


def test_one_value_has_no_interval():
    assert compute_mean_interval([4.0]) == (4.0, None)


@pytest.mark.parametrize(("count", "total"), [(3, 16), (1, 2), (500, 512)])
def test_the_ends_of_a_share_are_those_that_a_test_would_just_not_reject(count, total):
    for end in compute_share_interval(count, total):
        error = math.sqrt(end * (1 - end) / total)
        assert abs(count / total - end) == pytest.approx(NORMAL * error, rel=1e-5)


def test_none_or_all_of_a_few_are_no_certainty():
    # Where Wilson's equation has a solution in one line.
    expected = NORMAL**2 / (16 + NORMAL**2)
    assert compute_share_interval(0, 16) == pytest.approx((0.0, expected), abs=1e-6)
    assert compute_share_interval(16, 16) == pytest.approx((1 - expected, 1.0), abs=1e-6)


def test_json_has_none_for_what_is_no_number():
    found = [to_json_number(value) for value in (1, np.float32(0.5), math.nan, -math.inf)]
    assert found == [1.0, 0.5, None, None]
