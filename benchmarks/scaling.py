"""Training rate and peak memory by the number of environments and of CPU cores, as a table.

    python benchmarks/scaling.py [--envs 256 512 ... 8192] [--cores 1 2] [--rounds 3]

Each configuration trains in a process of its own, restricted to its cores, in each round; rounds
run through them forward and backward in turn, so that a machine that drifts does so for all.
Rates are medians of the rounds, ratios medians of the rounds' ratios. Peak memory is the process's
largest resident set in any round, compilation included. To see that it works:

    python benchmarks/scaling.py --envs 256 --cores 1 --rounds 1 --seconds 1
"""

import itertools
import multiprocessing
import os
import statistics
import sys
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

from benchmarks.shared import TimedTraining, make_parser
from quadwalk.cores import count_cores
from quadwalk.tasks import sprint


class Result(NamedTuple):
    """One training of a configuration."""

    rate: float  # control steps per second
    memory: float  # MB, peak
    devices: int


def measure(envs: int, cores: int, seconds: float) -> Result:
    """Train with `envs` environments on `cores` cores for `seconds`; return rate and peak memory.

    The process that calls it is then bound to those cores, and must be a new one: memory is its
    largest so far.
    """
    import resource  # not on Windows

    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    training = TimedTraining(envs)
    timed = training.run(seconds)
    unit = 1 if sys.platform == "darwin" else 1024  # bytes in what getrusage counts in
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Result(timed.steps / timed.seconds, peak * unit / 1e6, training.devices)


def main() -> None:
    """Measure each number of environments on each number of cores, and print a table."""
    doubling = [2**k for k in range(count_cores().bit_length()) if 2**k < count_cores()]
    parser = make_parser(__doc__)
    parser.add_argument("--envs", type=int, nargs="+", default=[2**k for k in range(8, 14)])
    parser.add_argument("--cores", type=int, nargs="+", default=[*doubling, count_cores()])
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
        for (envs, cores), result in zip(rounds, measured, strict=True):
            results[envs, cores].append(result)
            print(
                f"{envs} environments, {cores} cores: {result.rate:,.0f} steps/s", file=sys.stderr
            )

    fewest = options.cores[0]
    print(
        f"{'environments':>12} {'cores':>6} {'devices':>8} {'control steps/s':>16} "
        f"{'physics steps/s':>16} {'peak MB':>9} {f'x {fewest} core':>9}"
    )
    for (envs, cores), runs in results.items():
        rate = statistics.median(run.rate for run in runs)
        memory = max(run.memory for run in runs)
        bases = results[envs, fewest]
        ratio = statistics.median(
            run.rate / base.rate for run, base in zip(runs, bases, strict=True)
        )
        print(
            f"{envs:12,} {cores:6} {runs[0].devices:8} {rate:16,.0f} "
            f"{rate * sprint.TASK.env.substeps:16,.0f} {memory:9,.0f} {ratio:9.2f}"
        )


if __name__ == "__main__":
    main()
