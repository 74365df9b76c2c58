"""The networks against Brax's own, which take a policy's and a critic's observation by name."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.acme import running_statistics, specs
from brax.training.acme.running_statistics import NestedMeanStd, normalize
from brax.training.agents.ppo import losses, networks
from brax.training.distribution import NormalTanhDistribution
from brax.training.types import Transition

from quadwalk.tasks import sprint
from quadwalk.train.networks import NormalTanh, make_networks, mean_policy

SEEN, MORE, ACTIONS = 5, 3, 2
ENVS, UNROLL = 6, 4
CONFIG = dataclasses.replace(sprint.TASK.ppo, hidden=(16, 16))


@pytest.fixture(scope="module")
def pair():
    """Ours, Brax's, and parameters for both."""
    ours = make_networks(CONFIG, SEEN, ACTIONS, MORE)
    brax = networks.make_ppo_networks(
        {"state": SEEN, "whole": SEEN + MORE},
        ACTIONS,
        preprocess_observations_fn=normalize,
        policy_hidden_layer_sizes=CONFIG.hidden,
        value_hidden_layer_sizes=CONFIG.hidden,
        value_obs_key="whole",
    ).replace(parametric_action_distribution=ours.parametric_action_distribution)
    keys = jax.random.split(jax.random.PRNGKey(0), 2)
    params = losses.PPONetworkParams(
        policy=brax.policy_network.init(keys[0]), value=brax.value_network.init(keys[1])
    )
    return ours, brax, params


@pytest.fixture(scope="module")
def statistics():
    rng = np.random.default_rng(1)
    mean, std = rng.normal(size=SEEN + MORE), rng.uniform(0.5, 2.0, SEEN + MORE)
    flat = NestedMeanStd(jnp.asarray(mean), jnp.asarray(std))
    named = running_statistics.init_state(
        {"state": specs.Array((SEEN,), "float32"), "whole": specs.Array((SEEN + MORE,), "float32")}
    ).replace(mean=by_name(flat.mean), std=by_name(flat.std))
    return flat, named


def by_name(observation):
    return {"state": observation[..., :SEEN], "whole": observation}


def test_loss_and_gradients_are_those_of_brax_with_two_observations(pair, statistics):
    ours, brax, params = pair
    rng = np.random.default_rng(2)

    def draw(*shape):
        return jnp.asarray(rng.normal(size=(ENVS, UNROLL, *shape)), jnp.float32)

    observation, last = draw(SEEN + MORE), draw(SEEN + MORE)[:, :1]
    extras = {"raw_action": draw(ACTIONS), "log_prob": draw(), "distribution_params": draw(4)}
    data = Transition(
        observation, None, draw(), (draw() > -1.0).astype(jnp.float32), last,
        {"state_extras": {"truncation": jnp.zeros((ENVS, UNROLL))}, "policy_extras": extras},
    )  # fmt: skip
    named = data._replace(observation=by_name(observation), next_observation=by_name(last))

    def graded(which, data, normalizer):
        def loss(params):
            key = jax.random.PRNGKey(0)
            return losses.compute_ppo_loss(params, normalizer, data, key, which)[0]

        return jax.jit(jax.value_and_grad(loss))(params)

    found, expected = graded(ours, data, statistics[0]), graded(brax, named, statistics[1])
    for a, b in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-6)
    assert any(np.abs(x).max() > 1e-3 for x in jax.tree.leaves(found[1].value))


def test_the_policy_needs_no_more_than_it_sees(pair, statistics):
    ours, _, params = pair
    policy = mean_policy(ours, statistics[0], params.policy)
    small = NestedMeanStd(statistics[0].mean[:SEEN], statistics[0].std[:SEEN])
    alone = mean_policy(ours, small, params.policy)
    observation = jnp.asarray(np.random.default_rng(3).normal(size=(7, SEEN + MORE)), jnp.float32)
    np.testing.assert_array_equal(policy(observation), alone(observation[:, :SEEN]))
    other = observation.at[:, SEEN:].add(5.0)
    np.testing.assert_array_equal(policy(observation), policy(other))


def test_what_never_varied_is_passed_on_less_its_mean(pair, statistics):
    ours, _, params = pair
    mean, std = statistics[0].mean, statistics[0].std
    never = NestedMeanStd(mean.at[:2].set([0.0, 50.0]), std.at[:2].set([1e-6, 1e-3]))
    passed = NestedMeanStd(never.mean, std.at[:2].set(1.0))
    observation = jnp.asarray(np.random.default_rng(3).normal(size=(5, SEEN + MORE)), jnp.float32)
    for network, weights in (
        (ours.policy_network, params.policy),
        (ours.value_network, params.value),
    ):
        found, expected = (network.apply(own, weights, observation) for own in (never, passed))
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("std", "tolerance"), [(0.1, 0.001), (0.35, 0.02), (0.7, 0.12)])
@pytest.mark.parametrize("mean", [-1.5, 0.0, 0.5])
def test_the_entropy_is_near_the_mean_of_brax_samples(std, tolerance, mean):
    # Per action, at the standard deviations that are learnt with; .35 is where training begins.
    raw = np.log(np.expm1(std - 0.001))
    parameters = jnp.full((100_000, 2), jnp.array([mean, raw], jnp.float32))
    drawn = NormalTanhDistribution(1).entropy(parameters, jax.random.PRNGKey(0))
    found = NormalTanh(1).entropy(parameters[:1], jax.random.PRNGKey(0))
    assert float(found[0]) == pytest.approx(float(drawn.mean()), abs=tolerance)
