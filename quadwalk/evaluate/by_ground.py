"""How well a policy gets over every kind of ground at several difficulties, none seen in training.

Every kind and difficulty is a cell of its own: episodes begin on its tiles and end at their edges.
Where velocities are commanded, the command is to go straight ahead at `PACE`.
"""

import dataclasses
import math
from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State

from quadwalk.evaluate.loaded import LoadedRun
from quadwalk.evaluate.simulate import CHUNK, ROOM, Policy, Report, over_devices
from quadwalk.evaluate.summary import (
    SETTLING,
    WINDOW,
    mean_figure,
    share_interval,
    velocity_of,
    window_means,
)
from quadwalk.ground.terrain import FILE, Terrain
from quadwalk.task.env import QuadrupedEnv
from quadwalk.task.state import chosen
from quadwalk.train.robot import load_robot

PACE = 0.7  # m/s
# Episodes at a time: about an eighth of all, since what has ended at the end is stepped on until
# the last has; in multiples of `ROOM`, and not more than this.
MOST = 2048
ROWS, LEAST_ROWS = 32, 4  # of tiles, shared out to the kinds: no two of a cell are alike


class Episode(NamedTuple):
    """How an episode went."""

    upright: bool  # without a fall
    arrived: bool  # at its tile's edge
    speed: float  # ahead, or without commands along world x, m/s
    error: float  # of the velocity, m/s; NaN where it was too short


def measure_by_ground(
    loaded: LoadedRun, levels: int, episodes: int, seed: int, report: Report | None = None
) -> dict[str, Any]:
    """Success, speed and error of `episodes` in each cell, as plain values for JSON.

    `levels` difficulties, evenly from the least to the greatest that were trained on. success: the
    share that, without a fall, comes to the tile's edge or the time limit. arrived: the share that
    comes to the edge. speed: mean over an episode, ahead, m/s; without commands along world x.
    velocity_error: as `tracking_errors` has it, m/s; None without commands, or where no episode
    lasted long enough.
    """
    ground = loaded.env.config.ground
    kinds = (FILE,) if ground.file is not None else ground.kinds
    env = ground_env(loaded, kinds, levels)
    assert env.terrain is not None
    difficulties = list(dict.fromkeys(tile.difficulty for tile in env.terrain.tiles))
    told = env.config.command.given
    pairs = list(product(kinds, difficulties))
    tiles = np.concatenate([_tiles(env.terrain, *pair, episodes) for pair in pairs])
    found = dict(_simulate(env, loaded.policy.act, tiles, seed, report))
    cells = [
        {"kind": kind, "difficulty": difficulty}
        | _figures([found[cell * episodes + k] for k in range(episodes)], told)
        for cell, (kind, difficulty) in enumerate(pairs)
    ]
    return {
        "kinds": list(kinds),
        "difficulties": difficulties,
        "episodes": episodes,
        "command": PACE if told else None,
        "cells": cells,
    }


