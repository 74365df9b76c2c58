"""A run's policy rolled out and measured: what the command writes down, and a notebook looks at."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image

from quadwalk.env.randomization import as_values
from quadwalk.evaluation.loaded import LoadedRun
from quadwalk.evaluation.motion.course import motor_limits, weight_of
from quadwalk.evaluation.motion.forces import with_foot_forces
from quadwalk.evaluation.motion.gait import Gait, gait_metrics, measure_gait
from quadwalk.evaluation.recording.mcap import RERUN_BLUEPRINT, write_mcap
from quadwalk.evaluation.recording.provenance import attachments, provenance
from quadwalk.evaluation.report.pictures import draw_film_strip
from quadwalk.evaluation.rollout import Rollout
from quadwalk.evaluation.simulate import GROUP, Report, simulate_episodes
from quadwalk.evaluation.summary import episode_figures, summarize, typical_episode
from quadwalk.files import atomic_write
from quadwalk.settings.serialize import to_dict

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Episodes of one policy in one engine, and their figures."""

    loaded: LoadedRun
    seed: int
    rollouts: list[Rollout]  # of all, or of the first
    episodes: list[dict[str, Any]]  # the figures of each, as `episode_figures` defines them

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Of each figure the mean over the episodes, its uncertainty, median and worst."""
        return summarize(self.episodes)

    @cached_property
    def typical(self) -> Rollout:
        """The episode of median speed: the one to look at."""
        number, count = typical_episode(self.episodes), len(self.episodes)
        if number < len(self.rollouts):
            return self.rollouts[number]
        env, act = self.loaded.env, self.loaded.policy.act
        return next(simulate_episodes(env, act, count, self.seed, only=number))

    @cached_property
    def gait(self) -> Gait:
        """How that episode ran."""
        return measure_gait(self.typical, self.loaded.env.quadruped)

    @cached_property
    def origin(self) -> dict[str, Any]:
        """Where the figures come from: run, policy, code, versions, engine and seed."""
        return provenance(self.loaded, self.seed)

    @cached_property
    def results(self) -> dict[str, Any]:
        """All figures as plain values for JSON, and where they come from."""
        gait = gait_metrics(self.gait, self.loaded.env.quadruped)
        return {
            **self.origin,
            "summary": self.summary,
            "episodes": self.episodes,
            "typical_episode": {"episode": self.typical.episode, **gait},
        }

    def film_strip(self, width: int = 480, height: int = 300) -> Image.Image:
        """Eight pictures of two strides of the typical episode, each of so many pixels."""
        quadruped = self.loaded.env.quadruped
        strip = draw_film_strip(self.typical, quadruped, width=width, height=height)
        return Image.fromarray(strip)

    def report(self) -> "Figure":
        """The typical episode as plots: footfalls, speed, joints, torques, rewards, path."""
        from quadwalk.evaluation.report.plots import draw_report

        count = len(self.episodes)
        title = self.loaded.run.name
        if count > 1:
            title += f": of {count} episodes the one of median speed"
        return draw_report(self.typical, self.loaded.env.quadruped, title)

    def save_mcap(self, folder: str | Path, episodes: int | None = None) -> list[Path]:
        """Write the first `episodes`, by default all, as MCAP files for Rerun or Foxglove.

        Beside them goes rerun.rbl, a layout for Rerun.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        about = {**self.origin, "config": to_dict(self.loaded.policy.config)}
        metadata = {k: v if isinstance(v, str) else json.dumps(v) for k, v in about.items()}
        attached = attachments(self.loaded)
        written = []
        for rollout in self.rollouts[:episodes]:
            written.append(folder / f"episode_{rollout.episode:03d}.mcap")
            complete = with_foot_forces(rollout, self.loaded.env)
            drawn = self.episodes[rollout.episode].get("conditions")
            own = {} if drawn is None else {"conditions": json.dumps(drawn)}
            write_mcap(written[-1], complete, self.loaded.env.quadruped, metadata | own, attached)
        if written:
            with atomic_write(folder / RERUN_BLUEPRINT.name) as file:
                file.write(RERUN_BLUEPRINT.read_bytes())
        return written


def measure(
    loaded: LoadedRun,
    episodes: int,
    seed: int,
    report: Report | None = None,
    whole: int | None = None,
) -> Evaluation:
    """Roll the policy out from `episodes` fresh starts and measure each.

    `report` is called with the control steps done. Of many episodes the first `whole` rollouts
    are kept, or all: one of 20 s is 2 MB.
    """
    env = loaded.env
    found = Evaluation(loaded, seed, [], [])
    for rollout in simulate_episodes(env, loaded.policy.act, episodes, seed, report):
        weight, limits = weight_of(rollout, env.mj_model), motor_limits(rollout, env.quadruped)
        own = episode_figures(rollout, env.config.reward, weight, limits)
        if rollout.conditions is not None:
            own["conditions"] = as_values(rollout.conditions, env.stepping)
        found.episodes.append(own)
        if whole is None or episodes <= GROUP or rollout.episode < whole:
            found.rollouts.append(rollout)
    return found
