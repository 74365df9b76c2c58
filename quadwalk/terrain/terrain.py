"""One field for all robots: tiles of every kind and difficulty side by side, from a seed."""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import mujoco
import numpy as np

from quadwalk.bounds import Bounds, Few, Natural, Settings
from quadwalk.errors import UsageError
from quadwalk.terrain.heightfield import Heightfield, make_field, read_heights
from quadwalk.terrain.tiles import KINDS, OF_LEG, Patch, Sizes

FILE = "file"  # the kind of a field that was read
UNSEEN = 1_000_000  # seeds from here on are for evaluation
_MOST_NODES = 50_000_000

Meters = Annotated[float, Bounds(0.0, open="low", unit="m")]


@dataclass(frozen=True)
class GroundConfig(Settings, group="env.ground"):
    """The ground: a tile of each kind at each level of difficulty, or a field from a file."""

    # kinds of terrain, one row of tiles each; none: a flat floor without end
    kinds: tuple[str, ...]
    levels: Few  # tiles of each kind, of rising difficulty
    # of the first and the last level, 0 to 1
    difficulty: Annotated[tuple[float, float], Bounds(0.0, 1.0, ordered=True)]
    tile: tuple[float, float]  # m, length and width of a tile
    border: Annotated[float, Bounds(0.0, unit="m")]  # m, level ground around all tiles
    cell: Annotated[float, Bounds(0.005, 1.0, unit="m")]  # m between heights
    seed: Natural  # seed of the terrain; evaluations use seeds from 1 000 000 on
    step: Meters | None  # m, height of stairs at difficulty 1; None: 0.3 of a leg
    tread: Meters | None  # m, depth of stairs; None: 0.6 of a leg
    block: Meters | None  # m, height of blocks and logs at difficulty 1; None: 0.3 of a leg
    roughness: Meters | None  # m, amplitude at difficulty 1; None: 0.16 of a leg
    file: Path | None  # a gray PNG, or an .npy file of heights in m, instead of tiles
    white: Meters  # m, height of white in a PNG; black is 0
    # in training, an environment's level follows its success; False: all levels are equally likely
    curriculum: bool = False
    confined: bool = False  # an episode ends where it leaves its tile, without a fall

    def __post_init__(self) -> None:
        super().__post_init__()
        for kind in self.kinds:
            if kind not in KINDS:
                raise UsageError(
                    f"--env.ground.kinds: no terrain {kind!r}; expected some of: {', '.join(KINDS)}"
                )
        if min(self.tile) < 10 * self.cell:
            raise UsageError(
                f"--env.ground.tile is {self.tile}; expected length and width of 10 cells or more, "
                f"{10 * self.cell:g} m"
            )

    @property
    def flat(self) -> bool:
        """True if the ground is an endless flat floor."""
        return not self.kinds and self.file is None

    @property
    def difficulties(self) -> tuple[float, ...]:
        """Difficulty of each level, 0 to 1, in equal steps from the first level to the last."""
        return tuple(float(x) for x in np.linspace(*self.difficulty, self.levels))

    def make_unseen(self, seed: int = 0) -> "GroundConfig":
        """Return the same ground from another seed, one that training never uses.

        Unequal `seed` give unequal ground.
        """
        return dataclasses.replace(self, seed=UNSEEN + seed)


# For a task on a flat floor; tiles and levels as in legged_gym (arXiv:2109.11978).
FLAT = GroundConfig(
    kinds=(),
    levels=10,
    difficulty=(0.0, 1.0),
    tile=(8.0, 8.0),
    border=4.0,
    cell=0.05,
    seed=0,
    step=None,
    tread=None,
    block=None,
    roughness=None,
    file=None,
    white=1.0,
)


@dataclass(frozen=True)
class Place:
    """A tile of a field; where it is and where episodes start on it, in the field's frame."""

    kind: str
    level: int
    difficulty: float
    middle: tuple[float, float]  # m, x and y
    size: tuple[float, float]  # m, length and width
    start: tuple[float, float]  # m, where an episode starts, on average
    spread: tuple[float, float]  # m, how far from there, along x and y, at most


