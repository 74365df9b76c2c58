"""How well a policy follows each velocity command: a grid of forward velocity and yaw rate."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.evaluate.cells import measure_cells
from quadwalk.evaluate.loaded import LoadedRun
from quadwalk.evaluate.motion.course import SETTLING, heading_velocity
from quadwalk.evaluate.simulate import GROUP, Report, fresh_starts
from quadwalk.settings.environment import CommandConfig
from quadwalk.task.env import QuadrupedEnv

FORWARD, TURNS = 12, 9  # commands along each axis of the grid


def grid(config: CommandConfig) -> list[tuple[float, float, float]]:
    """Commands (forward m/s, lateral m/s, yaw rate rad/s) over the ranges of a task.

    Turns that need more than the task's centripetal acceleration are left out.
    """
    forward = np.linspace(*config.forward, FORWARD)
    turns = np.linspace(*config.yaw_rate, TURNS)
    most = np.inf if config.turning is None else config.turning + 1e-6
    return [(float(v), 0.0, float(w)) for v in forward for w in turns if abs(v * w) <= most]


def measure_steering(
    loaded: LoadedRun,
    commands: list[tuple[float, float, float]],
    episodes: int,
    seed: int,
    report: Report | None = None,
) -> dict[str, Any]:
    """Errors and falls of `episodes` at each of `commands`, held, as plain values for JSON.

    velocity, yaw_rate: means of the motion from twice `SETTLING` on, m/s and rad/s.
    velocity_error, yaw_rate_error: distance of these means from the command. success: the share
    without a fall.
    """
    env, dt = loaded.env, loaded.env.config.control_dt
    starts = holding(env, commands, episodes, seed)
    settled = round(2 * SETTLING / dt)

    def measure(number: int, upright: bool, poses: np.ndarray) -> dict[str, float | bool]:
        motion = heading_velocity(poses, dt)[settled:]
        forward, lateral, turn = motion.mean(axis=0) if len(motion) else np.full(3, np.nan)
        command = commands[number // episodes]
        return {
            "velocity": float(forward),
            "lateral": float(lateral),
            "yaw_rate": float(turn),
            "velocity_error": float(np.hypot(forward - command[0], lateral - command[1])),
            "yaw_rate_error": float(abs(turn - command[2])),
        }

    room = min(GROUP, len(starts.obs))
    found = measure_cells(env, loaded.policy.act, starts, episodes, measure, room, report)
    return {
        "engine": env.engine,
        "episodes": episodes,
        "cells": [
            {"command": list(command)} | figures
            for command, figures in zip(commands, found, strict=True)
        ],
    }


def holding(
    env: QuadrupedEnv, commands: list[tuple[float, float, float]], episodes: int, seed: int
) -> Any:
    """The first states of `episodes` at each command, which they hold, one command after another.

    Each command has the same starts.
    """
    states = fresh_starts(env, episodes, seed)

    @env.jit
    def begun(env: QuadrupedEnv, commands: jax.Array, states: Any) -> Any:
        def start(velocity: jax.Array, state: Any) -> Any:
            command = state.pipeline_state.command._replace(velocity=velocity)
            return env.begun(state, command=command)

        return jax.vmap(jax.vmap(start, in_axes=(None, 0)), in_axes=(0, None))(commands, states)

    starts = begun(jnp.asarray(commands, jnp.float32), states)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), starts)
