"""Heights on a grid: read from a file, measured anywhere, laid in place of a model's floor."""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from quadwalk.errors import UserError
from quadwalk.files import get_os_reason

FLOOR = "floor"  # the geom that robots stand on, in every model
BASE = 1.0  # m, how far MuJoCo's heightfield goes down below its lowest point
_DEPTHS = {"I;16": 65535.0, "I": 65535.0, "L": 255.0, "1": 1.0}  # white, by Pillow's mode


@dataclass(frozen=True, eq=False)
class Heightfield:
    """Heights over a grid of square cells; between its nodes, MuJoCo's triangles.

    Each cell is two; they share its diagonal from the node of least x and y to that of most.
    """

    heights: np.ndarray  # (rows, columns) float32, m: rows along y, columns along x
    cell: float  # m between nodes
    origin: tuple[float, float]  # m, x and y of node [0, 0]

    @property
    def size(self) -> tuple[float, float]:
        """Length along x and width along y, m."""
        rows, columns = self.heights.shape
        return (columns - 1) * self.cell, (rows - 1) * self.cell

    def compute_height(self, points: np.ndarray) -> np.ndarray:
        """Return the height (...), m, at `points` (..., 2), m; beyond an edge, that of the edge."""
        shape = np.array(self.heights.shape[::-1])
        at = np.clip((np.asarray(points) - self.origin) / self.cell, 0, shape - 1)
        corner = np.minimum(at.astype(int), shape - 2)
        j, i = np.moveaxis(corner, -1, 0)
        u, v = np.moveaxis(at - corner, -1, 0)
        h = self.heights
        third = np.where(u > v, h[i, j + 1], h[i + 1, j])
        first, last = np.maximum(u, v), np.minimum(u, v)
        return h[i, j] * (1 - first) + third * (first - last) + h[i + 1, j + 1] * last


def make_field(heights: np.ndarray, cell: float) -> Heightfield:
    """Return `heights` (rows, columns), m, as a field with the middle of its grid at x = y = 0.

    Rows are `cell` m apart along y, columns along x.
    """
    rows, columns = heights.shape
    origin = (-0.5 * (columns - 1) * cell, -0.5 * (rows - 1) * cell)
    return Heightfield(np.asarray(heights, np.float32), cell, origin)


def read_heights(path: Path, white: float) -> np.ndarray:
    """Read heights (rows, columns), m, from an .npy file of numbers in m or from a gray PNG.

    The first row has the least y. In a picture, which is read from its bottom up, black is 0 and
    white is `white` m. Raises `UserError` that names the file and what is expected.
    """
    path = Path(path)
    what = f"the terrain {path}"
    expected = "a gray PNG, or an .npy file of a two-dimensional array of heights in m"
    if path.suffix not in (".png", ".npy"):
        raise UserError(f"{what} is of no known kind; expected {expected}")
    try:
        heights = np.load(path) if path.suffix == ".npy" else _read_picture(path, white)
    except (OSError, ValueError, EOFError, SyntaxError, Image.DecompressionBombError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise UserError(f"cannot read {what}: {get_os_reason(error)}") from None
        raise UserError(f"{what} cannot be read; expected {expected}") from None
    if not isinstance(heights, np.ndarray) or heights.dtype.kind not in "iuf":
        raise UserError(f"{what} does not hold an array of numbers; expected {expected}")
    if heights.ndim != 2 or min(heights.shape) < 2:
        shape = f"the shape {heights.shape}; expected two dimensions of at least 2 nodes"
        raise UserError(f"{what} has {shape}")
    if not np.all(np.isfinite(heights)):
        raise UserError(f"{what} has heights that are not finite; expected numbers")
    return np.asarray(heights, np.float32)


def _read_picture(path: Path, white: float) -> np.ndarray:
    """Return the heights (rows, columns), m, of a gray PNG, from its bottom row up."""
    with Image.open(path, formats=["PNG"]) as picture:
        # Without a palette: its numbers are no heights.
        gray = picture if picture.mode in _DEPTHS else picture.convert("L")
        return white * np.asarray(gray, np.float64)[::-1] / _DEPTHS[gray.mode]


def lay(spec: mujoco.MjSpec, field: Heightfield) -> None:
    """Make the floor of `spec` the heightfield `field`; its name, friction and the like stay."""
    low, high = float(field.heights.min()), float(field.heights.max())
    height = max(high - low, 1e-3)  # MuJoCo wants one even for a level field
    rows, columns = field.heights.shape
    length, width = field.size
    grid = spec.hfield(FLOOR) if has_field(spec) else spec.add_hfield(name=FLOOR)
    grid.nrow, grid.ncol = rows, columns
    grid.size = [length / 2, width / 2, height, BASE]
    # As shares of the height, the lowest 0: whatever is given, MuJoCo scales it to [0, 1].
    grid.userdata = ((field.heights.astype(np.float64) - low) / height).ravel()
    floor = spec.geom(FLOOR)
    x, y = field.origin
    floor.type = mujoco.mjtGeom.mjGEOM_HFIELD
    floor.hfieldname = FLOOR
    floor.pos = [x + length / 2, y + width / 2, low]


def has_field(spec: mujoco.MjSpec) -> bool:
    """Return True if the floor of `spec` is a heightfield."""
    return bool(spec.geom(FLOOR).type == mujoco.mjtGeom.mjGEOM_HFIELD)


def compute_floor_height(model: mujoco.MjModel, points: np.ndarray) -> np.ndarray:
    """Return the height (...), m, of a model's floor at `points` (..., 2), m; 0 for a plane."""
    field = read_field(model)
    return np.zeros(np.shape(points)[:-1]) if field is None else field.compute_height(points)


def read_field(model: mujoco.MjModel) -> Heightfield | None:
    """Return the heightfield of a model's floor, rounded as MuJoCo stores it; None for a plane."""
    floor = model.geom(FLOOR)
    if floor.type[0] != mujoco.mjtGeom.mjGEOM_HFIELD:
        return None
    which = int(floor.dataid[0])
    rows, columns = int(model.hfield_nrow[which]), int(model.hfield_ncol[which])
    first = int(model.hfield_adr[which])
    shares = model.hfield_data[first : first + rows * columns].astype(np.float64)
    half_length, half_width, height, _ = model.hfield_size[which]
    heights = (floor.pos[2] + height * shares).astype(np.float32).reshape(rows, columns)
    origin = (float(floor.pos[0] - half_length), float(floor.pos[1] - half_width))
    return Heightfield(heights, float(2 * half_length / (columns - 1)), origin)
