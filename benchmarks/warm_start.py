"""How much sooner a robot learns from the networks of trained runs: the same training from each.

    python benchmarks/warm_start.py RUN... [--task run] [--robots a1 go1 go2]
        [--steps 10000000] [--seed 0]

"nothing" among the runs is a training from random networks. Robots are files, or names of robots in
installed packages as of `--robot.urdf`. It prints when the evaluation environments run at
1 m/s, reach 98 % of the fastest at the end, and fall in 2 % of their episodes: steps and seconds of
training, means over the last 20 iterations. With commands the speed is the commanded one less the
velocity's error. To see that it works: --steps 300000.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

import quadwalk
from benchmarks.shared import make_parser
from quadwalk.cli.process import run_command
from quadwalk.runs.log import read_history

ITERATIONS = 20  # that a mean is over
NOTHING = "nothing"


class Curve(NamedTuple):
    """A training, after each iteration (n,)."""

    steps: np.ndarray
    seconds: np.ndarray
    speeds: np.ndarray  # m/s
    falls: np.ndarray  # share of episodes


def main() -> None:
    """Train other robots from the networks of each run; print when each has learned."""
    parser = make_parser(__doc__)
    parser.add_argument("runs", nargs="+", metavar="RUN", help=f"a run's folder or name; {NOTHING}")
    parser.add_argument("--task", default="run")
    parser.add_argument("--robots", nargs="+", default=["a1", "go1", "go2"])
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for name in options.robots:
        curves = {
            run: train(options.task, name, run, options.steps, options.seed) for run in options.runs
        }
        final = max(curve.speeds[-1] for curve in curves.values())
        print(f"{name}: {final:.2f} m/s at the end of the fastest")
        for run, curve in curves.items():
            print(
                f"  from {Path(run).name:10} 1 m/s: {describe_when(curve, curve.speeds >= 1.0)}; "
                f"98 %: {describe_when(curve, curve.speeds >= 0.98 * final)}; "
                f"2 % falls: {describe_when(curve, curve.falls <= 0.02)}; "
                f"end {curve.speeds[-1]:.2f} m/s, {curve.falls[-1]:.1%} falls",
                flush=True,
            )


def train(task: str, robot: str, run: str, steps: int, seed: int) -> Curve:
    """Train a robot in `task`, with the networks of `run` at first.

    Returns its curve, in which speeds and falls are means over the last `ITERATIONS`.
    """
    init = None if run == NOTHING else run
    rows = read_history(
        quadwalk.train(task, robot=robot, steps=steps, seed=seed, init=init, quiet=True)
    )
    step_counts, seconds, speeds, falls = (
        np.array([row[name] for row in rows])
        for name in ("steps", "time/elapsed", "eval/speed", "eval/fall_rate")
    )
    return Curve(step_counts, seconds, average_last(speeds), average_last(falls))


def average_last(values: np.ndarray) -> np.ndarray:
    """Return the mean of each value (n,) and those before it, `ITERATIONS` in all or fewer."""
    # Fewer at first: a robot that runs at once must not seem to need 20.
    ends = range(1, len(values) + 1)
    return np.array([values[max(0, end - ITERATIONS) : end].mean() for end in ends])


def describe_when(curve: Curve, reached: np.ndarray) -> str:
    """Return the training, in steps and seconds, until `reached` (n,) is true; or "never"."""
    iterations = np.flatnonzero(reached)
    if not len(iterations):
        return "never"
    first = iterations[0]
    return f"{curve.steps[first] / 1e6:.2f} M steps, {curve.seconds[first]:.0f} s"


if __name__ == "__main__":
    run_command(main)
