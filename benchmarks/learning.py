"""What a training step costs: collecting, learning, the rest; and beside another commit's.

    python benchmarks/learning.py [--task sprint] [--against COMMIT] [--rounds 5] [--envs 2048]
        [--python PATH] [--processor-time]

Trains a task in iterations, in turn with the other commit's benchmarks/learning.py, in a process of
its own each; what counts is the median of the ratios, since a machine's speed drifts. Costs are in
microseconds of a core for one control step of one environment. Physics alone is the control steps
of `collect` without policy, reward and fresh starts, from standing robots with random targets.

Where the other commit has other packages, PATH is a Python that has them. On a machine that others
use too, --processor-time counts what the cores spent on it, not what they waited.
"""

import argparse
import contextlib
import dataclasses
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.shared import make_parser, map_over_cores
from quadwalk.cores import count_cores
from quadwalk.env.env import QuadrupedEnv
from quadwalk.learn import ppo
from quadwalk.learn.devices import choose_devices, make_mesh
from quadwalk.learn.networks import make_env_networks
from quadwalk.physics.engines import ENGINES
from quadwalk.physics.motor import PhysicsState
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.task_files import load_task
from quadwalk.tasks import list_tasks

ROOT = Path(__file__).resolve().parents[1]
ITERATIONS = 8  # in a round
PARTS = ("training", "collect", "learn", "physics alone")  # what a worker prints


def main() -> None:
    """Measure the costs of training, in turn with another commit if named, and print them."""
    parser = make_parser(__doc__)
    parser.add_argument("--task", default="sprint", choices=list_tasks())
    parser.add_argument("--against", metavar="COMMIT", help="the commit to compare with")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--envs", type=int, default=2048)
    parser.add_argument("--python", default=sys.executable, help="one with that commit's packages")
    parser.add_argument("--processor-time", action="store_true", help="for a busy machine")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        work(options.task, options.envs, options.processor_time)
        return
    flags = [f"--task={options.task}", f"--envs={options.envs}"]
    if options.processor_time:
        flags.append("--processor-time")
    with contextlib.ExitStack() as stack:
        workers = {"this code": stack.enter_context(start_worker(ROOT, sys.executable, flags))}
        if options.against:
            checkout = stack.enter_context(check_out(options.against))
            other = stack.enter_context(start_worker(checkout, options.python, flags))
            workers[options.against] = other
        rounds = [[ask(process) for process in workers.values()] for _ in range(options.rounds)]
    costs = dict(zip(workers, np.swapaxes(rounds, 0, 1), strict=True))  # (rounds, parts)
    for name, table in costs.items():
        medians = dict(zip(PARTS, np.median(table, axis=0), strict=True))
        medians["rest"] = medians["training"] - medians["collect"] - medians["learn"]
        print(f"{name}: {count_cores() * 1e6 / medians['training']:,.0f} training steps/s")
        for part, cost in medians.items():
            print(f"  {part:14}{cost:7.1f} us per control step and core")
    our_costs = costs["this code"]
    print(f"physics alone / training    {np.median(our_costs[:, 3] / our_costs[:, 0]):.2f}")
    if options.against:
        ratio = np.median(costs[options.against][:, 0] / our_costs[:, 0])
        print(f"training steps/s            {ratio:.2f} x {options.against}")


@contextlib.contextmanager
def check_out(commit: str) -> Iterator[Path]:
    """Return a context that gives a folder with the files of `commit`, and removes it."""
    with tempfile.TemporaryDirectory() as folder:
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--detach", folder, commit], check=True, capture_output=True)
        try:
            yield Path(folder)
        finally:
            subprocess.run([*git, "remove", "--force", folder], check=True)


@contextlib.contextmanager
def start_worker(checkout: Path, python: str, flags: list[str]) -> Iterator[subprocess.Popen[str]]:
    """Return a context that gives a process that has compiled and trains rounds, one per `ask`.

    It runs the code in `checkout`, with `flags` for this benchmark.
    """
    command = [python, str(checkout / "benchmarks" / "learning.py"), "--work", *flags]
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=environment, text=True, stdin=pipe, stdout=pipe) as process:
        ask(process)
        yield process
        assert process.stdin is not None
        process.stdin.close()


def ask(process: subprocess.Popen[str]) -> list[float]:
    """Have the worker of `start_worker` train one round; return its costs, as of `PARTS`.

    They are in microseconds of a core for one control step.
    """
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    return [float(cost) for cost in process.stdout.readline().split()]


def work(task: str, envs: int, processor_time: bool) -> None:
    """Train one round for each line of standard input, and print the costs named in `PARTS`."""
    read_clock = time.process_time if processor_time else time.perf_counter
    config, devices = choose_devices(dataclasses.replace(load_task(task), envs=envs))
    env = QuadrupedEnv(load_quadruped(), config.env)
    networks = make_env_networks(env, config.ppo)
    mesh = make_mesh(devices)
    state = ppo.init_state(env, networks, config.ppo, mesh, envs, seed=0)
    iterate = ppo.Iteration(env, networks, config.ppo, mesh, iterations=1000)
    for _ in range(4):
        state, _ = jax.block_until_ready(iterate(state))

    noise = np.random.default_rng(0).normal(0.0, 0.1, (config.ppo.unroll, 12))
    targets = env.robot.home_joints + noise

    def step_physics(physics: PhysicsState) -> PhysicsState:
        def step(physics: PhysicsState, target: jax.Array) -> tuple[PhysicsState, None]:
            control_step = ENGINES[env.engine].step
            return control_step(env.model, env.stepping, physics, target)[0], None

        return jax.lax.scan(step, physics, jnp.asarray(targets, jnp.float32))[0]

    physics_alone = map_over_cores(step_physics)
    physics = jax.block_until_ready(physics_alone(state.workers.envs.pipeline_state.physics))
    cores = 1 if processor_time else len(devices)
    unit = cores * 1e6 / (ITERATIONS * envs * config.ppo.unroll)
    for _ in sys.stdin:
        collecting = learning = 0.0
        began = read_clock()
        for _ in range(ITERATIONS):
            start = read_clock()
            workers, rollout, _, key = jax.block_until_ready(iterate.collect(*state))
            middle = read_clock()
            learner, _ = jax.block_until_ready(iterate.learn(state.learner, rollout, key))
            state = ppo.TrainState(learner, workers)
            collecting += middle - start
            learning += read_clock() - middle
        training = read_clock() - began
        physics = state.workers.envs.pipeline_state.physics
        began = read_clock()
        for _ in range(ITERATIONS):
            physics = jax.block_until_ready(physics_alone(physics))
        costs = (training, collecting, learning, read_clock() - began)
        print(*(cost * unit for cost in costs), flush=True)


if __name__ == "__main__":
    main()
