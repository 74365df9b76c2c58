"""One way to draw a MuJoCo model: with a GL library where one works, else with a ray caster."""

import weakref
from dataclasses import dataclass

import mujoco
import numpy as np

from quadwalk.render.opengl import GlPainter, find_working_library
from quadwalk.render.raycast import RayPainter


@dataclass(frozen=True)
class Camera:
    """A view of the world; angles, degrees, are of the line of sight, as MuJoCo's."""

    lookat: tuple[float, ...] | np.ndarray  # (3,) m, what is in the middle of the picture
    distance: float  # m, from there to the eye
    azimuth: float
    elevation: float


class Canvas:
    """Draws poses of `model` as pictures of `width` by `height` pixels, with its visual shapes."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 1000)
        # A mirror image in the floor costs as much again as the picture itself.
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        library = find_working_library()
        self._painter: GlPainter | RayPainter
        if library is None:
            self._painter = RayPainter(model, width, height)
        else:
            self._painter = GlPainter(model, width, height, library)
            weakref.finalize(self, self._painter.close)
        self.library = library or "rays"  # what draws

    def draw(self, qpos: np.ndarray, camera: Camera) -> np.ndarray:
        """(height, width, 3) uint8 picture of the pose `qpos` (nq,)."""
        data, view = self._data, mujoco.MjvCamera()
        data.qpos[:] = qpos
        # Only qpos is known of a state: what is drawn follows from it.
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_camlight(self._model, data)
        view.lookat, view.distance = camera.lookat, camera.distance
        view.azimuth, view.elevation = camera.azimuth, camera.elevation
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._model, data, mujoco.MjvOption(), None, view, everything, self._scene
        )
        return self._painter.paint(data, self._scene)


def render_home(model: mujoco.MjModel, width: int = 1280, height: int = 800) -> np.ndarray:
    """(height, width, 3) uint8 picture of the pose `home` of a model with its visual shapes."""
    home = model.key("home").qpos
    data = mujoco.MjData(model)
    data.qpos[:] = home
    mujoco.mj_kinematics(model, data)
    shapes = model.geom_bodyid > 0
    reach = model.geom_rbound[shapes, None]
    low = (data.geom_xpos[shapes] - reach).min(axis=0)
    high = (data.geom_xpos[shapes] + reach).max(axis=0)
    # The whole robot fits across the picture, and within its 45 degrees of height; what is near,
    # its feet, takes more room than what is far.
    size = high - low
    middle = (low + high) / 2 - [0, 0, 0.12 * size[2]]
    distance = float(max(1.1 * np.linalg.norm(size), 1.6 * size[2]))
    return Canvas(model, width, height).draw(home, Camera(middle, distance, 140.0, -16.0))
