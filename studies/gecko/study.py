"""Why the blog post's robot crawled like a gecko: its task with one thing changed at a time.

    python -m studies.gecko.study [--seeds 2] [--only blog "blog, rewards"]

The tasks `blog`, the post's, and `sprint`, ours, differ in the `CAUSES` below. Each of these is
exchanged by itself: in the post's task for what ours has, and in ours for what the post's has.

Every variant is trained for as many control steps as its task, over several seeds, a core for each
training, and evaluated in MuJoCo C, every shape colliding (`gait.py`). Runs are kept in `--runs`:
one that is there is not trained again. Results go to `--out` as they come, and
notebooks/04_gecko.ipynb shows them. All of it takes two hours on two cores; to see that it works:

    python -m studies.gecko.study --seeds 1 --steps 1 --only blog --runs /tmp/runs --out /tmp/a.json
"""

import argparse
import itertools
import re
from dataclasses import replace
from pathlib import Path

from quadwalk.cli.process import run_command
from quadwalk.experiments.job import Job, fix_sizes
from quadwalk.experiments.options import PlaceConfig, add_place_flags, read_place
from quadwalk.settings.serialize import change_settings
from quadwalk.settings.training import TrainConfig
from quadwalk.task_files import load_task
from studies.cases import Results, run_cases
from studies.gecko.gait import measure

RESULTS = Path(__file__).parent / "results.json"
# Settings of a TrainConfig that are exchanged together. The learner's that count steps go with the
# length of a step.
CAUSES = {
    "episode length": ("env.episode_seconds",),
    "control rate": ("env.substeps", "ppo.unroll", "ppo.discount", "ppo.gae_lambda"),
    "action mapping": ("env.action",),
    "rewards": ("env.reward",),
    "motors": ("env.motor",),
    # Without knees and trunk to rest on, a robot that may lie down sinks into the floor.
    "falls": ("env.termination", "env.contacts"),
}
# Of the action mapping where action 0 is and nothing else: the post's bounds, as wide as they were
# within the calves' limits, about the standing pose.
ABOUT_STANDING = {
    "env.action.thigh_low": -0.2,
    "env.action.thigh_high": 1.8,
    "env.action.calf_low": -2.55,
    "env.action.calf_high": -0.65,
}
OTHER = {"blog": "sprint", "sprint": "blog"}
STEPS = {"blog": 10_000_000, "sprint": 5_000_000}  # the post's; enough for ours to gallop


def exchange(config: TrainConfig, other: TrainConfig, *causes: str) -> TrainConfig:
    """Return `config` with the settings of some `CAUSES` taken from `other`."""
    for setting in itertools.chain.from_iterable(CAUSES[cause] for cause in causes):
        part, name = setting.split(".")
        value = getattr(getattr(other, part), name)
        config = replace(config, **{part: replace(getattr(config, part), **{name: value})})
    return config


def make_variants() -> dict[str, TrainConfig]:
    """Return the variants by name: each task as it is, with one cause exchanged, and with all.

    Two more follow from the results of these.
    """
    variants = {}
    for name, name_of_other in OTHER.items():
        task, other = load_task(name), load_task(name_of_other)
        variants[name] = task
        variants |= {f"{name}, {cause}": exchange(task, other, cause) for cause in CAUSES}
        variants[f"{name}, all of them"] = exchange(task, other, *CAUSES)
    post, sprint = load_task("blog"), load_task("sprint")
    variants["blog, action 0"] = change_settings(post, ABOUT_STANDING)
    variants["sprint, action mapping and falls"] = exchange(sprint, post, "action mapping", "falls")
    return variants


def make_job(name: str, seed: int, steps: int | None, runs: Path, place: PlaceConfig) -> Job:
    """Return the job that trains a variant with a seed and measures its gait."""
    steps = steps or STEPS[name.partition(",")[0]]
    run = f"{re.sub(r'\W+', '-', name)}_{steps}_s{seed}"
    config = replace(make_variants()[name], name=run, runs=runs, seed=seed, steps=steps)
    return Job(fix_sizes(config, place), measure)


def main() -> None:
    """Train and measure every variant with every seed; write the results as they come."""
    names = list(make_variants())
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--steps", type=int, help="control steps of each run, in place of STEPS")
    parser.add_argument("--only", nargs="+", choices=names, help="of the variants")
    parser.add_argument("--runs", type=Path, default=Path("runs/gecko"))
    parser.add_argument("--out", type=Path, default=RESULTS)
    add_place_flags(parser, cores=1)
    options = parser.parse_args()
    results, place = Results(options.out, names), read_place(options)
    cases = list(itertools.product(options.only or names, range(options.seeds)))
    runs = options.runs.resolve()
    jobs = {case: make_job(*case, options.steps, runs, place) for case in cases}
    for case, result in run_cases(jobs, place):
        name, seed = case
        steps = jobs[case].config.steps
        results.add({"variant": name, "seed": seed, "steps": steps, **result})
        print(f"{name}, seed {seed}: {result['figures']}", flush=True)


if __name__ == "__main__":
    run_command(main)
