"""Training rate and peak memory by the number of environments and of CPU cores, as a table.

    python benchmarks/scaling.py [--envs 256 512 ... 8192] [--cores 1 2] [--rounds 3]

Each configuration trains in a process of its own, restricted to its cores, in each round; rounds
run through them forward and backward in turn, so that a machine that drifts does so for all.
Rates are medians of the rounds, ratios medians of the rounds' ratios. Peak memory is the process's
largest resident set in any round, compilation included. To see that it works:

    python benchmarks/scaling.py --envs 256 --cores 1 --rounds 1 --seconds 1
"""

import argparse
import itertools
import math
import multiprocessing
import os
import statistics
import sys
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

from default_training import SUBSTEPS, DefaultTraining

from quadwalk.learn.devices import cpu_cores

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]


class Result(NamedTuple):
    rate: float  # control steps per second
    memory: float  # MB, peak
    devices: int


def measure(envs: int, cores: int, seconds: float) -> Result:
    """Train with `envs` environments on `cores` cores; must have a process of its own."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    training = DefaultTraining(envs)
    took = training.run(seconds)
    unit = 1 if sys.platform == "darwin" else 1024  # bytes in what getrusage counts in
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss if resource else math.nan
    return Result(took.steps / took.seconds, peak * unit / 1e6, training.devices)


def main() -> None:
    everything = cpu_cores()
    doubling = [2**k for k in range(everything.bit_length()) if 2**k < everything]
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--envs", type=int, nargs="+", default=[2**k for k in range(8, 14)])
    parser.add_argument("--cores", type=int, nargs="+", default=[*doubling, everything])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=15.0, help="of training in a round")
    options = parser.parse_args()

    grid = list(itertools.product(options.envs, options.cores))
    results: dict[tuple[int, int], list[Result]] = {key: [] for key in grid}
    rounds = [key for turn in range(options.rounds) for key in grid[:: (-1) ** turn]]
    # Spawned, not forked: nothing of this process's memory counts in the others'.
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, max_tasks_per_child=1) as pool:
        measured = pool.map(measure, *zip(*rounds, strict=True), itertools.repeat(options.seconds))
        for (envs, cores), found in zip(rounds, measured, strict=True):
            results[envs, cores].append(found)
            print(f"{envs} environments, {cores} cores: {found.rate:,.0f} steps/s", file=sys.stderr)

    fewest = options.cores[0]
    print(
        f"{'environments':>12} {'cores':>6} {'devices':>8} {'control steps/s':>16} "
        f"{'physics steps/s':>16} {'peak MB':>9} {f'x {fewest} core':>9}"
    )
    for (envs, cores), runs in results.items():
        rate = statistics.median(r.rate for r in runs)
        memory = max(r.memory for r in runs)
        base = results[envs, fewest]
        ratio = statistics.median(r.rate / b.rate for r, b in zip(runs, base, strict=True))
        print(
            f"{envs:12,} {cores:6} {runs[0].devices:8} {rate:16,.0f} {rate * SUBSTEPS:16,.0f} "
            f"{memory:9,.0f} {ratio:9.2f}"
        )


if __name__ == "__main__":
    main()
