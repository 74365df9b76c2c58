"""Markers of a 3D view around the robot: ground, path so far, velocity and foot forces.

Every message is complete in itself, because a viewer that jumps in time is given only the newest
message of a topic. It stays small: the ground is one grid that follows the robot in whole meters,
and the path is thinned to a bounded number of points. Nearly every byte repeats, and compresses
away. Ground that is not flat is a topic of its own, of one message.
"""

import math

import numpy as np
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from scipy.spatial.transform import Rotation

from quadwalk.evaluation.mcap.encoding import set_pose
from quadwalk.terrain.heightfield import Heightfield

SCENE_PERIOD = 0.06  # s: often enough for arrows, and a third of the bytes of each step
PATH_POINTS = 64  # at most, whatever the episode's length
GRID_HALF_WIDTH = 8  # m around the robot

GROUND_MARGIN = 2.0  # m of uneven ground drawn around the path
GROUND_NODES = 40_000  # of it, at most

_SUN = np.array([-0.55, 0.35, 0.76])  # unit vector toward the light
_VELOCITY_ARROW = 0.25  # m of arrow for 1 m/s
_FORCE_ARROW = 0.3  # m of arrow for the robot's weight on one foot
_HALF = math.sqrt(0.5)


class SceneWriter:
    """Fills one `SceneUpdate` again and again; `world` is the frame everything is drawn in."""

    def __init__(
        self,
        path: np.ndarray,
        velocity: np.ndarray,
        weight: float,
        world: str = "world",
        ground: Heightfield | None = None,
    ) -> None:
        """`path` (T + 1, 3) of the base in m, its `velocity` (T + 1, 3) in m/s, `weight` in N.

        The ground is a grid at height 0; `ground`, where there is any, is drawn by `draw_ground`.
        """
        self._path, self._weight = path, weight
        self._below = np.zeros(len(path)) if ground is None else ground.compute_height(path[:, :2])
        self._speed = np.linalg.norm(velocity, axis=1)
        across = np.linalg.norm(velocity[:, :2], axis=1)
        yaw, pitch = np.arctan2(velocity[:, 1], velocity[:, 0]), -np.arctan2(velocity[:, 2], across)
        # They lay the x axis, which an arrow points along, along the velocity.
        along = Rotation.from_euler("ZY", np.stack([yaw, pitch], axis=1))
        self._along = along.as_quat(scalar_first=True)
        self.message = SceneUpdate()
        floor, track, moving, self._forces = (
            self.message.entities.add(frame_id=world, id=name)
            for name in ("ground", "path", "velocity", "foot_forces")
        )
        self._grid = floor.lines.add(type=LinePrimitive.LINE_LIST, thickness=1.0)
        self._grid.scale_invariant = True
        _set_color(self._grid.color, 0.55, 0.55, 0.6, 0.7)
        self._grid.pose.orientation.w = 1.0
        for x in [] if ground is not None else range(-GRID_HALF_WIDTH, GRID_HALF_WIDTH + 1):
            for y in (-GRID_HALF_WIDTH, GRID_HALF_WIDTH):
                self._grid.points.add(x=x, y=y)
            for y in (-GRID_HALF_WIDTH, GRID_HALF_WIDTH):
                self._grid.points.add(x=y, y=x)
        self._line = track.lines.add(type=LinePrimitive.LINE_STRIP, thickness=0.02)
        self._line.pose.orientation.w = 1.0
        _set_color(self._line.color, 0.1, 0.45, 0.9, 1.0)
        self._arrow = moving.arrows.add(shaft_diameter=0.025, head_diameter=0.05)
        self._arrow.head_length = 0.06
        _set_color(self._arrow.color, 0.95, 0.55, 0.1, 1.0)

    def serialize(self, time: int, scene: tuple[int, np.ndarray, np.ndarray]) -> bytes:
        """Return the message at `time`, ns, of a scene (row, feet, forces).

        `row` is the number of the state, `feet` (4, 3) are in m, `forces` (4,) in N, 0 in the air.
        """
        row, feet, forces = scene
        for entity in self.message.entities:
            entity.timestamp.FromNanoseconds(time)
        x, y, z = (_round(value) for value in self._path[row])
        self._grid.pose.position.x, self._grid.pose.position.y = float(round(x)), float(round(y))
        self._draw_path(row)
        self._draw_velocity(row, (x, y, z))
        self._draw_forces(feet, forces)
        return self.message.SerializeToString()

    def _draw_path(self, row: int) -> None:
        """Draw the path up to state `row` on the ground, thinned to a bounded number of points."""
        # A power of two keeps earlier points where they were when the path is thinned further.
        stride = 1
        while row // stride >= PATH_POINTS - 1:
            stride *= 2
        del self._line.points[:]
        for k in [*range(0, row, stride), row]:
            x, y, _ = self._path[k]
            # Just above the ground, to be seen.
            self._line.points.add(x=_round(x), y=_round(y), z=_round(float(self._below[k]) + 0.01))

    def _draw_velocity(self, row: int, start: tuple[float, float, float]) -> None:
        """Draw the velocity of state `row` as an arrow above the place `start`, m."""
        x, y, z = start
        pose = self._arrow.pose
        set_pose(pose.position, pose.orientation, [x, y, z + 0.25, *map(_round, self._along[row])])
        self._arrow.shaft_length = _round(_VELOCITY_ARROW * self._speed[row])

    def _draw_forces(self, feet: np.ndarray, forces: np.ndarray) -> None:
        """Draw the force (4,), N, on each foot, (4, 3) m, as an arrow upwards; none in the air."""
        del self._forces.arrows[:]
        for (x, y, z), force in zip(feet.tolist(), forces.tolist(), strict=True):
            if not force > 0.0:
                continue
            arrow = self._forces.arrows.add(
                shaft_diameter=0.015, head_diameter=0.03, head_length=0.03
            )
            arrow.shaft_length = _round(_FORCE_ARROW * force / self._weight)
            up = [_HALF, 0.0, -_HALF, 0.0]  # of the arrow's x axis
            set_pose(arrow.pose.position, arrow.pose.orientation, [*map(_round, (x, y, z)), *up])
            _set_color(arrow.color, 0.85, 0.15, 0.2, 1.0)


