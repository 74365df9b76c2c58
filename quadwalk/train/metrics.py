"""What a training iteration is summed up as."""

import collections
import math
from collections.abc import Iterable, Mapping
from typing import Any

from quadwalk.task.terms import Reward

EPISODES = 32  # the share of falls is over about this many of the last episodes
SCORED = 20  # iterations of the judges' speed that tell how good a policy is


class TrainingMetrics:
    """Makes one row of metrics from what each iteration returns.

    train/speed, train/fall_rate: of the judges, which act without noise: how good the policy is.
    noisy/speed, noisy/fall_rate: of the environments learnt from. train/reward and
    train/reward/NAME: of those too, per step and scaled, so that the terms add up to the reward.
    train/nan: episodes that a state that was not finite has ended so far.
    """

    def __init__(self, rewards: Mapping[str, Reward]) -> None:
        self._rewards = rewards
        self._judged = FallRate(EPISODES)
        self._noisy = FallRate(EPISODES)
        self._speeds: collections.deque[float] = collections.deque(maxlen=SCORED)
        self._nan = 0.0

    def state(self) -> dict[str, Any]:
        """What a resumed training needs to go on counting, as JSON data."""
        return {
            "judged": self._judged.counts,
            "noisy": self._noisy.counts,
            "speeds": list(self._speeds),
            "nan": self._nan,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from where `state` was taken."""
        self._judged = FallRate(EPISODES, state["judged"])
        self._noisy = FallRate(EPISODES, state["noisy"])
        self._speeds.extend(state.get("speeds", ()))
        self._nan = state["nan"]

    @property
    def score(self) -> float:
        """How good the policy is of late: the judges' speed, m/s, times the share not falling.

        Speed is the mean over the last `SCORED` iterations, in which 64 judges together run for
        some minutes; falls are those of "train/fall_rate", none before an episode has ended.
        """
        speed = sum(self._speeds) / len(self._speeds) if self._speeds else 0.0
        falls = self._judged.share
        return speed * (1.0 - (0.0 if math.isnan(falls) else falls))

    def row(self, steps: int, numbers: Mapping[str, Any]) -> dict[str, float]:
        """The row after `steps` control steps."""
        values = {name: float(value) for name, value in numbers.items() if name != "suspect"}
        self._nan += values["count/nan"]
        self._speeds.append(values["judge/speed"])
        terms = {
            f"train/{name}": self._rewards[name.partition("/")[2]].scale * value
            for name, value in values.items()
            if name.startswith("reward/")
        }
        learning = {
            name: value
            for name, value in values.items()
            if name.startswith(("loss/", "policy/", "learning_rate"))
        }
        return {
            "steps": steps,
            "train/speed": values["judge/speed"],
            "train/fall_rate": self._judged.add(
                values["judge/count/fell"], values["judge/count/ended"]
            ),
            "train/reward": values["reward"],
            "train/nan": self._nan,
            "noisy/speed": values["speed"],
            "noisy/fall_rate": self._noisy.add(values["count/fell"], values["count/ended"]),
            **terms,
            **learning,
        }


class FallRate:
    """The share of falls among the last episodes that ended."""

    def __init__(self, episodes: int, counts: Iterable[tuple[float, float]] = ()) -> None:
        self._episodes = episodes
        self._counts = collections.deque((fell, ended) for fell, ended in counts)

    @property
    def counts(self) -> list[tuple[float, float]]:
        """Falls and episodes of each iteration that still counts, oldest first."""
        return list(self._counts)

    def add(self, fell: float, ended: float) -> float:
        """Count one iteration's episodes; return the share."""
        self._counts.append((fell, ended))
        while sum(ended for _, ended in self._counts) - self._counts[0][1] >= self._episodes:
            self._counts.popleft()
        return self.share

    @property
    def share(self) -> float:
        """Falls over episodes; NaN before any has ended."""
        total = sum(ended for _, ended in self._counts)
        return sum(fell for fell, _ in self._counts) / total if total else float("nan")
