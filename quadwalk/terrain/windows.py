"""Windows of a field, the ground near a robot alone, for models that each have their own.

A model holds all of its floor's heights; a thousand that differ would hold a thousand copies.
"""

import math
from dataclasses import replace

import mujoco
import numpy as np

from quadwalk.robot.quadruped import Quadruped
from quadwalk.terrain.heightfield import FLOOR, Heightfield, lay, make_field

STRIDE = 2.0  # m from one window to the next


class Windows:
    """Overlapping squares of the field that a model's floor is.

    No part of a robot is beyond the one whose middle is nearest to its trunk. In a model of a
    window, that middle is at x = y = 0.
    """

    def __init__(self, model: mujoco.MjModel, field: Heightfield) -> None:
        self._shares = model.hfield_data.reshape(field.heights.shape)
        self._field = field
        self._stride = max(round(STRIDE / field.cell), 1)  # nodes
        self._half = self._stride // 2 + math.ceil(measure_reach(model) / field.cell) + 1  # nodes

    def find_windows(self, places: np.ndarray) -> np.ndarray:
        """Return which windows (n, 2) are under `places` (n, 2), m."""
        at = (places - self._field.origin) / (self._stride * self._field.cell)
        return np.rint(at).astype(int)

    def compute_middles(self, windows: np.ndarray) -> np.ndarray:
        """Return the places (n, 2), m, of the middles of `windows` (n, 2)."""
        return self._field.origin + windows * (self._stride * self._field.cell)

    def put_window(self, model: mujoco.MjModel, window: tuple[int, int]) -> None:
        """Put this window into a model from `make_model`, or into a copy of it."""
        nodes = [
            np.clip(at * self._stride + np.arange(-self._half, self._half + 1), 0, count - 1)
            for at, count in zip(reversed(window), self._shares.shape, strict=True)
        ]
        model.hfield_data[:] = self._shares[np.ix_(*nodes)].ravel()

    def make_model(self, quadruped: Quadruped, timestep: float) -> mujoco.MjModel:
        """Return the full model on a window; `put_window` puts others in its place."""
        # As high and as low as the field, of whose height the shares are.
        heights = np.full((2 * self._half + 1,) * 2, self._field.heights.min())
        heights[0, 0] = self._field.heights.max()
        spec = quadruped.spec.copy()
        lay(spec, make_field(heights, self._field.cell))
        return replace(quadruped, spec=spec).make_full_model(timestep, visuals=False)


def measure_reach(model: mujoco.MjModel) -> float:
    """Return the farthest that any part of a model's robot gets from its trunk's origin, m."""
    trunk = int(model.jnt_bodyid[0])
    far = np.zeros(model.nbody)
    for body in range(trunk + 1, model.nbody):
        far[body] = far[model.body_parentid[body]] + np.linalg.norm(model.body_pos[body])
    size = np.linalg.norm(model.geom_pos, axis=1) + model.geom_rbound
    of_robot = np.arange(model.ngeom) != model.geom(FLOOR).id
    return float(np.max((far[model.geom_bodyid] + size)[of_robot]))
