"""Our training loop against Brax's own `ppo.train`, on the same environment and settings.

Both draw random numbers in an order of their own. To agree number by number, the noise of an action
is therefore a function of the policy's output. Minibatches are cut without shuffling, and starts
are the same; then parameters must agree after whole iterations. With random numbers as they are,
learning curves must agree as far as seeds do.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from brax.envs import training as brax_wrappers
from brax.envs.base import Env, State, Wrapper
from brax.training import gradients
from brax_training import (
    NormalTanh,
    compute_curves,
    get_params,
    make_brax_networks,
    train_with_brax,
)
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P
from scipy import stats
from toy import Plain

from quadwalk.learn import ppo
from quadwalk.learn.devices import make_mesh
from quadwalk.learn.distribution import TanhNormal
from quadwalk.learn.networks import make_networks
from quadwalk.settings.training import PPOConfig
from quadwalk.tasks import sprint

ENVS = 32
SETTINGS = {
    "eval_envs": 2,
    "unroll": 10,
    "hidden": (16, 16),
    "discount": 0.9,
    "entropy": 0.01,
    "final_entropy": 0.01,  # Brax's stays the same throughout
}


class Motion(NamedTuple):
    position: jax.Array
    velocity: jax.Array
    steps: jax.Array


class Point(Plain):
    """A mass on a line, pushed by the action, best at rest at 0; beyond 2 it has fallen."""

    observation_size = 2
    action_size = 1

    def __init__(self, episode_steps: int, dt: float = 0.1, spread: float = 0.0) -> None:
        self.config = dataclasses.replace(
            sprint.TASK.env, episode_seconds=episode_steps * sprint.TASK.env.control_dt
        )
        self.dt = dt  # s; with 0, nothing moves
        self.spread = spread  # fresh starts are at random up to this far from 0

    def observe(self, inner: Motion) -> jax.Array:
        return jnp.stack([inner.position, inner.velocity])

    def reset(self, rng: jax.Array) -> State:
        position = jax.random.uniform(rng, (), minval=-1.0, maxval=1.0) * self.spread
        return self.make_start(Motion(position, jnp.zeros(()), jnp.zeros((), jnp.int32)))

    def step(self, state: State, action: jax.Array) -> State:
        before = state.pipeline_state
        velocity = before.velocity + self.dt * 3.0 * action[0]
        motion = Motion(before.position + self.dt * velocity, velocity, before.steps + 1)
        fell = jnp.abs(motion.position) > 2.0
        reward = 1.0 - motion.position**2 - 0.1 * action[0] ** 2 - 5.0 * fell
        limit = (motion.steps >= self.config.episode_steps) & ~fell
        return self.make_next(state, motion, reward, limit, speed=velocity, fell=fell, nan=0.0)


def compute_noise(mean: jax.Array) -> jax.Array:
    return 1.5 * jnp.sin(20.0 * mean)


class Keyless(NormalTanh):
    """Actions whose noise follows from the policy's output, whatever the random key."""

    def create_dist(self, parameters: jax.Array) -> Any:
        normal = super().create_dist(parameters)
        normal.sample = lambda seed: normal.loc + normal.scale * compute_noise(normal.loc)
        return normal


class Scattered(Wrapper):
    """First episodes that start anywhere, on top of a wrapper that remembers the usual start."""

    def reset(self, rng: jax.Array) -> State:
        state = self.env.reset(rng)
        draw = jax.vmap(lambda key: jax.random.uniform(key, (2,), minval=-1.5, maxval=1.5))(rng)
        motion = jax.vmap(place_by_observation)(draw)
        return state.replace(pipeline_state=motion, obs=draw)


def place_by_observation(observation: jax.Array) -> Motion:
    """Return a state, its clock too, that follows from its observation."""
    position, velocity = observation
    return Motion(position, velocity, (jnp.abs(position) * 100).astype(jnp.int32) % 4)


def wrap_scattered(env: Env, **settings: Any) -> Wrapper:
    return Scattered(brax_wrappers.wrap(env, **settings))


class Both(NamedTuple):
    """Parameters, gradients and losses of `ppo.train` and of our loop after the same start."""

    brax: list[Any]  # (normalizer, policy, value) after each iteration, the start first
    ours: list[Any]
    brax_gradients: Any  # of the first update
    learner: ppo.Learner  # ours, after the first iteration
    brax_losses: dict[str, Any]  # of the first iteration
    losses: dict[str, Any]


