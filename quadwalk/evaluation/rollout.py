"""Rollouts: episodes of a policy in any engine, stepped as training steps them, as plain arrays.

An environment differs from that of training in its engine alone. MJX and the engine trained in
step the training model: spheres against the floor only, a fast solver. MuJoCo C steps the full
model: every collision shape, 2 ms steps, a converged solver. So one engine checks the other.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.brax import State
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.randomization import EpisodeRandomization
from quadwalk.env.state import EnvState, select_rows

# Observations (..., n) to actions (..., 12); a pytree (`jax.tree_util.Partial`), so that it can be
# an argument of what is compiled: once for all policies of one shape.
ActionFunction = Callable[[jax.Array], jax.Array]
# The environment, batched states before and after a control step with actions (n, 12), to what is
# recorded of it: a pytree of arrays (n, ...).
Recorder = Callable[[QuadrupedEnv, State, jax.Array, State], Any]
Command = tuple[float, float, float]  # forward and lateral m/s, yaw rate rad/s
Report = Callable[[int], None]  # receives the mean number of control steps done of each episode

CHUNK = 50  # control steps between looks at which episodes have ended
GROUP = 512  # recorded episodes at a time, at most: those of 20 s take 0.8 GB of memory
ROOM = 64  # many episodes go in multiples of this, which devices can share


@dataclass(frozen=True)
class Rollout:
    """One episode of T control steps on a quadruped with 12 joints.

    Row k of a (T, ...) array belongs to control step k; rows of the (T + 1, ...) arrays are the
    states before the first step and after each step. Joint columns are in the order of
    `Quadruped.joints`, foot columns in the order of `Quadruped.feet`. World frame: z up, x ahead.
    """

    control_dt: float  # s, one control step
    seed: int
    episode: int  # index of this episode in its evaluation
    end: str  # "time limit", or why it fell: "tipped", "low", "touched" (body on floor), "nan"
    qpos: np.ndarray  # (T + 1, 19) world position m, quaternion wxyz, joint positions rad
    qvel: np.ndarray  # (T + 1, 18) world linear m/s, body angular rad/s, joint rad/s
    action: np.ndarray  # (T, 12) in [-1, 1]
    target: np.ndarray  # (T, 12) joint position targets, rad
    torque: np.ndarray  # (T, 12) mean over the control step, Nm
    energy: np.ndarray  # (T,) mechanical energy spent in the step, sum of max(tau * qd, 0) dt, J
    observation: np.ndarray  # (T, n) the policy's observation before the step
    observation_names: tuple[str, ...]  # n names
    contact: np.ndarray  # (T, 4) bool, foot on the ground at the end of the step
    reward_terms: dict[str, np.ndarray]  # name -> (T,) raw terms, before scales
    reward: np.ndarray  # (T,) scaled total
    # (T, 3) the velocity command of the step: forward and lateral velocity in the frame of the
    # heading, m/s, lateral to the left, and yaw rate, rad/s; None where it ran along x
    command: np.ndarray | None = None
    # (T, 4) the floor's push along its normal, N; None until `add_foot_forces` adds it
    foot_force: np.ndarray | None = None
    # the episode's, of NumPy arrays; None in an ideal world, as are the next two
    conditions: EpisodeRandomization | None = None
    # (T, 12) the joint position targets that the motors obeyed at the end of the step, rad
    applied_target: np.ndarray | None = None
    # (T, m) what the first m numbers of `observation` would be without delay, noise and offsets
    truth: np.ndarray | None = None

    @property
    def steps(self) -> int:
        """Number of control steps, T."""
        return len(self.action)

    @property
    def time(self) -> np.ndarray:
        """Simulated time of each state, (T + 1,) s."""
        return np.arange(self.steps + 1) * self.control_dt

    @property
    def fell(self) -> bool:
        """True if the episode ended before its time limit, by a fall."""
        return self.end != "time limit"


def slice_steps(rollout: Rollout, start: int, stop: int | None = None) -> Rollout:
    """Return the control steps `start` to `stop` - 1, by default to the end, with their states.

    If the episode is shorter, there are fewer.
    """
    start, stop, _ = slice(start, stop).indices(rollout.steps)
    stops = {
        field.name: stop + (field.name in ("qpos", "qvel"))
        for field in fields(rollout)
        if isinstance(getattr(rollout, field.name), np.ndarray)
    }
    return replace(
        rollout,
        **{name: getattr(rollout, name)[start:end] for name, end in stops.items()},
        reward_terms={name: term[start:stop] for name, term in rollout.reward_terms.items()},
    )


def reset_episodes(
    env: QuadrupedEnv, episodes: int, seed: int, tiles: np.ndarray | None = None
) -> State:
    """Return the first states of `episodes` episodes, in a batch, the same for the same seed.

    `tiles` (episodes,) are the indices of the terrain's tiles on which they begin; None: any.
    """
    keys = jax.random.split(jax.random.PRNGKey(seed), episodes)
    tile_arguments = () if tiles is None else (jnp.asarray(tiles),)
    reset = jax.jit(lambda env, *rows: jax.vmap(env.reset)(*rows))
    states: State = reset(env, keys, *tile_arguments)
    return states


def reset_cells(
    env: QuadrupedEnv, reset: Callable[..., State], cells: np.ndarray, *episodes: Any
) -> State:
    """Return the first states (m * n, ...) of n episodes in each of `cells` (m, ...), cell by cell.

    Each is `reset(env, cell, *episode)`, where `episode` has a row of each array of `episodes`, (n,
    ...).
    """

    @jax.jit
    def reset_all(env: QuadrupedEnv, cells: jax.Array, *episodes: Any) -> State:
        over_episodes = jax.vmap(partial(reset, env), in_axes=(None, *(0 for _ in episodes)))
        over_cells = jax.vmap(over_episodes, in_axes=(0, *(None for _ in episodes)))
        return over_cells(cells, *episodes)

    states = reset_all(env, jnp.asarray(cells), *episodes)
    flat: State = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), states)
    return flat


def reset_with_commands(
    env: QuadrupedEnv, commands: list[Command], episodes: int, seed: int
) -> State:
    """Return the same first states of `episodes` with each command, one command after another.

    A command is forward and lateral velocity, m/s, and yaw rate, rad/s.
    """

    def reset(env: QuadrupedEnv, velocity: jax.Array, state: State) -> State:
        command = state.pipeline_state.command._replace(velocity=velocity)
        return env.start_episode(state, command=command)

    starts = reset_episodes(env, episodes, seed)
    return reset_cells(env, reset, np.array(commands, np.float32), starts)


def roll_out(
    env: QuadrupedEnv,
    policy: ActionFunction,
    starts: State,
    record: Recorder,
    room: int | None = None,
    report: Report | None = None,
    change: Callable[[QuadrupedEnv, State], State] = lambda _, states: states,
) -> Iterator[tuple[int, str, Any]]:
    """Step `policy` from each of `starts` (n, ...) until its episode ends.

    Yields for each episode, when it ends, its number, the name of its end, and the values that
    `record` returned in its T control steps, as NumPy arrays (T, ...). At most `room` episodes run
    at a time, by default all; where one has ended the next begins. `change` alters the batched
    states before each step.
    """

    @jax.jit
    def step_chunk(env: QuadrupedEnv, policy: ActionFunction, states: State) -> tuple[State, Any]:
        def step(before: State, _: None) -> tuple[State, tuple[jax.Array, Any]]:
            action = policy(before.obs)
            before = change(env, before)
            after = jax.vmap(env.step)(before, action)
            return after, (after.info["end"], record(env, before, action, after))

        return jax.lax.scan(step, states, None, length=CHUNK)

    def take_starts(numbers: np.ndarray) -> State:
        # A row without an episode goes from a start as well, for one program of one size.
        states: State = share_over_devices(env, _take(starts, np.minimum(numbers, count - 1)))
        return states

    renew = jax.jit(select_rows)
    count, longest = len(starts.obs), env.config.episode_steps
    # The number of the episode in each row of the batch; `count` and more: none.
    numbers = np.arange(room or count)
    waiting = iter(range(len(numbers), count))
    states, step_counts = take_starts(numbers), np.zeros(count)
    records: defaultdict[int, list[Any]] = defaultdict(list)
    while np.any(numbers < count):
        states, outputs = step_chunk(env, policy, states)
        ends, parts = jax.device_get(outputs)
        is_over = (ends > 0).any(axis=0)
        steps = np.where(is_over, np.argmax(ends > 0, axis=0) + 1, CHUNK)
        is_new = np.zeros(len(numbers), bool)
        for row in np.flatnonzero(numbers < count):
            number, last = int(numbers[row]), steps[row]
            records[number].append(_take(parts, (slice(last), row)))
            step_counts[number] = longest if is_over[row] else step_counts[number] + last
            if is_over[row]:
                episode = jax.tree.map(lambda *x: np.concatenate(x), *records.pop(number))
                yield number, env.ends[ends[last - 1, row]], episode
                numbers[row] = next(waiting, count)
                is_new[row] = numbers[row] < count
        if report is not None:
            report(round(step_counts.mean()))
        if is_new.any():
            states = renew(is_new, take_starts(numbers), states)


def roll_out_paths(
    env: QuadrupedEnv, policy: ActionFunction, starts: State, *options: Any, **named_options: Any
) -> Iterator[tuple[int, bool, np.ndarray]]:
    """Step episodes with the arguments of `roll_out`, and keep only the trunk's path.

    Yields for each episode, when it ends, its number, True if it did not end by a fall, and the
    trunk's poses (T + 1, 7), m and wxyz.
    """

    def record_pose(env: QuadrupedEnv, before: State, action: jax.Array, after: State) -> jax.Array:
        pose: jax.Array = after.pipeline_state.qpos[:, :7]
        return pose

    first = np.asarray(starts.pipeline_state.qpos[:, :7])
    for number, end, path in roll_out(env, policy, starts, record_pose, *options, **named_options):
        poses = np.concatenate([first[number, None], path])
        yield number, end == "time limit", poses.astype(float)


def share_over_devices(env: QuadrupedEnv, batch: Any) -> Any:
    """Return `batch`, whose arrays (episodes, ...) are then divided between the devices.

    Episodes do not depend on each other, so the compiler can give each device its share of them.
    MuJoCo C has threads of its own, and needs none of this.
    """
    devices = jax.devices()
    if env.engine == "mujoco" or len(jax.tree.leaves(batch)[0]) % len(devices):
        return batch
    mesh = jax.sharding.Mesh(np.array(devices), ("episodes",))
    spec = jax.sharding.PartitionSpec("episodes")
    return jax.device_put(batch, jax.sharding.NamedSharding(mesh, spec))


def simulate_episodes(
    env: QuadrupedEnv,
    policy: ActionFunction,
    episodes: int,
    seed: int,
    report: Report | None = None,
    only: int | None = None,
    starts: State | None = None,
) -> Iterator[Rollout]:
    """Roll `policy` out from `episodes` starts and yield each episode, in order of their numbers.

    `starts` (episodes, ...) are by default `reset_episodes` of `seed`. With `only`, just the
    episode of this number is simulated. At most `GROUP` are in memory, if the caller keeps none.
    They have no foot forces: `add_foot_forces` adds them. `report` is called with the number of
    control steps done.
    """
    starts = reset_episodes(env, episodes, seed) if starts is None else starts
    # In a batch of the same size it goes as it went.
    room = min(ROOM * math.ceil(episodes / math.ceil(episodes / GROUP) / ROOM), episodes)
    first = only or 0
    if only is not None:
        starts = _take(starts, slice(only, only + 1))
    initial = jax.device_get(starts.pipeline_state)
    finished: dict[int, Rollout] = {}
    following = 0
    for k, end, steps in roll_out(env, policy, starts, _record_step, room, report):
        states = {
            name: np.concatenate([getattr(initial, name)[k, None], steps[name]]).astype(float)
            for name in ("qpos", "qvel")
        }
        finished[k] = Rollout(
            control_dt=env.config.control_dt,
            seed=seed,
            episode=first + k,
            end=end,
            observation_names=env.sensors.names,
            conditions=_take(initial.conditions, k),
            **{**steps, **states},
        )
        while following in finished:
            yield finished.pop(following)
            following += 1


def _record_step(
    env: QuadrupedEnv, before: State, action: jax.Array, after: State
) -> dict[str, Any]:
    """Return the fields of a `Rollout` for one control step, by name."""
    start: EnvState = before.pipeline_state
    state: EnvState = after.pipeline_state
    ideal = start.conditions is None

    def compute_applied_target(state: EnvState, action: jax.Array) -> jax.Array:
        targets: jax.Array = env.apply_action(state, action)[3]
        return targets[-1]

    return {
        "observation": before.obs[..., : len(env.sensors.names)],
        "action": action,
        "target": jax.vmap(partial(env.config.action, env.robot))(action, start.qpos[:, 7:]),
        "qpos": state.qpos,
        "qvel": state.qvel,
        **{name: after.info[name] for name in ("torque", "energy", "contact")},
        "reward": after.reward,
        "reward_terms": {
            name.removeprefix("reward/"): value
            for name, value in after.metrics.items()
            if name.startswith("reward/")
        },
        "command": None if start.command is None else start.command.velocity,
        "applied_target": None if ideal else jax.vmap(compute_applied_target)(start, action),
        "truth": None if ideal else jax.vmap(partial(env.sensors.compute_truth, env.robot))(start),
    }


def _take(tree: Any, rows: Any) -> Any:
    """Return all arrays of a pytree indexed with `rows` along their first axis."""
    return jax.tree.map(lambda x: x[rows], tree)
