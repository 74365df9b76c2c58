"""The suite "terrain": success on each kind of ground at several difficulties, none from training.

Each kind and difficulty is a cell of its own: episodes begin on its tiles and end at their edges.
Where velocities are commanded, the command is to go straight ahead at `PACE`.
"""

import dataclasses
import math
from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.load import LoadedRun
from quadwalk.evaluation.metrics import (
    compute_heading_velocity,
    compute_tracking_errors,
    get_mean,
    measure_cells,
)
from quadwalk.evaluation.report.tables import format_percent, format_value, print_table
from quadwalk.evaluation.rollout import ROOM, Report, reset_episodes
from quadwalk.render.figures import INK, make_figure
from quadwalk.terrain.terrain import FILE

PACE = 0.7  # m/s
# Episodes at a time, at most. They are about an eighth of all, in multiples of `ROOM`: rows without
# an episode are stepped on until the last has ended.
MOST = 2048
ROWS, LEAST_ROWS = 32, 4  # of tiles, shared out to the kinds: no two of a cell are alike


def measure_terrain(
    loaded: LoadedRun, episodes: int, seed: int, report: Report | None = None, levels: int = 3
) -> dict[str, Any]:
    """Return success, speed and error on each kind of ground at each difficulty, values for JSON.

    A kind at a difficulty is a cell, with `episodes` each. There are `levels` difficulties, evenly
    from the least to the greatest that were trained on.

    - success: the share that, without a fall, comes to the tile's edge or the time limit.
    - arrived: the share that comes to the edge.
    - speed: mean over an episode, ahead, m/s; without commands along world x.
    - velocity_error: as of `compute_tracking_errors`, m/s; None without commands, or where no
      episode lasted long enough.
    """
    ground = loaded.env.config.ground
    kinds = (FILE,) if ground.file is not None else ground.kinds
    env = make_cells_env(loaded, kinds, levels)
    assert env.terrain is not None
    difficulties = list(dict.fromkeys(tile.difficulty for tile in env.terrain.tiles))
    commanded, dt = env.config.command.active, env.config.control_dt
    cells = list(product(kinds, difficulties))
    tiles_of_cells = [
        [k for k, tile in enumerate(env.terrain.tiles) if (tile.kind, tile.difficulty) == cell]
        for cell in cells
    ]
    tiles = np.concatenate([np.resize(places, episodes) for places in tiles_of_cells])  # in turn

    def measure(number: int, upright: bool, poses: np.ndarray) -> dict[str, float | bool]:
        arrived = upright and len(poses) - 1 < env.config.episode_steps
        if not commanded:
            speed, error = (np.diff(poses[:, 0]) / dt).mean(), math.nan
        else:
            velocity = compute_heading_velocity(poses, dt)
            speed = velocity[:, 0].mean()
            command = np.full_like(velocity, [PACE, 0.0, 0.0])
            error, _ = compute_tracking_errors(velocity, command, dt)
        return {"arrived": arrived, "speed": float(speed), "velocity_error": error}

    starts = reset_episodes(env, len(tiles), seed, tiles.astype(np.int32))
    room = min(ROOM * math.ceil(len(tiles) / (8 * ROOM)), MOST)
    figures = measure_cells(env, loaded.policy.act, starts, episodes, measure, room, report)
    return {
        "kinds": list(kinds),
        "difficulties": difficulties,
        "episodes": episodes,
        "command": PACE if commanded else None,
        "cells": [
            {"kind": kind, "difficulty": difficulty} | cell_figures
            for (kind, difficulty), cell_figures in zip(cells, figures, strict=True)
        ],
    }


