"""Training on an environment that costs nothing, in place of the quadruped: `train.py` in seconds.

What is tested with it is everything about a training but the environment.
"""

import copy
import os
import resource
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from quadwalk.tasks import sprint

# Before JAX is imported, for this module is what a process begins with. Not only by default: JAX
# says 1 to the processes that one with JAX starts, and XLA then fills what a test reads.
os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from brax.envs.base import Env, State

import quadwalk.env.env
import quadwalk.learn.prepare
import quadwalk.learn.writer
import quadwalk.progress.curves
from quadwalk.cli.process import run_command
from quadwalk.env.env import EnvState
from quadwalk.env.numbers import get_numbers, replace_numbers
from quadwalk.env.rewards import compute_total_reward
from quadwalk.errors import UserError
from quadwalk.learn.cli import main
from quadwalk.learn.desk import DeskIteration
from quadwalk.learn.flags import parse_config
from quadwalk.learn.loop import train
from quadwalk.physics.motor import PhysicsState
from quadwalk.settings.environment import EnvConfig

GOAL = 0.5
BATCH = 64  # control steps in an iteration with the flags `TINY`
TINY = (
    "--envs=16 --ppo.eval-envs=2 --ppo.unroll=4 --ppo.epochs=1 --ppo.minibatches=2 --ppo.hidden=8"
)


class Plain(Env):
    """A `TrainingEnv` on even ground; another class says how it moves."""

    config = sprint.TASK.env
    backend = "none"
    curriculum = terrain = mirrors = gains_note = None

    def __init_subclass__(cls, static: bool = True) -> None:
        if static:
            jax.tree_util.register_static(cls)  # a pytree, as an environment is, without leaves

    terms: tuple[str, ...] = ()  # metrics beyond those that all have

    def observe(self, inner: Any) -> jax.Array:
        """Return the observation of `inner`, a state's `pipeline_state`."""
        raise NotImplementedError

    def make_start(self, inner: Any) -> State:
        """Return the first state of an episode whose `pipeline_state` is `inner`."""
        zero = jnp.zeros(())
        metrics = dict.fromkeys(("speed", "fell", "nan", *self.terms), zero)
        return State(inner, self.observe(inner), zero, zero, metrics, {"truncation": zero})

    def start_episode(self, state: State, **changes: jax.Array) -> State:
        """Return `state` with `changes` of its `pipeline_state`, observed anew."""
        inner = state.pipeline_state._replace(**changes)
        return state.replace(pipeline_state=inner, obs=self.observe(inner))

    def make_next(self, state: State, inner: Any, reward: Any, limit: Any, **metrics: Any) -> State:
        """Return `state` after a step; `limit`, a bool, says if the time limit ends the episode.

        The metrics `fell` and `nan`, which must be there, end it as well. `inner` is the
        `pipeline_state`.
        """
        metrics = {name: jnp.float32(value) for name, value in metrics.items()}
        limit = jnp.float32(limit)
        return state.replace(
            pipeline_state=inner,
            obs=self.observe(inner),
            reward=reward,
            done=jnp.maximum(limit, jnp.maximum(metrics["fell"], metrics["nan"])),
            metrics=metrics,
            info={**state.info, "truncation": limit},
        )


class Toy(Plain):
    """A point that its actions push; the reward is best where they are `GOAL`.

    A step is not a number where `qpos[1]` is more than `env.termination.tipped.angle`. Each reset
    draws the former between 0 and 1; the latter is 1 unless a test lowers it.
    """

    observation_size = policy_size = 3
    sensors = SimpleNamespace(names=("position", "drawn", "speed"), critic_names=())
    action_size = 12
    terms = ("reward/forward",)

    def __init__(
        self, quadruped: Any = None, config: EnvConfig | None = None, bodies: Any = ()
    ) -> None:
        self.config = config or sprint.TASK.env
        self.quadruped = quadruped

    @property
    def mj_model(self) -> mujoco.MjModel:
        """Model of the quadruped; the toy does not step it."""
        return self.quadruped.make_full_model(visuals=False)

    @property
    def robot(self) -> SimpleNamespace:
        """The quadruped's home joints and limits, rad: what training asks of a robot."""
        quadruped = self.quadruped
        return SimpleNamespace(
            home_joints=quadruped.home[7:],
            lower=quadruped.lower,
            upper=quadruped.upper,
            knees_ahead=np.zeros(4, bool),
        )

    def observe(self, inner: EnvState) -> jax.Array:
        """Return position, drawn number and speed, (3,)."""
        return jnp.array([inner.physics.qpos[0], inner.physics.qpos[1], inner.physics.qvel[0]])

    def reset(self, rng: jax.Array) -> State:
        """Return the first state of an episode, at rest at a random position."""
        numbers = jax.random.uniform(rng, (2,))
        physics = PhysicsState(jnp.zeros(19).at[:2].set(numbers), jnp.zeros(18))
        return self.make_start(EnvState(physics, jnp.zeros(12), jnp.zeros((), jnp.int32)))

    def step(self, state: State, action: jax.Array) -> State:
        """Take a control step, at the speed that is the mean of `action` (12,)."""
        before = state.pipeline_state
        speed = before.physics.qvel.at[0].set(jnp.mean(action))
        position = before.physics.qpos.at[0].add(speed[0] * self.config.control_dt)
        physics = PhysicsState(position, speed)
        after = EnvState(physics, action, before.steps + 1)
        nan = before.physics.qpos[1] > self.config.termination["tipped"].params["angle"]
        limit = (after.steps >= self.config.episode_steps) & ~nan
        reward = 1.0 - jnp.mean(jnp.square(action - GOAL))
        metrics = {"speed": speed[0], "fell": 0.0, "nan": nan, "reward/forward": reward}
        return self.make_next(state, after, reward, limit, **metrics)


