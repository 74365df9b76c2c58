"""Seconds from `python train.py` to a policy that walks: 1 m/s, at most 5 % of 64 episodes fall.

    python benchmarks/time_to_walk.py [--seeds 3] [--minutes 4]

Each seed trains twice with the defaults but for frequent checkpoints: with an empty compilation
cache, and with what that has left. Every policy is kept with the time at which it was written,
counted from the start of the process. Afterwards they are evaluated in turn, as `eval.py` does it
(MJX, mean action, episodes of up to 20 s), until one walks. So the times are resolved no finer than
the checkpoints are apart, and hold what these cost. To see that it works:

    python benchmarks/time_to_walk.py --seeds 1 --minutes 0.1
"""

import itertools
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import quadwalk
from benchmarks.shared import make_parser

TRAIN = Path(__file__).resolve().parents[1] / "train.py"
SPEED = 1.0  # m/s, at least
FALLS = 0.05  # at most
EPISODES = 64
SECONDS = 20.0  # an episode's time limit


class Written(NamedTuple):
    """A policy, and when it was written."""

    path: Path  # of a run that has it as its last
    seconds: float  # since the start of the process


def train(
    run: Path, cache: Path, seed: int, minutes: float, checkpoint_steps: int
) -> list[Written]:
    """Train into folder `run` for `minutes`; return every policy that was saved, with its time.

    `cache` is the folder of the compiled programs.
    """
    flags = f"--seed {seed} --minutes {minutes} --checkpoint-steps {checkpoint_steps} --quiet"
    command = [sys.executable, str(TRAIN), "--runs", str(run.parent), "--name", run.name]
    policies: list[Written] = []
    last = None
    with tempfile.TemporaryFile() as output:
        began = time.time()
        process = subprocess.Popen(
            [*command, *flags.split()],
            env={**os.environ, "XDG_CACHE_HOME": str(cache)},
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            running = True
            while running:
                running = process.poll() is None
                file = run / "policy.npz"
                changed = file.stat().st_mtime if file.exists() else None
                if changed != last:
                    # The next one takes its name, but a second name keeps it.
                    copy = run / f"kept_{len(policies):03d}"
                    copy.mkdir()
                    for name in ("robot.urdf", "policy.npz"):
                        os.link(run / name, copy / name)
                    last = (copy / "policy.npz").stat().st_mtime
                    policies.append(Written(copy, last - began))
                time.sleep(0.1)
        finally:
            process.terminate()
            process.wait()
        if process.returncode:
            output.seek(0)
            sys.exit(output.read().decode(errors="replace"))
    return policies


def find_walking(policies: list[Written]) -> tuple[float, str] | None:
    """Evaluate policies, oldest first, up to the first that walks.

    Returns the seconds from the start of training to that policy, and its figures as a line of the
    table; None if none walks. Prints such a line for each on standard error.
    """
    for path, seconds in policies:
        evaluation = quadwalk.evaluate(path, episodes=EPISODES, seconds=SECONDS)
        steps = evaluation.loaded.policy.steps
        speed, falls = evaluation.summary["speed"]["mean"], evaluation.summary["fall_rate"]
        figures = f"{seconds:8.1f} {steps:10,} {speed:6.2f} {falls:5.0%}"
        print(figures, file=sys.stderr)
        if speed >= SPEED and falls <= FALLS:
            return seconds, figures
    return None


def main() -> None:
    """Train with each seed, twice, and print when the first policy walks."""
    parser = make_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--minutes", type=float, default=4.0, help="that a training may take")
    parser.add_argument("--checkpoint-steps", type=int, default=50_000)
    options = parser.parse_args()

    times: dict[str, list[float]] = {"cold": [], "warm": []}
    with tempfile.TemporaryDirectory() as folder:
        policies = {}
        for seed, kind in itertools.product(range(options.seeds), times):
            print(f"training, seed {seed}, {kind} cache", file=sys.stderr)
            policies[seed, kind] = train(
                Path(folder) / f"seed_{seed}_{kind}",
                Path(folder) / f"cache_{seed}",
                seed,
                options.minutes,
                options.checkpoint_steps,
            )
        print(f"{'seed':>4} {'cache':>6} {'seconds':>8} {'steps':>10} {'m/s':>6} {'fell':>5}")
        for (seed, kind), saved_policies in policies.items():
            late = float("inf"), f"not in {options.minutes:g} minutes"
            seconds, figures = find_walking(saved_policies) or late
            times[kind].append(seconds)
            print(f"{seed:4} {kind:>6} {figures}", flush=True)
    for kind, seconds_of_seeds in times.items():
        low, high = min(seconds_of_seeds), max(seconds_of_seeds)
        median = statistics.median(seconds_of_seeds)
        print(f"{kind}: {low:.1f} to {high:.1f} s, median {median:.1f}")


if __name__ == "__main__":
    main()
