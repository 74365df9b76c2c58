"""The kinds of tiles: heights of a piece of ground, from a difficulty and a random generator.

Each kind is a pure function `(patch, sizes, difficulty, rng) -> heights`. It returns the heights
(rows, columns), m, of the nodes of `patch`. At difficulty 0 a tile is flat or nearly so; at 1 it
has the sizes of `Sizes`. Most kinds are the same in all directions around a flat square in the
middle, where a robot starts, and end at the height of the tiles around them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator


@dataclass(frozen=True)
class Sizes:
    """Sizes of tiles of difficulty 1, m; only the slope is in rad."""

    slope: float  # rad
    roughness: float  # highest and lowest are +- this
    grain: float  # between independent heights of roughness
    wave: float  # highest and lowest are +- this
    wavelength: float
    step: float  # height of a stair
    tread: float  # its depth
    block: float  # height of blocks and logs
    block_length: float  # the middle of what blocks are long and wide
    ditch: float  # width of a ditch
    ditch_depth: float
    middle: float  # half the side of the level square that a robot starts on


# For a robot with legs of 1 m. An AlienGo's, 0.5 m, meet stairs of 15 cm with treads of 30 cm,
# blocks of 15 cm and roughness of +-8 cm, as its users train it for (DLSLab, Isaac Lab).
OF_LEG = Sizes(
    slope=float(np.radians(25.0)),
    roughness=0.16,
    grain=0.2,
    wave=0.16,
    wavelength=2.4,
    step=0.3,
    tread=0.6,
    block=0.3,
    block_length=1.0,
    ditch=0.5,
    ditch_depth=0.6,
    middle=1.0,
)


@dataclass(frozen=True)
class Patch:
    """The grid of a tile: places of its nodes from its middle, m, x (columns,) and y (rows,)."""

    x: np.ndarray
    y: np.ndarray
    cell: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.y), len(self.x)

    @property
    def inwards(self) -> np.ndarray:
        """Distance (rows, columns) of each node from the nearest edge of the tile, m."""
        across = np.abs(self.y[0]) - np.abs(self.y)
        along = np.abs(self.x[0]) - np.abs(self.x)
        return np.minimum(across[:, None], along[None, :])


def _compute_reach(patch: Patch, sizes: Sizes) -> float:
    """Return the distance from a tile's edge to the flat square in its middle, m."""
    return max(float(patch.inwards.max()) - sizes.middle, patch.cell)


def make_flat(patch: Patch, sizes: Sizes, difficulty: float, rng: Generator) -> np.ndarray:
    """Make flat ground, whatever the difficulty."""
    return np.zeros(patch.shape)


def make_slope_up(patch: Patch, sizes: Sizes, difficulty: float, rng: Generator) -> np.ndarray:
    """Make a hollow: from the flat square in its middle the ground rises on all four sides."""
    steepness = np.tan(difficulty * sizes.slope)
    return -steepness * np.minimum(patch.inwards, _compute_reach(patch, sizes))


def make_slope_down(patch: Patch, sizes: Sizes, difficulty: float, rng: Generator) -> np.ndarray:
    """Make a hill: from the flat square on its top the ground falls on all four sides."""
    return -make_slope_up(patch, sizes, difficulty, rng)


def make_rough(patch: Patch, sizes: Sizes, difficulty: float, rng: Generator) -> np.ndarray:
    """Make random heights on a coarse grid, bilinear between its nodes; the middle is rough too."""
    return difficulty * sizes.roughness * _make_noise(patch, sizes.grain, rng)


def make_waves(patch: Patch, sizes: Sizes, difficulty: float, rng: Generator) -> np.ndarray:
    """Make sine waves along x plus sine waves along y, with random phases, in the middle too."""
    phases = rng.uniform(0.0, 2 * np.pi, 2)
    x, y = (2 * np.pi / sizes.wavelength * axis for axis in (patch.x, patch.y))
    both = np.sin(x + phases[0])[None, :] + np.sin(y + phases[1])[:, None]
    return 0.5 * difficulty * sizes.wave * both


def make_stairs_up(patch: Patch, sizes: Sizes, difficulty: float, rng: Generator) -> np.ndarray:
    """Make stairs up from the flat square in the middle, on all four sides."""
    # A little more, so that rounding does not decide where a stair begins.
    number = np.floor((_compute_reach(patch, sizes) - patch.inwards) / sizes.tread + 1e-6)
    top = np.floor(_compute_reach(patch, sizes) / sizes.tread + 1e-6)
    return difficulty * sizes.step * (np.clip(number + 1, 0, top) - top)


def make_stairs_down(patch: Patch, sizes: Sizes, difficulty: float, rng: Generator) -> np.ndarray:
    """Make stairs down from the flat square in the middle, on all four sides."""
    return -make_stairs_up(patch, sizes, difficulty, rng)