@dataclass(frozen=True, eq=False)
class Terrain:
    """A field of heights and its tiles: all levels of the first kind, then of the second, ..."""

    field: Heightfield
    tiles: tuple[Place, ...]

    def find_tile(self, kind: str, level: int) -> Place:
        """Return the first tile of this kind and level; `UsageError` where there is none."""
        for tile in self.tiles:
            if (tile.kind, tile.level) == (kind, level):
                return tile
        names = dict.fromkeys(f"{tile.kind} {tile.level}" for tile in self.tiles)
        raise UsageError(
            f"the terrain has no tile {kind!r} of level {level}; it has: {', '.join(names)}"
        )


def measure_leg(model: mujoco.MjModel, foot: str) -> float:
    """Return the distance from the thigh's joint to the foot's center, the knee stretched, m."""
    geom = model.geom(foot).id
    calf = model.geom_bodyid[geom]
    return float(np.linalg.norm(model.body_pos[calf]) + np.linalg.norm(model.geom_pos[geom]))


def make_sizes(config: GroundConfig, leg: float) -> Sizes:
    """Return the steps, slopes and other features of a tile of difficulty 1.

    They grow with the length of the robot's legs, `leg` m, unless `config` sets them.
    """
    sizes = {name: size * (1.0 if name == "slope" else leg) for name, size in vars(OF_LEG).items()}
    for name in ("step", "tread", "block", "roughness"):
        if getattr(config, name) is not None:
            sizes[name] = getattr(config, name)
    return Sizes(**sizes)


def make_terrain(config: GroundConfig, leg: float) -> Terrain:
    """Make the ground of `config`, or read it from its file, for robots with legs of `leg` m.

    Levels follow one another along x, kinds along y; the middle of all is x = y = 0. The heights of
    a tile depend only on its kind, that kind's place in `config.kinds`, its level and difficulty,
    its sizes and the seed.
    """
    assert not config.flat
    if config.file is not None:
        return _read_terrain(config, config.file)
    sizes = make_sizes(config, leg)
    cell, levels = config.cell, config.difficulties
    columns, rows = (round(side / cell) for side in config.tile)
    edge = round(config.border / cell)
    shape = (len(config.kinds) * rows + 2 * edge + 1, len(levels) * columns + 2 * edge + 1)
    if math.prod(shape) > _MOST_NODES:
        raise UsageError(
            f"the ground has {shape[0]} x {shape[1]} heights; expected fewer tiles, smaller ones, "
            f"or a larger --env.ground.cell, for at most {_MOST_NODES}"
        )
    x, y = (cell * (np.arange(n + 1) - n / 2) for n in (columns, rows))
    patch = Patch(x, y, cell)
    field = make_field(np.zeros(shape, np.float32), cell)
    tiles = []
    for k, kind in enumerate(config.kinds):
        for level, difficulty in enumerate(levels):
            rng = np.random.default_rng([config.seed, k, level])
            top, left = edge + k * rows, edge + level * columns
            # A tile's last nodes are the next one's first.
            heights = KINDS[kind](patch, sizes, difficulty, rng)
            field.heights[top : top + rows + 1, left : left + columns + 1] = heights
            middle = (
                field.origin[0] + cell * (left + columns / 2),
                field.origin[1] + cell * (top + rows / 2),
            )
            tiles.append(_make_place(kind, level, difficulty, middle, patch, sizes))
    return Terrain(field, tuple(tiles))


def _make_place(
    kind: str,
    level: int,
    difficulty: float,
    middle: tuple[float, float],
    patch: Patch,
    sizes: Sizes,
) -> Place:
    """Return a tile's record: where it is, and where on it episodes of its kind start."""
    size = (float(np.ptp(patch.x)), float(np.ptp(patch.y)))
    start, spread = middle, (0.3 * sizes.middle, 0.3 * sizes.middle)
    if kind == "course":  # from its near end, anywhere across
        start = (middle[0] - size[0] / 2 + sizes.middle, middle[1])
        spread = (spread[0], max(size[1] / 2 - sizes.middle, 0.0))
    elif kind in ("flat", "rough", "waves"):  # no place is like another
        spread = (size[0] / 4, size[1] / 4)
    return Place(kind, level, difficulty, middle, size, start, spread)


def _read_terrain(config: GroundConfig, path: Path) -> Terrain:
    """Read a field from a file: one tile, on which episodes start anywhere near the middle."""
    field = make_field(read_heights(path, config.white), config.cell)
    middle, size = (0.0, 0.0), field.size
    spread = (size[0] / 4, size[1] / 4)
    return Terrain(field, (Place(FILE, 0, 0.0, middle, size, middle, spread),))
