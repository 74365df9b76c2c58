"""PPO: `collect` lets the policy act, `learn` updates it from what came of that.

The loss and the statistics of observations are Brax's, written with features first and environments
last, as `quadwalk.learn.networks` are. Both functions run on every device at once, as
`quadwalk.learn.iteration` compiles them: each device of the mesh steps its own share of
the environments; gradients and statistics are averaged over devices, so every device holds the same
learner. The learning rate follows the policy's change (KL divergence), as in Schulman et al. 2017,
section 4, and Rudin et al. 2022, arXiv:2109.11978.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from quadwalk.brax import Env, PPONetworkParams, RunningStatisticsState, State
from quadwalk.learn.acting import SURE
from quadwalk.learn.episodes import fresh_starts, start_anew
from quadwalk.learn.networks import Networks, Parts, TanhNormal
from quadwalk.settings.training import PPOConfig

AXIS = "devices"
RATE = "learning_rate"  # its name in the optimizer's state
MOST_KL = 1.0  # of one state, in the mean that the learning rate follows
Metrics = dict[str, Any]


class Learner(NamedTuple):
    """What learning changes; the same on every device."""

    params: PPONetworkParams
    optimizer: optax.OptState
    normalizer: RunningStatisticsState
    iterations: jax.Array  # () int32, done so far


class RolloutState(NamedTuple):
    """What collecting changes; leading axis: environments, or devices for `key`."""

    envs: State
    key: jax.Array  # (devices, 2) uint32


class Rollout(NamedTuple):
    """What the environments learned from met in `unroll` control steps; environments last."""

    seen: Parts  # each (unroll, m, envs), `Networks.normalized`, before each step
    raw_action: jax.Array  # (unroll, 12, envs), before the squashing
    policy: TanhNormal  # of them, (unroll, 12, envs)
    log_prob: jax.Array  # (unroll, envs), theirs
    reward: jax.Array  # (unroll, envs), scaled, with what is expected after a time limit
    discount: jax.Array  # (unroll, envs), 0 in an episode's last step, else 1


class NanStep(NamedTuple):
    """The first step of an iteration after which numbers were not finite, for replay."""

    found: jax.Array  # () float32, more than 0 if there was one; else the rest means nothing
    before: Any  # the environment's `pipeline_state` before the step
    action: jax.Array  # (12,) what it was stepped with


def make_optimizer(config: PPOConfig) -> optax.GradientTransformation:
    """Adam with a learning rate that is part of its state, after clipping by global norm."""
    return optax.chain(
        optax.clip_by_global_norm(config.max_grad_norm),
        optax.inject_hyperparams(optax.adam)(learning_rate=config.learning_rate),
    )


def collect(
    env: Env, networks: Networks, config: PPOConfig, learner: Learner, workers: RolloutState
) -> tuple[RolloutState, tuple[Rollout, Parts], Metrics]:
    """Step every environment `unroll` times; the last of them, for evaluation, as a trained policy.

    Returns what those learned from met and what they see (m, envs) at the end, and metrics: means
    per step, and counts of episodes; those of the evaluation environments are named "eval/...",
    "nan_step" is a `NanStep`. A finished episode is followed by a fresh one.
    """
    envs = len(workers.envs.done)
    learnt_from = envs - config.eval_envs // jax.lax.axis_size(AXIS)
    key, key_steps, key_starts = jax.random.split(workers.key[0], 3)
    starts = fresh_starts(env, workers.envs, learner.iterations == 0, learnt_from, key_starts)

    def expected(observation: jax.Array) -> jax.Array:
        seen = networks.normalized(learner.normalizer, observation)
        return networks.value(learner.params.value, seen)

    def one_step(
        carry: tuple[State, NanStep], xs: tuple[jax.Array, jax.Array]
    ) -> tuple[tuple[State, NanStep], tuple[Rollout, Metrics]]:
        before, nan_step = carry
        key, number = xs
        seen = networks.normalized(learner.normalizer, before.obs)
        policy = networks.policy(learner.params.policy, seen)
        raw_action = policy.sample(key)
        noiseless = jnp.arange(envs) >= learnt_from
        if config.stochastic:
            noiseless &= policy.std <= SURE
        action = jnp.tanh(jnp.where(noiseless, policy.mean, raw_action)).T
        after = jax.vmap(env.step)(before, action)
        nan_step = _first_nan(nan_step, after.metrics["nan"], before.pipeline_state, action)
        reward, following = start_anew(
            env,
            config,
            expected,
            after,
            starts.of_step(number),
            learnt_from,
            jax.random.fold_in(key, 1),
        )
        log_prob = policy.log_prob(raw_action)
        met = Rollout(seen, raw_action, policy, log_prob, reward, 1.0 - after.done)
        met = jax.tree.map(lambda x: x[..., :learnt_from], met)
        return (following, nan_step), (met, _step_metrics(after, learnt_from))

    nowhere = jax.tree.map(lambda x: jnp.zeros_like(x[0]), workers.envs.pipeline_state)
    nan_step = NanStep(jnp.zeros(()), nowhere, jnp.zeros(env.action_size))
    (after, nan_step), (rollout, metrics) = jax.lax.scan(
        one_step,
        (starts.envs, nan_step),
        (jax.random.split(key_steps, config.unroll), jnp.arange(config.unroll)),
    )
    if env.curriculum is not None:
        metrics |= env.curriculum.sums(after.pipeline_state.tile[:learnt_from])
    last = networks.normalized(learner.normalizer, after.obs[:learnt_from])
    return RolloutState(after, key[None]), (rollout, last), _over_devices(metrics, nan_step)


def _step_metrics(after: State, learnt_from: int) -> Metrics:
    """Means and counts of a step, of the training and of the evaluation environments."""
    return {
        "reward": jnp.mean(after.reward[:learnt_from]),
        **{name: jnp.mean(value[:learnt_from]) for name, value in after.metrics.items()},
        **{
            f"eval/{name}": jnp.mean(after.metrics[name][learnt_from:])
            for name in ("speed", "velocity_error", "standing")
            if name in after.metrics
        },
        "count/ended": jnp.sum(after.done[:learnt_from]),
        "count/fell": jnp.sum(after.metrics["fell"][:learnt_from]),
        "count/nan": jnp.sum(after.metrics["nan"]),
        "eval/count/ended": jnp.sum(after.done[learnt_from:]),
        "eval/count/fell": jnp.sum(after.metrics["fell"][learnt_from:]),
    }


def _over_devices(metrics: Metrics, nan_step: NanStep) -> Metrics:
    """The `metrics` of every step and device as one; the first `NanStep` found is among them."""
    nan_steps = jax.lax.all_gather(nan_step, AXIS)
    counts = {name: jnp.sum(value) for name, value in metrics.items() if "count/" in name}
    means = {name: jnp.mean(value) for name, value in metrics.items() if name not in counts}
    return {
        **jax.lax.psum(counts, AXIS),
        **jax.lax.pmean(means, AXIS),
        "nan_step": jax.tree.map(lambda x: x[jnp.argmax(nan_steps.found > 0)], nan_steps),
    }


def _first_nan(known: NanStep, nan: jax.Array, before: Any, action: jax.Array) -> NanStep:
    """`known` if it was found, else the first environment of a step whose `nan` (n,) is set."""
    index = jnp.argmax(nan)
    new = NanStep(nan[index], *jax.tree.map(lambda x: x[index], (before, action)))
    return jax.tree.map(lambda old, new: jnp.where(known.found > 0, old, new), known, new)


def anneal(start: float, end: float, share: float, progress: jax.Array) -> jax.Array:
    """`start`, falling to `end` over the last `share` of the training; `progress` from 0 to 1."""
    return start + jnp.clip(1.0 - (1.0 - progress) / share, 0.0, 1.0) * (end - start)


def learn(
    networks: Networks,
    config: PPOConfig,
    learner: Learner,
    data: tuple[Rollout, Parts],
    key: jax.Array,
    iterations: int,
) -> tuple[Learner, Metrics]:
    """Epochs of minibatch updates on what `collect` gives, one of `iterations` in all.

    A minibatch is of environments side by side. The first call measures the observations and no
    more: a policy that had learned on raw ones would change beyond recognition when they are
    normalized.
    """
    progress = learner.iterations / float(iterations)  # more than int32 holds, if it must be
    desired_kl = anneal(config.desired_kl, config.final_kl, config.anneal_share, progress)
    entropy = anneal(config.entropy, config.final_entropy, config.anneal_share, progress)
    size = data[0].reward.shape[-1] // config.minibatches

    def update(carry: Any, number: jax.Array) -> Any:
        own = partial(_environments, number * size, size)
        return _update(networks, config, desired_kl, entropy, carry, *data, own)

    def epoch(carry: Any, key: jax.Array) -> Any:
        return jax.lax.scan(update, carry, jax.random.permutation(key, config.minibatches))

    before = learner.params, learner.optimizer
    after, metrics = jax.lax.scan(epoch, before, jax.random.split(key, config.epochs))
    first = learner.iterations == 0
    params, state = jax.tree.map(lambda old, new: jnp.where(first, old, new), before, after)
    # After learning: the divergence from the collecting policy is then a matter of weights alone.
    normalizer = networks.measured(learner.normalizer, data[0].seen, AXIS)
    return Learner(params, state, normalizer, learner.iterations + 1), {
        "loss/policy": jnp.mean(metrics["policy"]),
        "loss/value": jnp.mean(metrics["value"]),
        "loss/kl": jnp.mean(metrics["kl"]),
        "policy/std": metrics["std"][-1, -1],
        "learning_rate": metrics[RATE][-1, -1],
    }


def _environments(first: jax.Array, number: int, tree: Any) -> Any:
    """Of arrays (..., envs), the columns of so many environments from the `first` on."""
    return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, first, number, axis=-1), tree)


def gradients(
    networks: Networks,
    config: PPOConfig,
    entropy: jax.Array,
    params: PPONetworkParams,
    rollout: Rollout,
    last: Parts,
    own: Callable[[Any], Any] = lambda tree: tree,
) -> tuple[PPONetworkParams, Metrics]:
    """Of PPO's loss, as Brax's `compute_ppo_loss`, on a minibatch, and its parts.

    `own` takes the minibatch's environments out of arrays (..., envs). It is called step by step:
    what the networks compute of one step stays in a core's cache. Each network has a pass of its
    own, since advantages are measured against those of the whole minibatch.
    """
    value, (value_loss, advantages) = _value_gradient(
        networks, config, params.value, rollout, last, own
    )
    advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    loss = partial(_policy_loss, networks, config, entropy)

    def step(total: Any, xs: tuple[Rollout, jax.Array]) -> Any:
        met, advantage = xs
        gradient, metrics = jax.grad(loss, has_aux=True)(params.policy, own(met), advantage)
        return jax.tree.map(jnp.add, total, gradient), metrics

    nothing = jax.tree.map(jnp.zeros_like, params.policy)
    policy, metrics = jax.lax.scan(step, nothing, (rollout, advantages))
    steps = len(rollout.reward)
    gradient = jax.tree.map(lambda x: x / steps, PPONetworkParams(policy=policy, value=value))
    return gradient, jax.tree.map(jnp.mean, {**metrics, "value": value_loss})


def _value_gradient(
    networks: Networks,
    config: PPOConfig,
    params: Any,
    rollout: Rollout,
    last: Parts,
    own: Callable[[Any], Any],
) -> tuple[Any, tuple[jax.Array, jax.Array]]:
    """The value loss's gradient, summed over steps; the loss (unroll,), advantages (unroll, envs).

    Generalized advantage estimation (Schulman et al. 2016, arXiv:1506.02438) goes from the last
    step back, so each step's return is known when its value is learned. As in Brax, an advantage
    counts the next step's return in full, and `gae_lambda` weighs what is beyond.
    """

    def loss(params: Any, met: Rollout, following: jax.Array, beyond: jax.Array) -> Any:
        value = networks.value(params, met.seen)
        kept = config.discount * met.discount
        surprise = met.reward + kept * following - value
        error = jax.lax.stop_gradient(surprise + config.gae_lambda * kept * beyond)
        target = jax.lax.stop_gradient(value) + error
        mean = 0.5 * config.value_coef * jnp.mean((target - value) ** 2)
        return mean, (value, error, surprise + kept * beyond)

    def step(carry: Any, met: Rollout) -> Any:
        total, following, beyond = carry
        (mean, (value, error, advantage)), gradient = jax.value_and_grad(loss, has_aux=True)(
            params, own(met), following, beyond
        )
        return (jax.tree.map(jnp.add, total, gradient), value, error), (mean, advantage)

    after = networks.value(params, own(last))
    start = jax.tree.map(jnp.zeros_like, params), after, jnp.zeros_like(after)
    (total, _, _), found = jax.lax.scan(step, start, rollout, reverse=True)
    return total, found


def _policy_loss(
    networks: Networks,
    config: PPOConfig,
    entropy: jax.Array,
    params: Any,
    met: Rollout,
    advantages: jax.Array,
) -> tuple[jax.Array, Metrics]:
    """Of a step, the policy's clipped loss less the entropy bonus; how far the policy changed."""
    policy = networks.policy(params, met.seen)
    ratio = jnp.exp(policy.log_prob(met.raw_action) - met.log_prob)
    clipped = jnp.clip(ratio, 1.0 - config.clip_epsilon, 1.0 + config.clip_epsilon)
    loss = -jnp.mean(jnp.minimum(ratio * advantages, clipped * advantages))
    # Where tanh saturates, a policy can be so sure of an action that one state of a thousand
    # diverges by 10^5, and the learning rate would end at its lower bound.
    divergence = jnp.mean(jnp.minimum(policy.divergence(met.policy), MOST_KL))
    metrics = {"policy": loss, "kl": divergence, "std": jnp.mean(policy.std)}
    return loss - entropy * jnp.mean(policy.entropy()), metrics


