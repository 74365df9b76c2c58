"""The environment as the learner uses it, and fresh episodes in place of those that end."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from quadwalk.brax import State
from quadwalk.env.reflections import Mirrors
from quadwalk.env.reset import Curriculum
from quadwalk.env.state import select_rows
from quadwalk.settings.environment import EnvConfig
from quadwalk.settings.training import PPOConfig

CHUNK = 16  # episodes that are started at once: of a thousand robots, few end in a step
Metrics = dict[str, Any]


class TrainingEnv(Protocol):
    """An environment that the learner can train in, such as `QuadrupedEnv`; a pytree.

    The learner reads a state's `obs`, `reward` and `done`, and the metrics "speed", "fell" and
    "nan". `info["truncation"]` is 1 at a time limit. `pipeline_state` is a named tuple with
    `steps`, with a curriculum also `tile`, `travel` and `qpos`, with `PPOConfig.retry` also
    `conditions`.
    """

    config: EnvConfig
    curriculum: Curriculum | None

    @property
    def policy_size(self) -> int:
        """Length of the first part of an observation, which is all that the policy sees."""

    @property
    def observation_size(self) -> int:
        """Length of an observation, all of which the value network sees."""

    @property
    def action_size(self) -> int:
        """Length of an action."""

    @property
    def mirrors(self) -> Mirrors | None:
        """How observations and actions mirror; `NotSymmetric` or None: they do not."""

    def reset(self, rng: jax.Array, tile: jax.Array | None = None) -> State:
        """Return the start of an episode, on the terrain's tile of index `tile`; None: on any."""

    def step(self, state: State, action: jax.Array) -> State:
        """Return the state one control step later; it does not start a fresh episode."""

    def start_episode(self, state: State, **changes: Any) -> State:
        """Return the start of an episode with `changes` of its `pipeline_state`, observed anew."""

    def start_with_body(self, state: State, body: jax.Array) -> State:
        """Return the start of an episode as one of another body; for environments with a bank."""


def reset_envs(env: TrainingEnv, keys: jax.Array, tiles: jax.Array | None = None) -> State:
    """Return fresh episodes, one for each of `keys` (n, 2), on `tiles` (n,), None: on any.

    Each starts at a random step. Otherwise all would reach their time limit in the same iteration.
    """
    state = jax.vmap(env.reset)(*([keys] if tiles is None else [keys, tiles]))
    steps = jax.vmap(lambda key: jax.random.randint(key, (), 0, env.config.episode_steps))(keys)
    return jax.vmap(env.start_episode)(state, steps=steps)


def sample_starts(
    env: TrainingEnv, envs: State, first: jax.Array, training_envs: int, key: jax.Array
) -> tuple[State, State]:
    """Return `envs` (n, ...) before an iteration, and starts of the episodes that may begin in it.

    In the `first` iteration of all, `envs` start afresh. There are as many starts as environments.
    With a curriculum each environment has its own, (n, ...). Otherwise `select_starts` shares them
    out anew in each step. It slices them from an array that holds all twice, (2 n, ...).
    """
    number = len(envs.done)
    tiles = choose_tiles(env, envs.pipeline_state, first, training_envs, key)
    starts = reset_envs(env, jax.random.split(key, number), tiles)
    envs = jax.tree.map(lambda new, old: jnp.where(first, new, old), starts, envs)
    if tiles is None:
        starts = jax.tree.map(lambda x: jnp.concatenate([x, x]), starts)
    return envs, starts


def select_starts(starts: State, number: int, step: jax.Array) -> State:
    """Return a start for each of `number` environments in `step` of the iteration."""
    if len(starts.done) == number:
        return starts
    first = number - 1 - step % number
    return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, first, number), starts)


def choose_tiles(
    env: TrainingEnv, state: Any, first: jax.Array, training_envs: int, key: jax.Array
) -> jax.Array | None:
    """Return the tile (n,) of each environment's next episode; None without a curriculum.

    The curriculum moves the first `training_envs` environments, by what their episodes have come to
    at the start of the iteration. The others, for evaluation, get any tile alike.
    """
    if env.curriculum is None:
        return None
    envs, (key_first, key_next, key_even) = len(state.tile), jax.random.split(key, 3)
    following = jax.vmap(env.curriculum.sample_next_tile)(
        state.tile, state.travel, state.qpos, state.steps, jax.random.split(key_next, envs)
    )
    learning = jnp.where(first, env.curriculum.sample_first_tiles(envs, key_first), following)
    evenly = env.curriculum.sample_tiles(envs, key_even)
    return jnp.where(jnp.arange(envs) < training_envs, learning, evenly)


