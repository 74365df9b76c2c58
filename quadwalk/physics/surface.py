"""Surfaces of ground that is not level, and the offset surfaces that centers of spheres touch.

A sphere touches ground of triangles where its center touches the ground's offset surface. That runs
a radius above the ground: over slopes it is shifted, around edges round, over notches narrower than
the sphere closed. It is computed once for each radius, on a grid twice as fine as the ground's. A
sphere then costs three reads of it. At the edge of a stair it touches that edge, not the plane of
the triangle below its center.
"""

import functools
import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import maximum_filter

from quadwalk.cores import count_cores
from quadwalk.physics.batching import Shared
from quadwalk.physics.vectors import Array, Vector, cross
from quadwalk.terrain.heightfield import Heightfield

FINER = 2  # cells of an offset surface along one of the ground's
_BAND = 256  # rows of nodes computed at a time, by one of the cores
_CHUNK = 16384  # nodes computed at a time: arrays of so many stay in a core's cache


class Spot(NamedTuple):
    """A place in a grid: its cell and triangle, and where it is in them."""

    corner: Array  # index of its cell's first node
    u: Array  # from that node along x, cells
    v: Array  # from that node along y, cells


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Surface(Shared):
    """Heights on one or more grids of the same nodes.

    Let the grids be an argument of a program: a constant would be compiled into it once for each
    part that reads, at many times the memory.
    """

    grids: jax.Array | np.ndarray  # (k, rows, columns) m
    cell: float = field(metadata={"static": True})  # m
    origin: tuple[float, float] = field(metadata={"static": True})  # m, x and y of node [0, 0]

    def measure(
        self, x: Array, y: Array, which: np.ndarray | int = 0
    ) -> tuple[Array, Array, Array]:
        """Return height, m, and slopes along x and y at places `x`, `y` (...), m, of grid `which`.

        Beyond an edge they are those of the edge. No read is out of bounds, even where x or y is
        NaN.
        """
        spot = self.locate(x, y, which)
        return self.interpolate(spot, self.read(spot))

    def locate(self, x: Array, y: Array, which: np.ndarray | int = 0) -> Spot:
        """Return the spots of the places `x`, `y` (...), m, in grid `which`."""
        _, rows, columns = self.grids.shape
        x = jnp.clip((x - self.origin[0]) / self.cell, 0, columns - 1)
        y = jnp.clip((y - self.origin[1]) / self.cell, 0, rows - 1)
        j = jnp.clip(x.astype(jnp.int32), 0, columns - 2)
        i = jnp.clip(y.astype(jnp.int32), 0, rows - 2)
        return Spot((which * rows + i) * columns + j, x - j, y - i)

    def read(self, spot: Spot) -> Vector:
        """Return the heights, m, at a spot's triangle: of its cell's first, third and last node."""
        columns = self.grids.shape[2]
        grid = jnp.asarray(self.grids, jnp.result_type(spot.u)).reshape(-1)
        third = jnp.where(spot.u > spot.v, 1, columns)
        x, y, z = (
            grid.at[spot.corner + step].get(mode="promise_in_bounds")
            for step in (0, third, columns + 1)
        )
        return x, y, z

    def interpolate(self, spot: Spot, heights: Vector) -> tuple[Array, Array, Array]:
        """Return height, m, and slopes along x and y at `spot`, from its triangle's `heights`."""
        node, third, beyond = heights
        right = spot.u > spot.v
        before, after = third - node, beyond - third
        along, across = jnp.where(right, before, after), jnp.where(right, after, before)
        level = node + spot.u * along + spot.v * across
        return level, along / self.cell, across / self.cell


class Ground(NamedTuple):
    """Ground that is not level, the same for all robots."""

    surface: Surface
    offsets: tuple[Surface, ...]  # for each kind of sphere that may touch it: `Model.contacts`


def make_ground_surface(field: Heightfield) -> Surface:
    """Return the surface of the ground itself."""
    return Surface(field.heights[None], field.cell, field.origin)


def make_offset_surface(field: Heightfield, radii: tuple[float, ...]) -> Surface:
    """Return the surface on which centers of spheres move that roll over the ground `field`.

    It has a grid for each of `radii`, m. Heights are exact at the nodes of the grid and, if the
    ground is a plane, everywhere, to the precision of the heights of `field`.
    """
    fine = _refine(field.heights)
    cell = field.cell / FINER
    return Surface(np.stack([_offset(fine, cell, r) for r in radii]), cell, field.origin)


