"""Evaluations of the runs of jobs, computed in processes of their own."""

import os
import signal

from quadwalk.runs.directory import Run
from quadwalk.runs.log import read_metrics


def get_last_reward(run: Run) -> float:
    """Return the training's reward in the last row of a run's metrics."""
    return read_metrics(run)[-1]["train/reward"]


def die_once(run: Run) -> float:
    """Kill this process the first time for `run`, and return its last reward the second time."""
    mark = run.path / "died"
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return get_last_reward(run)
