"""An iteration of PPO, on an environment whose every number is known."""

import dataclasses
from functools import partial
from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State
from toy import Plain

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.randomization import EpisodeRandomization
from quadwalk.env.reset import Curriculum
from quadwalk.env.state import EnvState, start_travel
from quadwalk.learn import episodes, ppo
from quadwalk.learn.acting import make_policy
from quadwalk.learn.devices import make_mesh
from quadwalk.learn.distribution import TanhNormal
from quadwalk.learn.networks import make_networks
from quadwalk.physics.motor import PhysicsState
from quadwalk.tasks import sprint, walk

CONFIG = dataclasses.replace(
    sprint.TASK.ppo,
    eval_envs=4,
    unroll=6,
    minibatches=2,
    epochs=2,
    hidden=(16,),
    discount=0.9,
    reward_scale=0.5,
)
ENVS = 8
GOAL = 0.5


class Count(NamedTuple):
    steps: jax.Array
    origin: jax.Array  # drawn at each reset


class Counter(Plain):
    """An environment that counts its steps; the reward is best where the action is `GOAL`.

    Episodes last 4 steps: those with a positive origin then meet the time limit, the others fall.
    An origin above 1 is never drawn; it stands for a state whose step is not a number.
    """

    config = dataclasses.replace(sprint.TASK.env, episode_seconds=4 * sprint.TASK.env.control_dt)
    observation_size = action_size = 2

    def observe(self, inner: Count) -> jax.Array:
        return jnp.stack([inner.steps.astype(jnp.float32), inner.origin])

    def reset(self, rng: jax.Array) -> State:
        origin = jax.random.uniform(rng, (), minval=-1.0)
        return self.make_start(Count(jnp.zeros((), jnp.int32), origin))

    def step(self, state: State, action: jax.Array) -> State:
        count = state.pipeline_state._replace(steps=state.pipeline_state.steps + 1)
        over, nan = count.steps >= self.config.episode_steps, count.origin > 1
        metrics = {"speed": action[0], "fell": over & (count.origin <= 0), "nan": nan}
        reward = 1.0 - jnp.sum(jnp.square(action - GOAL))
        return self.make_next(state, count, reward, over & (count.origin > 0), **metrics)


@pytest.fixture(scope="module")
def networks():
    return make_networks(CONFIG, 2, 2)


@pytest.fixture(scope="module")
def iterate(networks):
    return ppo.Iteration(Counter(), networks, CONFIG, make_mesh(), iterations=150)


def start(networks, seed: int = 0) -> ppo.TrainState:
    return ppo.init_state(Counter(), networks, CONFIG, make_mesh(), ENVS, seed)


class Rows(NamedTuple):
    """Transitions, environments first; observations as they are, for none are normalized yet."""

    observation: np.ndarray  # (envs, unroll, 2)
    action: np.ndarray  # (envs, unroll, 2)
    reward: np.ndarray  # (envs, unroll)
    discount: np.ndarray  # (envs, unroll)


def collect_rows(iterate, state):
    """Return workers, transitions as `Rows` and metrics of one collection."""
    workers, rollout, metrics, _ = jax.device_get(iterate.collect(*state))
    steps = rollout.transitions
    arrays = steps.inputs[0], jnp.tanh(steps.raw_action), steps.reward, steps.discount
    return workers, Rows(*(np.moveaxis(x, -1, 0) for x in arrays)), metrics


@pytest.fixture(scope="module")
def collected(networks, iterate):
    """Return a learner, and the workers, transitions and metrics of its first collection."""
    state = start(networks)
    return state.learner, *collect_rows(iterate, state)


def test_episodes_start_out_of_phase():
    keys = jax.random.split(jax.random.PRNGKey(0), ENVS)
    state = episodes.reset_envs(Counter(), keys)
    steps = np.asarray(state.pipeline_state.steps)
    np.testing.assert_array_equal(state.obs[:, 0], steps)
    assert set(steps) <= set(range(4))
    assert len(set(steps)) > 1


