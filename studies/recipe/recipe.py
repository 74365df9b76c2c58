"""What a change of settings gives: train each over several seeds and judge it in both engines.

    python -m studies.recipe.recipe "" "--ppo.entropy 0.003" "--ppo.epochs 3" [--steps 4000000]

Each argument holds the flags of one variant, "" the defaults. Runs are kept in `--runs`, named by
flags, steps and seed: one that is there already is not trained again, so a stopped study goes on
where it was. The rows printed are Markdown, for `recipe.md`; the gait's are those of each run's
typical episode in MuJoCo C. An episode less than half as fast as the median is counted as slow:
such a robot stands, or limps. To see that it works:

    python -m studies.recipe.recipe "" --steps 1 --seeds 1 --episodes 2 --runs /tmp/runs
"""

import argparse
import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from quadwalk.api import evaluate
from quadwalk.errors import run_command
from quadwalk.train.flags import parse_config
from studies.runs import in_processes, trained

COLUMNS = (
    "flags",
    "seed",
    "m/s",
    "falls",
    "slow",
    "drift",
    "heading",
    "m/s in C",
    "falls in C",
    "gait",
    "swing, cm",
    "slip",
    "torque",
    "joint speed",
    "action rate, 1/s",
)


def row(flags: str, seed: int, steps: int | None, episodes: int, runs: Path) -> str:
    """The row of one run, which is trained if it has not been."""
    words = re.sub(r"[^\w.]+", "-", flags).strip("-") or "default"
    config, _ = parse_config(flags.split())
    name = f"{words}_{steps or 'full'}_s{seed}"
    config = replace(config, name=name, runs=runs, seed=seed, quiet=True)
    run = trained(replace(config, steps=steps or config.steps))
    mjx = evaluate(run, episodes=episodes).summary
    judged = evaluate(run, episodes=episodes, engine="mujoco")
    c, gait = judged.summary, judged.gait
    slow = sum(each["speed"] < 0.5 * c["speed"]["median"] for each in judged.episodes)
    cells = (
        f"`{flags or 'defaults'}`",
        f"{seed}",
        f"{mjx['speed']['mean']:.2f}",
        f"{mjx['fall_rate']:.1%}",
        f"{slow}",
        f"{mjx['lateral_drift']['mean'] / mjx['distance']['mean']:.1%}",
        f"{mjx['heading_error']['mean']:.1f}°",
        f"{c['speed']['mean']:.2f}",
        f"{c['fall_rate']:.1%}",
        gait.gait,
        f"{100 * np.nan_to_num(gait.swing_height).min():.1f}",
        f"{np.fmax.reduce(gait.slip_share):.1%}",
        f"{np.fmax.reduce(gait.torque_peak):.0%}",
        f"{np.fmax.reduce(gait.joint_speed_peak):.0%}",
        f"{gait.action_rate:.1f}",
    )
    return line(cells)


def line(cells: tuple[str, ...]) -> str:
    """A row of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("variants", nargs="+", help="flags of train.py, as one argument each")
    parser.add_argument("--steps", type=int, help="control steps; by default train.py's")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--runs", type=Path, default=Path("runs/recipe"))
    parser.add_argument("--at-once", type=int, default=1, help="runs; if several, one core each")
    options = parser.parse_args()

    for flags in options.variants:
        parse_config(flags.split())  # a wrong one is told before the first is trained
    print(line(COLUMNS), "|" + "---|" * len(COLUMNS), sep="\n", flush=True)
    cases = itertools.product(
        options.variants,
        range(options.seeds),
        [options.steps],
        [options.episodes],
        [options.runs.resolve()],
    )
    devices = 1 if options.at_once > 1 else None
    for found in in_processes(row, cases, options.at_once, devices):
        print(found, flush=True)


if __name__ == "__main__":
    run_command(main)