def compute_contact_frame(along: Array, across: Array) -> tuple[Vector, Vector, Vector]:
    """Return normal and tangents of a surface with slopes `along` x and `across`, as in MuJoCo.

    The first tangent is world y made perpendicular to the normal, or z where the normal is within
    60 degrees of y (mju_makeFrame).
    """
    up = jax.lax.rsqrt(1.0 + along * along + across * across)
    normal = (-along * up, -across * up, up)
    usual = jnp.abs(normal[1]) < 0.5
    y, z = jnp.where(usual, 1.0, 0.0), jnp.where(usual, 0.0, 1.0)
    cosine = jnp.where(usual, normal[1], normal[2])
    length = jax.lax.rsqrt(1.0 - cosine * cosine)
    first = (
        -normal[0] * cosine * length,
        (y - normal[1] * cosine) * length,
        (z - normal[2] * cosine) * length,
    )
    return normal, first, cross(normal, first)


def _refine(heights: np.ndarray) -> np.ndarray:
    """Return `heights` of the same surface with `FINER` = 2 times as many cells each way."""
    rows, columns = heights.shape
    fine = np.empty((2 * rows - 1, 2 * columns - 1), heights.dtype)
    fine[::2, ::2] = heights
    fine[::2, 1::2] = (heights[:, 1:] + heights[:, :-1]) / 2
    fine[1::2, ::2] = (heights[1:] + heights[:-1]) / 2
    fine[1::2, 1::2] = (heights[1:, 1:] + heights[:-1, :-1]) / 2  # the middle of the diagonal
    return fine


def _offset(heights: np.ndarray, cell: float, radius: float) -> np.ndarray:
    """Return the heights of the centers of spheres, m, that touch the ground over each node.

    `heights` (rows, columns), m, are those of the ground, its nodes `cell` m apart. The spheres'
    `radius` is in m.
    """
    radius = radius / cell
    reach = int(np.ceil(radius)) + 1
    edge = reach + 1  # whether a node's ground is bent hangs on those next to it too
    # In units of a cell: slopes are then differences of neighbors.
    padded = np.pad(heights / cell, edge, mode="edge")
    tolerance = 8 * np.finfo(padded.dtype).eps * max(1.0, float(np.abs(padded).max()))
    out = np.empty_like(padded, shape=heights.shape)

    def fill(first: int) -> None:
        band = padded[first : first + _BAND + 2 * edge]
        out[first : first + _BAND] = cell * _offset_band(band, reach, radius, tolerance)

    with ThreadPoolExecutor(count_cores()) as pool:
        list(pool.map(fill, range(0, len(out), _BAND)))
    return out


def _offset_band(padded: np.ndarray, reach: int, radius: float, tolerance: float) -> np.ndarray:
    """Return `_offset` of some rows, in cells, without the `reach` + 1 outermost nodes."""
    edge = reach + 1
    inner = padded[edge:-edge, edge:-edge]
    along = padded[edge:-edge, edge + 1 : padded.shape[1] + 1 - edge] - inner
    across = padded[edge + 1 : padded.shape[0] + 1 - edge, edge:-edge] - inner
    # Right where the ground around a node is a plane.
    out = inner + radius * np.sqrt(1 + along * along + across * across)
    bent = _find_bends(padded, tolerance)
    places = np.flatnonzero(maximum_filter(bent, 2 * reach + 1)[edge:-edge, edge:-edge])
    for first in range(0, len(places), _CHUNK):
        part = places[first : first + _CHUNK]
        rows, columns = np.divmod(part, inner.shape[1])
        middle = (rows + edge) * padded.shape[1] + columns + edge
        near = {
            (i, j): padded.take(middle + i * padded.shape[1] + j)
            for i, j in itertools.product(range(-reach, reach + 1), repeat=2)
        }
        np.put(out, part, _rest_spheres(near, reach, radius))
    return out


