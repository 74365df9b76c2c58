"""The parts of Brax that this project uses, imported without what MJX prints.

Brax imports MJX, which prints that an optional back end, Warp, is not installed.
"""

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    from brax.envs.base import Env, State
    from brax.training.acme.running_statistics import NestedMeanStd, RunningStatisticsState
    from brax.training.networks import ACTIVATION
    from brax.training.types import UInt64

__all__ = [
    "ACTIVATION",
    "Env",
    "NestedMeanStd",
    "RunningStatisticsState",
    "State",
    "UInt64",
]
