"""How well a policy gets over each kind of ground at several difficulties, none seen in training.

Each kind and difficulty is a cell of its own: episodes begin on its tiles and end at their edges.
Where velocities are commanded, the command is to go straight ahead at `PACE`.
"""

import dataclasses
import math
from itertools import product
from typing import Any

import numpy as np

from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.grids.cells import measure_cells
from quadwalk.evaluation.loaded import LoadedRun
from quadwalk.evaluation.motion.course import heading_velocity, tracking_errors
from quadwalk.evaluation.simulate import ROOM, Report, fresh_starts
from quadwalk.robot.load import load_robot
from quadwalk.terrain.terrain import FILE

PACE = 0.7  # m/s
# Episodes at a time, at most. They are about an eighth of all, in multiples of `ROOM`: rows without
# an episode are stepped on until the last has ended.
MOST = 2048
ROWS, LEAST_ROWS = 32, 4  # of tiles, shared out to the kinds: no two of a cell are alike


def measure_by_ground(
    loaded: LoadedRun, episodes: int, seed: int, report: Report | None = None, levels: int = 3
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
    commanded, dt = env.config.command.given, env.config.control_dt
    cells = list(product(kinds, difficulties))
    own = [[(tile.kind, tile.difficulty) == cell for tile in env.terrain.tiles] for cell in cells]
    tiles = np.concatenate([np.resize(np.flatnonzero(row), episodes) for row in own])  # in turn

    def measure(number: int, upright: bool, poses: np.ndarray) -> dict[str, float | bool]:
        arrived = upright and len(poses) - 1 < env.config.episode_steps
        if not commanded:
            speed, error = (np.diff(poses[:, 0]) / dt).mean(), math.nan
        else:
            velocity = heading_velocity(poses, dt)
            speed = velocity[:, 0].mean()
            error, _ = tracking_errors(velocity, np.full_like(velocity, [PACE, 0.0, 0.0]), dt)
        return {"arrived": arrived, "speed": float(speed), "velocity_error": error}

    starts = fresh_starts(env, len(tiles), seed, tiles.astype(np.int32))
    room = min(ROOM * math.ceil(len(tiles) / (8 * ROOM)), MOST)
    found = measure_cells(env, loaded.policy.act, starts, episodes, measure, room, report)
    return {
        "kinds": list(kinds),
        "difficulties": difficulties,
        "episodes": episodes,
        "command": PACE if commanded else None,
        "cells": [
            {"kind": kind, "difficulty": difficulty} | figures
            for (kind, difficulty), figures in zip(cells, found, strict=True)
        ],
    }


def ground_env(loaded: LoadedRun, kinds: tuple[str, ...], levels: int) -> QuadrupedEnv:
    """The environment of the cells of `kinds`: tiles of each, and episodes confined to them."""
    config = loaded.env.config
    ground, command = config.ground, config.command
    if ground.file is None:
        rows = tuple(kind for kind in kinds for _ in range(max(ROWS // len(kinds), LEAST_ROWS)))
        ground = dataclasses.replace(ground, kinds=rows, levels=levels)
    if command.given:
        command = command.held_at(PACE)
    config = dataclasses.replace(
        config, ground=dataclasses.replace(ground, confined=True), command=command
    )
    # The run's own robot stands on its ground already.
    quadruped = load_robot(loaded.policy.config.robot)
    return QuadrupedEnv(quadruped, config, loaded.env.engine)
