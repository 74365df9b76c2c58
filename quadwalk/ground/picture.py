"""A picture of every kind of tile."""

import numpy as np
from matplotlib.figure import Figure

from quadwalk.ground.terrain import GroundConfig, Place, Terrain, make_terrain

_PIXELS = 50  # a meter
_DEPTH = 0.6  # m on the picture, upwards, that a meter away from the eye takes
_SUN = np.array([-0.55, 0.35, 0.76])  # unit vector towards the light
_TOP, _CUT = np.array([237, 222, 194]), np.array([120, 100, 80])


def draw_kinds(config: GroundConfig, leg: float) -> Figure:
    """Half a tile of every kind of `config`, a row for each, at every level, a column."""
    terrain = make_terrain(config, leg)
    kinds, levels = config.kinds, config.difficulties
    figure = Figure(figsize=(2.9 * len(levels), 1.75 * len(kinds)), dpi=80, layout="constrained")
    grid = figure.subplots(len(kinds), len(levels), squeeze=False)
    for axes, kind in zip(grid, kinds, strict=True):
        for level, (cell, difficulty) in enumerate(zip(axes, levels, strict=True)):
            cell.imshow(cut_open(terrain, terrain.tile(kind, level)))
            cell.set_title(f"{kind.replace('_', ' ')}, {difficulty:g}", fontsize=11)
            cell.axis("off")
    return figure


def cut_open(terrain: Terrain, tile: Place, room: float = 1.8) -> np.ndarray:
    """(height, width, 3) uint8 picture of the half of a tile beyond its middle line along x.

    Seen in parallel, at one scale; `room` m are left for what is above and below 0.
    """
    (length, width), cell, step = tile.size, terrain.field.cell, 1 / _PIXELS
    ahead = np.arange(cell - length / 2, length / 2 - cell, step)
    away = np.arange(width / 2 - cell, 0, -step)  # the last nodes are the next tile's
    points = np.stack(np.meshgrid(tile.middle[0] + ahead, tile.middle[1] + away), axis=-1)
    heights = terrain.field.height_at(points)
    falling, along = np.gradient(heights, step)
    normals = np.stack([-along, falling, np.ones_like(heights)], axis=-1)
    light = normals @ _SUN / np.linalg.norm(normals, axis=-1)
    colors = _TOP * (0.25 + 0.75 * np.clip(light, 0, 1))[..., None]
    size = round((2 * room + _DEPTH * width / 2) * _PIXELS)
    picture = np.full((size, len(ahead), 3), 255, np.uint8)
    rows = np.arange(size)[:, None]
    # From the far end on, what is near covers what is behind it.
    for y, height, color in zip(away, heights, colors, strict=True):
        top = size - (room + height + _DEPTH * y) * _PIXELS
        np.copyto(picture, color[None].astype(np.uint8), where=(rows >= top)[..., None])
    front = rows >= size - (room + heights[-1]) * _PIXELS
    np.copyto(picture, _CUT.astype(np.uint8), where=front[..., None])
    return picture
