"""Episodes of a policy, stepped as training steps them, in any engine: one checks the other.

An environment differs from that of training in its engine alone. MJX and the engine trained in
step the training model: spheres against the floor only, a fast solver. MuJoCo C steps the full
model: every collision shape, 2 ms steps, a converged solver.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.brax import State
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.state import EnvState, tree_where
from quadwalk.evaluation.rollout import Rollout

# Observations (..., n) to actions (..., 12); a pytree (`jax.tree_util.Partial`), so that it can be
# an argument of what is compiled: once for all policies of one shape.
Policy = Callable[[jax.Array], jax.Array]
# The environment, batched states before and after a control step with actions (n, 12), to what is
# kept of it: a pytree of arrays (n, ...).
Watch = Callable[[QuadrupedEnv, State, jax.Array, State], Any]
Report = Callable[[int], None]  # is given the mean number of control steps done of each episode

CHUNK = 50  # control steps between looks at which episodes have ended
GROUP = 512  # recorded episodes at a time, at most: those of 20 s take 0.8 GB of memory
ROOM = 64  # many episodes go in multiples of this, which devices can share


def roll_out(
    env: QuadrupedEnv,
    policy: Policy,
    starts: State,
    watch: Watch,
    room: int | None = None,
    report: Report | None = None,
    change: Callable[[QuadrupedEnv, State], State] = lambda _, states: states,
) -> Iterator[tuple[int, str, Any]]:
    """Step `policy` from each of `starts` (n, ...) until its episode ends.

    Yields for each episode, when it ends, its number, the name of its end, and what `watch` kept
    of its T control steps: NumPy arrays (T, ...). `room` episodes go at a time, by default all;
    where one has ended the next begins. `change` alters the batched states before each step.
    """

    @jax.jit
    def chunk(env: QuadrupedEnv, policy: Policy, states: State) -> tuple[State, Any]:
        def step(before: State, _: None) -> tuple[State, tuple[jax.Array, Any]]:
            action = policy(before.obs)
            before = change(env, before)
            after = jax.vmap(env.step)(before, action)
            return after, (after.info["end"], watch(env, before, action, after))

        return jax.lax.scan(step, states, None, length=CHUNK)

    def begun(numbers: np.ndarray) -> State:
        # A row without an episode goes from a start as well, for one program of one size.
        which = np.minimum(numbers, count - 1)
        own: State = over_devices(env, _rows(starts, which))
        return own

    renew = jax.jit(tree_where)
    count, longest = len(starts.obs), env.config.episode_steps
    rows = np.arange(room or count)  # the number of the episode in each; `count` and more: none
    following = iter(range(len(rows), count))
    states, done = begun(rows), np.zeros(count)
    kept: defaultdict[int, list[Any]] = defaultdict(list)
    while np.any(rows < count):
        states, watched = chunk(env, policy, states)
        ends, parts = jax.device_get(watched)
        over = (ends > 0).any(axis=0)
        steps = np.where(over, np.argmax(ends > 0, axis=0) + 1, CHUNK)
        new = np.zeros(len(rows), bool)
        for row in np.flatnonzero(rows < count):
            number, own = int(rows[row]), steps[row]
            kept[number].append(_rows(parts, (slice(own), row)))
            done[number] = longest if over[row] else done[number] + own
            if over[row]:
                whole = jax.tree.map(lambda *x: np.concatenate(x), *kept.pop(number))
                yield number, env.ends[ends[own - 1, row]], whole
                rows[row] = next(following, count)
                new[row] = rows[row] < count
        if report is not None:
            report(round(done.mean()))
        if new.any():
            states = renew(new, begun(rows), states)


def _rows(tree: Any, rows: Any) -> Any:
    """The `rows` of all arrays of a pytree."""
    return jax.tree.map(lambda x: x[rows], tree)


def fresh_starts(
    env: QuadrupedEnv, episodes: int, seed: int, tiles: np.ndarray | None = None
) -> State:
    """The batched `State` of `episodes` fresh episodes, the same for the same seed.

    `tiles` (episodes,) are the indices of the terrain's tiles that they begin on; None: any.
    """
    keys = jax.random.split(jax.random.PRNGKey(seed), episodes)
    on = () if tiles is None else (jnp.asarray(tiles),)
    start: State = jax.jit(lambda env, *of: jax.vmap(env.reset)(*of))(env, keys, *on)
    return start


def over_devices(env: QuadrupedEnv, batch: Any) -> Any:
    """`batch`, whose arrays begin with the axis of episodes, shared out between the devices.

    Episodes do not meet, so the compiler can give each device its share of them. MuJoCo C has
    threads of its own.
    """
    devices = jax.devices()
    if env.engine == "mujoco" or len(jax.tree.leaves(batch)[0]) % len(devices):
        return batch
    mesh = jax.sharding.Mesh(np.array(devices), ("episodes",))
    spec = jax.sharding.PartitionSpec("episodes")
    return jax.device_put(batch, jax.sharding.NamedSharding(mesh, spec))


def simulate_episodes(
    env: QuadrupedEnv,
    policy: Policy,
    episodes: int,
    seed: int,
    report: Report | None = None,
    only: int | None = None,
    starts: State | None = None,
) -> Iterator[Rollout]:
    """Record `policy` from `episodes` starts, until each ends, in order of their numbers.

    `starts` (episodes, ...) are by default the fresh ones of `seed`; `only` is the number of one.
    At most `GROUP` are in memory, if rollouts are let go. None has its foot forces.
    """
    starts = fresh_starts(env, episodes, seed) if starts is None else starts
    # In a batch of the same size it goes as it went.
    room = min(ROOM * math.ceil(episodes / math.ceil(episodes / GROUP) / ROOM), episodes)
    first = only or 0
    if only is not None:
        starts = _rows(starts, slice(only, only + 1))
    initial = jax.device_get(starts.pipeline_state)
    ended: dict[int, Rollout] = {}
    following = 0
    for k, end, steps in roll_out(env, policy, starts, _recorded, room, report):
        states = {
            name: np.concatenate([getattr(initial, name)[k, None], steps[name]]).astype(float)
            for name in ("qpos", "qvel")
        }
        ended[k] = Rollout(
            control_dt=env.config.control_dt,
            seed=seed,
            episode=first + k,
            end=end,
            observation_names=env.sensors.names,
            conditions=_rows(initial.conditions, k),
            **{**steps, **states},
        )
        while following in ended:
            yield ended.pop(following)
            following += 1


def _recorded(env: QuadrupedEnv, before: State, action: jax.Array, after: State) -> dict[str, Any]:
    """What a `Rollout` keeps of a control step, by the names of its fields."""
    begun: EnvState = before.pipeline_state
    state: EnvState = after.pipeline_state
    ideal = begun.conditions is None
    return {
        "observation": before.obs[..., : len(env.sensors.names)],
        "action": action,
        "target": jax.vmap(partial(env.config.action, env.robot))(action, begun.qpos[:, 7:]),
        "qpos": state.qpos,
        "qvel": state.qvel,
        **{name: after.info[name] for name in ("torque", "energy", "contact")},
        "reward": after.reward,
        "reward_terms": {
            name.removeprefix("reward/"): value
            for name, value in after.metrics.items()
            if name.startswith("reward/")
        },
        "command": None if begun.command is None else begun.command.velocity,
        "applied_target": None if ideal else jax.vmap(env.applied_target)(begun, action),
        "truth": None if ideal else jax.vmap(partial(env.sensors.compute_truth, env.robot))(begun),
    }
