"""Simulated seconds per second while learning: this project against what a blog post used.

    python benchmarks/versus.py [--rounds 5] [--post-python PATH]

The post: PyBullet at 240 Hz, its task, four processes (SubprocVecEnv), Stable-Baselines3's PPO with
its defaults (`the_post.py`, in a Python 3.11 that uv sets up, or in that of PATH). Ours: the
training of `quadwalk train sprint`. Both learn in one run on the same cores, in turn, the other one
waiting; a turn of the post is one of its rollouts of 4 x 2048 steps and the learning from it, a
turn of ours takes as long. What counts is the median of the rounds' ratios; --rounds 1 shows that
it works.
"""

import shutil
import statistics
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from benchmarks.shared import TimedTraining, make_parser
from quadwalk.cores import count_cores
from quadwalk.learn.devices import CPU_ENVS
from quadwalk.tasks import sprint

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


def read_turn(process: subprocess.Popen[str]) -> Turn:
    """Wait for the line by which the post's process ends its turn; return its figures.

    Ends the program if the process has ended.
    """
    assert process.stdout is not None
    for line in process.stdout:  # PyBullet prints to it too
        if line.startswith("turn "):
            _, steps, simulated, seconds = line.split()
            return Turn(int(steps), float(simulated), float(seconds))
    sys.exit(f"error: {POST.name} ended with status {process.wait()}; expected its figures")


def main() -> None:
    """Let both sides learn in turn, and print their simulated seconds per second."""
    parser = make_parser(__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--post-python", metavar="PATH", help="Python that has pybullet")
    options = parser.parse_args()
    command = [options.post_python] if options.post_python else ["uv", "run", "--script"]
    if shutil.which(command[0]) is None:
        parser.error(f"{command[0]} is not there; expected uv, or --post-python PATH")
    post_turns: list[Turn] = []
    our_turns: list[Turn] = []
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, POST], text=True, stdin=pipe, stdout=pipe) as post:
        assert post.stdin is not None
        # One after the other: neither sets up while the other works.
        read_turn(post)
        training = TimedTraining(CPU_ENVS)
        print(f"simulated seconds per second, {count_cores()} cores")
        print(f"{'':8} the post     ours    ratio")
        for number in range(1, options.rounds + 1):
            print(file=post.stdin, flush=True)
            post_turns.append(read_turn(post))
            timed = training.run(post_turns[-1].seconds)
            our_turns.append(
                Turn(timed.steps, timed.steps * sprint.TASK.env.control_dt, timed.seconds)
            )
            print_row(f"round {number:2}", post_turns[-1:], our_turns[-1:])
        post.stdin.close()
    print_row("median", post_turns, our_turns)
    rates = [
        statistics.median(turn.steps / turn.seconds for turn in side)
        for side in (post_turns, our_turns)
    ]
    print(f"control steps/s: the post {rates[0]:,.0f}, ours {rates[1]:,.0f}")


def print_row(name: str, post_turns: list[Turn], our_turns: list[Turn]) -> None:
    """Print a row: the medians of both sides' simulated seconds per second, and of our gain.

    `post_turns` and `our_turns` are turns of the same rounds; the gain is ours over theirs in each.
    """
    gains = [
        our_turn.ratio / post_turn.ratio
        for our_turn, post_turn in zip(our_turns, post_turns, strict=True)
    ]
    columns = [turn.ratio for turn in post_turns], [turn.ratio for turn in our_turns], gains
    print(f"{name:8}", *(f"{statistics.median(column):8.1f}" for column in columns))


if __name__ == "__main__":
    main()
