"""What each ingredient of a policy for the real world gives: trained without it, and evaluated.

    python -m studies.real_world.study [--seeds 1] [--steps 6000000] [--only run "no critic"]

`sprint` is the task of an ideal world, `run` that of the real one; the others are `run` without one
of its ingredients. Each is trained over so many seeds, and evaluated under the same conditions in
the fast engine: as its model says, with one thing after another different, and with everything at
once as `run` draws it; and at its model's in MuJoCo C, every shape colliding. Runs are kept in
`--runs`: one that is there is not trained again. Results go to `--out` as they come. To see that
it works:

    python -m studies.real_world.study --steps 1 --episodes 4 --only sprint --runs /tmp/runs --out \
        /tmp/a.json
"""

import argparse
import itertools
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from quadwalk.api import evaluate
from quadwalk.cli.process import run_command
from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.load import LoadedRun, load_run
from quadwalk.evaluation.sweep import Point, measure_points
from quadwalk.experiments.job import Job, fix_sizes
from quadwalk.experiments.options import add_place_flags, read_place
from quadwalk.runs.directory import Run
from quadwalk.settings.serialize import change_settings
from quadwalk.settings.training import TrainConfig
from quadwalk.task_files import load_task
from studies.cases import Results, run_cases

RESULTS = Path(__file__).parent / "results.json"
SECONDS = 20.0
POINTS = {
    "nominal": Point(),
    "everything at once": Point(everything=1.0),
    "4 ms late": Point(delay=4.0),
    "12 ms late": Point(delay=12.0),
    "20 ms late": Point(delay=20.0),
    "32 ms late": Point(delay=32.0),
    "sensor noise": Point(noise=1.0),
    "sensor noise x 2": Point(noise=2.0),
    "5 kg more": Point(mass=5.0),
    "motors at 80 %": Point(strength=80.0),
    "friction 0.3": Point(friction=0.3),
    "pushes of 1 m/s": Point(push=1.0),
}


def make_variants() -> dict[str, TrainConfig]:
    """Return the tasks to train, by name: `sprint`, `run`, and `run` without one thing each.

    Those are latency, noise, pushes, randomization, history and the critic's own observations.
    """
    run = load_task("run")
    ranges = "env.randomization"
    without: dict[str, dict[str, Any]] = {
        "no latency": {f"{ranges}.{name}": None for name in ("latency", "sensor_latency")},
        "no noise": {f"{ranges}.{name}": None for name in ("noise", "encoder", "imu_tilt")},
        "no pushes": {f"{ranges}.push": None},
        "one robot, one floor": {
            f"{ranges}.{name}": None
            for name in (
                *("friction", "trunk_mass", "trunk_center", "link_mass", "strength"),
                *("kp", "kd", "joint_friction", "damping", "armature"),
            )
        },
        "no history": {f"env.observation.{name}.history": 0 for name in run.env.observation},
        "no critic": {"env.critic": {}},
    }
    return {
        "sprint": load_task("sprint"),
        "run": run,
        **{name: change_settings(run, changes) for name, changes in without.items()},
    }


def make_job(name: str, seed: int, options: argparse.Namespace) -> Job:
    """Return the job that trains a variant with a seed and evaluates it."""
    run = f"{re.sub(r'\W+', '-', name)}_{options.steps}_s{seed}"
    config, runs = make_variants()[name], options.runs.resolve()
    config = replace(config, name=run, runs=runs, seed=seed, steps=options.steps)
    return Job(fix_sizes(config, read_place(options)), partial(judge, episodes=options.episodes))


def judge(run: Run, episodes: int) -> dict[str, Any]:
    """Evaluate a run under each condition of `POINTS`, and once in MuJoCo C."""
    loaded = replace_ranges(load_run(run, SECONDS, engine="fast"))
    results = measure_points(loaded, list(POINTS.values()), episodes, seed=0)
    summary = evaluate(run, episodes=16, seconds=SECONDS, engine="mujoco").summary
    return {
        "episodes": episodes,
        "points": dict(zip(POINTS, results, strict=True)),
        "mujoco": {name: summary[name] for name in ("fall_rate", "speed", "heading_error")},
    }


def replace_ranges(loaded: LoadedRun) -> LoadedRun:
    """Return `loaded` with the randomization ranges of the task `run`, instead of its own.

    So runs of all variants are evaluated under the same conditions.
    """
    ranges = replace(load_task("run").env.randomization, enabled=False)
    config = replace(loaded.env.config, randomization=ranges)
    return replace(loaded, env=QuadrupedEnv(loaded.env.quadruped, config, loaded.env.engine))


def main() -> None:
    """Train and evaluate every variant with every seed; write the results as they come."""
    names = list(make_variants())
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--steps", type=int, default=6_000_000, help="control steps of each run")
    parser.add_argument("--episodes", type=int, default=256, help="at each point")
    parser.add_argument("--only", nargs="+", choices=names, help="of the variants")
    parser.add_argument("--runs", type=Path, default=Path("runs/real_world"))
    parser.add_argument("--out", type=Path, default=RESULTS)
    add_place_flags(parser)
    options = parser.parse_args()
    results = Results(options.out, names)
    cases = list(itertools.product(options.only or names, range(options.seeds)))
    jobs = {case: make_job(*case, options) for case in cases}
    for (name, seed), result in run_cases(jobs, read_place(options)):
        results.add({"variant": name, "seed": seed, "steps": options.steps, **result})
        shares = {name: f"{100 * p['success']:.0f} %" for name, p in result["points"].items()}
        print(f"{name}, seed {seed}: {shares}", flush=True)


if __name__ == "__main__":
    run_command(main)
