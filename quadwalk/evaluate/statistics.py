"""How sure one can be of what some episodes show."""

import math
from collections.abc import Sequence

import numpy as np

_Z = 1.959963984540054  # 97.5 % of a normal distribution lies below


def mean_interval(values: Sequence[float] | np.ndarray) -> tuple[float, float | None]:
    """The mean, and half the width of its 95 % confidence interval by Student's t.

    None in its place for a single value. Values must be there and finite.
    """
    array = np.asarray(values, dtype=float)
    if len(array) < 2:
        return float(array.mean()), None
    error = array.std(ddof=1) / math.sqrt(len(array))
    return float(array.mean()), float(student(len(array) - 1) * error)


def student(freedom: int) -> float:
    """The 97.5 % point of Student's t with `freedom` degrees of freedom, to within one percent.

    Exact for 1 and 2; else the expansion about the normal distribution's (Abramowitz & Stegun,
    "Handbook of mathematical functions", 1964, 26.7.5).
    """
    if freedom == 1:
        return math.tan(0.475 * math.pi)
    if freedom == 2:
        return 0.95 / math.sqrt(2 * 0.975 * 0.025)
    z, n = _Z, freedom
    return (
        z
        + (z**3 + z) / (4 * n)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * n**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * n**3)
    )


def share_interval(count: int, total: int) -> tuple[float, float]:
    """The 95 % confidence interval of a share, `count` of `total`.

    Wilson's (J. American Statistical Association 22, 1927), which does not claim certainty where
    none or all of a few succeeded.
    """
    share, weight = count / total, _Z**2 / total
    middle = (share + weight / 2) / (1 + weight)
    half = _Z / (1 + weight) * math.sqrt(share * (1 - share) / total + weight / (4 * total))
    return max(middle - half, 0.0), min(middle + half, 1.0)
