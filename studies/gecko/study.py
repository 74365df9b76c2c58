"""Why the blog post's robot crawled like a gecko: its task with one thing changed at a time.

    python benchmarks/gecko.py [--seeds 2] [--only blog "blog, rewards"]

The presets `blog`, the post's task, and `run`, ours, differ in the `CAUSES` below. Each of these is
exchanged by itself: in the post's task for what ours has, and in ours for what the post's has.

Every variant is trained for as many control steps as its preset, over several seeds, a core for
each training, and judged in MuJoCo C, every shape colliding (`gecko_gait.py`). Runs are kept in
`--runs`: one that is there is not trained again. Results go to `--out` as they come, and
notebooks/04_gecko.ipynb shows them.
"""

from quadwalk.task.files import load_task
import argparse
import dataclasses
import itertools
import json
import multiprocessing
import re
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from quadwalk.errors import UserError, run_command
from quadwalk.files import atomic_write
from quadwalk.train.devices import cpu_cores, set_up_devices
from quadwalk.train.settings import TrainConfig

ROOT = Path(__file__).resolve().parent.parent
# Settings of a TrainConfig that are exchanged together. The learner's that count steps go with the
# length of a step.
CAUSES = {
    "episode length": ("env.episode_seconds",),
    "control rate": ("env.substeps", "ppo.unroll", "ppo.discount", "ppo.gae_lambda"),
    "action mapping": ("env.motor.targets", "env.motor.step_limit"),
    "rewards": ("env.reward",),
    "motors": tuple(
        f"env.motor.{name}" for name in ("kp", "kd", "effort", "speed_limit", "joint_friction")
    ),
    # Without knees and trunk to rest on, a robot that may lie down sinks into the floor.
    "falls": ("env.termination", "env.contacts"),
}
# Of the action mapping where action 0 is and nothing else: the post's bounds, as wide as they were
# within the calves' limits, about the standing pose.
ABOUT_STANDING = {"thigh_bounds": (-0.2, 1.8), "calf_bounds": (-2.55, -0.65)}
OTHER = {"blog": "run", "run": "blog"}
STEPS = {"blog": 10_000_000, "run": 5_000_000}  # the post's; enough for ours to gallop


def exchange(config: Any, other: Any, settings: tuple[str, ...]) -> Any:
    """`config` with these settings, dotted names, as `other` has them."""
    for setting in settings:
        name, _, rest = setting.partition(".")
        value = getattr(other, name)
        if rest:
            value = exchange(getattr(config, name), value, (rest,))
        config = dataclasses.replace(config, **{name: value})
    return config


def variants() -> dict[str, TrainConfig]:
    """The presets, each with nothing, one thing and all exchanged; and what these made us try.

    Name to configuration.
    """
    found = {}
    for preset, causes in itertools.product(OTHER, [(), *((c,) for c in CAUSES), tuple(CAUSES)]):
        settings = tuple(itertools.chain.from_iterable(CAUSES[cause] for cause in causes))
        changed = "all of them" if len(causes) > 1 else ", ".join(causes)
        name = f"{preset}, {changed}" if changed else preset
        found[name] = exchange(load_task(preset), load_task(OTHER[preset]), settings)
    post, ours = load_task("blog"), load_task("run")
    actuation = dataclasses.replace(post.env.motor, **ABOUT_STANDING)
    found["blog, action 0"] = dataclasses.replace(
        post, env=dataclasses.replace(post.env, actuation=actuation)
    )
    both = CAUSES["action mapping"] + CAUSES["falls"]
    found["run, action mapping and falls"] = exchange(ours, post, both)
    return found


def base(name: str) -> str:
    """The preset that a variant starts from."""
    return name.partition(",")[0]


def judge(name: str, seed: int, steps: int, runs: Path) -> dict[str, Any]:
    """Train a variant, if it has not been, and measure it; must have a process of its own."""
    set_up_devices(1)
    from gecko_gait import measure

    from quadwalk.train.loop import train
    from quadwalk.train.runs.directory import Run
    from quadwalk.train.runs.policy import load_policy
    from quadwalk.train.runs.resume import resumed_config

    words = re.sub(r"\W+", "-", name)
    config = dataclasses.replace(
        variants()[name],
        name=f"{words}_{steps}_s{seed}",
        runs=runs,
        seed=seed,
        steps=steps,
        devices=1,
        quiet=True,
    )
    run = Run(runs / str(config.name))
    if not run.path.exists():
        train(config)
    elif not run.policy.exists() or load_policy(run.policy).steps < steps:
        train(dataclasses.replace(resumed_config(runs, run.name), quiet=True))
    kept = load_policy(run.policy).config
    if (kept.env, kept.ppo) != (config.env, config.ppo):
        raise UserError(f"{run.path} was trained with other settings; remove it to train it anew")
    return {"variant": name, "seed": seed, "steps": steps, **measure(run)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--steps", type=int, help="control steps of each run, in place of STEPS")
    parser.add_argument("--only", nargs="+", choices=list(variants()), help="of the variants")
    parser.add_argument("--runs", type=Path, default=ROOT / "runs/gecko")
    parser.add_argument("--out", type=Path, default=ROOT / "notebooks/gecko.json")
    options = parser.parse_args()

    runs = options.runs.resolve()
    results = json.loads(options.out.read_text()) if options.out.exists() else []
    # A new process for each, for JAX is set up once in one.
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(cpu_cores(), mp_context=spawn, max_tasks_per_child=1) as pool:
        jobs: list[Future[dict[str, Any]]] = [
            pool.submit(judge, name, seed, options.steps or STEPS[base(name)], runs)
            for name in options.only or variants()
            for seed in range(options.seeds)
        ]
        for job in as_completed(jobs):
            try:
                found = job.result()
            except BaseException:
                pool.shutdown(cancel_futures=True)  # else all others are trained first
                raise
            results = [each for each in results if key(each) != key(found)]
            results = sorted([*results, found], key=key)
            # One line for each, so that a change shows which.
            lines = ",\n".join(json.dumps(each) for each in results)
            with atomic_write(options.out) as file:
                file.write(f"[\n{lines}\n]\n".encode())
            print(f"{found['variant']}, seed {found['seed']}: {found['figures']}", flush=True)


def key(found: dict[str, Any]) -> tuple[int, int]:
    """Where a result belongs among the others."""
    return list(variants()).index(found["variant"]), found["seed"]


if __name__ == "__main__":
    run_command(main)
