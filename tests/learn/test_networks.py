"""Networks, distribution, loss and statistics against Brax's own, and symmetric against plain."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.acme import running_statistics, specs
from brax.training.acme.running_statistics import NestedMeanStd, normalize
from brax.training.agents.ppo import losses
from brax.training.agents.ppo import networks as brax_networks
from brax.training.distribution import NormalTanhDistribution
from brax.training.types import Transition
from brax_training import NormalTanh
from jax.sharding import PartitionSpec as P

from quadwalk.env.reflections import Mirrors
from quadwalk.errors import UsageError
from quadwalk.learn import ppo
from quadwalk.learn.acting import make_policy
from quadwalk.learn.devices import make_mesh
from quadwalk.learn.distribution import SURE, TanhNormal
from quadwalk.learn.networks import make_networks
from quadwalk.learn.statistics import init_statistics, update_statistics
from quadwalk.learn.symmetric import Basis, to_plain
from quadwalk.robot.mirror import Mirror
from quadwalk.tasks import sprint

SEEN, MORE, ACTIONS = 5, 3, 2
ENVS, UNROLL = 6, 4
CONFIG = dataclasses.replace(sprint.TASK.ppo, hidden=(16, 16), discount=0.9)
# Seen: a pair that changes places, one that also changes signs, one negated number. The critic's:
# one kept, and a pair. The actions change places and signs.
MIRRORS = Mirrors(
    Mirror(np.array([1, 0, 3, 2, 4, 5, 7, 6]), np.array([1, 1, -1, -1, -1, 1, 1, 1], np.float32)),
    Mirror(np.array([1, 0]), np.array([-1, -1], np.float32)),
)
ENTROPY = 0.01


@pytest.fixture(scope="module")
def statistics():
    rng = np.random.default_rng(1)
    mean, std = rng.normal(size=SEEN + MORE), rng.uniform(0.5, 2.0, SEEN + MORE)
    return NestedMeanStd(jnp.asarray(mean, jnp.float32), jnp.asarray(std, jnp.float32))


def make_symmetric(networks, statistics):
    """Of symmetric `networks`, `statistics` that are their own mirror image; else as they are."""
    if networks.critic_obs.mirror is None:
        return statistics
    mirror = MIRRORS.observation
    mean = (statistics.mean + mirror(statistics.mean)) / 2
    return NestedMeanStd(mean, (statistics.std + statistics.std[mirror.source]) / 2)


@pytest.fixture(scope="module", params=["plain", "symmetric"])
def networks(request):
    return make_networks(CONFIG, SEEN, ACTIONS, MORE, MIRRORS if request.param != "plain" else None)


def sample_normal(seed, *shape):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), jnp.float32)


def test_loss_and_gradients_are_those_of_brax_with_two_observations(
    networks, statistics, monkeypatch
):
    """Of a symmetric network, of the plain one that computes the same.

    Brax lets a state's divergence count in full; policies at random are far apart.
    """
    monkeypatch.setattr(ppo, "MOST_KL", np.inf)
    statistics = make_symmetric(networks, statistics)
    params = networks.init(jax.random.PRNGKey(0))
    observation, last = (
        sample_normal(2, ENVS, UNROLL, SEEN + MORE),
        sample_normal(3, ENVS, SEEN + MORE),
    )
    raw, reward = sample_normal(4, ENVS, UNROLL, ACTIONS), sample_normal(5, ENVS, UNROLL)
    outputs, log_prob = sample_normal(6, ENVS, UNROLL, 2 * ACTIONS), sample_normal(7, ENVS, UNROLL)
    discount = (sample_normal(8, ENVS, UNROLL) > -1.0).astype(jnp.float32)

    def steps_first(x):  # (envs, unroll, n) to (unroll, n, envs)
        return jnp.moveaxis(x, 0, -1)

    def seen(x):
        flat = networks.normalize(statistics, x.reshape(-1, SEEN + MORE))
        return tuple(part.reshape(-1, *x.shape[:-1]) for part in flat)

    parts = tuple(jnp.moveaxis(part, 0, 1).swapaxes(0, 2) for part in seen(observation))
    before = TanhNormal.from_outputs(jnp.moveaxis(outputs, -1, 0), networks.std_scale)
    before = TanhNormal(*(jnp.moveaxis(x, (0, 1, 2), (1, 2, 0)) for x in before))
    transitions = ppo.Transitions(parts, steps_first(raw), before, log_prob.T, reward.T, discount.T)
    rollout = ppo.Rollout(transitions, seen(last))
    gradient, metrics = ppo.PPO(networks, CONFIG, 1).compute_gradient(params, rollout, ENTROPY)

    brax = brax_networks.make_ppo_networks(
        {"state": SEEN, "whole": SEEN + MORE},
        ACTIONS,
        preprocess_observations_fn=normalize,
        policy_hidden_layer_sizes=CONFIG.hidden,
        value_hidden_layer_sizes=CONFIG.hidden,
        value_obs_key="whole",
    ).replace(parametric_action_distribution=NormalTanh(ACTIONS, var_scale=networks.std_scale))

    def by_name(x):
        return {"state": x[..., :SEEN], "whole": x}

    named = running_statistics.init_state(
        {"state": specs.Array((SEEN,), "float32"), "whole": specs.Array((SEEN + MORE,), "float32")}
    ).replace(mean=by_name(statistics.mean), std=by_name(statistics.std))
    extras = {"raw_action": raw, "log_prob": log_prob, "distribution_params": outputs}
    data = Transition(
        by_name(observation), None, reward, discount, by_name(last[:, None]),
        {"state_extras": {"truncation": jnp.zeros((ENVS, UNROLL))}, "policy_extras": extras},
    )  # fmt: skip

    def theirs(params):
        return losses.compute_ppo_loss(
            losses.PPONetworkParams(
                to_plain(params.policy, networks.policy_obs, networks.outputs),
                to_plain(params.value, networks.critic_obs, networks.value_output),
            ),
            named, data, jax.random.PRNGKey(0), brax, entropy_cost=ENTROPY,
            discounting=CONFIG.discount, gae_lambda=CONFIG.gae_lambda,
            clipping_epsilon=CONFIG.clip_epsilon, vf_coefficient=CONFIG.value_coef,
        )  # fmt: skip

    slope, parts = jax.grad(theirs, has_aux=True)(params)
    for own, name in (("policy", "policy_loss"), ("value", "v_loss"), ("kl", "kl_mean")):
        assert metrics[own] == pytest.approx(float(parts[name]), rel=1e-4, abs=1e-6)
    for a, b in zip(*map(jax.tree.leaves, (gradient, slope)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-5)
    assert any(np.abs(x).max() > 1e-3 for x in jax.tree.leaves(gradient.value))


def test_a_mirrored_observation_has_the_mirrored_action_with_the_other_lead(statistics):
    """And the same value."""
    networks = make_networks(CONFIG, SEEN, ACTIONS, MORE, MIRRORS)
    params, own = networks.init(jax.random.PRNGKey(1)), make_symmetric(networks, statistics)
    params = jax.tree.map(lambda x: x + 0.3 * sample_normal(9, *x.shape), params)  # biases too
    observation = sample_normal(10, 50, SEEN + MORE)

    def answers(observation, lead):
        def turned(path, leaf):
            return lead * leaf if path[-1].key == "lead" else leaf

        led = jax.tree_util.tree_map_with_path(turned, params)
        parts = networks.normalize(own, observation)
        return networks.apply_policy(led.policy, parts), networks.apply_value(led.value, parts)

    policy, value = answers(observation, 1.0)
    image, same = answers(MIRRORS.observation(observation), -1.0)
    other, _ = answers(observation, -1.0)
    assert np.abs(other.mean - policy.mean).max() > 0.1  # the lead matters
    np.testing.assert_allclose(image.mean.T, MIRRORS.action(policy.mean.T), atol=1e-5)
    np.testing.assert_allclose(image.std, policy.std[MIRRORS.action.source], atol=1e-5)
    np.testing.assert_allclose(same, value, atol=1e-5)
    assert np.std(value) > 0.1
    assert np.abs(image.mean - policy.mean).max() > 0.1


def test_the_to_plain_acts_as_the_learner_does(networks, statistics):
    own = make_symmetric(networks, statistics)
    params = networks.init(jax.random.PRNGKey(2))
    observation = sample_normal(11, 7, SEEN + MORE)
    inputs = networks.normalize(own, observation)
    mode = jnp.tanh(networks.apply_policy(params.policy, inputs).mean).T
    policy = make_policy(CONFIG, *networks.to_plain(own, params.policy))
    np.testing.assert_allclose(policy(observation), mode, atol=1e-5)
    np.testing.assert_array_equal(policy(observation), policy(observation[:, :SEEN]))
    other = observation.at[:, SEEN:].add(5.0)
    np.testing.assert_array_equal(policy(observation), policy(other))


def test_a_stochastic_policy_acts_with_noise_where_it_is_unsure(networks, statistics):
    config = dataclasses.replace(CONFIG, stochastic=True)
    own, params = make_symmetric(networks, statistics), networks.init(jax.random.PRNGKey(2))
    plain = networks.to_plain(own, params.policy)
    observation = 3.0 * sample_normal(12, 4000, SEEN + MORE)
    mean, std = networks.apply_policy(params.policy, networks.normalize(own, observation))
    assert std.min() < SURE < std.max()

    def added(observation):
        action = make_policy(config, *plain)(observation)
        return np.arctanh(np.clip(action, -0.9999, 0.9999)) - mean.T

    found, clear = added(observation), np.abs(mean.T) < 2.0  # far from where tanh saturates
    unsure = np.asarray(std.T) > SURE
    np.testing.assert_allclose(found[clear & ~unsure], 0.0, atol=1e-4)
    noisy, noise = clear & unsure, found / std.T
    assert noise[noisy].mean() == pytest.approx(0.0, abs=0.05)
    assert noise[noisy].std() == pytest.approx(1.0, abs=0.05)
    joints = noise[noisy.all(axis=1)].T
    assert np.abs(np.corrcoef(joints) - np.eye(ACTIONS)).max() < 0.1
    np.testing.assert_array_equal(found, added(observation))
    # What differs by a tenth of its spread has other noise.
    moved = added(observation + 0.1 * own.std * sample_normal(13, *observation.shape))
    assert np.corrcoef(found[noisy], moved[noisy])[0, 1] < 0.9


def test_a_symmetric_network_needs_halves():
    with pytest.raises(UsageError, match="expected even numbers"):
        make_networks(dataclasses.replace(CONFIG, hidden=(16, 15)), SEEN, ACTIONS, MORE, MIRRORS)


@pytest.mark.parametrize("seed", range(5))
def test_a_basis_is_orthonormal_and_the_mirror_changes_its_signs_alone(seed):
    rng = np.random.default_rng(seed)
    size = int(rng.integers(3, 12))
    source, pairs = np.arange(size), rng.permutation(size)[: 2 * (size // 3)].reshape(-1, 2)
    source[pairs] = pairs[:, ::-1]
    sign = rng.choice([-1.0, 1.0], size).astype(np.float32)
    sign[pairs[:, 1]] = sign[pairs[:, 0]]
    basis, x = Basis(size, Mirror(source, sign)), sample_normal(seed, size, 4)
    kept, negated = basis.split(x)
    image = basis.split(sign[:, None] * x[source])
    np.testing.assert_allclose(image[0], kept, atol=1e-6)
    np.testing.assert_allclose(image[1], -negated, atol=1e-6)
    np.testing.assert_allclose(basis.join((kept, negated)), x, atol=1e-6)
    whole = np.concatenate(basis.matrices)
    np.testing.assert_allclose(whole @ whole.T, np.eye(size), atol=1e-6)


def test_statistics_are_those_of_brax_of_the_data_and_their_mirror_image(networks):
    """Over two devices, three times, each normalized by what was known before."""
    mesh, found = make_mesh(), init_statistics(networks.critic_obs.size)

    def count(statistics, x):
        parts = networks.normalize(statistics, x)
        steps = tuple(jnp.stack(jnp.split(part, 4, axis=1)) for part in parts)
        return update_statistics(statistics, steps, networks.critic_obs, ppo.AXIS)

    measured = jax.jit(
        jax.shard_map(count, mesh=mesh, in_specs=(P(), P(ppo.AXIS)), out_specs=P(), check_vma=False)
    )
    seen = []
    for seed in range(3):
        x = 3.0 + 2.0 * sample_normal(seed, 40, SEEN + MORE).at[:, 5].set(0.7)
        seen += [x] if networks.critic_obs.mirror is None else [x, MIRRORS.observation(x)]
        found = measured(found, x)
    whole = running_statistics.update(
        running_statistics.init_state(specs.Array((SEEN + MORE,), "float32")),
        jnp.concatenate(seen),
    )
    assert int(found.count.lo) == 120
    np.testing.assert_allclose(found.mean, whole.mean, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(found.std[:5], whole.std[:5], rtol=1e-4)
    np.testing.assert_allclose(found.std[6:], whole.std[6:], rtol=1e-4)
    assert found.std[5] < 1e-5  # constant


def test_what_never_varied_is_passed_on_less_its_mean(statistics):
    networks = make_networks(CONFIG, SEEN, ACTIONS, MORE)
    never = NestedMeanStd(
        statistics.mean.at[:2].set([0.0, 50.0]), statistics.std.at[:2].set([1e-6, 1e-3])
    )
    passed = NestedMeanStd(never.mean, never.std.at[:2].set(1.0))
    observation = sample_normal(3, 5, SEEN + MORE)
    found, expected = (networks.normalize(own, observation)[0] for own in (never, passed))
    np.testing.assert_array_equal(found, expected)


def test_samples_have_the_mean_and_deviation_of_the_distribution():
    many = TanhNormal(jnp.full((1, 100_000), 0.3), jnp.full((1, 100_000), 0.2))
    sample = many.sample(jax.random.PRNGKey(0))
    assert float(sample.mean()) == pytest.approx(0.3, abs=0.003)
    assert float(sample.std()) == pytest.approx(0.2, abs=0.003)


@pytest.mark.parametrize(("std", "tolerance"), [(0.1, 0.001), (0.35, 0.02), (0.7, 0.12)])
@pytest.mark.parametrize("mean", [-1.5, 0.0, 0.5])
def test_the_entropy_is_near_the_mean_of_brax_samples(std, tolerance, mean):
    # Per action, at the standard deviations that are learnt with; 0.35 is where training begins.
    raw = np.log(np.expm1(std - 0.001))
    parameters = jnp.full((100_000, 2), jnp.array([mean, raw], jnp.float32))
    drawn = NormalTanhDistribution(1).entropy(parameters, jax.random.PRNGKey(0))
    found = TanhNormal.from_outputs(parameters[:1].T, 1.0).compute_entropy()
    assert float(found[0]) == pytest.approx(float(drawn.mean()), abs=tolerance)