def draw_ground(field: Heightfield, path: np.ndarray, world: str = "world") -> bytes:
    """Return the message of the ground around `path` (T + 1, 2), m: triangles lit from one side.

    It is an encoded `SceneUpdate` in the frame `world`.
    """
    rows, columns = field.heights.shape
    last = np.array([columns, rows]) - 1
    low, high = (
        np.clip((edge - field.origin) / field.cell, 0, last).astype(int)
        for edge in (path.min(axis=0) - GROUND_MARGIN, path.max(axis=0) + GROUND_MARGIN)
    )
    every = math.ceil(math.sqrt(max(np.prod(high - low + 1) / GROUND_NODES, 1.0)))
    j, i = (np.arange(a, b + 1, every) for a, b in zip(low, high, strict=True))
    heights = field.heights[np.ix_(i, j)].astype(float)
    falling, along = np.gradient(heights, every * field.cell)
    normal = np.stack([-along, -falling, np.ones_like(heights)], axis=-1)
    light = normal @ _SUN / np.linalg.norm(normal, axis=-1)
    update = SceneUpdate()
    triangles = update.entities.add(frame_id=world, id="ground").triangles.add()
    triangles.pose.orientation.w = 1.0
    x, y = (o + field.cell * k for o, k in zip(field.origin, (j, i), strict=True))
    for row, column in np.ndindex(heights.shape):
        place = x[column], y[row], heights[row, column]
        triangles.points.add(
            **{axis: _round(float(p)) for axis, p in zip("xyz", place, strict=True)}
        )
        shade = round(64 * (0.25 + 0.6 * max(light[row, column], 0.0))) / 64
        triangles.colors.add(r=shade, g=0.96875 * shade, b=0.875 * shade, a=1.0)
    first = (np.arange(len(i) - 1)[:, None] * len(j) + np.arange(len(j) - 1)).ravel()
    opposite = first + len(j) + 1
    right = np.stack([first, first + 1, opposite], axis=1)
    left = np.stack([first, opposite, first + len(j)], axis=1)
    triangles.indices.extend(np.concatenate([right, left]).ravel().tolist())
    return update.SerializeToString()


def _round(value: float) -> float:
    """Round to a multiple of 2^-10: fine enough to draw, and short numbers compress."""
    return round(float(value) * 1024) / 1024


def _set_color(color, r: float, g: float, b: float, a: float) -> None:
    """Set the fields of a color, 0 to 1."""
    color.r, color.g, color.b, color.a = r, g, b, a
