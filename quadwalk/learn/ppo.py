"""Proximal policy optimization (Schulman et al. 2017, arXiv:1707.06347), over all devices.

`collect` steps the environments with the policy. `learn` goes over what came of it in epochs of
minibatches: advantages and value loss, policy loss, update. Each device has its own share of the
environments; gradients and statistics are averaged, so every device holds the same learner.
`Iteration` compiles both. Arrays have environments last, and features before them.

What is not in the paper, and where it is:

- privileged critic, a value network that sees more than the policy: `networks.make_networks`
- mirror symmetry, networks that are symmetric as the robot is: `symmetric`
- squashing of actions by tanh, with the entropy in closed form: `distribution`
- normalized observations, which the first iteration only measures: `statistics`, `PPO.learn`
- adaptive learning rate, by the KL divergence of the policy: `adapt_learning_rate`
- annealing, less divergence and less entropy near the end: `anneal`
- fresh advantages in each minibatch, by the value network as it is: `PPO.compute_value_gradient`
- bootstrapping at time limits: `episodes.replace_finished`
- episodes out of phase, and a curriculum of terrain: `episodes.sample_starts`
- retry, the conditions of a fall once more: `episodes.choose_retries`
- evaluation environments, whose steps are not learned from: `PPO.collect`
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from quadwalk.brax import RunningStatisticsState, State
from quadwalk.learn.devices import AXIS, release_freed_memory
from quadwalk.learn.distribution import SURE, TanhNormal
from quadwalk.learn.episodes import (
    Metrics,
    NanStep,
    TrainingEnv,
    compute_metrics,
    find_first_nan,
    reduce_metrics,
    replace_finished,
    sample_starts,
    select_starts,
)
from quadwalk.learn.networks import NetworkParams, Networks
from quadwalk.learn.statistics import init_statistics, update_statistics
from quadwalk.learn.symmetric import Parts
from quadwalk.settings.training import PPOConfig

RATE = "learning_rate"  # its name in the optimizer's state
# The most that one state's divergence counts. Where tanh saturates, a policy can be so sure of an
# action that one state of a thousand diverges by 10^5, and the learning rate would end at its
# lower bound.
MOST_KL = 1.0


class Learner(NamedTuple):
    """What learning changes; the same on every device."""

    params: NetworkParams
    optimizer: optax.OptState
    normalizer: RunningStatisticsState  # of observations
    iterations: jax.Array  # () int32, done so far


class Workers(NamedTuple):
    """What collecting changes; leading axis: environments, or devices for `key`."""

    envs: State
    key: jax.Array  # (devices, 2) uint32


class TrainState(NamedTuple):
    """Everything that an iteration of training reads and writes."""

    learner: Learner
    workers: Workers


class Transitions(NamedTuple):
    """Control steps of the environments that are learned from, (unroll, ..., envs)."""

    inputs: Parts  # each (unroll, m, envs), of the networks before each step
    raw_action: jax.Array  # (unroll, 12, envs), before the squashing
    policy: TanhNormal  # the distribution of these, (unroll, 12, envs)
    log_prob: jax.Array  # (unroll, envs), of these
    reward: jax.Array  # (unroll, envs), scaled, with the value of what a time limit cuts off
    discount: jax.Array  # (unroll, envs), 0 in an episode's last step, else 1


class Rollout(NamedTuple):
    """The transitions of an iteration, and the networks' inputs (m, envs) after the last."""

    transitions: Transitions
    last_inputs: Parts