def ground_env(loaded: LoadedRun, kinds: tuple[str, ...], levels: int) -> QuadrupedEnv:
    """The environment of the cells of `kinds`: tiles of each, and episodes confined to them."""
    config = loaded.env.config
    ground, command = config.ground, config.command
    if ground.file is None:
        rows = tuple(kind for kind in kinds for _ in range(max(ROWS // len(kinds), LEAST_ROWS)))
        ground = dataclasses.replace(ground, kinds=rows, levels=levels)
    if command.given:
        command = dataclasses.replace(
            command, forward=(PACE, PACE), lateral=(0.0, 0.0), yaw_rate=(0.0, 0.0), standing=0.0
        )
    config = dataclasses.replace(
        config, ground=dataclasses.replace(ground, confined=True), command=command
    )
    # The run's own robot stands on its ground already.
    quadruped = load_robot(loaded.policy.config.robot)
    return QuadrupedEnv(quadruped, config, loaded.env.engine)


def _tiles(terrain: Terrain, kind: str, difficulty: float, episodes: int) -> np.ndarray:
    """(episodes,) the tiles of a cell, in turn."""
    own = [(tile.kind, tile.difficulty) == (kind, difficulty) for tile in terrain.tiles]
    return np.resize(np.flatnonzero(own).astype(np.int32), episodes)


def _simulate(
    env: QuadrupedEnv, policy: Policy, tiles: np.ndarray, seed: int, report: Report | None
) -> Iterator[tuple[int, Episode]]:
    """The episodes on `tiles` (n,), each with its number, in the order in which they end.

    So many at a time as there is room for; one that has ended makes room for the next. An episode
    is the same in any company.
    """

    @env.jit
    def chunk(policy: Policy, states: State) -> tuple[State, tuple[jax.Array, jax.Array]]:
        def step(states: State, _: None) -> tuple[State, tuple[jax.Array, jax.Array]]:
            states = jax.vmap(env.step)(states, policy(states.obs))
            return states, (states.info["end"], states.pipeline_state.qpos[:, :7])

        return jax.lax.scan(step, states, None, length=CHUNK)

    begin, renew = env.jit(jax.vmap(env.reset)), env.jit(chosen)
    count = len(tiles)
    keys = np.asarray(jax.random.split(jax.random.PRNGKey(seed), count))
    room = min(ROOM * math.ceil(count / (8 * ROOM)), MOST, count)
    own = np.arange(room)  # the episode in each row of the batch; `count`: none
    waiting, ended, new, states = len(own), 0, own < count, None
    poses: dict[int, list[np.ndarray]] = {}
    while np.any(own < count):
        if new.any():
            # Of all rows, for one program: what is not asked for is left out.
            which = np.minimum(own, count - 1)
            fresh = over_devices(env, begin(keys[which], jnp.asarray(tiles[which])))
            states = fresh if states is None else renew(new, fresh, states)
            start = np.asarray(fresh.pipeline_state.qpos[:, :7])
            poses |= {own[row]: [start[None, row]] for row in np.flatnonzero(new)}
        states, frames = chunk(policy, states)
        ends, after = jax.device_get(frames)
        over = (ends > 0).any(axis=0)
        last = np.where(over, np.argmax(ends > 0, axis=0), CHUNK - 1)
        for row in np.flatnonzero(own < count):
            poses[own[row]].append(after[: last[row] + 1, row])
            if over[row]:
                path = np.concatenate(poses.pop(own[row]))
                yield int(own[row]), _episode(env, env.ends[ends[last[row], row]], path)
        free = np.flatnonzero(over & (own < count))
        own[free] = np.minimum(waiting + np.arange(len(free)), count)
        waiting += len(free)
        new = np.isin(np.arange(len(own)), free) & (own < count)
        ended += len(free)
        if report is not None:  # as if all went on at once
            report(round(env.config.episode_steps * ended / count))


def _episode(env: QuadrupedEnv, end: str, poses: np.ndarray) -> Episode:
    """One that ended so, from the trunk's poses (steps + 1, 7), m and wxyz."""
    upright, dt = end == "time limit", env.config.control_dt
    velocity = _velocity(poses, dt, env.config.command.given)
    return Episode(
        upright,
        upright and len(velocity) < env.config.episode_steps,
        float(velocity[:, 0].mean()),
        _velocity_error(velocity, dt),
    )


def _figures(episodes: list[Episode], told: bool) -> dict[str, Any]:
    """The figures of one cell; `told` if there are commands."""
    upright, arrived, speeds, errors = zip(*episodes, strict=True)
    return {
        "success": sum(upright) / len(episodes),
        "success_ci95": list(share_interval(sum(upright), len(episodes))),
        "arrived": sum(arrived) / len(episodes),
        "speed": mean_figure(speeds),
        "velocity_error": mean_figure(errors) if told else None,
    }


def _velocity(poses: np.ndarray, dt: float, heading: bool) -> np.ndarray:
    """(T, 2) m/s in each step between `poses` (T + 1, 7): along x and y, or ahead and left."""
    poses = poses.astype(float)
    along: np.ndarray = np.diff(poses[:, :2], axis=0) / dt
    return velocity_of(poses, dt)[:, :2] if heading else along


def _velocity_error(velocity: np.ndarray, dt: float) -> float:
    """m/s: how far means over a `WINDOW` are from the command; NaN where it is too short."""
    settling, window = (round(s / dt) for s in (SETTLING, WINDOW))
    judged = velocity[settling:] - [PACE, 0.0]
    if len(judged) < window:
        return math.nan
    return float(np.linalg.norm(window_means(judged, window), axis=1).mean())
