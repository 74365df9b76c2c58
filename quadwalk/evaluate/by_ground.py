"""How well a policy gets over every kind of ground at several difficulties, none seen in training.

Every kind and difficulty is a cell of its own: episodes begin on its tiles and end at their edges.
Where velocities are commanded, the command is to go straight ahead at `PACE`.
"""

import dataclasses
import math
from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import quadwalk.physics.mjx  # noqa: F401  # before Brax, which imports MJX less quietly

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import State

from quadwalk.evaluate.simulate import CHUNK, Policy, Report, over_devices, until_all_ended
from quadwalk.evaluate.subject import Subject
from quadwalk.evaluate.summary import (
    SETTLING,
    WINDOW,
    mean_figure,
    share_interval,
    velocity_of,
    window_means,
)
from quadwalk.ground.terrain import FILE
from quadwalk.physics.mujoco_c import MujocoModel
from quadwalk.task.env import QuadrupedEnv
from quadwalk.train.robot import load_run_robot

PACE = 0.7  # m/s
FIELDS_MEMORY = 2**29  # bytes of fields at a time
ROWS = 4  # tiles of each cell, of which no two are alike


class Outcome(NamedTuple):
    """Control steps of a batch of episodes."""

    end: Any  # (steps, episodes) index into `QuadrupedEnv.ends`
    pose: Any  # (steps, episodes, 7) the trunk's after the step, m and wxyz


def measure_by_ground(
    subject: Subject, levels: int, episodes: int, seed: int, report: Report | None = None
) -> dict[str, Any]:
    """Success, speed and error of `episodes` in each cell, as plain values for JSON.

    `levels` difficulties, evenly from the least to the greatest that were trained on. success: the
    share that, without a fall, comes to the tile's edge or the time limit. arrived: the share that
    comes to the edge. speed: mean over an episode, ahead, m/s; without commands along world x.
    velocity_error: as `tracking_errors` has it, m/s; None without commands, or where no episode
    lasted long enough.
    """
    ground = subject.env.config.ground
    kinds = (FILE,) if ground.file is not None else tuple(dict.fromkeys(ground.kinds))
    # Where each episode has a field of its own, small ones: of a kind at a time.
    parts = [(kind,) for kind in kinds] if _has_own_fields(subject.env) else [kinds]
    cells = [
        cell
        for part in parts
        for cell in _measure_kinds(subject, part, levels, episodes, seed, report)
    ]
    return {
        "kinds": list(kinds),
        "difficulties": list(dict.fromkeys(cell["difficulty"] for cell in cells)),
        "episodes": episodes,
        "command": PACE if subject.env.config.command.given else None,
        "cells": cells,
    }


def _measure_kinds(
    subject: Subject,
    kinds: tuple[str, ...],
    levels: int,
    episodes: int,
    seed: int,
    report: Report | None,
) -> Iterator[dict[str, Any]]:
    """The cells of some kinds, one after another."""
    env = ground_env(subject, kinds, levels)
    assert env.terrain is not None
    difficulties = tuple(dict.fromkeys(tile.difficulty for tile in env.terrain.tiles))
    tiles = _tiles(kinds, len(difficulties), episodes)
    start, outcome = _simulate(env, subject.policy.act, tiles, seed, report)
    for index in range(len(kinds) * len(difficulties)):
        own = slice(index * episodes, (index + 1) * episodes)
        part = Outcome(*(x[:, own] for x in outcome))
        kind, difficulty = divmod(index, len(difficulties))
        figures = _figures(env, start[own], part)
        yield {"kind": kinds[kind], "difficulty": difficulties[difficulty], **figures}


def ground_env(subject: Subject, kinds: tuple[str, ...], levels: int) -> QuadrupedEnv:
    """The environment of the cells of `kinds`: `ROWS` tiles of each, episodes confined to them."""
    config = subject.env.config
    ground, command = config.ground, config.command
    if ground.file is None:
        rows = tuple(kind for kind in kinds for _ in range(ROWS))
        ground = dataclasses.replace(ground, kinds=rows, levels=levels)
    if command.given:
        command = dataclasses.replace(
            command, forward=(PACE, PACE), lateral=(0.0, 0.0), yaw_rate=(0.0, 0.0), standing=0.0
        )
    config = dataclasses.replace(
        config, ground=dataclasses.replace(ground, confined=True), command=command
    )
    # The subject's own robot stands on its ground already.
    quadruped = load_run_robot(subject.run, subject.policy.config.robot)
    return QuadrupedEnv(quadruped, config, subject.env.engine)


