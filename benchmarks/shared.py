"""What several benchmarks share: their parser, programs on all cores, a training to be timed."""

import argparse
import os
import sysconfig
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from quadwalk.env.env import QuadrupedEnv
from quadwalk.learn import ppo
from quadwalk.learn.devices import AXIS, count_cores, count_devices, make_mesh, set_up_devices
from quadwalk.learn.networks import make_env_networks
from quadwalk.physics.batching import batch_robots
from quadwalk.physics.fast import compute_acceleration, integrate
from quadwalk.physics.model import Model
from quadwalk.physics.motor import PhysicsState, Stepping
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.tasks import sprint


def make_parser(doc: str | None) -> argparse.ArgumentParser:
    """Return a parser that describes its program by the first line of the docstring `doc`."""
    return argparse.ArgumentParser(description=(doc or "").partition("\n")[0])


def format_row(cells: Sequence[str]) -> str:
    """Return a line of a table in Markdown."""
    return f"| {' | '.join(cells)} |"


def map_over_cores(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function` of one robot, compiled for many, which the cores share.

    Its arguments and results get a first axis for the robots, whose number is a multiple of
    the devices.
    """
    split = jax.sharding.PartitionSpec(AXIS)
    mesh = make_mesh()
    return jax.jit(
        jax.shard_map(
            jax.vmap(function), mesh=mesh, in_specs=split, out_specs=split, check_vma=False
        )
    )


def make_fast_step(
    model: Model, stepping: Stepping
) -> Callable[[PhysicsState, jax.Array], jax.Array]:
    """Return a function that steps a robot in the fast engine and returns its last qpos (19,).

    Its arguments are a state and torques (n, 12), Nm, one row for each of n physics steps. It is
    made to be batched, by `jax.vmap` or `map_over_cores`.
    """

    def step_batch(model: Model, state: PhysicsState, torques: jax.Array) -> jax.Array:
        def step(state: PhysicsState, torque: jax.Array) -> tuple[PhysicsState, None]:
            qacc = compute_acceleration(
                model, state, torque, stepping.iterations, stepping.line_search, stepping.dt
            )
            return integrate(state, qacc, stepping.dt), None

        return jax.lax.scan(step, state, torques)[0].qpos

    like = jax.ShapeDtypeStruct((19,), np.float32)
    return lambda *inputs: batch_robots(step_batch, like)(model, *inputs)


def measure_in_turn(
    measures: Mapping[str, Callable[[], float]], rounds: int
) -> dict[str, np.ndarray]:
    """Call each measure once in each round, in turn; return their results (rounds,) by name.

    Before, each is called once more, to compile.
    """
    for measure in measures.values():
        measure()
    table = [[measure() for measure in measures.values()] for _ in range(rounds)]
    return dict(zip(measures, np.transpose(table), strict=True))


def find_example_robots() -> Path | None:
    """Return the folder of example-robot-data's robots; None if it is not installed.

    QUADWALK_EXAMPLE_ROBOTS can name another folder.
    """
    if setting := os.environ.get("QUADWALK_EXAMPLE_ROBOTS"):
        return Path(setting)
    for name in ("purelib", "platlib"):
        folder = Path(sysconfig.get_path(name))
        robots = folder / "cmeel.prefix/share/example-robot-data/robots"
        if robots.is_dir():
            return robots
    return None


class Timed(NamedTuple):
    """What a stretch of training took."""

    steps: int  # control steps of the environments that are learned from
    collecting: float  # s
    learning: float  # s

    @property
    def seconds(self) -> float:
        """Seconds of collecting and learning together."""
        return self.collecting + self.learning


class TimedTraining:
    """The training of `quadwalk train sprint`, without files; it has compiled when made."""

    def __init__(self, envs: int) -> None:
        config = sprint.TASK.ppo
        self.devices = count_devices(envs, config.minibatches, config.eval_envs, count_cores())
        set_up_devices(self.devices)
        env = QuadrupedEnv(load_quadruped(), sprint.TASK.env)
        networks = make_env_networks(env, config)
        mesh = make_mesh()
        self.state = ppo.init_state(env, networks, config, mesh, envs, seed=0)
        # The learning rate's schedule alone depends on how many iterations there are.
        self.iterate = ppo.Iteration(env, networks, config, mesh, iterations=1000)
        self.batch = envs * config.unroll
        self.run(0.0)  # compiles, and measures the observations
        self.run(0.0)

    def run(self, seconds: float) -> Timed:
        """Train for `seconds`, at least one iteration; return what that took."""
        began = time.perf_counter()
        total = Timed(0, 0.0, 0.0)
        while not total.steps or time.perf_counter() - began < seconds:
            start = time.perf_counter()
            workers, rollout, _, key = jax.block_until_ready(self.iterate.collect(*self.state))
            middle = time.perf_counter()
            learner, _ = jax.block_until_ready(self.iterate.learn(self.state.learner, rollout, key))
            end = time.perf_counter()
            self.state = ppo.TrainState(learner, workers)
            total = Timed(
                total.steps + self.batch,
                total.collecting + middle - start,
                total.learning + end - middle,
            )
        return total