def make_cells_env(loaded: LoadedRun, kinds: tuple[str, ...], levels: int) -> QuadrupedEnv:
    """Make an environment with tiles of each kind at each of `levels` difficulties.

    An episode ends where it leaves its tile. A velocity command is `PACE` straight ahead.
    """
    config = loaded.env.config
    ground, command = config.ground, config.command
    if ground.file is None:
        rows = tuple(kind for kind in kinds for _ in range(max(ROWS // len(kinds), LEAST_ROWS)))
        ground = dataclasses.replace(ground, kinds=rows, levels=levels)
    if command.active:
        command = command.hold_at(PACE)
    config = dataclasses.replace(
        config, ground=dataclasses.replace(ground, confined=True), command=command
    )
    return QuadrupedEnv(loaded.load_level_robot(), config, loaded.env.engine)


def print_terrain(results: dict[str, Any]) -> None:
    """Print a table of success, arrival, speed and velocity error on each kind of ground.

    The difficulties are side by side. `results` are of `measure_terrain`.
    """
    levels = len(results["difficulties"])
    rows: list[list[str] | None] = []
    for index, kind in enumerate(results["kinds"]):
        cells = results["cells"][index * levels : (index + 1) * levels]
        success = [format_percent(cell["success"]) for cell in cells]
        rows.append([kind.replace("_", " "), *success, "% success"])
        rows.append(["", *(format_percent(cell["arrived"]) for cell in cells), "% arrival"])
        rows.append(["", *(format_value(cell["speed"]) for cell in cells), "m/s"])
        if results["command"] is not None:
            rows.append(["", *(format_value(cell["velocity_error"]) for cell in cells), "m/s off"])
        rows.append(None)
    command = "" if results["command"] is None else f" at a command of {results['command']:g} m/s"
    title = (
        f"ground that training did not have,{command} {results['episodes']} episodes each; "
        "success: no fall before the tile's edge or the time limit, arrival: reached the edge"
    )
    headings = ("", *(f"difficulty {x:.2g}" for x in results["difficulties"]), "unit")
    print_table(title, headings, rows)


def draw_terrain(results: dict[str, Any], title: str) -> Figure:
    """Draw heat maps over kinds of ground and difficulties: success, speed, velocity error.

    They are in % and m/s; the error is there with commands alone. `results` are of
    `measure_terrain`.
    """
    kinds, difficulties = results["kinds"], results["difficulties"]
    commanded = results["command"] is not None
    maps: list[tuple[str, str, float, Any]] = [
        ("success, %", "viridis", 100.0, lambda cell: 100 * cell["success"]),
        ("speed, m/s", "viridis", 0.0, lambda cell: cell["speed"]["mean"]),
        ("velocity error, m/s", "viridis_r", 0.0, lambda cell: get_mean(cell["velocity_error"])),
    ]
    maps = maps if commanded else maps[:2]
    size = (1.6 + 4.2 * len(maps), 1.6 + 0.5 * max(len(kinds), 3))
    command = f", command {results['command']:g} m/s" if commanded else ""
    text = f"{title}: {results['episodes']} episodes in each cell, unseen ground{command}"
    figure = make_figure(size, text)
    panels: Any = figure.subplots(1, len(maps), squeeze=False)[0]
    for axes, (heading, colors, top, value) in zip(panels, maps, strict=True):
        cells = np.array([value(cell) for cell in results["cells"]], float)
        values = cells.reshape(len(kinds), len(difficulties))
        high = top or max(float(np.nanmax(values, initial=0.0)), 0.1)
        axes.imshow(values, cmap=colors, vmin=0.0, vmax=high, aspect="auto")
        axes.set_title(heading, fontsize=11, loc="left")
        axes.set_xticks(range(len(difficulties)), [f"{x:.2g}" for x in difficulties])
        axes.set_yticks(range(len(kinds)), [kind.replace("_", " ") for kind in kinds])
        axes.set_xlabel("difficulty")
        for (row, column), number in np.ndenumerate(values):
            label = "-" if math.isnan(number) else f"{number:.0f}" if top else f"{number:z.2f}"
            shade = axes.images[0].to_rgba(number)
            color = "white" if np.dot(shade[:3], (0.3, 0.6, 0.1)) < 0.5 else INK
            axes.text(column, row, label, ha="center", va="center", fontsize=10, color=color)
    return figure
