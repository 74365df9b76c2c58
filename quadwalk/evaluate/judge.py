"""One run judged: rolled out, measured, and written down."""

import json
import time
from pathlib import Path
from typing import Any

from rich.console import Console

from quadwalk.errors import UserError
from quadwalk.evaluate.engines import engine_differences, print_engines
from quadwalk.evaluate.foot_force import with_foot_forces
from quadwalk.evaluate.gait import gait_metrics, measure_gait
from quadwalk.evaluate.options import EvalConfig
from quadwalk.evaluate.provenance import attachments, provenance
from quadwalk.evaluate.recording.mcap import write_mcap
from quadwalk.evaluate.report.pictures import render_film_strip, render_video
from quadwalk.evaluate.report.plots import plot_report
from quadwalk.evaluate.rollout import Rollout
from quadwalk.evaluate.simulate import Engine, simulate_episodes
from quadwalk.evaluate.simulating import simulating
from quadwalk.evaluate.subject import Subject
from quadwalk.evaluate.summary import (
    describe_gait,
    episode_figures,
    print_table,
    summarise,
    typical_episode,
)
from quadwalk.evaluate.view import view
from quadwalk.train.runs.directory import write_json_atomic
from quadwalk.train.settings import to_dict


def judge(subject: Subject, config: EvalConfig, out: Path, console: Console) -> dict[str, Any]:
    """Evaluate one run into the folder `out`; return what its metrics.json holds.

    The result is printed on standard output, what is being done on `console`.
    """
    engine: Engine = "mjx" if config.engine == "mjx" else "mujoco"
    name, env = subject.run.name, subject.env
    rollouts, episodes = _roll_out(subject, config, engine, console)
    summary = summarise(episodes)
    typical = typical_episode(episodes)
    gait = measure_gait(rollouts[typical], env.quadruped)
    origin = provenance(subject, config, engine)
    print_table(summary, f"{name}, {subject.policy.steps:,} steps of training, engine {engine}")
    results = {**origin, "summary": summary, "episodes": episodes}
    results["typical_episode"] = {"episode": typical, **gait_metrics(gait, env.quadruped)}
    if engine == "mujoco":
        results["mjx_summary"] = summarise(_roll_out(subject, config, "mjx", console)[1])
        results["difference_to_mjx"] = engine_differences(results["mjx_summary"], summary)
        print_engines(results["mjx_summary"], summary)
    print(describe_gait(gait, typical))
    write_json_atomic(out / "metrics.json", results)

    with console.status("writing"):
        _write_recordings(subject, config, engine, rollouts, origin, out)
        plot_report(rollouts[typical], env.quadruped, out / "report.png", name)
        pictures = _draw(config, rollouts[typical], subject, out, console)
    recorded = len(rollouts[: config.mcap])
    written = ["metrics.json", "report.png", *pictures, f"{recorded} MCAP files"]
    console.print(f"written to {out}: {', '.join(written)}")
    if recorded:
        console.print(f"see it with: rerun {out / 'episode_000.mcap'}, or open it in Foxglove")
    if config.view:
        view(rollouts[typical], env.quadruped, console)
    return results


def _roll_out(
    subject: Subject, config: EvalConfig, engine: Engine, console: Console
) -> tuple[list[Rollout], list[dict[str, Any]]]:
    """The episodes in `engine`, and the figures of each."""
    env, began = subject.env, time.monotonic()
    what = f"simulating {config.episodes} episodes in {engine}"
    with simulating(console, what, env.config.episode_steps, env.config.control_dt) as report:
        rollouts = simulate_episodes(
            env, subject.policy.act, config.episodes, config.seed, engine, report
        )
    simulated = sum(rollout.steps for rollout in rollouts) * env.config.control_dt
    took = time.monotonic() - began
    console.print(f"{subject.run.name}: {simulated:,.0f} s simulated in {engine} in {took:.1f} s")
    scales, weight = env.config.reward, env.robot.weight
    return rollouts, [episode_figures(rollout, scales, weight) for rollout in rollouts]


def _write_recordings(
    subject: Subject,
    config: EvalConfig,
    engine: Engine,
    rollouts: list[Rollout],
    origin: dict[str, Any],
    out: Path,
) -> None:
    metadata = {
        name: value if isinstance(value, str) else json.dumps(value)
        for name, value in origin.items()
    }
    metadata["config"] = json.dumps(to_dict(subject.policy.config))
    attached = attachments(subject)
    for rollout in rollouts[: config.mcap]:
        path = out / f"episode_{rollout.episode:03d}.mcap"
        complete = with_foot_forces(rollout, subject.env, engine)
        write_mcap(path, complete, subject.env.quadruped, metadata, attached)


def _draw(
    config: EvalConfig, rollout: Rollout, subject: Subject, out: Path, console: Console
) -> list[str]:
    """Draw the film strip and the video that is asked for; names of the files there are."""
    files = {"film_strip.png": render_film_strip}
    if config.video != "none":
        files[f"episode.{config.video}"] = render_video
    drawn = []
    for name, render in files.items():
        try:
            render(rollout, subject.env.quadruped, out / name)
            drawn.append(name)
        except UserError as error:  # no ffmpeg, say: everything else still works
            console.print(f"no {name}: {error}")
    return drawn