@dataclass(frozen=True)
class PPO:
    """The algorithm on one device's share of the environments."""

    networks: Networks
    config: PPOConfig
    iterations: int  # of the whole training

    def collect(
        self, env: TrainingEnv, learner: Learner, workers: Workers
    ) -> tuple[Workers, Rollout, Metrics, jax.Array]:
        """Step every environment `unroll` times; a finished episode is followed by a fresh one.

        The last environments are for evaluation: they act as a trained policy does, and their
        steps are no transitions. Metrics are means over steps, and counts of episodes; those of the
        evaluation environments are named "eval/...". "nan_step" is a `NanStep`. The last value
        is a key (devices, 2) for `learn`.
        """
        config, networks = self.config, self.networks
        envs = len(workers.envs.done)
        training_envs = envs - config.eval_envs // jax.lax.axis_size(AXIS)
        key, key_steps, key_starts = jax.random.split(workers.key[0], 3)
        before, starts = sample_starts(
            env, workers.envs, learner.iterations == 0, training_envs, key_starts
        )

        def compute_value(observation: jax.Array) -> jax.Array:
            inputs = networks.normalize(learner.normalizer, observation)
            return networks.apply_value(learner.params.value, inputs)

        def step(
            carry: tuple[State, NanStep], xs: tuple[jax.Array, jax.Array]
        ) -> tuple[tuple[State, NanStep], tuple[Transitions, Metrics]]:
            before, nan_step = carry
            key, number = xs
            inputs = networks.normalize(learner.normalizer, before.obs)
            policy = networks.apply_policy(learner.params.policy, inputs)
            raw_action = policy.sample(key)
            deterministic = jnp.arange(envs) >= training_envs
            if config.stochastic:
                deterministic &= policy.std <= SURE
            action = jnp.tanh(jnp.where(deterministic, policy.mean, raw_action)).T
            after = jax.vmap(env.step)(before, action)
            nan_step = find_first_nan(nan_step, after.metrics["nan"], before, action)
            reward, following = replace_finished(
                env,
                config,
                compute_value,
                after,
                select_starts(starts, envs, number),
                training_envs,
                jax.random.fold_in(key, 1),
            )
            log_prob = policy.compute_log_prob(raw_action)
            transition = Transitions(inputs, raw_action, policy, log_prob, reward, 1.0 - after.done)
            transition = jax.tree.map(lambda x: x[..., :training_envs], transition)
            return (following, nan_step), (transition, compute_metrics(after, training_envs))

        nan_step = NanStep(
            flag=jnp.zeros(()),
            before=jax.tree.map(lambda x: jnp.zeros_like(x[0]), before.pipeline_state),
            action=jnp.zeros(env.action_size),
        )
        (after, nan_step), (transitions, metrics) = jax.lax.scan(
            step,
            (before, nan_step),
            (jax.random.split(key_steps, config.unroll), jnp.arange(config.unroll)),
        )
        if env.curriculum is not None:
            metrics |= env.curriculum.sum_levels(after.pipeline_state.tile[:training_envs])
        last_inputs = networks.normalize(learner.normalizer, after.obs[:training_envs])
        key, key_learn = jax.random.split(key)
        return (
            Workers(after, key[None]),
            Rollout(transitions, last_inputs),
            reduce_metrics(metrics, nan_step, AXIS),
            key_learn[None],
        )

    def learn(self, learner: Learner, rollout: Rollout, key: jax.Array) -> tuple[Learner, Metrics]:
        """Update the learner in epochs of minibatches, each of environments side by side.

        The first iteration measures the observations and no more: a policy that had learned on raw
        ones would change beyond recognition when they are normalized.
        """
        config = self.config
        progress = learner.iterations / float(self.iterations)  # may be more than int32 holds
        desired_kl = anneal(config.desired_kl, config.final_kl, config.anneal_share, progress)
        entropy = anneal(config.entropy, config.final_entropy, config.anneal_share, progress)
        size = rollout.transitions.reward.shape[-1] // config.minibatches

        def update(
            carry: tuple[NetworkParams, optax.OptState], number: jax.Array
        ) -> tuple[tuple[NetworkParams, optax.OptState], Metrics]:
            params, optimizer = carry
            minibatch = partial(slice_environments, first=number * size, count=size)
            gradient, metrics = jax.lax.pmean(
                self.compute_gradient(params, rollout, entropy, minibatch), AXIS
            )
            rate = optax.tree_utils.tree_get(optimizer, RATE)
            rate = adapt_learning_rate(config, rate, metrics["kl"], desired_kl)
            optimizer = optax.tree_utils.tree_set(optimizer, **{RATE: rate})
            updates, optimizer = make_optimizer(config).update(gradient, optimizer, params)
            params = optax.apply_updates(params, updates)
            return (params, optimizer), {**metrics, RATE: rate}

        def run_epoch(carry: Any, key: jax.Array) -> Any:
            return jax.lax.scan(update, carry, jax.random.permutation(key, config.minibatches))

        before = learner.params, learner.optimizer
        after, metrics = jax.lax.scan(run_epoch, before, jax.random.split(key[0], config.epochs))
        first = learner.iterations == 0
        params, optimizer = jax.tree.map(lambda old, new: jnp.where(first, old, new), before, after)
        # After learning: the divergence from the collecting policy is then a matter of weights
        # alone.
        normalizer = update_statistics(
            learner.normalizer, rollout.transitions.inputs, self.networks.critic_obs, AXIS
        )
        learner = Learner(params, optimizer, normalizer, learner.iterations + 1)
        floats = [x for x in jax.tree.leaves(learner) if jnp.issubdtype(x.dtype, jnp.floating)]
        return learner, {
            "loss/policy": jnp.mean(metrics["policy"]),
            "loss/value": jnp.mean(metrics["value"]),
            "loss/kl": jnp.mean(metrics["kl"]),
            "policy/std": metrics["std"][-1, -1],
            "learning_rate": metrics[RATE][-1, -1],
            "learner/finite": jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in floats])),
        }

    def compute_gradient(
        self,
        params: NetworkParams,
        rollout: Rollout,
        entropy: jax.Array,
        minibatch: Callable[[Any], Any] = lambda tree: tree,
    ) -> tuple[NetworkParams, Metrics]:
        """Return the gradient of PPO's loss on a minibatch, and the parts of the loss.

        `minibatch` takes its environments out of arrays (..., envs). It is called step by step:
        what the networks compute of one step stays in a core's cache. Each network has a pass of
        its own, since advantages are normalized over the whole minibatch.
        """
        value_gradient, value_loss, advantages = self.compute_value_gradient(
            params.value, rollout, minibatch
        )
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)

        def step(total: Any, xs: tuple[Transitions, jax.Array]) -> Any:
            transition, advantage = xs
            gradient, metrics = jax.grad(self.compute_policy_loss, has_aux=True)(
                params.policy, minibatch(transition), advantage, entropy
            )
            return jax.tree.map(jnp.add, total, gradient), metrics

        start = jax.tree.map(jnp.zeros_like, params.policy)
        xs = rollout.transitions, advantages
        policy_gradient, metrics = jax.lax.scan(step, start, xs)
        steps = len(rollout.transitions.reward)
        gradient = NetworkParams(policy=policy_gradient, value=value_gradient)
        gradient = jax.tree.map(lambda x: x / steps, gradient)
        return gradient, jax.tree.map(jnp.mean, {**metrics, "value": value_loss})

    def compute_value_gradient(
        self, params: Any, rollout: Rollout, minibatch: Callable[[Any], Any]
    ) -> tuple[Any, jax.Array, jax.Array]:
        """Return gradient and values of the value loss on a minibatch, and the advantages.

        `minibatch` takes its environments out of arrays (..., envs). The gradient is the sum over
        steps, the loss is (unroll,), advantages are (unroll, envs).

        Generalized advantage estimation (Schulman et al. 2016, arXiv:1506.02438) goes from the last
        step back. So each step's return is known when its value is learned.
        """
        config, networks = self.config, self.networks

        def compute_loss(
            params: Any, transition: Transitions, next_value: jax.Array, next_error: jax.Array
        ) -> Any:
            value = networks.apply_value(params, transition.inputs)
            error, advantage = estimate_advantage(config, transition, value, next_value, next_error)
            error = jax.lax.stop_gradient(error)
            target = jax.lax.stop_gradient(value) + error
            loss = 0.5 * config.value_coef * jnp.mean((target - value) ** 2)
            return loss, (value, error, advantage)

        def step(carry: Any, transition: Transitions) -> Any:
            total, next_value, next_error = carry
            (loss, (value, error, advantage)), gradient = jax.value_and_grad(
                compute_loss, has_aux=True
            )(params, minibatch(transition), next_value, next_error)
            return (jax.tree.map(jnp.add, total, gradient), value, error), (loss, advantage)

        last_value = networks.apply_value(params, minibatch(rollout.last_inputs))
        start = jax.tree.map(jnp.zeros_like, params), last_value, jnp.zeros_like(last_value)
        (gradient, _, _), (loss, advantages) = jax.lax.scan(
            step, start, rollout.transitions, reverse=True
        )
        return gradient, loss, advantages

    def compute_policy_loss(
        self, params: Any, transition: Transitions, advantage: jax.Array, entropy: jax.Array
    ) -> tuple[jax.Array, Metrics]:
        """Return the clipped loss of a step, less the entropy bonus, and metrics."""
        policy = self.networks.apply_policy(params, transition.inputs)
        ratio = jnp.exp(policy.compute_log_prob(transition.raw_action) - transition.log_prob)
        epsilon = self.config.clip_epsilon
        clipped = jnp.clip(ratio, 1.0 - epsilon, 1.0 + epsilon)
        loss = -jnp.mean(jnp.minimum(ratio * advantage, clipped * advantage))
        divergence = jnp.minimum(policy.compute_divergence(transition.policy), MOST_KL)
        metrics = {"policy": loss, "kl": jnp.mean(divergence), "std": jnp.mean(policy.std)}
        return loss - entropy * jnp.mean(policy.compute_entropy()), metrics


