"""The results of an evaluation: episodes of one policy, their metrics, reports and recordings."""

import contextlib
import json
import subprocess
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image

from quadwalk.cli.shell import ROOT
from quadwalk.env.randomization import to_values
from quadwalk.evaluation.gait import Gait, flatten_gait, measure_gait
from quadwalk.evaluation.load import LoadedRun
from quadwalk.evaluation.mcap.foot_forces import add_foot_forces
from quadwalk.evaluation.mcap.write import RERUN_BLUEPRINT, write_mcap
from quadwalk.evaluation.metrics import (
    compute_metrics,
    compute_motor_limits,
    compute_weight,
    find_typical_episode,
    summarize_episodes,
)
from quadwalk.evaluation.report.pictures import draw_film_strip
from quadwalk.evaluation.rollout import GROUP, Report, Rollout, simulate_episodes
from quadwalk.files import open_atomic
from quadwalk.robot.mjcf import write_xml
from quadwalk.runs.directory import get_versions
from quadwalk.settings.serialize import to_dict

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Episodes of one policy in one engine, and their metrics."""

    loaded: LoadedRun
    seed: int
    rollouts: list[Rollout]  # of all, or of the first
    episodes: list[dict[str, Any]]  # the metrics of each, as of `compute_metrics`

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The mean of each metric over the episodes, its uncertainty, median and worst."""
        return summarize_episodes(self.episodes)

    @cached_property
    def typical(self) -> Rollout:
        """The rollout of the episode of median speed; simulated again if it was not kept."""
        number, count = find_typical_episode(self.episodes), len(self.episodes)
        if number < len(self.rollouts):
            return self.rollouts[number]
        env, act = self.loaded.env, self.loaded.policy.act
        return next(simulate_episodes(env, act, count, self.seed, only=number))

    @cached_property
    def gait(self) -> Gait:
        """The gait of the typical episode."""
        return measure_gait(self.typical, self.loaded.env.quadruped)

    @cached_property
    def origin(self) -> dict[str, Any]:
        """The origin of the metrics: run, policy, code, versions, engine and seed."""
        return make_provenance(self.loaded, self.seed)

    @cached_property
    def results(self) -> dict[str, Any]:
        """All metrics and their origin, as plain values for JSON."""
        gait = flatten_gait(self.gait, self.loaded.env.quadruped)
        return {
            **self.origin,
            "summary": self.summary,
            "episodes": self.episodes,
            "typical_episode": {"episode": self.typical.episode, **gait},
        }

    def film_strip(self, width: int = 480, height: int = 300) -> Image.Image:
        """Draw two strides of the typical episode: eight pictures joined into one.

        Each of the eight is `width` by `height` pixels.
        """
        quadruped = self.loaded.env.quadruped
        strip = draw_film_strip(self.typical, quadruped, width=width, height=height)
        return Image.fromarray(strip)

    def report(self) -> "Figure":
        """Draw the figure of the typical episode, as of `draw_report`: footfalls, speed, joints."""
        from quadwalk.evaluation.report.plots import draw_report

        count = len(self.episodes)
        title = self.loaded.run.name
        if count > 1:
            title += f": of {count} episodes the one of median speed"
        return draw_report(self.typical, self.loaded.env.quadruped, title)

    def save_mcap(self, folder: str | Path, episodes: int | None = None) -> list[Path]:
        """Write the first `episodes` of the rollouts that were kept as MCAP files into `folder`.

        By default all; none is simulated again, so there may be fewer than `episodes`. Beside them
        goes rerun.rbl, a layout for Rerun. Returns the paths of the MCAP files.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        about = {**self.origin, "config": to_dict(self.loaded.policy.config)}
        metadata = {k: v if isinstance(v, str) else json.dumps(v) for k, v in about.items()}
        attachments = make_attachments(self.loaded)
        paths = []
        for rollout in self.rollouts[:episodes]:
            paths.append(folder / f"episode_{rollout.episode:03d}.mcap")
            rollout = add_foot_forces(rollout, self.loaded.env)
            records = dict(metadata)
            if "conditions" in self.episodes[rollout.episode]:
                records["conditions"] = json.dumps(self.episodes[rollout.episode]["conditions"])
            write_mcap(paths[-1], rollout, self.loaded.env.quadruped, records, attachments)
        if paths:
            with open_atomic(folder / RERUN_BLUEPRINT.name) as file:
                file.write(RERUN_BLUEPRINT.read_bytes())
        return paths


def evaluate_policy(
    loaded: LoadedRun,
    episodes: int,
    seed: int,
    report: Report | None = None,
    keep: int | None = None,
) -> Evaluation:
    """Roll a policy out from `episodes` starts and compute the metrics of each episode.

    `report` is called with the number of control steps done. Up to `GROUP` episodes the result
    keeps every rollout; of more, the first `keep`, by default all: one of 20 s is 2 MB.
    """
    env = loaded.env
    evaluation = Evaluation(loaded, seed, [], [])
    for rollout in simulate_episodes(env, loaded.policy.act, episodes, seed, report):
        weight = compute_weight(rollout, env.mj_model)
        limits = compute_motor_limits(rollout, env.quadruped)
        metrics = compute_metrics(rollout, env.config.reward, weight, limits)
        if rollout.conditions is not None:
            metrics["conditions"] = to_values(rollout.conditions, env.stepping)
        evaluation.episodes.append(metrics)
        if keep is None or episodes <= GROUP or rollout.episode < keep:
            evaluation.rollouts.append(rollout)
    return evaluation


def make_provenance(loaded: LoadedRun, seed: int) -> dict[str, Any]:
    """Return what was evaluated and by which versions, seed and engine, as plain values for JSON.

    `seed` is the one that the starts were sampled with.
    """
    return {
        "run": loaded.run.name,
        "engine": loaded.env.engine,
        "seed": seed,
        "seconds": loaded.env.config.episode_seconds,
        "randomized": loaded.env.config.randomization.enabled,
        "training_steps": loaded.policy.steps,
        "policy_sha256": loaded.sha256,
        "notes": list(loaded.notes),
        "revision": find_revision(),
        "versions": get_versions(),
    }


def find_revision(source: Path = ROOT) -> str:
    """Return "git COMMIT" of the checkout `source`, with "-dirty" if files differ from it.

    Without git or a checkout it is "quadwalk VERSION".
    """
    # An installed package may lie inside some other project's checkout, whose commit is not its.
    if (source / ".git").exists():
        command = ["git", "--no-optional-locks", "-C", str(source), "describe", "--always"]
        command += ["--dirty", "--abbrev=40", "--exclude=*"]
        with contextlib.suppress(OSError, subprocess.SubprocessError):
            commit = subprocess.check_output(
                command, stderr=subprocess.DEVNULL, text=True, timeout=10
            ).strip()
            if commit:
                return f"git {commit}"
    return f"quadwalk {get_versions()['quadwalk']}"


def make_attachments(loaded: LoadedRun) -> dict[str, bytes]:
    """Return by name what to attach to each recording: the run's config.json, the robot's MJCF.

    The MJCF is without the ground. Without a config.json the run attaches none.
    """
    quadruped = loaded.load_level_robot()  # a recording shows the ground of its own
    files = {f"{quadruped.name}.xml": write_xml(quadruped.spec).encode()}
    if loaded.config is not None:
        files["config.json"] = loaded.config
    return files
