"""Fresh episodes in the place of those that end: where, under which conditions, worth what."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from quadwalk.brax import Env, State
from quadwalk.env.state import tree_where
from quadwalk.settings.training import PPOConfig

SOME = 16  # fresh episodes that are begun at once: of a thousand robots, few end in a step


def reset_envs(env: Env, keys: jax.Array, tiles: jax.Array | None = None) -> State:
    """A batch of fresh episodes of `keys` (n, 2), on `tiles` (n,) of the terrain; None: any.

    Each starts at a random step: else all would reach their time limit in the same iteration.
    """
    state = jax.vmap(env.reset)(*([keys] if tiles is None else [keys, tiles]))
    phase = jax.vmap(lambda key: jax.random.randint(key, (), 0, env.config.episode_steps))(keys)
    return jax.vmap(env.begun)(state, steps=phase)


class FreshStarts(NamedTuple):
    """The environments before an iteration, and the episodes that may begin in it."""

    envs: State  # (n, ...), in the first iteration of all at fresh starts
    fresh: State  # (n, ...) each environment's own, or (2 n, ...) those of all, twice over
    own: bool

    def of_step(self, number: jax.Array) -> State:
        """A start for each environment (n, ...) in step `number` of the iteration."""
        if self.own:
            return self.fresh
        envs = len(self.envs.done)
        first_row = envs - 1 - number % envs
        return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, first_row, envs), self.fresh)


def fresh_starts(
    env: Env, envs: State, first: jax.Array, learnt_from: int, key: jax.Array
) -> FreshStarts:
    """As many starts as there are environments.

    With a curriculum each environment has its own; otherwise they are dealt out anew.
    """
    number = len(envs.done)
    tiles = next_tiles(env, envs.pipeline_state, first, learnt_from, key)
    fresh = reset_envs(env, jax.random.split(key, number), tiles)
    begun = jax.tree.map(lambda new, old: jnp.where(first, new, old), fresh, envs)
    if tiles is None:  # once over, of which a step takes a part: `jnp.roll` would do it in each
        fresh = jax.tree.map(lambda x: jnp.concatenate([x, x]), fresh)
    return FreshStarts(begun, fresh, own=tiles is not None)


def next_tiles(
    env: Env, state: Any, first: jax.Array, learnt_from: int, key: jax.Array
) -> jax.Array | None:
    """Where the next episode of each environment is to be, (n,) tiles; None without a curriculum.

    Episodes that end in this iteration count at its start. The environments that
    evaluate meet all tiles alike.
    """
    if env.curriculum is None:
        return None
    envs, (key_first, key_next, key_even) = len(state.tile), jax.random.split(key, 3)
    following = jax.vmap(env.curriculum.following)(
        state.tile, state.travel, state.qpos, state.steps, jax.random.split(key_next, envs)
    )
    learning = jnp.where(first, env.curriculum.first(envs, key_first), following)
    evenly = env.curriculum.evenly(envs, key_even)
    return jnp.where(jnp.arange(envs) < learnt_from, learning, evenly)


def start_anew(
    env: Env,
    config: PPOConfig,
    expected: Callable[[jax.Array], jax.Array],
    after: State,
    start: State,
    learnt_from: int,
    key: jax.Array,
) -> tuple[jax.Array, State]:
    """Rewards (n,) to learn from, and `after` with finished episodes replaced by `start`.

    A time-out does not count as a failure: what the value network expects after it is
    added to its reward, and the step then ends the episode, which equals bootstrapping through the
    limit (Pardo et al. 2018, arXiv:1712.00378). `expected` gives the values of observations.
    """
    # Only after a fall at a random step: those that fell together must not end together.
    late = start.pipeline_state.steps * after.metrics["fell"].astype(jnp.int32)
    changes = {"steps": late}
    if config.retry:
        changes["conditions"] = retried(config.retry, after, start, learnt_from, key)
    start = start.replace(pipeline_state=start.pipeline_state._replace(**changes))
    envs, ended = len(after.done), jnp.sum(after.done > 0)
    rows = jnp.flatnonzero(after.done > 0, size=envs + SOME, fill_value=envs)
    truncation = config.discount * after.info["truncation"]

    def some(carry: tuple[Any, jax.Array]) -> tuple[Any, jax.Array]:
        (reward, state, obs), done = carry
        own = jax.lax.dynamic_slice_in_dim(rows, done, SOME)
        beyond = truncation[own] * expected(after.obs[own])
        # Seen as it really starts. For all rows that would take a twentieth of a training step.
        begun = jax.vmap(env.begun)(jax.tree.map(lambda x: x[own], start))
        new = begun.pipeline_state, begun.obs
        state, obs = jax.tree.map(
            lambda old, new: old.at[own].set(new, mode="drop"), (state, obs), new
        )
        return (reward.at[own].add(beyond, mode="drop"), state, obs), done + SOME

    old = config.reward_scale * after.reward, after.pipeline_state, after.obs
    (reward, state, obs), _ = jax.lax.while_loop(
        lambda carry: carry[1] < ended, some, (old, jnp.zeros((), jnp.int32))
    )
    return reward, after.replace(pipeline_state=state, obs=obs)


def retried(share: float, after: State, start: State, learnt_from: int, key: jax.Array) -> Any:
    """Return the conditions of `start`; after that share of falls, those of the one that fell.

    As prioritized level replay does (Jiang et al. 2021, arXiv:2010.03934), by falls alone. The
    environments that evaluate, from number `learnt_from` on, meet what is drawn.
    """
    fallen, fresh = after.pipeline_state.conditions, start.pipeline_state.conditions
    if fresh is None:
        return None
    again = jax.random.bernoulli(key, share, after.done.shape) & (after.metrics["fell"] > 0)
    again &= jnp.arange(len(after.done)) < learnt_from
    return tree_where(again, fallen._replace(targets=fresh.targets, key=fresh.key), fresh)
