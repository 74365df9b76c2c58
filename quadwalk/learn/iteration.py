"""An iteration of training as two compiled programs, to collect and to learn.

They are two since one program of both takes an eighth longer (docs/physics.md).
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from quadwalk.brax import Env
from quadwalk.env.ground_input import heights, with_heights
from quadwalk.learn import ppo
from quadwalk.learn.devices import release_freed_memory
from quadwalk.learn.networks import Networks, TanhNormal
from quadwalk.settings.training import PPOConfig

T = TypeVar("T")


class TrainState(NamedTuple):
    """Everything that an iteration of training reads and writes."""

    learner: ppo.Learner
    workers: ppo.RolloutState


def make_mesh(devices: list[jax.Device] | None = None) -> Mesh:
    """A one-dimensional mesh over `devices`, by default all."""
    return Mesh(np.array(devices or jax.devices()), (ppo.AXIS,))


def init_state(
    env: Env, networks: Networks, config: PPOConfig, mesh: Mesh, num_envs: int, seed: int
) -> TrainState:
    """The state before the first iteration, in which `num_envs` environments will start."""
    key_networks, key_workers = jax.random.split(jax.random.PRNGKey(seed))
    params = networks.init(key_networks)
    learner = ppo.Learner(
        params=params,
        optimizer=ppo.make_optimizer(config).init(params),
        normalizer=networks.init_statistics(),
        iterations=jnp.zeros((), jnp.int32),
    )
    split = NamedSharding(mesh, P(ppo.AXIS))
    # Only their shapes, from one's: the first `collect` starts them, and a program for that alone
    # would take as long to compile as a good part of `collect`.
    one = jax.eval_shape(env.reset, jax.ShapeDtypeStruct((2,), np.uint32))
    number = num_envs + config.eval_envs
    envs = jax.tree.map(lambda x: np.zeros((number, *x.shape), x.dtype), one)
    workers = ppo.RolloutState(
        envs=jax.device_put(envs, split),
        key=jax.device_put(jax.random.split(key_workers, mesh.size), split),
    )
    # Through NumPy, so that these are the same kind of arrays as those read from a file.
    learner = jax.tree.map(np.asarray, learner)
    return TrainState(jax.device_put(learner, NamedSharding(mesh, P())), workers)


def placed_like(saved: T, state: T) -> T:
    """`saved`, of NumPy arrays, on the devices that hold `state`."""

    def place(new: np.ndarray, old: jax.Array) -> jax.Array:
        return jax.make_array_from_callback(new.shape, old.sharding, lambda index: new[index])

    placed: T = jax.tree.map(place, saved, state)
    return placed


class Iteration:
    """One iteration of training: `state, numbers = iteration(state)`; `state` is donated."""

    def __init__(
        self, env: Env, networks: Networks, config: PPOConfig, mesh: Mesh, iterations: int
    ) -> None:
        def collecting(
            learner: ppo.Learner, workers: ppo.RolloutState, ground: tuple[jax.Array, ...]
        ) -> tuple[Any, ...]:
            own = with_heights(env, ground)
            workers, data, collected = ppo.collect(own, networks, config, learner, workers)
            key, key_learn = jax.random.split(workers.key[0])
            return workers._replace(key=key[None]), data, collected, key_learn[None]

        def learning(learner: ppo.Learner, data: Any, key: jax.Array) -> tuple[Any, ...]:
            learner, learned = ppo.learn(networks, config, learner, data, key[0], iterations)
            floats = [x for x in jax.tree.leaves(learner) if jnp.issubdtype(x.dtype, jnp.floating)]
            finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in floats]))
            return learner, {**learned, "learner/finite": finite}

        one: Any = P()
        split: Any = P(ppo.AXIS)
        rows: Any = P(None, ppo.AXIS)  # environments last
        steps: Any = P(None, None, ppo.AXIS)
        data: Any = ppo.Rollout(steps, steps, TanhNormal(steps, steps), rows, rows, rows), rows

        def program(function: Callable[..., Any], inputs: Any, outputs: Any, **others: Any) -> Any:
            shared = jax.shard_map(
                function, mesh=mesh, in_specs=inputs, out_specs=outputs, check_vma=False
            )
            return jax.jit(shared, **others)

        self._collect = program(
            collecting, (one, split, one), (split, data, one, split), donate_argnums=1
        )
        self._ground = jax.device_put(heights(env), NamedSharding(mesh, one))
        self.learn = program(learning, (one, data, split), (one, one), donate_argnums=0)

    def trace(self, state: TrainState) -> None:
        """Trace both programs for states like this: what the task's functions cannot do shows."""
        collecting = self._collect.lower(*state, self._ground)
        _, data, _, key = collecting.out_info
        self._collect, self.learn = collecting, self.learn.lower(state.learner, data, key)

    def compile(self) -> None:
        """Compile both, once traced, at the same time."""
        with ThreadPoolExecutor() as pool:
            self._collect, self.learn = pool.map(
                lambda traced: traced.compile(), (self._collect, self.learn)
            )
        release_freed_memory()

    def collect(self, learner: ppo.Learner, workers: ppo.RolloutState) -> tuple[Any, ...]:
        """Workers, data, metrics and a random key to learn with; `workers` are donated."""
        found: tuple[Any, ...] = self._collect(learner, workers, self._ground)
        return found

    def __call__(self, state: TrainState) -> tuple[TrainState, ppo.Metrics]:
        workers, data, collected, key = self.collect(*state)
        learner, learned = self.learn(state.learner, data, key)
        return TrainState(learner, workers), {**collected, **learned}
