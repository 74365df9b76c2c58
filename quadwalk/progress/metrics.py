"""The row of metrics that sums up an iteration of training, and its figures that tell most."""

import collections
import math
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:  # which imports JAX: a display shows something before
    from quadwalk.settings.terms import Reward

EPISODES = 32  # the share of falls is over about this many of the last episodes
LEVEL = "train/level/"  # before a kind of ground
SCORED = 20  # iterations whose scored figures tell how good a policy is


class Headline(NamedTuple):
    """The figure of a row of metrics that tells best how a training goes."""

    key: str
    name: str
    unit: str
    factor: float = 1.0  # from the row's number to the unit
    off: str = ""  # what it is an error of

    def get_value(self, row: Mapping[str, Any]) -> float:
        """Return the figure of a row in `unit`, such as m/s or %; NaN where the row has none."""
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


def get_scored_figure(row: Mapping[str, Any]) -> float:
    """Return the figure of a row of metrics that its task is about.

    It is the share of time standing where episodes start in any pose, else the speed, m/s.
    """
    return float(row.get("eval/standing", row["eval/speed"]))


def compute_score(figures: Collection[float], falls: float) -> float:
    """Return how good a policy is: the mean of its scored figures, times the share not falling.

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
    train/fell/CLASS, train/velocity_error/CLASS, train/standing/CLASS: with several bodies, of a
    class of them, such as light. They are the share of control steps that end in a fall, the
    velocity error, and the share of time that robots stand.
    train/level/KIND: with a curriculum, the mean level, from 0, of environments on that ground.
    """

    def __init__(self, rewards: "Mapping[str, Reward]") -> None:
        self.rewards = rewards
        self._train_falls = FallRate(EPISODES)
        self._eval_falls = FallRate(EPISODES)
        self._figures: collections.deque[float] = collections.deque(maxlen=SCORED)
        self._nan = 0.0

    def get_state(self) -> dict[str, Any]:
        """Return the counts of falls, NaN and scored figures so far, as JSON data for `restore`."""
        return {
            "train_falls": self._train_falls.counts,
            "eval_falls": self._eval_falls.counts,
            "speeds": list(self._figures),
            "nan": self._nan,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `get_state` returned."""
        self._train_falls = FallRate(EPISODES, state["train_falls"])
        self._eval_falls = FallRate(EPISODES, state["eval_falls"])
        self._figures.extend(map(float, state["speeds"]))
        self._nan = float(state["nan"])

    @property
    def score(self) -> float:
        """The score of the policy in the last `SCORED` iterations."""
        return compute_score(self._figures, self._eval_falls.share)

    def make_row(self, steps: int, numbers: Mapping[str, Any]) -> dict[str, float]:
        """Count one iteration and return its row, of the names above, after `steps` control steps.

        `steps` are those of all environments since the start; `numbers` come from
        `quadwalk.learn.ppo`.
        """
        values = {name: float(value) for name, value in numbers.items() if name != "nan_step"}
        self._nan += values["count/nan"]
        self._figures.append(get_scored_figure(values))
        fixed = {
            "steps": steps,
            "train/speed": values["speed"],
            "train/fall_rate": self._train_falls.add(values["count/fell"], values["count/ended"]),
            "train/reward": values["reward"],
            "train/nan": self._nan,
            "eval/speed": values["eval/speed"],
            "eval/fall_rate": self._eval_falls.add(
                values["eval/count/fell"], values["eval/count/ended"]
            ),
        }
        names = ("eval/velocity_error", "eval/standing")
        of_task = {name: values[name] for name in names if name in values}
        terms, levels, classes, learning = {}, {}, {}, {}
        for name, value in values.items():
            kind, _, rest = name.partition("/")
            if kind == "reward" and rest:
                terms[f"train/{name}"] = self.rewards[rest].scale * value
            elif name.startswith("count/level/"):
                robots = values[name.replace("level", "robots", 1)]
                levels[LEVEL + name.removeprefix("count/level/")] = value / max(robots, 1.0)
            elif kind == "count":
                figure, _, body_class = rest.partition("/")
                bodies = values.get(f"count/bodies/{body_class}")
                if bodies is not None and figure != "bodies":
                    classes[f"train/{rest}"] = value / max(bodies, 1e-9)
            elif name.startswith(("loss/", "policy/", "learning_rate")):
                learning[name] = value
        return {**fixed, **of_task, **terms, **levels, **classes, **learning}


class FallRate:
    """The share of falls among the last episodes that ended."""

    def __init__(self, episodes: int, counts: Iterable[tuple[float, float]] = ()) -> None:
        self._episodes = episodes
        self._counts = collections.deque((float(fell), float(ended)) for fell, ended in counts)

    @property
    def counts(self) -> list[tuple[float, float]]:
        """(Falls, ended episodes) of each iteration that `share` is taken over, oldest first."""
        return list(self._counts)

    def add(self, fell: float, ended: float) -> float:
        """Count one iteration's episodes; return the share."""
        self._counts.append((fell, ended))
        while sum(ended for _, ended in self._counts) - self._counts[0][1] >= self._episodes:
            self._counts.popleft()
        return self.share

    @property
    def share(self) -> float:
        """Falls over ended episodes of `counts`, 0 to 1; NaN before any has ended."""
        total = sum(ended for _, ended in self._counts)
        return sum(fell for fell, _ in self._counts) / total if total else float("nan")
