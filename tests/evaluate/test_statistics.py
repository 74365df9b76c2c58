"""Intervals against SciPy's."""

import numpy as np
import pytest
from scipy import stats

from quadwalk.evaluate.statistics import mean_interval, share_interval, student


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 7, 15, 63, 255, 10_000])
def test_students_t(freedom):
    assert student(freedom) == pytest.approx(stats.t.ppf(0.975, freedom), rel=0.01)


@pytest.mark.parametrize("count", [2, 5, 64])
def test_the_interval_of_a_mean(count):
    values = np.random.default_rng(count).normal(3.0, 2.0, count)
    mean, half_width = mean_interval(values)
    low, high = stats.t.interval(0.95, count - 1, values.mean(), stats.sem(values))
    assert mean == pytest.approx(values.mean())
    assert 2 * half_width == pytest.approx(high - low, rel=0.01)


def test_one_value_has_no_interval():
    assert mean_interval([4.0]) == (4.0, None)


@pytest.mark.parametrize(("count", "total"), [(0, 16), (3, 16), (16, 16), (1, 1), (500, 512)])
def test_the_interval_of_a_share(count, total):
    expected = stats.binomtest(count, total).proportion_ci(method="wilson")
    low, high = share_interval(count, total)
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert 0 <= low <= count / total <= high <= 1