def make_blocks(patch: Patch, sizes: Sizes, difficulty: float, rng: Generator) -> np.ndarray:
    """Make blocks of random sizes that cover about half of the ground outside the flat middle.

    Where two overlap, the ground is as high as one of them, not as their sum.
    """
    heights = np.zeros(patch.shape)
    sides = np.array([np.ptp(patch.x), np.ptp(patch.y)])
    for _ in range(round(0.7 * float(np.prod(sides)) / sizes.block_length**2)):
        place = rng.uniform(-0.5, 0.5, 2) * sides
        half = sizes.block_length * rng.uniform(0.25, 0.75, 2)
        height = difficulty * sizes.block * rng.uniform(0.4, 1.0)
        ahead = np.abs(patch.x - place[0]) < half[0]
        left = np.abs(patch.y - place[1]) < half[1]
        heights[np.ix_(left, ahead)] = height
    heights[_is_in_middle(patch, sizes)] = 0.0
    return heights


def make_ditches(patch: Patch, sizes: Sizes, difficulty: float, rng: Generator) -> np.ndarray:
    """Make square ditches around the flat middle, one outside the other.

    They are wider and deeper with `difficulty`.
    """
    outwards = _compute_reach(patch, sizes) - patch.inwards
    period = sizes.ditch + sizes.middle
    within = np.mod(outwards, period) - 0.5 * sizes.middle
    width = difficulty * sizes.ditch
    dug = (outwards > 0) & (patch.inwards > sizes.ditch) & (np.abs(within - width / 2) < width / 2)
    return np.where(dug, -difficulty * sizes.ditch_depth, 0.0)


def make_course(patch: Patch, sizes: Sizes, difficulty: float, rng: Generator) -> np.ndarray:
    """Make blocks, logs and ditches across the way along x, in random order and distances."""
    heights = np.zeros(patch.shape)
    ahead, finish = float(patch.x[0]) + 2 * sizes.middle, float(patch.x[-1]) - sizes.middle
    low, high = float(patch.y[0]), float(patch.y[-1])
    while True:
        ahead += sizes.middle * rng.uniform(1.0, 3.0)
        if ahead > finish:
            return heights
        # Each leaves a way around it on one side, but logs and ditches of full width.
        ends = np.sort(rng.uniform(low, high, 2)) if rng.random() < 0.5 else np.array([low, high])
        across = (patch.y >= ends[0]) & (patch.y <= ends[1])
        height = difficulty * sizes.block * rng.uniform(0.5, 1.0)
        kind = rng.integers(3)
        if kind == 0:
            length = sizes.block_length * rng.uniform(0.3, 1.0)
            profile = np.where(np.abs(patch.x - ahead - length / 2) < length / 2, height, 0.0)
        elif kind == 1:  # half a round log
            length = 2 * height + patch.cell
            arc = height**2 - (patch.x - ahead - length / 2) ** 2
            profile = np.sqrt(np.maximum(arc, 0.0))
        else:
            length = difficulty * sizes.ditch * rng.uniform(0.5, 1.0)
            dug = np.abs(patch.x - ahead - length / 2) < length / 2
            profile = np.where(dug, -difficulty * sizes.ditch_depth, 0.0)
        heights[across] += profile
        ahead += length


def _make_noise(patch: Patch, grain: float, rng: Generator) -> np.ndarray:
    """Return random numbers (rows, columns) in -1 to 1, one for each node of `patch`.

    They are independent and uniform at points `grain` m apart, and bilinear between those.
    """
    heights = rng.uniform(-1.0, 1.0, [int(np.ptp(axis) / grain) + 2 for axis in (patch.y, patch.x)])
    for axis, at in enumerate((patch.y, patch.x)):
        place = (at - at[0]) / grain
        first = place.astype(int)
        share = np.expand_dims(place - first, 1 - axis)
        before, after = (np.take(heights, first + k, axis) for k in (0, 1))
        heights = (1 - share) * before + share * after
    return heights


def _is_in_middle(patch: Patch, sizes: Sizes) -> np.ndarray:
    """Return True for each node (rows, columns) that is in the flat square of the middle."""
    left, ahead = (np.abs(axis) < sizes.middle for axis in (patch.y, patch.x))
    return left[:, None] & ahead[None, :]


Tile = Callable[[Patch, Sizes, float, Generator], np.ndarray]

KINDS: Mapping[str, Tile] = {
    "flat": make_flat,
    "slope_up": make_slope_up,
    "slope_down": make_slope_down,
    "rough": make_rough,
    "waves": make_waves,
    "stairs_up": make_stairs_up,
    "stairs_down": make_stairs_down,
    "blocks": make_blocks,
    "ditches": make_ditches,
    "course": make_course,
}
