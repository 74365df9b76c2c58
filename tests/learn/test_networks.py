"""Networks, distribution, loss and statistics against Brax's own, and symmetric against plain."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.acme import running_statistics, specs
from brax.training.acme.running_statistics import NestedMeanStd
from brax.training.acme.running_statistics import normalize as normalize_with_brax
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
from quadwalk.learn.devices import AXIS, make_mesh
from quadwalk.learn.distribution import SURE, TanhNormal
from quadwalk.learn.networks import make_networks
from quadwalk.learn.statistics import init_statistics, normalize, update_statistics
from quadwalk.learn.symmetric import Basis, to_plain
from quadwalk.robot.mirror import Mirror
from quadwalk.tasks import sprint

POLICY_SIZE, SIZE, ACTIONS = 5, 8, 2
ENVS, UNROLL = 6, 4
CONFIG = dataclasses.replace(sprint.TASK.ppo, hidden=(16, 16), discount=0.9)
# The policy's observations: a pair that changes places, one that also changes signs, a number that
# changes its sign. The critic's: one that stays, and a pair. The actions change places and signs.
MIRRORS = Mirrors(
    Mirror(np.array([1, 0, 3, 2, 4, 5, 7, 6]), np.array([1, 1, -1, -1, -1, 1, 1, 1], np.float32)),
    Mirror(np.array([1, 0]), np.array([-1, -1], np.float32)),
)
ENTROPY = 0.01


def make(mirrors, config=CONFIG):
    return make_networks(config, POLICY_SIZE, ACTIONS, SIZE - POLICY_SIZE, mirrors)


@pytest.fixture(scope="module", params=[None, MIRRORS], ids=["plain", "symmetric"])
def networks(request):
    return make(request.param)


@pytest.fixture(scope="module")
def statistics(networks):
    """Return statistics that are their own mirror image, if `networks` are symmetric."""
    rng = np.random.default_rng(1)
    mean, std = rng.normal(size=SIZE), rng.uniform(0.5, 2.0, SIZE)
    if networks.critic_obs.mirror is not None:
        mirror = MIRRORS.observation
        mean, std = (mean + mirror(mean)) / 2, (std + std[mirror.source]) / 2
    return NestedMeanStd(jnp.asarray(mean, jnp.float32), jnp.asarray(std, jnp.float32))


def sample_normal(seed, *shape):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), jnp.float32)


def test_loss_and_gradients_are_those_of_brax_with_two_observations(
    networks, statistics, monkeypatch
):
    """Compare with Brax; a symmetric network is first made the plain one that computes the same."""
    # Brax lets a state's divergence count in full; policies at random are far apart.
    monkeypatch.setattr(ppo, "MOST_KL", np.inf)
    params = networks.init(jax.random.PRNGKey(0))
    # Steps first and environments last, as the learner has them.
    observation, raw_action, outputs = (
        sample_normal(size, UNROLL, size, ENVS) for size in (SIZE, ACTIONS, 2 * ACTIONS)
    )
    reward, log_prob, chance = sample_normal(3, 3, UNROLL, ENVS)
    discount = (chance > -1.0).astype(jnp.float32)
    last = sample_normal(4, SIZE, ENVS)

    def normalize_steps(x):
        steps = [networks.normalize(statistics, step.T) for step in x]
        return tuple(map(jnp.stack, zip(*steps, strict=True)))

    before = TanhNormal.from_outputs(jnp.moveaxis(outputs, 1, 0), networks.std_scale)
    before = TanhNormal(*(jnp.moveaxis(x, 0, 1) for x in before))
    inputs = normalize_steps(observation)
    transitions = ppo.Transitions(inputs, raw_action, before, log_prob, reward, discount)
    rollout = ppo.Rollout(transitions, networks.normalize(statistics, last.T))
    gradient, metrics = ppo.PPO(networks, CONFIG, 1).compute_gradient(params, rollout, ENTROPY)

    brax = brax_networks.make_ppo_networks(
        {"state": POLICY_SIZE, "critic": SIZE},
        ACTIONS,
        preprocess_observations_fn=normalize_with_brax,
        policy_hidden_layer_sizes=CONFIG.hidden,
        value_hidden_layer_sizes=CONFIG.hidden,
        value_obs_key="critic",
    ).replace(parametric_action_distribution=NormalTanh(ACTIONS, var_scale=networks.std_scale))

    def split_by_name(x):
        return {"state": x[..., :POLICY_SIZE], "critic": x}

    def put_environments_first(x):
        return jnp.moveaxis(x, -1, 0)

    shapes = {
        "state": specs.Array((POLICY_SIZE,), "float32"),
        "critic": specs.Array((SIZE,), "float32"),
    }
    brax_statistics = running_statistics.init_state(shapes).replace(
        mean=split_by_name(statistics.mean), std=split_by_name(statistics.std)
    )
    extras = {"raw_action": raw_action, "log_prob": log_prob, "distribution_params": outputs}
    data = Transition(
        observation=split_by_name(put_environments_first(observation)),
        action=None,
        reward=reward.T,
        discount=discount.T,
        next_observation=split_by_name(last.T[:, None]),
        extras={
            "state_extras": {"truncation": jnp.zeros((ENVS, UNROLL))},
            "policy_extras": jax.tree.map(put_environments_first, extras),
        },
    )

    def compute_brax_loss(params):
        return losses.compute_ppo_loss(
            losses.PPONetworkParams(
                to_plain(params.policy, networks.policy_obs, networks.outputs),
                to_plain(params.value, networks.critic_obs, networks.value_output),
            ),
            brax_statistics,
            data,
            jax.random.PRNGKey(0),
            brax,
            entropy_cost=ENTROPY,
            discounting=CONFIG.discount,
            gae_lambda=CONFIG.gae_lambda,
            clipping_epsilon=CONFIG.clip_epsilon,
            vf_coefficient=CONFIG.value_coef,
        )

    brax_gradient, brax_metrics = jax.grad(compute_brax_loss, has_aux=True)(params)
    for name, brax_name in (("policy", "policy_loss"), ("value", "v_loss"), ("kl", "kl_mean")):
        assert metrics[name] == pytest.approx(float(brax_metrics[brax_name]), rel=1e-4, abs=1e-6)
    for a, b in zip(*map(jax.tree.leaves, (gradient, brax_gradient)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-5)
    assert any(np.abs(x).max() > 1e-3 for x in jax.tree.leaves(gradient.value))


@pytest.mark.parametrize("networks", [MIRRORS], indirect=True, ids=["symmetric"])
def test_a_mirrored_observation_has_the_mirrored_action_with_the_other_lead(networks, statistics):
    """Check that it has the same value, too."""
    params = networks.init(jax.random.PRNGKey(1))
    params = jax.tree.map(lambda x: x + 0.3 * sample_normal(9, *x.shape), params)  # biases too
    observation = sample_normal(10, 50, SIZE)

    def apply_networks(observation, lead):
        lead_params = jax.tree_util.tree_map_with_path(
            lambda path, leaf: lead * leaf if path[-1].key == "lead" else leaf, params
        )
        inputs = networks.normalize(statistics, observation)
        policy = networks.apply_policy(lead_params.policy, inputs)
        return policy, networks.apply_value(lead_params.value, inputs)

    policy, value = apply_networks(observation, 1.0)
    image, image_value = apply_networks(MIRRORS.observation(observation), -1.0)
    other, _ = apply_networks(observation, -1.0)
    assert np.abs(other.mean - policy.mean).max() > 0.1  # the lead matters
    np.testing.assert_allclose(image.mean.T, MIRRORS.action(policy.mean.T), atol=1e-5)
    np.testing.assert_allclose(image.std, policy.std[MIRRORS.action.source], atol=1e-5)
    np.testing.assert_allclose(image_value, value, atol=1e-5)
    assert np.std(value) > 0.1
    assert np.abs(image.mean - policy.mean).max() > 0.1


def test_the_plain_policy_acts_as_the_learner_does(networks, statistics):
    params = networks.init(jax.random.PRNGKey(2))
    observation = sample_normal(11, 7, SIZE)
    inputs = networks.normalize(statistics, observation)
    action = jnp.tanh(networks.apply_policy(params.policy, inputs).mean).T
    policy = make_policy(CONFIG, *networks.to_plain(statistics, params.policy))
    np.testing.assert_allclose(policy(observation), action, atol=1e-5)
    np.testing.assert_array_equal(policy(observation), policy(observation[:, :POLICY_SIZE]))
    other = observation.at[:, POLICY_SIZE:].add(5.0)
    np.testing.assert_array_equal(policy(observation), policy(other))


def test_a_stochastic_policy_acts_with_noise_where_it_is_unsure(networks, statistics):
    params = networks.init(jax.random.PRNGKey(2))
    config = dataclasses.replace(CONFIG, stochastic=True)
    policy = make_policy(config, *networks.to_plain(statistics, params.policy))
    observation = 3.0 * sample_normal(12, 4000, SIZE)
    inputs = networks.normalize(statistics, observation)
    mean, std = map(np.transpose, networks.apply_policy(params.policy, inputs))
    assert std.min() < SURE < std.max()

    def measure_noise(observation):
        return np.arctanh(np.clip(policy(observation), -0.9999, 0.9999)) - mean

    noise = measure_noise(observation)
    clear = np.abs(mean) < 2.0  # far from where tanh saturates
    np.testing.assert_allclose(noise[clear & (std <= SURE)], 0.0, atol=1e-4)
    noisy = clear & (std > SURE)
    scaled = noise / std
    assert scaled[noisy].mean() == pytest.approx(0.0, abs=0.05)
    assert scaled[noisy].std() == pytest.approx(1.0, abs=0.05)
    joints = scaled[noisy.all(axis=1)].T
    assert np.abs(np.corrcoef(joints) - np.eye(ACTIONS)).max() < 0.1
    np.testing.assert_array_equal(noise, measure_noise(observation))
    # An observation that differs by a tenth of its deviation has other noise.
    shifted_noise = measure_noise(
        observation + 0.1 * statistics.std * sample_normal(13, 4000, SIZE)
    )
    assert np.corrcoef(noise[noisy], shifted_noise[noisy])[0, 1] < 0.9


def test_a_symmetric_network_needs_halves():
    with pytest.raises(UsageError, match="expected even numbers"):
        make(MIRRORS, dataclasses.replace(CONFIG, hidden=(16, 15)))


@pytest.mark.parametrize("seed", range(5))
def test_a_basis_is_orthonormal_and_the_mirror_changes_its_signs_alone(seed):
    rng = np.random.default_rng(seed)
    size = int(rng.integers(3, 12))
    source, pairs = np.arange(size), rng.permutation(size)[: 2 * (size // 3)].reshape(-1, 2)
    source[pairs] = pairs[:, ::-1]
    sign = rng.choice([-1.0, 1.0], size).astype(np.float32)
    sign[pairs[:, 1]] = sign[pairs[:, 0]]
    basis, x = Basis(size, Mirror(source, sign)), sample_normal(seed, size, 4)
    even, odd = basis.split(x)
    image = basis.split(sign[:, None] * x[source])
    np.testing.assert_allclose(image[0], even, atol=1e-6)
    np.testing.assert_allclose(image[1], -odd, atol=1e-6)
    np.testing.assert_allclose(basis.join((even, odd)), x, atol=1e-6)
    matrix = np.concatenate(basis.matrices)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(size), atol=1e-6)


def test_statistics_are_those_of_brax_of_the_data_and_their_mirror_image(networks):
    """Update three times over two devices, each time normalized by the statistics before."""

    def count(statistics, x):
        inputs = networks.normalize(statistics, x)
        steps = tuple(jnp.stack(jnp.split(part, 4, axis=1)) for part in inputs)
        return update_statistics(statistics, steps, networks.critic_obs, AXIS)

    count = jax.jit(
        jax.shard_map(
            count, mesh=make_mesh(), in_specs=(P(), P(AXIS)), out_specs=P(), check_vma=False
        )
    )
    statistics, rows = init_statistics(SIZE), []
    for seed in range(3):
        x = 3.0 + 2.0 * sample_normal(seed, 40, SIZE).at[:, 5].set(0.7)
        rows += [x] if networks.critic_obs.mirror is None else [x, MIRRORS.observation(x)]
        statistics = count(statistics, x)
    expected = running_statistics.init_state(specs.Array((SIZE,), "float32"))
    expected = running_statistics.update(expected, jnp.concatenate(rows))
    assert int(statistics.count.lo) == 120
    np.testing.assert_allclose(statistics.mean, expected.mean, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(statistics.std[:5], expected.std[:5], rtol=1e-4)
    np.testing.assert_allclose(statistics.std[6:], expected.std[6:], rtol=1e-4)
    assert statistics.std[5] < 1e-5  # constant


def test_what_never_varied_is_passed_on_less_its_mean():
    mean, observation = jnp.array([0.0, 50.0, 2.0]), sample_normal(3, 5, 3)
    constant = NestedMeanStd(mean, jnp.array([1e-6, 1e-3, 0.5]))
    outputs = normalize(constant, observation)
    np.testing.assert_array_equal(outputs, (observation - mean) / jnp.array([1.0, 1.0, 0.5]))


def test_samples_have_the_mean_and_deviation_of_the_distribution():
    many = TanhNormal(jnp.full((1, 100_000), 0.3), jnp.full((1, 100_000), 0.2))
    sample = many.sample(jax.random.PRNGKey(0))
    assert float(sample.mean()) == pytest.approx(0.3, abs=0.003)
    assert float(sample.std()) == pytest.approx(0.2, abs=0.003)


@pytest.mark.parametrize(("std", "tolerance"), [(0.1, 0.001), (0.35, 0.02), (0.7, 0.12)])
@pytest.mark.parametrize("mean", [-1.5, 0.0, 0.5])
def test_the_entropy_is_near_the_mean_of_brax_samples(std, tolerance, mean):
    # Per action, at the standard deviations of training, which begins at 0.35.
    raw_std = np.log(np.expm1(std - 0.001))
    outputs = jnp.full((100_000, 2), jnp.array([mean, raw_std], jnp.float32))
    samples = NormalTanhDistribution(1).entropy(outputs, jax.random.PRNGKey(0))
    entropy = TanhNormal.from_outputs(outputs[:1].T, 1.0).compute_entropy()
    assert float(entropy[0]) == pytest.approx(float(samples.mean()), abs=tolerance)