def test_the_next_episodes_are_where_the_curriculum_says_but_for_those_that_evaluate():
    lessons = Curriculum(("flat", "rough"), 3, 8.0, 100, pace=0.1)
    far = jnp.tile(jnp.eye(19)[0] * 5.0, (8, 1))  # more than half a tile from the start
    travel = jax.vmap(start_travel)(jnp.zeros((8, 19)))
    state = EnvState(
        PhysicsState(far, jnp.zeros((8, 18))),
        jnp.zeros((8, 12)),
        jnp.full(8, 100),
        tile=jnp.array([0, 3, 1, 4, 0, 3, 0, 0]),
        travel=travel._replace(steps=jnp.full(8, 100)),
    )
    env = SimpleNamespace(curriculum=lessons)
    draws = [
        np.asarray(episodes.choose_tiles(env, state, jnp.bool_(False), 6, jax.random.PRNGKey(seed)))
        for seed in range(30)
    ]
    assert all(tiles[:6].tolist() == [1, 4, 2, 5, 1, 4] for tiles in draws)
    assert {int(tile) for tiles in draws for tile in tiles[6:]} == set(range(6))
    first = episodes.choose_tiles(env, state, jnp.bool_(True), 6, jax.random.PRNGKey(0))
    assert (np.asarray(first)[:6] // 3).tolist() == [0, 1, 0, 1, 0, 1]
    none = SimpleNamespace(curriculum=None)
    assert episodes.choose_tiles(none, state, jnp.bool_(False), 6, jax.random.PRNGKey(0)) is None


def test_an_episode_runs_its_course_and_a_fresh_one_follows(collected):
    """Check that the episode after a time limit starts at its beginning."""
    _, _, data, _ = collected
    limits = 0
    for observation, discount in zip(data.observation, data.discount, strict=True):
        for t in range(CONFIG.unroll - 1):
            (steps, origin), (next_steps, next_origin) = observation[t : t + 2]
            assert (discount[t] == 0.0) == (origin != next_origin) == (steps == 3)
            if discount[t]:
                assert next_steps == steps + 1
            elif origin > 0:
                assert next_steps == 0
                limits += 1
    assert limits > 0


def test_the_time_limit_is_bootstrapped_through_and_a_fall_is_not(collected, networks):
    learner, _, data, _ = collected
    raw = CONFIG.reward_scale * (1.0 - np.square(data.action - GOAL).sum(-1))
    after = np.stack([np.full(data.reward.shape, 4.0), data.observation[..., 1]], axis=-1)
    bootstrap = CONFIG.discount * networks.apply_value(
        learner.params.value, (np.moveaxis(after, -1, 0),)
    )
    ended = data.discount == 0.0
    limit = ended & (data.observation[..., 1] > 0)
    assert limit.any()
    assert (ended & ~limit).any()
    np.testing.assert_allclose(data.reward, raw + np.where(limit, bootstrap, 0.0), rtol=1e-4)


def test_evaluation_environments_act_without_noise_and_are_not_learnt_from(collected, networks):
    learner, workers, data, metrics = collected
    assert len(workers.envs.done) == ENVS + CONFIG.eval_envs
    assert data.reward.shape == (ENVS, CONFIG.unroll)
    assert data.observation.shape == (ENVS, CONFIG.unroll, 2)
    mean = make_policy(CONFIG, learner.normalizer, learner.params.policy)
    # Their origins differ, but an untrained policy on few inputs is nearly flat.
    typical = float(np.mean(mean(data.observation)[..., 0]))
    assert metrics["eval/speed"] == pytest.approx(typical, abs=0.2)
    noise = data.action - np.asarray(mean(data.observation))
    assert noise.std() == pytest.approx(CONFIG.init_std, rel=0.35)


def test_evaluation_environments_of_a_stochastic_policy_act_with_noise(networks, collected):
    _, _, data, metrics = collected
    config = dataclasses.replace(CONFIG, stochastic=True)
    noisy_iteration = ppo.Iteration(Counter(), networks, config, make_mesh(), iterations=150)
    _, same, noisy = collect_rows(noisy_iteration, start(networks))
    jax.tree.map(partial(np.testing.assert_allclose, atol=1e-5), same, data)
    assert noisy["reward"] == pytest.approx(metrics["reward"], rel=1e-5)
    assert noisy["eval/speed"] != pytest.approx(metrics["eval/speed"], abs=0.01)


def test_the_metrics_count_every_episode(collected):
    _, _, data, metrics = collected
    ended = data.discount == 0.0
    assert metrics["count/ended"] == ended.sum()
    assert metrics["count/fell"] == (ended & (data.observation[..., 1] <= 0)).sum()
    assert metrics["eval/count/ended"] >= CONFIG.eval_envs  # 6 steps of episodes of 4
    expected = (1.0 - np.square(data.action - GOAL).sum(-1)).mean()
    assert metrics["reward"] == pytest.approx(expected, rel=1e-5)


def test_some_that_fell_meet_the_same_conditions_once_more():
    """Check that no others do, nor those that evaluate.

    Delayed targets and random keys are fresh.
    """
    envs, training_envs = 4000, 3000
    number = np.arange(envs, dtype=np.float32)

    def make_states(sign: float) -> State:
        conditions = jax.tree.map(lambda x: jnp.asarray(sign * x), numbered)
        physics = PhysicsState(number, number)
        zero = jnp.zeros(envs)
        return State(
            EnvState(physics, zero, zero, None, conditions), zero, zero, zero, {"fell": fell}, {}
        )

    vector = np.tile(number[:, None], (1, 3))
    numbered = EpisodeRandomization(
        None, number, None, vector, number, vector, vector, vector, vector
    )
    fell = jnp.asarray(number % 2)
    after, starts = make_states(1.0), make_states(-1.0)
    retries = episodes.choose_retries(0.25, after, training_envs, jax.random.PRNGKey(0))
    new_conditions = episodes.retry_conditions(retries, after, starts)
    np.testing.assert_array_equal(new_conditions.targets, -vector)
    np.testing.assert_array_equal(new_conditions.key, -vector)
    again = np.asarray(new_conditions.delay) > 0
    assert 0.2 < again[:training_envs].mean() / 0.5 < 0.3
    assert not again[training_envs:].any()
    assert not again[::2].any()
    np.testing.assert_array_equal(new_conditions.push, np.where(again[:, None], vector, -vector))
    np.testing.assert_array_equal(new_conditions.noise, np.where(again, number, -number))


def test_an_episode_after_a_fall_is_seen_as_it_starts(quadruped, monkeypatch):
    """Check that walk sees the clock of the episode's first step, and joints by its encoders.

    Only the first two of six have the same encoders again; the others evaluate.
    """
    monkeypatch.setattr(episodes, "CHUNK", 3)  # of four that end, three are begun and then one
    task = walk.TASK
    world = dataclasses.replace(task.env.randomization, noise=None, imu_tilt=None)
    env = QuadrupedEnv(quadruped, dataclasses.replace(task.env, randomization=world))
    names = env.sensors.names

    fresh = jax.jit(lambda keys: episodes.reset_envs(env, keys))
    after, start = map(fresh, jax.random.split(jax.random.PRNGKey(4), (2, 6)))
    fell = jnp.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    over = after.replace(done=fell.at[3].set(1.0), metrics={**after.metrics, "fell": fell})
    config = dataclasses.replace(task.ppo, retry=1.0 - 1e-6)
    next_state = jax.jit(
        lambda *states: episodes.replace_finished(env, config, lambda obs: obs[:, 0], *states)[1],
        static_argnums=2,
    )(over, start, 2, jax.random.PRNGKey(0))
    over, start, next_state = jax.device_get((over, start, next_state))
    steps = next_state.pipeline_state.steps
    assert steps.tolist() == [*start.pipeline_state.steps[:3], 0, *over.pipeline_state.steps[4:]]
    np.testing.assert_array_equal(next_state.obs[4:], over.obs[4:])
    encoder = next_state.pipeline_state.conditions.encoder
    np.testing.assert_array_equal(encoder[:2], over.pipeline_state.conditions.encoder[:2])
    np.testing.assert_array_equal(encoder[2:4], start.pipeline_state.conditions.encoder[2:4])
    moves = np.any(next_state.pipeline_state.command.velocity != 0.0, axis=-1)
    clock = 2.0 * np.pi * steps / 20.0
    for row in range(6):
        observation = dict(zip(names, next_state.obs[row], strict=False))
        assert observation["clock_sine"] == pytest.approx(moves[row] * np.sin(clock[row]), abs=1e-4)
        assert observation["clock_cosine"] == pytest.approx(
            moves[row] * np.cos(clock[row]), abs=1e-4
        )
        off = next_state.pipeline_state.qpos[row, 7:] - env.robot.home_joints + encoder[row]
        for ago in ("", "[-1]", "[-4]"):
            measured = [observation[f"joint_pos_{joint}{ago}"] for joint in quadruped.joints]
            np.testing.assert_allclose(measured, off, atol=1e-5)


@pytest.mark.parametrize("poisoned", [[], [2], [8], [3, 8]], ids=str)
def test_the_first_step_that_gave_no_number_is_kept(networks, iterate, poisoned):
    state = start(networks)
    learner = state.learner._replace(iterations=jnp.ones((), jnp.int32))  # the first starts anew
    envs = episodes.reset_envs(Counter(), jax.random.split(jax.random.PRNGKey(0), 12))
    count = envs.pipeline_state
    origin = count.origin.at[np.array(poisoned, int)].set(2.0)
    envs = envs.replace(pipeline_state=count._replace(origin=origin))
    _, data, metrics = collect_rows(iterate, (learner, state.workers._replace(envs=envs)))
    nan_step = metrics["nan_step"]
    assert metrics["count/nan"] == len(poisoned)
    assert (nan_step.flag > 0) == bool(poisoned)
    if poisoned:
        # Each device has six environments, of which the last two are for evaluation.
        first = poisoned[0]
        assert nan_step.before.origin == 2.0
        assert nan_step.before.steps == count.steps[first]
        # Their tanh is of two programs, which may round it differently.
        action = data.action[first - 2 * (first // 6), 0]
        np.testing.assert_allclose(nan_step.action, action, rtol=1e-6)


def test_a_learner_that_is_no_longer_finite_is_told(networks, iterate):
    state = start(networks)
    _, metrics = iterate(state)
    assert metrics["learner/finite"]
    state = start(networks)
    broken = jax.tree.map(lambda x: x.at[:1].set(jnp.inf), state.learner.params)
    _, metrics = iterate(state._replace(learner=state.learner._replace(params=broken)))
    assert not metrics["learner/finite"]


def test_the_first_iteration_only_measures_the_observations(networks, iterate):
    before = jax.device_get(start(networks).learner)
    state, _ = iterate(start(networks))
    after = jax.device_get(state.learner)
    jax.tree.map(np.testing.assert_array_equal, before.params, after.params)
    assert after.normalizer.mean[0] == pytest.approx(1.5, abs=0.5)  # of 0, 1, 2, 3
    state, _ = iterate(state)
    params = jax.device_get(state.learner.params)
    assert any(
        (a != b).any()
        for a, b in zip(jax.tree.leaves(after.params), jax.tree.leaves(params), strict=True)
    )


class Late(Counter):
    """A `Counter` that shows its action too, some steps after its first start, and a constant."""

    observation_size = 4
    constant = 0.7

    def __init__(self, late: int) -> None:
        self.late = late

    def reset(self, rng: jax.Array) -> State:
        return self._show(super().reset(rng), jnp.zeros(()), jnp.zeros(()))

    def step(self, state: State, action: jax.Array) -> State:
        age = state.info["age"] + 1.0
        signal = jnp.where(age >= self.late, action[0], 0.0)
        return self._show(super().step(state, action), age, signal)

    def start_episode(self, state: State, **changes: jax.Array) -> State:
        return self._show(super().start_episode(state, **changes), state.info["age"], jnp.zeros(()))

    def _show(self, state: State, age: jax.Array, signal: jax.Array) -> State:
        obs = jnp.concatenate([state.obs, jnp.stack([signal, jnp.float32(self.constant)])])
        return state.replace(obs=obs, info={**state.info, "age": age})


@pytest.mark.parametrize("unroll", [1, 5])
def test_a_number_that_is_constant_in_the_first_iteration_changes_no_policy_beyond_measure(unroll):
    config = dataclasses.replace(CONFIG, unroll=unroll)
    networks, env, mesh = make_networks(config, 4, 2), Late(unroll), make_mesh()
    iterate = ppo.Iteration(env, networks, config, mesh, iterations=150)
    state = ppo.init_state(env, networks, config, mesh, ENVS, 0)
    stds, divergences = [], []
    for _ in range(6):
        state, metrics = jax.block_until_ready(iterate(state))
        stds.append(np.asarray(state.learner.normalizer.std))
        divergences.append(float(metrics["loss/kl"]))
    assert stds[0][2] < 1e-5
    assert stds[-1][2] > 0.1
    assert max(divergences) < 0.5 * ppo.MOST_KL
    # What never varied is never divided by its rounding errors.
    learner = jax.device_get(state.learner)
    policy = make_policy(CONFIG, learner.normalizer, learner.params.policy)
    usual, other = jnp.array([2.0, 0.3, 0.0, env.constant]), jnp.array([2.0, 0.3, 0.0, 1.0])
    assert np.abs(policy(other) - policy(usual)).max() < 0.3


def test_the_same_seed_gives_the_same_numbers_and_another_does_not(networks, iterate):
    def train(seed: int):
        state = start(networks, seed)
        for _ in range(3):
            state, metrics = iterate(state)
        return jax.device_get((state, metrics))

    first, again, other = train(0), train(0), train(1)
    jax.tree.map(np.testing.assert_array_equal, first, again)
    assert first[1]["reward"] != other[1]["reward"]


def test_every_device_holds_the_same_learner(networks, iterate):
    state, _ = iterate(start(networks))
    state, _ = iterate(state)
    for leaf in jax.tree.leaves(state.learner):
        shards = [np.asarray(shard.data) for shard in leaf.addressable_shards]
        assert len(shards) == 2
        np.testing.assert_array_equal(*shards)


@pytest.mark.parametrize(
    ("share", "progress", "expected"),
    [
        (0.4, 0.0, 0.03),
        (0.4, 0.6, 0.03),
        (0.4, 0.8, 0.02),
        (0.4, 1.0, 0.01),
        (0.4, 1.5, 0.01),
        (1.0, 0.25, 0.025),
        (0.8, 0.2, 0.03),
        (0.8, 0.6, 0.02),
    ],
)
def test_the_policy_settles_towards_the_end(share, progress, expected):
    scale = ppo.anneal(0.03, 0.01, share, jnp.asarray(progress))
    assert float(scale) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("rate", "kl", "expected"),
    [
        (1e-3, 0.03, 1e-3),
        (1e-3, 0.07, 1e-3 / 1.5),
        (1e-3, 0.01, 1.5e-3),
        (1e-3, 0.0, 1e-3),
        (1.2e-5, 0.07, 1e-5),
        (8e-3, 0.01, 1e-2),
        # Begun with beyond the bounds, or gone on with after they were changed.
        (5e-2, 0.03, 1e-2),
        (5e-2, 0.07, 1e-2),
        (1e-6, 0.01, 1e-5),
        (5e-2, np.nan, 1e-2),
    ],
)
def test_the_learning_rate_follows_the_change_of_the_policy_within_its_bounds(rate, kl, expected):
    new_rate = ppo.adapt_learning_rate(
        CONFIG, jnp.asarray(rate), jnp.asarray(kl), jnp.asarray(0.03)
    )
    assert float(new_rate) == pytest.approx(expected)


def test_a_state_whose_action_is_sure_does_not_rule_the_learning_rate():
    """Check by hand a divergence of 0.01 in seven of eight states, and `MOST_KL` in the eighth.

    The 0.01 are of 2 actions, (0.02 / 0.2)^2 / 2 each.
    """
    envs = 8
    before = TanhNormal(jnp.zeros((2, envs)), jnp.full((2, envs), 0.2))
    after = before._replace(mean=before.mean.at[:].set(0.02).at[:, 0].set(50.0))
    nothing = jnp.zeros(envs)
    log_prob = before.compute_log_prob(before.mean)
    transition = ppo.Transitions(None, before.mean, before, log_prob, nothing, nothing)
    algorithm = ppo.PPO(SimpleNamespace(apply_policy=lambda *_: after), CONFIG, 1)
    _, metrics = algorithm.compute_policy_loss(None, transition, nothing, jnp.zeros(()))
    assert float(metrics["kl"]) == pytest.approx((7 * 0.01 + ppo.MOST_KL) / envs, abs=1e-3)
