"""Seconds from `python train.py` to a policy that walks: 1 m/s, at most 5 % of 64 episodes fall.

    python benchmarks/time_to_walk.py [--seeds 3] [--minutes 4]

Each seed trains twice with the defaults but for frequent checkpoints: with an empty compilation
cache, and with what that has left. Every policy is kept with the time at which it was written,
counted from the start of the process. Afterwards they are evaluated in turn, as `eval.py` does it
(MJX, mean action, episodes of up to 20 s), until one walks. So the times are resolved no finer than
the checkpoints are apart, and hold what these cost. To see that it works:

    python benchmarks/time_to_walk.py --seeds 1 --minutes 0.1
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

TRAIN = Path(__file__).resolve().parent.parent / "train.py"
SPEED = 1.0  # m/s, at least
FALLS = 0.05  # at most
EPISODES = 64
SECONDS = 20.0  # an episode's time limit


class Written(NamedTuple):
    """A policy, and when it was written."""

    path: Path  # of a run that has it as its last
    seconds: float  # since the start of the process


class Walks(NamedTuple):
    """The first policy that walks."""

    seconds: float
    steps: int  # control steps of training
    speed: float  # m/s
    falls: float


def train(
    run: Path, cache: Path, seed: int, minutes: float, checkpoint_steps: int
) -> list[Written]:
    """Train into folder `run`; return every policy that was saved on the way."""
    flags = f"--seed {seed} --minutes {minutes} --checkpoint-steps {checkpoint_steps} --quiet"
    command = [sys.executable, str(TRAIN), "--runs", str(run.parent), "--name", run.name]
    found: list[Written] = []
    last = None
    with tempfile.TemporaryFile() as said:
        began = time.time()
        process = subprocess.Popen(
            [*command, *flags.split()],
            env={**os.environ, "XDG_CACHE_HOME": str(cache)},
            stdout=said,
            stderr=subprocess.STDOUT,
        )
        try:
            running = True
            while running:
                running = process.poll() is None
                try:
                    written = (run / "policy.npz").stat().st_mtime_ns
                except FileNotFoundError:
                    written = None
                if written != last:
                    # The next one takes its name, but a second name keeps it.
                    kept = run / f"kept_{len(found):03d}"
                    kept.mkdir()
                    for file in ("robot.urdf", "policy.npz"):
                        os.link(run / file, kept / file)
                    last = (kept / "policy.npz").stat().st_mtime_ns
                    found.append(Written(kept, last / 1e9 - began))
                time.sleep(0.1)
        finally:
            process.terminate()
            process.wait()
        if process.returncode:
            said.seek(0)
            sys.exit(said.read().decode(errors="replace"))
    return found


def first_that_walks(policies: list[Written]) -> Walks | None:
    """Evaluate policies in turn."""
    from quadwalk.api import evaluate

    for kept, seconds in policies:
        judged = evaluate(kept, episodes=EPISODES, seconds=SECONDS)
        steps = judged.loaded.policy.steps
        speed, falls = judged.summary["speed"]["mean"], judged.summary["fall_rate"]
        print(
            f"  {seconds:6.1f} s, {steps:9,} steps: {speed:.2f} m/s, {falls:.0%} fell",
            file=sys.stderr,
        )
        if speed >= SPEED and falls <= FALLS:
            return Walks(seconds, steps, speed, falls)
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--minutes", type=float, default=4.0, help="that a training may take")
    parser.add_argument("--checkpoint-steps", type=int, default=50_000)
    options = parser.parse_args()

    kinds = ("cold", "warm")
    times: dict[str, list[float]] = {kind: [] for kind in kinds}
    with tempfile.TemporaryDirectory() as folder:
        trained = {}
        for seed in range(options.seeds):
            cache = Path(folder) / f"cache_{seed}"
            for kind in kinds:
                print(f"training, seed {seed}, {kind} cache", file=sys.stderr)
                run = Path(folder) / f"seed_{seed}_{kind}"
                trained[seed, kind] = train(
                    run, cache, seed, options.minutes, options.checkpoint_steps
                )
        print(f"{'seed':>4} {'cache':>6} {'seconds':>8} {'steps':>10} {'m/s':>6} {'fell':>5}")
        for (seed, kind), policies in trained.items():
            walks = first_that_walks(policies)
            times[kind].append(walks.seconds if walks else float("inf"))
            cells = (
                f"{walks.seconds:8.1f} {walks.steps:10,} {walks.speed:6.2f} {walks.falls:5.0%}"
                if walks
                else f"not in {options.minutes:g} minutes"
            )
            print(f"{seed:4} {kind:>6} {cells}", flush=True)
    for kind, found in times.items():
        print(
            f"{kind}: {min(found):.1f} to {max(found):.1f} s, median {statistics.median(found):.1f}"
        )


if __name__ == "__main__":
    main()