def adapted(config: PPOConfig, rate: jax.Array, kl: jax.Array, desired_kl: jax.Array) -> jax.Array:
    """`rate` within its bounds, less where the policy changes too much, more where too little."""
    rate = jnp.where(kl > 2.0 * desired_kl, rate / 1.5, rate)
    rate = jnp.where((kl < desired_kl / 2.0) & (kl > 0.0), rate * 1.5, rate)
    return jnp.clip(rate, config.min_learning_rate, config.max_learning_rate)


def _update(
    networks: Networks,
    config: PPOConfig,
    desired_kl: jax.Array,
    entropy: jax.Array,
    carry: tuple[PPONetworkParams, optax.OptState],
    rollout: Rollout,
    last: Parts,
    own: Callable[[Any], Any],
) -> tuple[tuple[PPONetworkParams, optax.OptState], Metrics]:
    """One gradient step on a minibatch; `carry` is parameters and optimizer state."""
    params, state = carry
    found = gradients(networks, config, entropy, params, rollout, last, own)
    grads, metrics = jax.lax.pmean(found, AXIS)
    rate = optax.tree_utils.tree_get(state, RATE)
    rate = adapted(config, rate, metrics["kl"], desired_kl)
    state = optax.tree_utils.tree_set(state, **{RATE: rate})
    updates, state = make_optimizer(config).update(grads, state, params)
    return (optax.apply_updates(params, updates), state), {**metrics, RATE: rate}
