"""What a training iteration is summed up as."""

import collections
import math
from collections.abc import Collection, Iterable, Mapping
from typing import Any

from quadwalk.settings.terms import Reward

EPISODES = 32  # the share of falls is over about this many of the last episodes
LEVEL = "train/level/"  # before a kind of ground
SCORED = 20  # iterations whose `scored_figure` tells how good a policy is


def scored_figure(row: Mapping[str, Any]) -> float:
    """Return the figure of a row of metrics that its task is about.

    It is the share of time standing where episodes start in any pose, else the speed, m/s.
    """
    return float(row.get("eval/standing", row["eval/speed"]))


def score(figures: Collection[float], falls: float) -> float:
    """Return how good a policy is: the mean of its `scored_figure`, times the share not falling.

    A speed below 0 is no better for falls. `figures` are those of the last `SCORED` iterations, in
    which 64 evaluation environments together run for some minutes; no falls are counted before an
    episode has ended, while `falls` is NaN.
    """
    mean = sum(figures) / len(figures) if figures else 0.0
    return min(mean, mean * (1.0 - (0.0 if math.isnan(falls) else falls)))


class TrainingMetrics:
    """Makes one row of metrics from what each iteration returns.

    train/speed, train/fall_rate, train/reward, train/reward/NAME: of the environments learned from;
    rewards are per step and scaled, so that the terms add up to the reward. train/nan: episodes
    that a state with NaN has ended so far. eval/speed, eval/fall_rate: of the evaluation
    environments, where the policy acts without noise. Speeds in m/s, falls as a share of episodes.
    eval/velocity_error: with velocity commands, how far the velocity is from them in a step, m/s.
    eval/standing: the share of time that those stand, of tasks that start in any pose.
    train/level/KIND: with a curriculum, the mean level, from 0, of environments on that ground.
    """

    def __init__(self, rewards: Mapping[str, Reward]) -> None:
        self._rewards = rewards
        self._train_falls = FallRate(EPISODES)
        self._eval_falls = FallRate(EPISODES)
        self._figures: collections.deque[float] = collections.deque(maxlen=SCORED)
        self._nan = 0.0

    def state(self) -> dict[str, Any]:
        """What a resumed training needs to go on counting, as JSON data."""
        return {
            "train_falls": self._train_falls.counts,
            "eval_falls": self._eval_falls.counts,
            "speeds": list(self._figures),
            "nan": self._nan,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from where `state` was taken."""
        self._train_falls = FallRate(EPISODES, state["train_falls"])
        self._eval_falls = FallRate(EPISODES, state["eval_falls"])
        self._figures.extend(map(float, state["speeds"]))
        self._nan = float(state["nan"])

    @property
    def score(self) -> float:
        """How good the policy is of late, by `score` of the last `SCORED` iterations."""
        return score(self._figures, self._eval_falls.share)

    def row(self, steps: int, numbers: Mapping[str, Any]) -> dict[str, float]:
        """The row after `steps` control steps, from what `quadwalk.learn.ppo` gives."""
        values = {name: float(value) for name, value in numbers.items() if name != "nan_step"}
        self._nan += values["count/nan"]
        self._figures.append(scored_figure(values))
        names = ("eval/velocity_error", "eval/standing")
        of_task = {name: values[name] for name in names if name in values}
        terms = {
            f"train/{name}": self._rewards[name.partition("/")[2]].scale * value
            for name, value in values.items()
            if name.startswith("reward/")
        }
        levels = {
            f"{LEVEL}{name.removeprefix('count/level/')}": value
            / max(values[name.replace("level", "robots", 1)], 1.0)
            for name, value in values.items()
            if name.startswith("count/level/")
        }
        learning = {
            name: value
            for name, value in values.items()
            if name.startswith(("loss/", "policy/", "learning_rate"))
        }
        return {
            "steps": steps,
            "train/speed": values["speed"],
            "train/fall_rate": self._train_falls.add(values["count/fell"], values["count/ended"]),
            "train/reward": values["reward"],
            "train/nan": self._nan,
            "eval/speed": values["eval/speed"],
            "eval/fall_rate": self._eval_falls.add(
                values["eval/count/fell"], values["eval/count/ended"]
            ),
            **of_task,
            **terms,
            **levels,
            **learning,
        }


class FallRate:
    """The share of falls among the last episodes that ended."""

    def __init__(self, episodes: int, counts: Iterable[tuple[float, float]] = ()) -> None:
        self._episodes = episodes
        self._counts = collections.deque((float(fell), float(ended)) for fell, ended in counts)

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