@jax.tree_util.register_pytree_node_class
class DeskToy(Toy, static=False):
    """The toy with stand-ins for all rewards of its task, and with numbers as leaves.

    The term `forward` is the toy's own. Each of the others is a power of the actions, over its
    parameter `height` if it has one. The toy fails where a reward `trot` is added, as if the task
    lacked what that needs.
    """

    numbers: Any = None

    def __init__(self, quadruped: Any, config: EnvConfig, bodies: Any = ()) -> None:
        super().__init__(quadruped, config)
        self.terms = tuple(f"reward/{name}" for name in config.reward)
        self.constants = self

    def tree_flatten(self) -> tuple[Any, "DeskToy"]:
        """Return (`numbers`,) as the pytree's children, and the toy as it was made."""
        return (self.numbers,), self.constants

    @classmethod
    def tree_unflatten(cls, constants: "DeskToy", children: Any) -> "DeskToy":
        """Return the toy that `tree_flatten` took apart, with the numbers in `children`."""
        toy = copy.copy(constants)
        toy.constants, toy.numbers = constants, children[0]
        if toy.numbers is not None:
            toy.config = replace_numbers(constants.config, toy.numbers)
        return toy

    def set_numbers(self, config: EnvConfig, names: Any) -> "DeskToy":
        """Return the toy with the numbers of `config` that `names` list, as leaves."""
        values = get_numbers(config, names)
        numbers = {name: jnp.float32(value) for name, value in values.items()}
        return DeskToy.tree_unflatten(self.constants, (numbers,))

    def step(self, state: State, action: jax.Array) -> State:
        """Take a step of `Toy`, rewarded by all terms; raise `UserError` if one is `trot`."""
        state = super().step(state, action)
        if "trot" in self.config.reward:
            raise UserError("the reward 'trot' does not give a number")
        values = {"forward": state.reward}
        for power, (name, term) in enumerate(self.config.reward.items(), 2):
            height = (term.params or {}).get("height", 1.0)
            values.setdefault(name, jnp.mean(jnp.abs(action)) ** power / height)
        metrics = {f"reward/{name}": values[name] for name in self.config.reward}
        reward = compute_total_reward(self.config.reward, values)
        return state.replace(reward=reward, metrics={**state.metrics, **metrics})


def run_train(output: Path, *flags: str) -> None:
    """Run `train.py` with `flags` on the toy, in a process of its own; it prints to `output`."""
    quadwalk.learn.prepare.QuadrupedEnv = Toy
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(descriptor, stream)
    run_command(lambda: main(flags))


def run_train_without_space(output: Path, *flags: str) -> None:
    """Run `run_train` where no file exceeds 40 kB: a checkpoint does not fit, a policy does."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, resource.RLIM_INFINITY))
    run_train(output, *flags)


def turn_round(iteration: DeskIteration) -> dict[str, float]:
    """Return the numbers to change after an iteration: a reward's sign after the third."""
    return {"env.reward.forward": -1.0} if iteration.iteration == 3 else {}


def train_until_killed(*flags: str) -> None:
    """Train the toy with `turn_round`; the process kills itself after the seventh iteration."""

    def change(iteration: DeskIteration) -> dict[str, float]:
        if iteration.iteration == 7:
            os.kill(os.getpid(), signal.SIGKILL)
        return turn_round(iteration)

    quadwalk.learn.prepare.QuadrupedEnv = DeskToy
    train(*parse_config(flags), on_iteration=change)


if __name__ == "__main__":
    run_train(Path("/dev/stdout"), *sys.argv[1:])
