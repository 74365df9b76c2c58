"""Many trainings at once against the ideal: the time of one alone, times how many take turns.

    python benchmarks/many.py [--trainings 8] [--steps 1000000] [--ray] [--rounds 3]

Trains so many runs of `sprint`, one core each, in processes of this machine and, with --ray, on a
Ray cluster of two nodes that share its cores; each from the start of a process to its last file. In
every round one is trained alone first, so that a machine that drifts does so for all. A ratio of 1
is ideal: nothing is lost to starting, sharing memory, or bringing back. To see that it works:

    python benchmarks/many.py --trainings 2 --steps 30000 --rounds 1
"""

import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from benchmarks.shared import make_parser
from quadwalk.cli.process import run_command
from quadwalk.cores import count_cores
from quadwalk.experiments.job import Job, fix_sizes
from quadwalk.experiments.options import PlaceConfig
from quadwalk.experiments.places import make_place
from quadwalk.experiments.runner import collect_values, run_jobs
from quadwalk.runs.directory import Run
from quadwalk.runs.policy import load_score
from quadwalk.tasks.sprint import TASK


def get_steps(run: Run) -> int:
    """Return the control steps for which the last policy of a run was trained."""
    return load_score(run.policy)[0]


def time_trainings(count: int, steps: int, config: PlaceConfig) -> float:
    """Return the seconds that `count` trainings at once take, from the start to the last file."""
    with tempfile.TemporaryDirectory() as folder:
        jobs = []
        for seed in range(count):
            task = replace(TASK, name=f"s{seed}", runs=Path(folder), steps=steps, seed=seed)
            jobs.append(Job(fix_sizes(task, config), get_steps))
        place = make_place(config)
        began = time.perf_counter()
        assert all(
            step_count >= steps for _, step_count in collect_values(run_jobs(jobs, place, count))
        )
        return time.perf_counter() - began


def main() -> None:
    """Time trainings at once and alone, and print the ratio to the ideal."""
    parser = make_parser(__doc__)
    parser.add_argument("--trainings", type=int, default=8)
    parser.add_argument("--steps", type=int, default=1_000_000, help="control steps of each")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--ray", action="store_true", help="also on two local nodes of Ray")
    options = parser.parse_args()
    cores, cluster = count_cores(), None
    alone = PlaceConfig(cores=1)
    places = {"processes": alone}
    if options.ray:
        from ray.cluster_utils import Cluster

        share = cores // 2 or 1
        head = {"num_cpus": cores - share, "include_dashboard": False}
        cluster = Cluster(initialize_head=True, head_node_args=head)
        cluster.add_node(num_cpus=share)
        places["two nodes of Ray"] = PlaceConfig(cores=1, cluster=cluster.address)
    time_trainings(1, 1, alone)  # compiles
    ratios: dict[str, list[float]] = {name: [] for name in places}
    turns = -(-options.trainings // cores)
    for _ in range(options.rounds):
        ideal = turns * time_trainings(1, options.steps, alone)
        print(f"alone: {ideal / turns:.1f} s; ideal for {options.trainings}: {ideal:.1f} s")
        for name, config in places.items():
            seconds = time_trainings(options.trainings, options.steps, config)
            ratios[name].append(seconds / ideal)
            print(f"{name}: {seconds:.1f} s, {seconds / ideal:.2f} of the ideal", flush=True)
    for name, values in ratios.items():
        low, median, high = min(values), statistics.median(values), max(values)
        print(f"{name}: median {median:.2f} ({low:.2f} to {high:.2f}) of the ideal, {cores} cores")
    if cluster is not None:
        cluster.shutdown()


if __name__ == "__main__":
    run_command(main)
