"""The policy and value networks, and the policy as a function of its parameters."""

from collections.abc import Callable
from typing import Any

import quadwalk.physics.mjx  # noqa: F401  # before Brax, which imports MJX less quietly

# isort: split
import jax
import numpy as np
from brax.training.acme import running_statistics
from brax.training.agents.ppo import networks as brax_networks
from brax.training.distribution import NormalTanhDistribution
from brax.training.networks import ACTIVATION

from quadwalk.errors import UsageError
from quadwalk.train.settings import PPOConfig


def make_networks(
    config: PPOConfig, observation_size: int, action_size: int
) -> brax_networks.PPONetworks:
    """Two multilayer perceptrons on normalised observations; a tanh-squashed normal policy."""
    if config.activation not in ACTIVATION:
        raise UsageError(
            f"ppo.activation is {config.activation!r}; expected one of {', '.join(ACTIVATION)}"
        )
    networks = brax_networks.make_ppo_networks(
        observation_size,
        action_size,
        preprocess_observations_fn=running_statistics.normalize,
        policy_hidden_layer_sizes=config.hidden,
        value_hidden_layer_sizes=config.hidden,
        activation=ACTIVATION[config.activation],
    )
    # Brax starts with a standard deviation of softplus(0) = 0.69 before the squashing.
    distribution = NormalTanhDistribution(action_size, var_scale=config.noise / np.log(2.0))
    return networks.replace(parametric_action_distribution=distribution)


def mean_policy(
    networks: brax_networks.PPONetworks, normalizer: Any, params: Any
) -> Callable[[jax.Array], jax.Array]:
    """The deterministic policy: observation (..., n) to action (..., 12) in [-1, 1].

    It is a pytree of its weights, so that a jitted function can take it as an argument, and what
    was compiled for one policy serves for the next.
    """

    def policy(normalizer: Any, params: Any, observation: jax.Array) -> jax.Array:
        logits = networks.policy_network.apply(normalizer, params, observation)
        return networks.parametric_action_distribution.mode(logits)

    return jax.tree_util.Partial(policy, normalizer, params)
