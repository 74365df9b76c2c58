"""Other robots from a trained run's networks, beside the same trainings from nothing.

    python benchmarks/warm_start.py RUN [--robots a1 go1 go2] [--steps 10000000] [--seed 0]

RUN has a checkpoint of the default task. For each robot of example-robot-data, whose URDF is named
so: steps and seconds of training until its evaluation while training runs at 1 m/s, and at 95 % of
the faster of both at the end; means over the last 20 iterations. To see that it works:
--steps 300000.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

import quadwalk
from benchmarks.shared import find_example_robots, make_parser
from quadwalk.runs.log import read_history

ITERATIONS = 20  # that a mean is over


class Curve(NamedTuple):
    """A training, after each iteration (n,)."""

    steps: np.ndarray
    seconds: np.ndarray
    speeds: np.ndarray  # m/s


def main() -> None:
    """Train other robots from the networks of a run and from nothing; print when each runs."""
    parser = make_parser(__doc__)
    parser.add_argument("run", help="a run's folder or name")
    parser.add_argument("--robots", nargs="+", default=["a1", "go1", "go2"])
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    folder = find_example_robots()
    if folder is None:
        parser.error("example-robot-data is not installed; expected the extra `zoo`")
    for name in options.robots:
        urdf = next(iter(sorted(folder.rglob(f"{name}.urdf"))), None)
        if urdf is None:
            parser.error(f"no {name}.urdf in {folder}")
        curves = {
            "from nothing": train(urdf, None, options.steps, options.seed),
            f"from {Path(options.run).name}": train(urdf, options.run, options.steps, options.seed),
        }
        final = max(curve.speeds[-1] for curve in curves.values())
        print(f"{name}: {final:.2f} m/s at the end of the faster")
        for start, curve in curves.items():
            print(
                f"  {start:14} 1 m/s: {describe_when(curve, 1.0)}; "
                f"95 %: {describe_when(curve, 0.95 * final)}; end {curve.speeds[-1]:.2f} m/s"
            )


def train(urdf: Path, init: str | None, steps: int, seed: int) -> Curve:
    """Train a robot, with the networks of the run `init` at first if one is named.

    Returns its curve, in which speeds are means over the last `ITERATIONS`.
    """
    rows = read_history(quadwalk.train(robot=urdf, steps=steps, seed=seed, init=init, quiet=True))
    done, seconds, speeds = (
        np.array([row[name] for row in rows]) for name in ("steps", "time/elapsed", "eval/speed")
    )
    # Fewer at first: a robot that runs at once must not seem to need 20.
    means = [speeds[max(0, end - ITERATIONS) : end].mean() for end in range(1, len(speeds) + 1)]
    return Curve(done, seconds, np.array(means))


def describe_when(curve: Curve, speed: float) -> str:
    """Return the training, in steps and seconds, that a speed (m/s) takes; or "not reached"."""
    reached = np.flatnonzero(curve.speeds >= speed)
    if not len(reached):
        return "not reached"
    first = reached[0]
    return f"{curve.steps[first] / 1e6:.2f} million steps, {curve.seconds[first]:.0f} s"


if __name__ == "__main__":
    main()
