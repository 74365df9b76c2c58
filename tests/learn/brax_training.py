"""Brax's `ppo.train` and our training loop on the same environment with the same settings.

Only what the loops do still differs. At a time limit, ours bootstraps from the state after it.
Brax's `bootstrap_on_timeout` does so from the state before it, and scales that too. Ours draws a
fresh start for each episode, and Brax restores the first one. Ours also spreads the episodes'
phases.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import Env, State, Wrapper
from brax.training.acme.running_statistics import normalize
from brax.training.agents.ppo import networks as brax_networks
from brax.training.agents.ppo import train as brax_ppo
from brax.training.distribution import NormalTanhDistribution
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from quadwalk.learn import ppo
from quadwalk.learn.acting import make_policy
from quadwalk.learn.devices import make_mesh
from quadwalk.learn.distribution import TanhNormal
from quadwalk.learn.networks import Networks, make_networks
from quadwalk.settings.training import PPOConfig

Params = tuple[Any, Any, Any]  # normalizer, policy, value


class _JaxForBrax:
    """JAX with a function that it removed; Brax 0.14.2 calls it, its next release does not."""

    @staticmethod
    def device_put_replicated(tree: Any, devices: list[jax.Device]) -> Any:
        """Return `tree` with a new first axis, along which each device holds the same."""
        split = NamedSharding(Mesh(np.array(devices), ("i",)), PartitionSpec("i"))
        return jax.tree.map(lambda x: jax.device_put(jnp.stack([x] * len(devices)), split), tree)

    def __getattr__(self, name: str) -> Any:
        return getattr(jax, name)


if not hasattr(jax, "device_put_replicated"):
    brax_ppo.jax = _JaxForBrax()


class NormalTanh(NormalTanhDistribution):
    """Brax's distribution of actions with our entropy, in closed form in place of a sample."""

    def entropy(self, parameters: jax.Array, seed: jax.Array) -> jax.Array:
        """Return the entropy of the distributions of `parameters` (..., 2 n); ignore `seed`."""
        return TanhNormal.from_outputs(
            jnp.moveaxis(parameters, -1, 0), self._var_scale
        ).compute_entropy()


def make_brax_networks(
    config: PPOConfig, networks: Networks, **others: Any
) -> brax_networks.PPONetworks:
    """Return Brax's own networks of the same sizes as `networks`, which are plain."""
    return brax_networks.make_ppo_networks(
        networks.critic_obs.size,
        networks.outputs.size // 2,
        preprocess_observations_fn=normalize,
        policy_hidden_layer_sizes=config.hidden,
        value_hidden_layer_sizes=config.hidden,
    ).replace(
        **{
            "parametric_action_distribution": NormalTanh(
                networks.outputs.size // 2, var_scale=networks.std_scale
            ),
            **others,
        }
    )


class ForBrax(Wrapper):
    """An environment of ours under Brax's wrappers, which keep entries of their own in `info`."""

    def reset(self, rng: jax.Array) -> State:
        """Reset the environment; add Brax's entry "time_out" to `info`."""
        state = self.env.reset(rng)
        return state.replace(info={**state.info, "time_out": jnp.zeros(())})

    def step(self, state: State, action: jax.Array) -> State:
        """Step the environment; keep Brax's entries of `info`, and call a time limit "time_out"."""
        after = self.env.step(state, action)
        time_out = after.info["truncation"]
        return after.replace(info={**state.info, **after.info, "time_out": time_out})


def train_with_brax(
    env: Env,
    networks: brax_networks.PPONetworks,
    config: PPOConfig,
    envs: int,
    start: ppo.Learner,
    iterations: int,
    points: int,
    seed: int,
    **others: Any,
) -> list[Params]:
    """Train by Brax; return parameters at the start, and after each of `points` equal parts.

    It trains for `iterations` of ours, with `envs` environments, from the parameters of `start`.
    """
    params_of_points: list[Params] = []
    brax_ppo.train(
        ForBrax(env),
        num_timesteps=iterations * envs * config.unroll,
        num_envs=envs,
        batch_size=envs // config.minibatches,
        num_minibatches=config.minibatches,
        num_updates_per_batch=config.epochs,
        unroll_length=config.unroll,
        learning_rate=config.learning_rate,
        learning_rate_schedule="ADAPTIVE_KL",
        learning_rate_schedule_min_lr=config.min_learning_rate,
        learning_rate_schedule_max_lr=config.max_learning_rate,
        desired_kl=config.desired_kl,
        discounting=config.discount,
        gae_lambda=config.gae_lambda,
        clipping_epsilon=config.clip_epsilon,
        entropy_cost=config.entropy,
        vf_loss_coefficient=config.value_coef,
        max_grad_norm=config.max_grad_norm,
        reward_scaling=config.reward_scale,
        normalize_observations=True,
        bootstrap_on_timeout=True,
        episode_length=10**6,  # the environment ends its own episodes
        run_evals=False,
        num_eval_envs=2,
        num_evals=points + 1,
        network_factory=lambda *args, **kwargs: networks,
        restore_params=(start.normalizer, start.params.policy, start.params.value),
        policy_params_fn=lambda steps, make, params: params_of_points.append(
            jax.device_get(params)
        ),
        seed=seed,
        **others,
    )
    return params_of_points


def get_params(learner: ppo.Learner) -> Params:
    """Return a learner's normalizer, policy and value parameters, on the host, as Brax's are."""
    return jax.device_get((learner.normalizer, learner.params.policy, learner.params.value))


def make_evaluation(env: Env, config: PPOConfig, episodes: int) -> Callable[[Params], Any]:
    """Return a function from parameters to the mean reward per step, by the mean action.

    The mean is over all steps of `episodes` of full length; after an episode's end they count as 0.
    """
    steps = env.config.episode_steps

    @jax.jit
    def evaluate(params: Params) -> jax.Array:
        policy = make_policy(config, params[0], params[1])

        def step(carry: Any, _: None) -> Any:
            state, running = carry
            after = jax.vmap(env.step)(state, policy(state.obs))
            return (after, running * (1.0 - after.done)), after.reward * running

        keys = jax.random.split(jax.random.PRNGKey(12345), episodes)
        state = jax.vmap(env.reset)(keys)
        _, rewards = jax.lax.scan(step, (state, jnp.ones(episodes)), None, length=steps)
        return rewards.sum(0).mean(-1) / steps

    return evaluate


def compute_curves(
    env: Env,
    config: PPOConfig,
    envs: int,
    iterations: int,
    points: int,
    seeds: int,
    episodes: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Train by our loop and by Brax's; return the rewards of ours and of Brax's.

    Each is (seeds, 1 + points), by `make_evaluation`. Both start from the same parameters.
    """
    networks = make_networks(config, env.observation_size, env.action_size)
    brax_networks = make_brax_networks(config, networks)
    mesh = make_mesh()
    iterate = ppo.Iteration(env, networks, config, mesh, iterations)
    evaluate = make_evaluation(env, config, episodes)
    ours, brax = [], []
    for seed in range(seeds):
        state = ppo.init_state(env, networks, config, mesh, envs, seed)
        state, _ = jax.block_until_ready(iterate(state))  # measures the observations only
        start = jax.device_get(state.learner)
        curve = [evaluate(get_params(start))]
        for number in range(1, iterations + 1):
            state, _ = jax.block_until_ready(iterate(state))
            if number % (iterations // points) == 0:
                curve.append(evaluate(get_params(state.learner)))
        ours.append(curve)
        params = train_with_brax(env, brax_networks, config, envs, start, iterations, points, seed)
        brax.append([evaluate(point) for point in params])
    return np.array(ours), np.array(brax)
