"""The figure that tells best how a training goes, of those of its evaluation environments."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple


class Headline(NamedTuple):
    """A figure in rows of metrics."""

    key: str
    name: str
    unit: str
    factor: float = 1.0  # from the row's number to the unit
    off: str = ""  # what it is an error of

    def value(self, row: Mapping[str, Any]) -> float:
        """Return the figure in its unit; NaN where the row has none."""
        number = row.get(self.key)
        return math.nan if number is None else self.factor * float(number)


SPEED = Headline("eval/speed", "speed", "m/s")
VELOCITY_ERROR = Headline("eval/velocity_error", "velocity error", "m/s", off="off the command")
STANDING = Headline("eval/standing", "standing", "% of the time", factor=100.0)


def choose_headline(names: Iterable[str]) -> Headline:
    """Return the headline of a training whose rows of metrics have these names.

    A mean speed over commands ahead and back says nothing of how they are followed.
    """
    present = set(names)
    return next((line for line in (VELOCITY_ERROR, STANDING) if line.key in present), SPEED)
