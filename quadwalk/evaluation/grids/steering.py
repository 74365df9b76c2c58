"""How well a policy follows commands: held ones, changes of them, and its gait at each speed."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.brax import State
from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.grids.cells import cell_starts, measure_cells, trunk_paths
from quadwalk.evaluation.loaded import LoadedRun, evaluation_ranges
from quadwalk.evaluation.motion.course import SETTLING, WINDOW, heading_velocity, window_means
from quadwalk.evaluation.motion.gait import measure_gait
from quadwalk.evaluation.rollout import later_steps
from quadwalk.evaluation.simulate import GROUP, Report, fresh_starts, simulate_episodes
from quadwalk.evaluation.statistics import mean_figure, number
from quadwalk.settings.environment import COMMANDED, CommandConfig

Command = tuple[float, float, float]  # forward and lateral m/s, yaw rate rad/s
STILL: Command = (0.0, 0.0, 0.0)

FORWARD, TURNS = 12, 9  # commands along each axis of the grid
SECONDS = 8.0  # s, that a command is held
SETTLED = 2 * SETTLING  # s, after which a held command's motion is evaluated
NO_SLIP = 20  # iterations at most of MuJoCo's no-slip solver
LONG = 20.0  # s, of an episode in which commands change as in training
CHANGE = 4.0  # s, after which it changes where a change is measured
NEAR = 0.1  # of a change: a response that stays so near its end has arrived


def steering_run(loaded: LoadedRun) -> LoadedRun:
    """Return `loaded` in MuJoCo C, in episodes that last as long as a command is held."""
    command = dataclasses.replace(loaded.env.config.command, seconds=SECONDS, soonest=None)
    return loaded.in_mujoco(episode_seconds=SECONDS, command=command)


def changing_run(loaded: LoadedRun) -> LoadedRun:
    """`loaded` in MuJoCo C, randomized, with commands that change as in training."""
    trained = loaded.policy.config.env
    return loaded.in_mujoco(
        command=dataclasses.replace(trained.command, margin=0.0),
        randomization=evaluation_ranges(trained, enabled=True),
        episode_seconds=LONG,
    )


def measure_steering(
    loaded: LoadedRun, episodes: int, seed: int, report: Report | None = None
) -> dict[str, Any]:
    """Tracking at each command, gaits and responses of a `steering_run`, plain values for JSON."""
    config = loaded.env.config.command
    return {
        "engine": loaded.env.engine,
        "episodes": episodes,
        "cells": measure_held(loaded, held_commands(config), episodes, seed, report),
        "standing": measure_still(loaded, episodes, seed),
        "standing_without_creep": measure_still(without_creep(loaded), episodes, seed),
        "gaits": measure_gaits(loaded, seed),
        "responses": [measure_response(loaded, *each, episodes, seed) for each in changes(config)],
    }


def measure_changing(
    loaded: LoadedRun, episodes: int, seed: int, report: Report | None = None
) -> dict[str, Any]:
    """Success of `episodes` of `loaded`, which is by `changing_run`, as plain values for JSON."""
    env = loaded.env
    starts, act = fresh_starts(env, episodes, seed), loaded.policy.act
    (found,) = measure_cells(env, act, starts, episodes, lambda *_: {}, GROUP, report)
    return {"seconds": LONG, "episodes": episodes, **found}


def held_commands(config: CommandConfig) -> list[Command]:
    """A grid of a task's forward velocities and yaw rates, within its centripetal acceleration."""
    forward = np.linspace(*config.forward, FORWARD)
    turns = np.linspace(*config.yaw_rate, TURNS)
    most = np.inf if config.turning is None else config.turning + 1e-6
    return [(float(v), 0.0, float(w)) for v in forward for w in turns if abs(v * w) <= most]


def changes(config: CommandConfig) -> list[tuple[Command, Command]]:
    """From a stand to nine tenths of the largest speed, back, and from a left to a right turn."""
    fast = (0.9 * config.forward[1], 0.0, 0.0)
    speed = config.forward[1] / 2
    turn = config.yaw_rate[1]
    turn = turn if config.turning is None else min(turn, config.turning / speed)
    return [(STILL, fast), (fast, STILL), ((speed, 0.0, turn), (speed, 0.0, -turn))]


