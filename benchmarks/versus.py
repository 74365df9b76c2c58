"""Simulated seconds per second while learning: this project against what a blog post used.

    python benchmarks/versus.py [--rounds 5] [--post-python PATH]

The post: PyBullet at 240 Hz, its task, four processes (SubprocVecEnv), Stable-Baselines3's PPO with
its defaults (`the_post.py`, in a Python 3.11 that uv sets up, or in that of PATH). Ours: what
`python train.py` does by default. Both learn in one run on the same cores, in turn, the other one
waiting; a turn of the post is one of its rollouts of 4 x 2048 steps and the learning from it, a
turn of ours takes as long. What counts is the median of the rounds' ratios; --rounds 1 shows that
it works.
"""

import argparse
import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from default_training import CONTROL_DT, DefaultTraining

from quadwalk.learn.devices import CPU_ENVS, cpu_cores

POST = Path(__file__).with_name("the_post.py")


class Turn(NamedTuple):
    """What one side did in its turn."""

    steps: int  # control steps, of all environments
    simulated: float  # s, of all environments
    seconds: float

    @property
    def ratio(self) -> float:
        """Simulated seconds per second."""
        return self.simulated / self.seconds


def post_turn(process: subprocess.Popen[str]) -> Turn:
    """What the post's process says of the turn that it has taken."""
    assert process.stdout is not None
    for line in process.stdout:  # PyBullet prints to it too
        if line.startswith("turn "):
            _, steps, simulated, seconds = line.split()
            return Turn(int(steps), float(simulated), float(seconds))
    sys.exit(f"error: {POST.name} ended with status {process.wait()}; expected its figures")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--post-python", help="a Python with PyBullet and Stable-Baselines3")
    options = parser.parse_args()
    command = [options.post_python] if options.post_python else ["uv", "run", "--script"]
    if not shutil.which(command[0]):
        sys.exit(f"error: {command[0]} is not there; expected uv, or --post-python PATH")
    rounds: list[tuple[Turn, Turn]] = []
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, POST], text=True, stdin=pipe, stdout=pipe) as post:
        assert post.stdin is not None
        # One after the other: neither sets up while the other works.
        post_turn(post)
        training = DefaultTraining(CPU_ENVS)
        print(f"simulated seconds per second, {cpu_cores()} cores")
        print(f"{'':8} the post     ours    ratio")
        for i in range(options.rounds):
            print(file=post.stdin, flush=True)
            theirs = post_turn(post)
            steps, seconds = training.run(theirs.seconds)
            own = Turn(steps, steps * CONTROL_DT, seconds)
            rounds.append((theirs, own))
            gain = own.ratio / theirs.ratio
            print(f"round {i + 1:2} {theirs.ratio:8.1f} {own.ratio:8.1f} {gain:8.1f}")
        post.stdin.close()

    def median(value: Callable[[Turn, Turn], float]) -> float:
        return statistics.median(value(theirs, own) for theirs, own in rounds)

    print(
        f"median   {median(lambda p, o: p.ratio):8.1f} {median(lambda p, o: o.ratio):8.1f} "
        f"{median(lambda p, o: o.ratio / p.ratio):8.1f}\n"
        f"control steps/s: the post {median(lambda p, o: p.steps / p.seconds):,.0f}, "
        f"ours {median(lambda p, o: o.steps / o.seconds):,.0f}"
    )


if __name__ == "__main__":
    main()