def _tiles(kinds: tuple[str, ...], levels: int, episodes: int) -> np.ndarray:
    """(n,) the tile of each episode, cell by cell: kind by kind, of each its levels."""
    if kinds == (FILE,):
        return np.zeros(episodes, np.int32)
    kind, level, episode = np.indices((len(kinds), levels, episodes), np.int32)
    return (((kind * ROWS + episode % ROWS) * levels) + level).ravel()


def _simulate(
    env: QuadrupedEnv, policy: Policy, tiles: np.ndarray, seed: int, report: Report | None
) -> tuple[np.ndarray, Outcome]:
    """The trunk's poses (n, 7) at the starts of episodes on `tiles` (n,), and how they went on.

    In as many batches as memory asks for; an episode is the same in any.
    """

    @env.jit
    def chunk(policy: Policy, states: State) -> tuple[State, Outcome]:
        def step(states: State, _: None) -> tuple[State, Outcome]:
            states = jax.vmap(env.step)(states, policy(states.obs))
            return states, Outcome(states.info["end"], states.pipeline_state.qpos[:, :7])

        return jax.lax.scan(step, states, None, length=CHUNK)

    reset = env.jit(jax.vmap(env.reset))
    keys = np.asarray(jax.random.split(jax.random.PRNGKey(seed), len(tiles)))
    size = _batch(env, len(tiles))
    starts, outcomes = [], []
    for begin in range(0, len(tiles), size):
        # All of one size, to be compiled once: what the last has too many of is left out again.
        rows = np.arange(begin, begin + size) % len(tiles)
        if isinstance(env.model, MujocoModel):
            env.model.stepper.forget()
        first = reset(keys[rows], jnp.asarray(tiles[rows]))
        starts.append(np.asarray(first.pipeline_state.qpos[:, :7]))
        outcomes.append(until_all_ended(partial(chunk, policy), over_devices(env, first), report))
    longest = max(len(outcome.end) for outcome in outcomes)
    padded = [
        Outcome(*(np.pad(x, [(0, longest - len(x))] + [(0, 0)] * (x.ndim - 1)) for x in outcome))
        for outcome in outcomes
    ]
    joined = Outcome(
        *(np.concatenate(x, axis=1)[:, : len(tiles)] for x in zip(*padded, strict=True))
    )
    return np.concatenate(starts)[: len(tiles)], joined


def _has_own_fields(env: QuadrupedEnv) -> bool:
    """Whether each episode has a model of its own, and a field: in MuJoCo C, robots that differ."""
    return env.engine == "mujoco" and env.config.randomisation.enabled


def _batch(env: QuadrupedEnv, episodes: int) -> int:
    """How many episodes at a time."""
    assert env.terrain is not None
    if not _has_own_fields(env):
        return episodes
    return min(episodes, max(FIELDS_MEMORY // env.terrain.field.heights.nbytes, 1))


def _figures(env: QuadrupedEnv, start: np.ndarray, outcome: Outcome) -> dict[str, Any]:
    """The figures of one cell."""
    last = np.argmax(outcome.end > 0, axis=0)
    upright = outcome.end[last, np.arange(len(last))] == env.ends.index("time limit")
    arrived = upright & (last + 1 < env.config.episode_steps)
    speeds, errors = [], []
    for episode, steps in enumerate(last + 1):
        poses = np.concatenate([start[None, episode], outcome.pose[:steps, episode]])
        velocity = _velocity(poses, env.config.control_dt, env.config.command.given)
        speeds.append(float(velocity[:, 0].mean()))
        errors.append(_velocity_error(velocity, env.config.control_dt))
    count = int(upright.sum())
    return {
        "success": count / len(last),
        "success_ci95": list(share_interval(count, len(last))),
        "arrived": float(arrived.mean()),
        "speed": mean_figure(speeds),
        "velocity_error": mean_figure(errors) if env.config.command.given else None,
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