def measure_held(
    loaded: LoadedRun,
    commands: list[Command],
    episodes: int,
    seed: int,
    report: Report | None = None,
) -> list[dict[str, Any]]:
    """Motion, errors and success of `episodes` from the same starts at each command, held.

    forward, lateral, yaw_rate: means of the motion from `SETTLED` on, m/s and rad/s.
    velocity_error, yaw_rate_error: how far these means are from the command. success: the share
    without a fall.
    """
    env, dt = loaded.env, loaded.env.config.control_dt
    settled = round(SETTLED / dt)

    def measure(which: int, upright: bool, poses: np.ndarray) -> dict[str, float | bool]:
        motion = heading_velocity(poses, dt)[settled:]
        mean = motion.mean(axis=0) if len(motion) else np.full(3, np.nan)
        off = mean - commands[which // episodes]
        found = dict(zip(COMMANDED, map(float, mean), strict=True))
        errors = {"velocity_error": np.hypot(off[0], off[1]), "yaw_rate_error": abs(off[2])}
        return found | {name: float(error) for name, error in errors.items()}

    starts = holding(env, commands, episodes, seed)
    found = measure_cells(env, loaded.policy.act, starts, episodes, measure, GROUP, report)
    return [{"command": list(held)} | cell for held, cell in zip(commands, found, strict=True)]


def measure_still(loaded: LoadedRun, episodes: int, seed: int) -> dict[str, Any]:
    """How far the trunk moves at the command to stand, m, from where it is at `SETTLED`.

    moved: of the farthest that each of `episodes` gets, the mean. most: the largest.
    """
    env = loaded.env
    settled = round(SETTLED / env.config.control_dt)
    starts = holding(env, [STILL], episodes, seed)
    paths = [poses[settled:, :2] for _, _, poses in trunk_paths(env, loaded.policy.act, starts)]
    # Of those that did not fall before.
    moved = [float(np.linalg.norm(path - path[0], axis=1).max()) for path in paths if len(path)]
    return {"moved": mean_figure(moved), "most": max(moved, default=None)}


def without_creep(loaded: LoadedRun) -> LoadedRun:
    """Return `loaded`, which is in MuJoCo C, with soles that hold as dry friction does.

    MuJoCo's soft friction gives way a little to any force. Its no-slip solver takes that back.
    """
    quadruped, env = loaded.env.quadruped, loaded.env
    # In the spec, from which the models of randomized robots are made too.
    spec = quadruped.spec.copy()
    spec.option.noslip_iterations = NO_SLIP
    env = QuadrupedEnv(dataclasses.replace(quadruped, spec=spec), env.config, env.engine)
    return dataclasses.replace(loaded, env=env)


def measure_gaits(loaded: LoadedRun, seed: int) -> list[dict[str, Any]]:
    """Return gait, speed, cost of transport and stride frequency at each speed straight ahead.

    They are of one episode at each, from `SETTLED` on: the start from a stand is left out.
    """
    env = loaded.env
    speeds = np.linspace(0.0, env.config.command.forward[1], 1 + 2 * FORWARD)[1:]
    starts = holding(env, [(float(speed), 0.0, 0.0) for speed in speeds], 1, seed)
    rollouts = simulate_episodes(env, loaded.policy.act, len(speeds), seed, starts=starts)
    settled = round(SETTLED / env.config.control_dt)
    found = [measure_gait(later_steps(rollout, settled), env.quadruped) for rollout in rollouts]
    figures = ("speed", "cost_of_transport", "stride_frequency")
    return [
        {"command": float(speed), "gait": gait.gait}
        | {name: number(getattr(gait, name)) for name in figures}
        for speed, gait in zip(speeds, found, strict=True)
    ]


def measure_response(
    loaded: LoadedRun, before: Command, after: Command, episodes: int, seed: int
) -> dict[str, Any]:
    """How soon motion follows when a command changes `CHANGE` s after the start.

    Of what changes most, m/s or rad/s, the mean of `episodes` over `WINDOW`, in curve from the
    change on. time: s, until it stays within `NEAR` of the change from its end; None: never.
    overshoot: share of the change. falls: share of episodes.
    """
    env, dt = loaded.env, loaded.env.config.control_dt
    turn, window = round(CHANGE / dt), round(WINDOW / dt)
    part = int(np.argmax(np.abs(np.subtract(after, before))))

    def change(env: QuadrupedEnv, state: State) -> State:
        now = state.pipeline_state
        # A step sooner: the policy has chosen its action, and sees the command in the next state.
        changed = now.steps >= turn - 1
        velocity = jnp.where(changed[:, None], jnp.asarray(after), now.command.velocity)
        command = now.command._replace(velocity=velocity)
        return state.replace(pipeline_state=now._replace(command=command))

    starts = holding(env, [before], episodes, seed)
    paths = trunk_paths(env, loaded.policy.act, starts, change=change)
    poses = [path for _, upright, path in paths if upright]
    motion = [window_means(heading_velocity(each, dt)[turn:], window)[:, part] for each in poses]
    curve = np.mean(motion, axis=0) if motion else np.zeros(0)
    share = (curve - before[part]) / (after[part] - before[part])
    away = np.flatnonzero(np.abs(share - 1.0) > NEAR)
    arrived = 1 + away[-1] if len(away) else 0
    return {
        "before": list(before),
        "after": list(after),
        "part": COMMANDED[part],
        "time": arrived * dt + WINDOW / 2 if arrived < len(curve) else None,
        "overshoot": max(float(share.max() - 1.0), 0.0) if len(curve) else None,
        "falls": 1.0 - len(poses) / episodes,
        "curve": curve.tolist(),
        "dt": dt,
    }


def holding(env: QuadrupedEnv, commands: list[Command], episodes: int, seed: int) -> State:
    """The same first states of `episodes`, held at each command, one command after another."""

    def start(env: QuadrupedEnv, velocity: jax.Array, state: State) -> State:
        command = state.pipeline_state.command._replace(velocity=velocity)
        return env.begun(state, command=command)

    return cell_starts(
        env, start, np.array(commands, np.float32), fresh_starts(env, episodes, seed)
    )