def replace_finished(
    env: TrainingEnv,
    config: PPOConfig,
    bootstrap_value: Callable[[jax.Array], jax.Array],
    after: State,
    starts: State,
    training_envs: int,
    key: jax.Array,
) -> tuple[jax.Array, State]:
    """Return rewards (n,) to learn from, and `after` with finished episodes replaced by `starts`.

    A time limit is no failure: `bootstrap_value` of the observation after it is added to its
    reward. The step then ends the episode, which equals bootstrapping through the limit (Pardo et
    al. 2018, arXiv:1712.00378).
    """
    # Only after a fall at a random step: those that fell together must not end together.
    changes = {"steps": starts.pipeline_state.steps * after.metrics["fell"].astype(jnp.int32)}
    bodies = None
    if config.retry:
        again = choose_retries(config.retry, after, training_envs, key)
        changes["conditions"] = retry_conditions(again, after, starts)
        bodies = retry_bodies(again, after, starts)
    starts = starts.replace(pipeline_state=starts.pipeline_state._replace(**changes))
    envs, finished = len(after.done), jnp.sum(after.done > 0)
    rows = jnp.flatnonzero(after.done > 0, size=envs + CHUNK, fill_value=envs)
    truncation = config.discount * after.info["truncation"]

    def replace_chunk(carry: tuple[Any, jax.Array]) -> tuple[Any, jax.Array]:
        (reward, state, obs), done = carry
        chunk = jax.lax.dynamic_slice_in_dim(rows, done, CHUNK)
        value = truncation[chunk] * bootstrap_value(after.obs[chunk])
        # Observed here: to observe all starts would take a twentieth of a training step.
        start = jax.tree.map(lambda x: x[chunk], starts)
        if bodies is None:
            start = jax.vmap(env.start_episode)(start)
        else:
            start = jax.vmap(env.start_with_body)(start, bodies[chunk])
        state, obs = jax.tree.map(
            lambda old, new: old.at[chunk].set(new, mode="drop"),
            (state, obs),
            (start.pipeline_state, start.obs),
        )
        return (reward.at[chunk].add(value, mode="drop"), state, obs), done + CHUNK

    unchanged = config.reward_scale * after.reward, after.pipeline_state, after.obs
    (reward, state, obs), _ = jax.lax.while_loop(
        lambda carry: carry[1] < finished, replace_chunk, (unchanged, jnp.zeros((), jnp.int32))
    )
    return reward, after.replace(pipeline_state=state, obs=obs)


def choose_retries(share: float, after: State, training_envs: int, key: jax.Array) -> jax.Array:
    """Return the environments (n,) bool that meet what they fell under once more.

    It is prioritized level replay (Jiang et al. 2021, arXiv:2010.03934) by falls alone. Only the
    first `training_envs` environments, which are not for evaluation, repeat anything, and those
    after a `share` of their falls.
    """
    again = jax.random.bernoulli(key, share, after.done.shape) & (after.metrics["fell"] > 0)
    again &= jnp.arange(len(after.done)) < training_envs
    return again


def retry_bodies(again: jax.Array, after: State, starts: State) -> jax.Array | None:
    """Return the bodies (n,) of the episodes that begin; None without a bank of them."""
    before, fresh = (getattr(x.pipeline_state, "body", None) for x in (after, starts))
    return None if before is None or fresh is None else jnp.where(again, before, fresh)


def retry_conditions(again: jax.Array, after: State, starts: State) -> Any:
    """Return the conditions of `starts`, of the rows `again` those of the episode that fell."""
    before, fresh = after.pipeline_state.conditions, starts.pipeline_state.conditions
    if fresh is None:
        return None
    return select_rows(again, before._replace(targets=fresh.targets, key=fresh.key), fresh)


class NanStep(NamedTuple):
    """The first step of an iteration after which numbers were not finite, for replay."""

    flag: jax.Array  # () float32, more than 0 if there was one; else the rest means nothing
    before: Any  # the environment's `pipeline_state` before the step
    action: jax.Array  # (12,) of the step


def compute_metrics(after: State, training_envs: int) -> Metrics:
    """Return means and counts of a step, of the training and of the evaluation environments."""
    return {
        "reward": jnp.mean(after.reward[:training_envs]),
        **{name: jnp.mean(value[:training_envs]) for name, value in after.metrics.items()},
        **{
            f"eval/{name}": jnp.mean(after.metrics[name][training_envs:])
            for name in ("speed", "velocity_error", "standing")
            if name in after.metrics
        },
        "count/ended": jnp.sum(after.done[:training_envs]),
        "count/fell": jnp.sum(after.metrics["fell"][:training_envs]),
        "count/nan": jnp.sum(after.metrics["nan"]),
        "eval/count/ended": jnp.sum(after.done[training_envs:]),
        "eval/count/fell": jnp.sum(after.metrics["fell"][training_envs:]),
    }


def reduce_metrics(metrics: Metrics, nan_step: NanStep, axis: str) -> Metrics:
    """Return `metrics` (unroll,) over all steps and devices, and the first `NanStep` of any."""
    nan_steps = jax.lax.all_gather(nan_step, axis)
    counts = {name: jnp.sum(value) for name, value in metrics.items() if "count/" in name}
    means = {name: jnp.mean(value) for name, value in metrics.items() if name not in counts}
    return {
        **jax.lax.psum(counts, axis),
        **jax.lax.pmean(means, axis),
        "nan_step": jax.tree.map(lambda x: x[jnp.argmax(nan_steps.flag > 0)], nan_steps),
    }


def find_first_nan(earlier: NanStep, nan: jax.Array, before: State, action: jax.Array) -> NanStep:
    """Return `earlier` if it was found, else the first environment of a step with `nan` (n,)."""
    index = jnp.argmax(nan)
    step = jax.tree.map(lambda x: x[index], (before.pipeline_state, action))
    nan_step = NanStep(nan[index], *step)
    return jax.tree.map(lambda old, new: jnp.where(earlier.flag > 0, old, new), earlier, nan_step)