@pytest.fixture
def train_both(monkeypatch):
    """Return a function that trains with both for some iterations, from the same starts.

    The starts are scattered.
    """
    records = []
    real = gradients.loss_and_pgrad

    def record_gradients(*args: Any, **kwargs: Any) -> Any:
        function = real(*args, **kwargs)

        def call(params: Any, normalizer: Any, data: Any, key: jax.Array) -> Any:
            result, grads = function(params, normalizer, data, key)
            device = jax.lax.axis_index(kwargs["pmap_axis_name"])
            jax.debug.callback(
                lambda *record: records.append(record), device, data.observation, grads
            )
            return result, grads

        return call

    monkeypatch.setattr(gradients, "loss_and_pgrad", record_gradients)
    monkeypatch.setattr(
        TanhNormal, "sample", lambda self, key: self.mean + self.std * compute_noise(self.mean)
    )
    monkeypatch.setattr(
        jax.random, "permutation", lambda key, x: jnp.arange(x) if isinstance(x, int) else x
    )

    def train(env: Point, config: PPOConfig, iterations: int) -> Both:
        mesh = make_mesh()
        networks = make_networks(config, Point.observation_size, Point.action_size)
        keyless = Keyless(Point.action_size, var_scale=networks.std_scale)
        brax_networks = make_brax_networks(config, networks, parametric_action_distribution=keyless)
        # Learning begins at once: the first iteration of all would measure observations only.
        state = ppo.init_state(env, networks, config, mesh, ENVS, seed=0)
        learner = state.learner._replace(iterations=jnp.ones((), jnp.int32))
        reported: list[dict[str, Any]] = []
        brax = train_with_brax(
            env, brax_networks, config, ENVS, jax.device_get(learner), iterations, iterations,
            seed=0, wrap_env_fn=wrap_scattered,
            progress_fn=lambda steps, metrics: reported.append(metrics),
        )  # fmt: skip
        jax.effects_barrier()

        # The first rows that Brax's loss saw, on each device, tell its starts.
        per_device = [[first[1] for first in records if first[0] == d] for d in range(mesh.size)]
        observations = [
            np.concatenate([data[:, 0] for data in device_rows[: config.minibatches]])
            for device_rows in per_device
        ]
        # Behind each device's share of environments learnt from stands one for evaluation.
        begin = np.concatenate([np.concatenate([part, part[:1]]) for part in observations])
        envs = jax.vmap(env.reset)(jax.random.split(jax.random.PRNGKey(0), len(begin)))
        envs = envs.replace(pipeline_state=jax.vmap(place_by_observation)(begin), obs=begin)
        envs = jax.device_put(envs, NamedSharding(mesh, P(ppo.AXIS)))
        learner = jax.device_put(learner, NamedSharding(mesh, P()))
        state = ppo.TrainState(learner, state.workers._replace(envs=envs))

        iterate = ppo.Iteration(env, networks, config, mesh, iterations)
        ours, first, losses = [get_params(state.learner)], None, None
        for _ in range(iterations):
            state, metrics = jax.block_until_ready(iterate(state))
            ours.append(get_params(state.learner))
            first, losses = first or jax.device_get(state.learner), losses or metrics
        return Both(brax, ours, records[0][2], first, reported[0], losses)

    return train


def assert_trees_close(ours: Any, brax: Any, **tolerance: float) -> None:
    pairs = zip(jax.tree.leaves(ours), jax.tree.leaves(brax), strict=True)
    for a, b in pairs:
        np.testing.assert_allclose(a, b, **tolerance)


@pytest.mark.parametrize(
    ("env", "changes"),
    [
        (Point(10**6), {}),
        # Brax bootstraps from the state before a time limit and we from the one after, which is
        # the same where nothing moves; its scale also shrinks what it bootstraps from.
        (Point(4, dt=0.0), {"reward_scale": 1.0}),
    ],
    ids=["moving", "time limit"],
)
def test_one_update_has_the_loss_and_gradients_of_brax(train_both, env, changes):
    one = {"minibatches": 1, "epochs": 1, "max_grad_norm": 1e6}
    both = train_both(env, dataclasses.replace(sprint.TASK.ppo, **SETTINGS, **one, **changes), 1)
    for ours, brax in (("loss/policy", "policy_loss"), ("loss/value", "v_loss")):
        expected = float(both.brax_losses[f"training/{brax}"])
        assert float(both.losses[ours]) == pytest.approx(expected, rel=1e-5, abs=1e-6)
    # Adam's first mean is a tenth of the first gradient, which clipping has left alone.
    mean = optax.tree_utils.tree_get(both.learner.optimizer, "mu")
    scale = float(optax.tree_utils.tree_norm(both.brax_gradients))
    assert scale > 1e-2
    gradient = jax.tree.map(lambda m: 10.0 * m, mean)
    assert_trees_close(gradient, both.brax_gradients, rtol=1e-4, atol=1e-5 * scale)


def test_iterations_leave_the_parameters_of_brax(train_both):
    """Check falls, epochs, minibatches, clipping, Adam, the learning rate and the normalizer."""
    config = dataclasses.replace(
        sprint.TASK.ppo, **SETTINGS, minibatches=2, epochs=3, desired_kl=0.01, final_kl=0.01
    )
    both = train_both(Point(10**6), config, iterations=4)
    assert len(both.ours) == len(both.brax) == 5
    assert_trees_close(both.ours[0], both.brax[0], rtol=0)
    for ours, brax in zip(both.ours[1:], both.brax[1:], strict=True):
        assert_trees_close(ours[1:], brax[1:], rtol=1e-3, atol=1e-4)
        assert_trees_close(ours[0].mean, brax[0].mean, rtol=1e-3, atol=1e-4)
        assert_trees_close(ours[0].std, brax[0].std, rtol=1e-3, atol=1e-4)


def test_learning_curves_agree_over_three_seeds():
    """Check that the 99 % interval of the difference holds zero.

    The difference is a tenth of the gain at most. An iteration is an episode long, so that it
    matters little that Brax's episodes are in phase.
    """
    config = dataclasses.replace(sprint.TASK.ppo,
        eval_envs=2, unroll=25, minibatches=4, hidden=(32, 32), discount=0.95, reward_scale=1.0,
        learning_rate=1e-3, min_learning_rate=1e-3, max_learning_rate=1e-3,
    )  # fmt: skip
    ours, brax = compute_curves(
        Point(25, spread=1.5), config, envs=256, iterations=30, points=5, seeds=3, episodes=128
    )
    gaps = (ours - brax)[:, 1:].mean(axis=1)  # (seeds,), less the common start
    interval = stats.ttest_1samp(gaps, 0.0).confidence_interval(0.99)
    assert interval.low <= 0.0 <= interval.high
    gain = brax[:, -1].mean() - brax[:, 0].mean()
    assert gain > 0.5
    assert abs(gaps.mean()) < 0.1 * gain
