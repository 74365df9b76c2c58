"""Other robots from a trained run's networks, beside the same trainings from nothing.

    python benchmarks/warm_start.py RUN [--robots a1 go1 go2] [--steps 10000000] [--seed 0]

RUN has a checkpoint of the default task. For each robot of example-robot-data, whose URDF is named
so: steps and seconds of training until its evaluation while training runs at 1 m/s, and at 95 % of
the faster of both at the end; means over the last 20 iterations. To see that it works:
--steps 300000.
"""

import argparse
from pathlib import Path

import numpy as np

import quadwalk
from benchmarks.zoo import example_robot_data
from quadwalk.runs.log import read_history

MEAN = 20  # iterations


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("run", help="a run's folder or name")
    parser.add_argument("--robots", nargs="+", default=["a1", "go1", "go2"])
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    folder = example_robot_data()
    if folder is None:
        parser.error("example-robot-data is not installed; expected the extra `zoo`")
    for name in options.robots:
        urdf = next(iter(sorted(folder.rglob(f"{name}.urdf"))), None)
        if urdf is None:
            parser.error(f"no {name}.urdf in {folder}")
        curves = {
            "from nothing": curve(urdf, None, options.steps, options.seed),
            f"from {Path(options.run).name}": curve(urdf, options.run, options.steps, options.seed),
        }
        final = max(speeds[-1] for _, _, speeds in curves.values())
        print(f"{name}: {final:.2f} m/s at the end of the faster")
        for what, (steps, seconds, speeds) in curves.items():
            told = [when(steps, seconds, speeds, speed) for speed in (1.0, 0.95 * final)]
            print(f"  {what:14} 1 m/s: {told[0]}; 95 %: {told[1]}; end {speeds[-1]:.2f} m/s")


def curve(
    urdf: Path, init: str | None, steps: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps, seconds and speed, m/s, after each iteration of a training."""
    rows = read_history(quadwalk.train(robot=urdf, steps=steps, seed=seed, init=init, quiet=True))
    done, seconds, speeds = (
        np.array([row[name] for row in rows]) for name in ("steps", "time/elapsed", "eval/speed")
    )
    # Fewer at first: a robot that runs at once must not seem to need 20.
    means = [speeds[max(0, end - MEAN) : end].mean() for end in range(1, len(speeds) + 1)]
    return done, seconds, np.array(means)


def when(steps: np.ndarray, seconds: np.ndarray, speeds: np.ndarray, speed: float) -> str:
    """The first steps and seconds at which that speed is reached."""
    reached = np.flatnonzero(speeds >= speed)
    if not len(reached):
        return "not reached"
    return f"{steps[reached[0]] / 1e6:.2f} million steps, {seconds[reached[0]]:.0f} s"


if __name__ == "__main__":
    main()