def estimate_advantage(
    config: PPOConfig,
    transition: Transitions,
    value: jax.Array,
    next_value: jax.Array,
    next_error: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Return by how much the lambda-return of a step exceeds its `value`, and its advantage.

    All are (envs,). `next_error` is the first of both for the next step. As in Brax, an advantage
    counts the next step's return in full, and `gae_lambda` weighs what comes after that.
    """
    discount = config.discount * transition.discount
    surprise = transition.reward + discount * next_value - value
    error = surprise + config.gae_lambda * discount * next_error
    return error, surprise + discount * next_error


def anneal(start: float, end: float, share: float, progress: jax.Array) -> jax.Array:
    """Return `start`, or less in the last `share` of training, and `end` at `progress` 1."""
    return start + jnp.clip(1.0 - (1.0 - progress) / share, 0.0, 1.0) * (end - start)


def adapt_learning_rate(
    config: PPOConfig, rate: jax.Array, kl: jax.Array, desired_kl: jax.Array
) -> jax.Array:
    """Return `rate` within its bounds, reduced where the policy changes too much, else raised.

    As in Rudin et al. 2022, arXiv:2109.11978.
    """
    rate = jnp.where(kl > 2.0 * desired_kl, rate / 1.5, rate)
    rate = jnp.where((kl < desired_kl / 2.0) & (kl > 0.0), rate * 1.5, rate)
    return jnp.clip(rate, config.min_learning_rate, config.max_learning_rate)


def make_optimizer(config: PPOConfig) -> optax.GradientTransformation:
    """Make Adam with a learning rate that is part of its state, after clipping by global norm."""
    return optax.chain(
        optax.clip_by_global_norm(config.max_grad_norm),
        optax.inject_hyperparams(optax.adam)(learning_rate=config.learning_rate),
    )


def slice_environments(tree: Any, first: jax.Array, count: int) -> Any:
    """Return `count` environments of arrays (..., envs), from the `first` on."""
    return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, first, count, axis=-1), tree)


def init_state(
    env: TrainingEnv, networks: Networks, config: PPOConfig, mesh: Mesh, num_envs: int, seed: int
) -> TrainState:
    """Return the state before the first iteration, in which `num_envs` environments will start."""
    key_networks, key_workers = jax.random.split(jax.random.PRNGKey(seed))
    params = networks.init(key_networks)
    learner = Learner(
        params=params,
        optimizer=make_optimizer(config).init(params),
        normalizer=init_statistics(networks.critic_obs.size),
        iterations=jnp.zeros((), jnp.int32),
    )
    split = NamedSharding(mesh, P(AXIS))
    # Zeros of their shapes: the first `collect` starts them, and a program for that alone would
    # take as long to compile as a good part of `collect`.
    shapes = jax.eval_shape(env.reset, jax.ShapeDtypeStruct((2,), np.uint32))
    number = num_envs + config.eval_envs
    envs = jax.tree.map(lambda x: np.zeros((number, *x.shape), x.dtype), shapes)
    workers = Workers(
        envs=jax.device_put(envs, split),
        key=jax.device_put(jax.random.split(key_workers, mesh.size), split),
    )
    # Through NumPy, so that these are the same kind of arrays as those read from a file.
    learner = jax.tree.map(np.asarray, learner)
    return TrainState(jax.device_put(learner, NamedSharding(mesh, P())), workers)


class Iteration:
    """An iteration of training: `state, metrics = iteration(state)`, whose `state` is donated.

    It is two programs, since one of both takes an eighth longer (studies/history.md).
    """

    def __init__(
        self, env: TrainingEnv, networks: Networks, config: PPOConfig, mesh: Mesh, iterations: int
    ) -> None:
        ppo = PPO(networks, config, iterations)
        same, split = P(), P(AXIS)
        row: Any = P(None, AXIS)  # environments last
        column: Any = P(None, None, AXIS)
        transitions = Transitions(column, column, TanhNormal(column, column), row, row, row)
        rollout = Rollout(transitions, row)
        shard = partial(jax.shard_map, mesh=mesh, check_vma=False)
        self._collect: Any = jax.jit(
            shard(
                ppo.collect, in_specs=(same, same, split), out_specs=(split, rollout, same, split)
            ),
            donate_argnums=2,
        )
        self.learn: Any = jax.jit(
            shard(ppo.learn, in_specs=(same, rollout, split), out_specs=(same, same)),
            donate_argnums=0,
        )
        self._place = NamedSharding(mesh, same)
        self.set_env(env)

    def set_env(self, env: TrainingEnv) -> None:
        """Set the environment; once traced, it may differ in the values of its leaves alone."""
        self._env = jax.device_put(env, self._place)  # its ground, once

    def trace(self, state: TrainState) -> None:
        """Trace both programs for states like this, where what a task's functions lack shows."""
        collect = self._collect.lower(self._env, *state)
        _, rollout, _, key = collect.out_info
        self._collect, self.learn = collect, self.learn.lower(state.learner, rollout, key)

    def compile(self) -> None:
        """Compile both, once traced, at the same time."""
        with ThreadPoolExecutor() as pool:
            self._collect, self.learn = pool.map(
                lambda traced: traced.compile(), (self._collect, self.learn)
            )
        release_freed_memory()

    def collect(
        self, learner: Learner, workers: Workers
    ) -> tuple[Workers, Rollout, Metrics, jax.Array]:
        """Return `workers` after an iteration, what they met, metrics, and a key to learn with."""
        return self._collect(self._env, learner, workers)

    def __call__(self, state: TrainState) -> tuple[TrainState, Metrics]:
        workers, rollout, collect_metrics, key = self.collect(*state)
        learner, learn_metrics = self.learn(state.learner, rollout, key)
        return TrainState(learner, workers), {**collect_metrics, **learn_metrics}