def _find_bends(h: np.ndarray, tolerance: float) -> np.ndarray:
    """Return 1 for each node that is not on a plane with its neighbors, else 0."""
    bent = np.zeros(h.shape, np.uint8)
    bent[:, 1:-1] |= np.abs(h[:, 2:] - 2 * h[:, 1:-1] + h[:, :-2]) > tolerance
    bent[1:-1] |= np.abs(h[2:] - 2 * h[1:-1] + h[:-2]) > tolerance
    bent[:-1, :-1] |= np.abs(h[1:, 1:] - h[1:, :-1] - h[:-1, 1:] + h[:-1, :-1]) > tolerance
    return bent


def _rest_spheres(
    heights: dict[tuple[int, int], np.ndarray], reach: int, radius: float
) -> np.ndarray:
    """Return the greatest height at which a triangle, edge or node holds a sphere, in cells.

    The height is that of the center, over a node. `heights` maps (row, column), counted from that
    node, to the ground's heights. `radius` is in cells.
    """
    best = heights[0, 0] + radius
    for i, j in itertools.product(range(-reach, reach), repeat=2):  # cells, by their first nodes
        node, ahead = heights[i, j], heights[i, j + 1]
        left, beyond = heights[i + 1, j], heights[i + 1, j + 1]
        if _compute_distance(i, j, right=True) < radius:
            slopes = (ahead - node, beyond - ahead)
            _hold_by_triangle(best, ahead, slopes, (j + 1, i), (-1, 1), radius)
        if _compute_distance(i, j, right=False) < radius:
            slopes = (beyond - left, left - node)
            _hold_by_triangle(best, left, slopes, (j, i + 1), (1, -1), radius)
        # The edges along x and y from the cell's first node, and its diagonal.
        _hold_by_edge(best, node, ahead, (j, i), (1, 0), radius)
        _hold_by_edge(best, node, left, (j, i), (0, 1), radius)
        _hold_by_edge(best, node, beyond, (j, i), (1, 1), radius)
    return best


@functools.cache
def _compute_distance(i: int, j: int, right: bool) -> float:
    """Return the distance of node 0 from the right or left triangle of cell i, j, in cells."""
    third = (j + 1, i) if right else (j, i + 1)
    a, b, c = np.array([(j, i), third, (j + 1, i + 1)], float)

    def measure_edge(a: np.ndarray, b: np.ndarray) -> float:
        share = np.clip(-a @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        return float(np.linalg.norm(a + share * (b - a)))

    return min(measure_edge(a, b), measure_edge(b, c), measure_edge(c, a))


def _hold_by_triangle(
    best: np.ndarray,
    height: np.ndarray,
    slopes: tuple[np.ndarray, np.ndarray],
    corner: tuple[int, int],
    signs: tuple[int, int],
    radius: float,
) -> None:
    """Raise `best`, in place, to the height at which the inside of a triangle holds the sphere.

    Its right-angled `corner` (x, y) is at `height`; from there it extends to `signs` along x and y.
    """
    gx, gy = slopes
    long = np.sqrt(1 + gx * gx + gy * gy)
    share = radius / long
    # Where the sphere touches the triangle's plane, from that corner.
    u, v = signs[0] * (share * gx - corner[0]), signs[1] * (share * gy - corner[1])
    value = height - corner[0] * gx - corner[1] * gy + radius * long
    value[(u < 0) | (v < 0) | (u + v > 1)] = -np.inf
    np.maximum(best, value, out=best)


def _hold_by_edge(
    best: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    start: tuple[int, int],
    along: tuple[int, int],
    radius: float,
) -> None:
    """Raise `best`, in place, to the height at which an edge or its ends hold the sphere.

    The edge begins at `start` (x, y), where the ground has the height `first`, and ends `along` (x,
    y) from there, at the height `last`.
    """
    length = float(np.hypot(*along))
    ex, ey = along[0] / length, along[1] / length
    foot = -(start[0] * ex + start[1] * ey)  # of the perpendicular, from the edge's start
    aside = radius**2 - (start[0] + foot * ex) ** 2 - (start[1] + foot * ey) ** 2
    if aside <= 0 or max(-foot, foot - length, 0.0) ** 2 >= aside:
        return
    slope = (last - first) / length
    place = slope / np.sqrt(1 + slope * slope)
    place *= np.sqrt(aside)
    np.clip(place, -foot, length - foot, out=place)
    value = first + slope * (foot + place)
    value += np.sqrt(np.maximum(aside - place * place, 0.0))
    np.maximum(best, value, out=best)
