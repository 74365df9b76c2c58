"""What the desk costs: training steps with the task's numbers as arguments and as constants.

    python benchmarks/desk.py [--task run] [--rounds 8] [--envs 2048] [--processor-time]

Iterations of both kinds of programs take turns in one process; what counts is the median of their
ratios, since a machine's speed drifts. On a machine that others use too, --processor-time counts
what the cores spent on it, not what they waited.
"""

import dataclasses
import time

import jax
import numpy as np

from benchmarks.shared import make_parser
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.numbers import list_numbers
from quadwalk.learn import ppo
from quadwalk.learn.devices import choose_devices, make_mesh
from quadwalk.learn.networks import make_env_networks
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.task_files import load_task
from quadwalk.tasks import list_tasks

ITERATIONS = 4  # of each kind in a round


class Trainer:
    """A training of `env`, which compiles when made, with its state."""

    def __init__(self, env, config, mesh) -> None:
        networks = make_env_networks(env, config.ppo, lambda text: None)
        self.state = ppo.init_state(env, networks, config.ppo, mesh, config.envs, 0)
        self.iterate = ppo.Iteration(env, networks, config.ppo, mesh, 1000)
        self.iterate.trace(self.state)
        self.iterate.compile()

    def measure(self, clock) -> float:
        """Train for `ITERATIONS`; return the seconds that they took by `clock`."""
        start = clock()
        for _ in range(ITERATIONS):
            self.state, metrics = self.iterate(self.state)
            jax.block_until_ready(metrics)
        return clock() - start


def main() -> None:
    """Measure both kinds of programs in turn, and print their ratio."""
    parser = make_parser(__doc__)
    parser.add_argument("--task", default="run", choices=list_tasks())
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--envs", type=int, default=2048)
    parser.add_argument("--processor-time", action="store_true", help="for a busy machine")
    options = parser.parse_args()
    clock = time.process_time if options.processor_time else time.perf_counter
    config = dataclasses.replace(load_task(options.task), envs=options.envs)
    config, devices = choose_devices(config)
    mesh = make_mesh(devices)
    env = QuadrupedEnv(load_quadruped(), config.env)
    names = [number.name for number in list_numbers(config.env)]
    trainers = [Trainer(each, config, mesh) for each in (env, env.set_numbers(config.env, names))]
    for trainer in trainers:  # the first iteration starts all episodes
        trainer.measure(clock)
    times = np.array([[x.measure(clock) for x in trainers] for _ in range(options.rounds)])
    steps = ITERATIONS * options.envs * config.ppo.unroll
    for name, seconds in zip(("constants", "desk"), np.median(times, axis=0), strict=True):
        print(f"{name:10}{steps / seconds:10,.0f} training steps per second of the clock")
    ratios = times[:, 1] / times[:, 0]
    print(
        f"desk / constants, time {np.median(ratios):.3f} ({ratios.min():.3f} to {ratios.max():.3f})"
    )


if __name__ == "__main__":
    main()
