"""An evaluation from start to end: load, roll out, measure, write."""

import dataclasses
import datetime
import json
import time
from pathlib import Path
from typing import Any

from rich.console import Console

from quadwalk.errors import UserError
from quadwalk.evaluate.__main__ import EvalConfig
from quadwalk.files import why
from quadwalk.train.run import Run, find_run, write_json_atomic


def evaluate(config: EvalConfig) -> dict[str, Any]:
    """Evaluate as `config` says; return what metrics.json holds."""
    run = find_run(config.runs, config.run)
    out = _make_output(config, run)
    # On stderr: what is printed on stdout is the result alone.
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    console.print(f"evaluating {run.path}, {config.episodes} episodes in {config.engine}")

    # Before anything imports JAX; and all of these late, since they take seconds.
    from quadwalk.train.devices import set_up_devices

    set_up_devices()
    from quadwalk.env.quadruped import QuadrupedEnv
    from quadwalk.evaluate.gait import gait_metrics, measure_gait
    from quadwalk.evaluate.mcap import write_mcap
    from quadwalk.evaluate.plots import plot_report
    from quadwalk.evaluate.render import render_film_strip
    from quadwalk.evaluate.simulate import simulate_episodes
    from quadwalk.evaluate.summary import (
        describe_gait,
        episode_figures,
        print_table,
        summarise,
        typical_episode,
    )
    from quadwalk.train import checkpoint
    from quadwalk.train.config import to_dict
    from quadwalk.train.policy import load_policy
    from quadwalk.train.robot import load_run_robot
    from quadwalk.train.versions import versions

    policy = load_policy(run.policy)
    quadruped = load_run_robot(run, policy.config.robot)
    env_config = dataclasses.replace(policy.config.env, episode_seconds=config.seconds)
    env = QuadrupedEnv(quadruped, env_config)
    if quadruped.joints != policy.joints or env.observation_size != policy.observation_size:
        raise UserError(
            f"{run.policy} was trained on another robot than {run.urdf}: it has joints "
            f"{', '.join(policy.joints)} and {policy.observation_size} observations"
        )

    began = time.monotonic()
    with console.status("simulating"):
        rollouts = simulate_episodes(
            env,
            policy.act,
            config.episodes,
            config.seed,
            config.engine,  # type: ignore[arg-type]
        )
    episodes = [episode_figures(rollout, env_config.reward) for rollout in rollouts]
    summary = summarise(episodes)
    typical = typical_episode(episodes)
    gait = measure_gait(rollouts[typical], quadruped)
    simulated = sum(rollout.steps for rollout in rollouts) * env_config.control_dt
    console.print(f"{simulated:,.0f} s simulated in {time.monotonic() - began:.1f} s")
    print_table(summary, f"{run.name}, {policy.steps:,} steps of training, engine {config.engine}")
    print(describe_gait(gait, typical))

    provenance = {
        "run": run.name,
        "engine": config.engine,
        "seed": config.seed,
        "seconds": config.seconds,
        "training_steps": policy.steps,
        "policy_sha256": checkpoint.sha256(run.policy),
        "versions": versions(),
    }
    results = {**provenance, "summary": summary, "episodes": episodes}
    results["typical_episode"] = {"episode": typical, **gait_metrics(gait, quadruped)}
    write_json_atomic(out / "metrics.json", results)
    metadata = {
        name: value if isinstance(value, str) else json.dumps(value)
        for name, value in provenance.items()
    }
    metadata["config"] = json.dumps(to_dict(policy.config))
    attachments = {"config.json": run.config.read_bytes()} if run.config.exists() else {}
    recorded = rollouts[: config.mcap]
    with console.status("writing"):
        for rollout in recorded:
            path = out / f"episode_{rollout.episode:03d}.mcap"
            write_mcap(path, rollout, quadruped, metadata, attachments)
        plot_report(rollouts[typical], quadruped, out / "report.png", run.name)
        try:
            render_film_strip(rollouts[typical], quadruped, out / "film_strip.png")
        except UserError as error:  # most likely no GL library: everything else still works
            console.print(f"no film strip: {error}")
    console.print(f"written to {out}: metrics.json, report.png, {len(recorded)} MCAP files")
    if recorded:
        console.print(f"see it with: rerun {out / 'episode_000.mcap'}, or open it in Foxglove")
    return results


def _make_output(config: EvalConfig, run: Run) -> Path:
    """The folder for the results, made."""
    name = f"{datetime.datetime.now():%Y-%m-%d_%H%M%S}-{config.engine}"
    out = config.out or run.path / "eval" / name
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the folder for results, {out}: {why(error)}") from error
    return out
