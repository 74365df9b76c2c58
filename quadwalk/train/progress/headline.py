"""The figure that tells best how a training goes: how it keeps to commands, else how fast it is."""

from collections.abc import Iterable
from typing import NamedTuple


class Headline(NamedTuple):
    """A figure of the evaluation environments."""

    key: str  # in a row of metrics
    name: str
    unit: str
    off: str = ""  # what it is an error of


SPEED = Headline("eval/speed", "speed", "m/s")
VELOCITY_ERROR = Headline("eval/velocity_error", "velocity error", "m/s", "off the command")


def choose_headline(names: Iterable[str]) -> Headline:
    """Return the headline of a training whose rows of metrics have these names.

    A mean speed over commands ahead and back says nothing of how they are followed.
    """
    return VELOCITY_ERROR if VELOCITY_ERROR.key in names else SPEED
