"""Numbers as short text, for people that watch a training."""

import itertools
import math
from collections.abc import Sequence

_BARS = "▁▂▃▄▅▆▇█"


def draw_sparkline(values: Sequence[float], width: int) -> str:
    """Return a line of bars for the course of `values`, of at most `width` characters.

    The lowest bar is 0, or the least value if that is negative. A character stands for the mean of
    its values, and is blank where none is finite.
    """
    if not values or width < 1:
        return ""
    width = min(width, len(values))
    edges = [round(index * len(values) / width) for index in range(width + 1)]
    means = [_compute_mean(values[start:end]) for start, end in itertools.pairwise(edges)]
    # Shares of the largest, so that nothing overflows when a training has gone wild.
    largest = max((abs(mean) for mean in means if math.isfinite(mean)), default=0.0) or 1.0
    shares = [mean / largest for mean in means]
    finite = [share for share in shares if math.isfinite(share)]
    low = min([0.0, *finite])
    span = max([0.0, *finite]) - low or 1.0  # a line of nothing but zeros lies at the bottom
    return "".join(
        _BARS[min(7, int(8 * (share - low) / span))] if math.isfinite(share) else " "
        for share in shares
    )


def _compute_mean(values: Sequence[float]) -> float:
    """Return the mean of the finite values; NaN where there is none."""
    finite = [value for value in values if math.isfinite(value)]
    return sum(finite) / len(finite) if finite else math.nan


def format_number(value: float) -> str:
    """Return a number to three figures or so: "12.4", "-0.031"; "-" if there is none."""
    if not math.isfinite(value):
        return "-"
    if value != 0 and (abs(value) < 1e-3 or abs(value) >= 1e6):
        return f"{value:.0e}"
    digits = 3 if abs(value) < 0.1 else 2 if abs(value) < 10 else 1 if abs(value) < 1000 else 0
    return f"{value:z.{digits}f}"  # z: never -0.00


def format_percent(value: float, unit: bool = True) -> str:
    """Return a share of 1 as "3.1 %"; "-" if there is none."""
    if not math.isfinite(value):
        return "-"
    return f"{100 * value:.1f}" + (" %" if unit else "")


def format_quantity(value: float) -> str:
    """Return a count with at most three digits, "950", "52.1k" or "4.1M"; "-" for NaN."""
    if not math.isfinite(value):
        return "-"
    for unit, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if abs(value) >= 0.9995 * size:
            scaled = value / size
            return f"{scaled:.0f}{unit}" if abs(scaled) >= 99.95 else f"{scaled:.1f}{unit}"
    return f"{value:.0f}"


def format_elapsed(seconds: float) -> str:
    """Return the time that a phase took: "0.4 s", "31 s", "2:05"."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    return f"{seconds:.0f} s" if seconds < 59.5 else format_duration(seconds)


def format_duration(seconds: float) -> str:
    """Return a time as "0:07", "12:31", "1:02:03"; "-" if it is not known."""
    if not math.isfinite(seconds):
        return "-"
    minutes, second = divmod(max(0, round(seconds)), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}" if hours else f"{minute}:{second:02}"
