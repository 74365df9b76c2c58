"""The policy and value networks, and the policy as a function of its parameters."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from brax.training.acme import running_statistics
from brax.training.acme.running_statistics import NestedMeanStd
from brax.training.distribution import NormalTanhDistribution
from brax.training.networks import (
    ACTIVATION,
    FeedForwardNetwork,
    make_policy_network,
    make_value_network,
)

from quadwalk.errors import UsageError
from quadwalk.train.settings import PPOConfig

# Of a number's standard deviation, as a share of its mean or, if that is less than 1, of 1.
CONSTANT = 1e-4


class Networks(NamedTuple):
    """What Brax's `PPONetworks` holds."""

    policy_network: FeedForwardNetwork
    value_network: FeedForwardNetwork
    parametric_action_distribution: "NormalTanh"


def make_networks(
    config: PPOConfig, policy_size: int, action_size: int, critic_size: int = 0
) -> Networks:
    """Two multilayer perceptrons on normalised observations; a tanh-squashed normal policy.

    The policy sees the first `policy_size` numbers of an observation, the value network
    `critic_size` more: what is known in simulation alone (Pinto et al. 2017, arXiv:1710.06542).
    """
    if config.activation not in ACTIVATION:
        raise UsageError(
            f"ppo.activation is {config.activation!r}; expected one of {', '.join(ACTIVATION)}"
        )
    shape = {
        "activation": ACTIVATION[config.activation],
        "preprocess_observations_fn": running_statistics.normalize,
        "hidden_layer_sizes": config.hidden,
    }
    # Brax starts with a standard deviation of softplus(0) = 0.69 before the squashing.
    distribution = NormalTanh(action_size, var_scale=config.noise / np.log(2.0))
    whole = policy_size + critic_size
    policy = make_policy_network(distribution.param_size, policy_size, **shape)
    return Networks(
        policy_network=_on_rows(policy, policy_size),
        value_network=_on_rows(make_value_network(whole, **shape), whole),
        parametric_action_distribution=distribution,
    )


def _on_rows(network: FeedForwardNetwork, size: int) -> FeedForwardNetwork:
    """`network` on the first `size` numbers, with all other axes of its input made one.

    XLA multiplies (rows, n) at nearly twice the speed of (envs, steps, n).
    """

    def apply(normalizer: Any, params: Any, observation: jax.Array) -> jax.Array:
        several = observation.shape[:-1]
        statistics = NestedMeanStd(normalizer.mean[:size], divisors(normalizer)[:size])
        rows = observation[..., :size].reshape(-1, size)
        out: jax.Array = network.apply(statistics, params, rows)
        return out.reshape(*several, *out.shape[1:])

    return FeedForwardNetwork(init=network.init, apply=apply)


def divisors(normalizer: NestedMeanStd) -> jax.Array:
    """What the numbers of an observation, less their means, are divided by (n,): their spread.

    It is 1 where a number has been constant so far, but for rounding: it may vary yet, and
    nothing says by how much.
    """
    least = CONSTANT * jnp.maximum(jnp.abs(normalizer.mean), 1.0)
    return jnp.where(normalizer.std < least, 1.0, normalizer.std)


class NormalTanh(NormalTanhDistribution):
    """Brax's distribution, with its entropy in closed form in place of Brax's random sample.

    The entropy is the normal's and the mean logarithm of the tanh's slope. That mean is expanded
    about the normal's own: log(1 - tanh(x)^2) has the second derivative -2 (1 - tanh(x)^2).
    """

    def entropy(self, parameters: jax.Array, seed: jax.Array) -> jax.Array:
        """(...) of the distributions with these parameters (..., 24); no use is made of `seed`."""
        normal = self.create_dist(parameters)
        slope = 1.0 - jnp.tanh(normal.loc) ** 2
        squashing = self._postprocessor.forward_log_det_jacobian(normal.loc)
        return jnp.sum(normal.entropy() + squashing - normal.scale**2 * slope, axis=-1)


def mean_policy(
    networks: Networks, normalizer: Any, params: Any
) -> Callable[[jax.Array], jax.Array]:
    """The deterministic policy: observation (..., n) to action (..., 12) in [-1, 1].

    Of an observation it takes the first numbers, those that the policy sees.

    It is a pytree of its weights, so that a jitted function can take it as an argument, and what
    was compiled for one policy serves for the next.
    """

    def policy(normalizer: Any, params: Any, observation: jax.Array) -> jax.Array:
        logits = networks.policy_network.apply(normalizer, params, observation)
        return networks.parametric_action_distribution.mode(logits)

    return jax.tree_util.Partial(policy, normalizer, params)
