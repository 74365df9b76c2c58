"""Windows: squares of a large heightfield, each as much ground as one robot can touch.

A MuJoCo model holds all of its floor's heights. A model for each robot would hold a copy of the
whole field; a model of a window holds only the ground near its robot.
"""

import math
from dataclasses import replace

import mujoco
import numpy as np

from quadwalk.robot.quadruped import Quadruped
from quadwalk.terrain.heightfield import FLOOR, Heightfield, lay, make_field

STRIDE = 2.0  # m from one window to the next


class Windows:
    """Overlapping squares of the heightfield `field`, which is the floor of `model`.

    A window has two indices, along x and along y. The window whose middle is nearest to a robot's
    trunk has all ground that the robot can touch. In a model from `make_model` the middle of its
    window is at x = y = 0. Beyond the field a window continues the heights of the field's edge.
    """

    def __init__(self, model: mujoco.MjModel, field: Heightfield) -> None:
        self._shares = model.hfield_data.reshape(field.heights.shape)
        self._field = field
        self._stride = max(round(STRIDE / field.cell), 1)  # nodes
        self._half = self._stride // 2 + math.ceil(measure_reach(model) / field.cell) + 1  # nodes

    def find_windows(self, places: np.ndarray) -> np.ndarray:
        """Return the indices (n, 2) of the windows with middles nearest to `places` (n, 2), m."""
        at = (places - self._field.origin) / (self._stride * self._field.cell)
        return np.rint(at).astype(int)

    def compute_middles(self, windows: np.ndarray) -> np.ndarray:
        """Return the middles (n, 2), m, of the windows with indices `windows` (n, 2)."""
        return self._field.origin + windows * (self._stride * self._field.cell)

    def put_window(self, model: mujoco.MjModel, window: tuple[int, int]) -> None:
        """Write the heights of the window with these indices into `model`, in place.

        `model` is from `make_model`, or a copy of such a model.
        """
        nodes = [
            np.clip(at * self._stride + np.arange(-self._half, self._half + 1), 0, count - 1)
            for at, count in zip(reversed(window), self._shares.shape, strict=True)
        ]
        model.hfield_data[:] = self._shares[np.ix_(*nodes)].ravel()

    def make_model(self, quadruped: Quadruped, timestep: float) -> mujoco.MjModel:
        """Return a model of the robot on ground of a window's size, without what can only be seen.

        Its heights are not those of any window until `put_window` writes them. `timestep` is in s.
        """
        # As high and as low as the field, of whose height the shares are.
        heights = np.full((2 * self._half + 1,) * 2, self._field.heights.min())
        heights[0, 0] = self._field.heights.max()
        spec = quadruped.spec.copy()
        lay(spec, make_field(heights, self._field.cell))
        return replace(quadruped, spec=spec).make_full_model(timestep, visuals=False)


def measure_reach(model: mujoco.MjModel) -> float:
    """Return the greatest distance of any part of a model's robot from its trunk's origin, m.

    No pose exceeds it: it adds up the lengths of the links.
    """
    trunk = int(model.jnt_bodyid[0])
    far = np.zeros(model.nbody)
    for body in range(trunk + 1, model.nbody):
        far[body] = far[model.body_parentid[body]] + np.linalg.norm(model.body_pos[body])
    size = np.linalg.norm(model.geom_pos, axis=1) + model.geom_rbound
    of_robot = np.arange(model.ngeom) != model.geom(FLOOR).id
    return float(np.max((far[model.geom_bodyid] + size)[of_robot]))
