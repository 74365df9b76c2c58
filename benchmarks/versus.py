"""Simulated seconds per second while learning: this project against what a blog post used.

    pip install -e '.[versus]'
    python benchmarks/versus.py [--rounds 5]

The post: PyBullet at 240 Hz, its task (`pybullet_task.py`), four processes (SubprocVecEnv),
Stable-Baselines3's PPO with its defaults. Ours: what `python train.py` does by default. Both learn
in one run on the same cores, in turn, the other one waiting; a turn of the post is one of its
rollouts of 4 x 2048 steps and the learning from it, a turn of ours takes as long. What counts is
the median of the rounds' ratios; --rounds 1 shows that it works.
"""

import argparse
import importlib.util
import multiprocessing
import statistics
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import NamedTuple

from quadwalk.train.devices import CPU_ENVS, cpu_cores

PROCESSES = 4  # the post's


class Turn(NamedTuple):
    """What one side did in its turn."""

    steps: int  # control steps, of all environments
    simulated: float  # s, of all environments
    seconds: float

    @property
    def ratio(self) -> float:
        """Simulated seconds per second."""
        return self.simulated / self.seconds


def the_post() -> Callable[[float], Turn]:
    """The post's training, ready to take turns; how long one lasts is its own affair."""
    from pybullet_task import DT, PyBulletTask
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import SubprocVecEnv

    model = PPO("MlpPolicy", SubprocVecEnv([PyBulletTask] * PROCESSES), device="cpu", seed=0)

    def turn(seconds: float) -> Turn:
        began = time.perf_counter()
        steps = PROCESSES * model.n_steps
        model.learn(steps, reset_num_timesteps=False)
        return Turn(steps, steps * DT, time.perf_counter() - began)

    turn(0.0)
    return turn


def ours() -> Callable[[float], Turn]:
    """The default training, ready to take turns of so many seconds."""
    from default_training import CONTROL_DT, DefaultTraining

    training = DefaultTraining(CPU_ENVS)

    def turn(seconds: float) -> Turn:
        steps, took = training.run(seconds)
        return Turn(steps, steps * CONTROL_DT, took)

    return turn


def serve(make: Callable[[], Callable[[float], Turn]], pipe: Connection) -> None:
    """Take turns as asked through `pipe`, until None comes."""
    turn = make()
    pipe.send(None)
    while (seconds := pipe.recv()) is not None:
        pipe.send(turn(seconds))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    if not all(map(importlib.util.find_spec, ("pybullet", "stable_baselines3"))):
        sys.exit("PyBullet and Stable-Baselines3 are missing: pip install -e '.[versus]'")

    # Spawned, so that neither side's threads and libraries are in the other's process.
    spawn = multiprocessing.get_context("spawn")
    pipes = []
    for make in (the_post, ours):
        pipe, theirs = spawn.Pipe()
        spawn.Process(target=serve, args=(make, theirs)).start()
        theirs.close()
        pipe.recv()  # one after the other: neither sets up while the other works
        pipes.append(pipe)

    def take_turn(pipe: Connection, seconds: float) -> Turn:
        pipe.send(seconds)
        return pipe.recv()

    rounds = []
    print(f"simulated seconds per second, {cpu_cores()} cores\n{'':8} the post     ours    ratio")
    for i in range(options.rounds):
        post = take_turn(pipes[0], 0.0)
        own = take_turn(pipes[1], post.seconds)
        rounds.append((post, own))
        print(f"round {i + 1:2} {post.ratio:8.1f} {own.ratio:8.1f} {own.ratio / post.ratio:8.1f}")
    for pipe in pipes:
        pipe.send(None)

    def median(value: Callable[[Turn, Turn], float]) -> float:
        return statistics.median(value(post, own) for post, own in rounds)

    print(
        f"median   {median(lambda p, o: p.ratio):8.1f} {median(lambda p, o: o.ratio):8.1f} "
        f"{median(lambda p, o: o.ratio / p.ratio):8.1f}\n"
        f"control steps/s: the post {median(lambda p, o: p.steps / p.seconds):,.0f}, "
        f"ours {median(lambda p, o: o.steps / o.seconds):,.0f}"
    )


if __name__ == "__main__":
    main()
