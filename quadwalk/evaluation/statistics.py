"""Means and shares with their 95 % confidence intervals, as values for JSON: None where none is."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are imported when they are used: stats takes half a second


def number(value: float) -> float | None:
    """`value` for JSON, which knows no NaN."""
    return float(value) if math.isfinite(value) else None


def mean_interval(values: Sequence[float] | np.ndarray) -> tuple[float, float | None]:
    """The mean of finite values, and half its 95 % interval by Student's t; None for one alone."""
    mean, freedom = float(np.mean(values)), len(values) - 1
    if not freedom:
        return mean, None
    return mean, float(scipy.stats.t.ppf(0.975, freedom) * scipy.stats.sem(values))


def mean_figure(values: Sequence[float] | np.ndarray) -> dict[str, float | None] | None:
    """The `mean_interval` of those `values` that are finite, for JSON; None where none is."""
    finite = np.asarray(values)[np.isfinite(values)]
    if not len(finite):
        return None
    mean, half_width = mean_interval(finite)
    return {"mean": mean, "ci95": half_width}


def share_interval(count: int, total: int) -> tuple[float, float]:
    """The 95 % confidence interval of a share, `count` of `total`.

    Wilson's (J. American Statistical Association 22, 1927), which does not claim certainty where
    none or all of a few succeeded.
    """
    interval = scipy.stats.binomtest(count, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def figure_mean(figure: dict[str, Any] | None) -> float:
    """The mean of a summary's figure; NaN where there is none."""
    return math.nan if figure is None else figure["mean"]
