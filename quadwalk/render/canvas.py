"""Pictures of a MuJoCo model, drawn with a GL library where one works, else with a ray caster."""

import weakref
from dataclasses import dataclass

import mujoco
import numpy as np

from quadwalk.render.opengl import GlPainter, find_working_library
from quadwalk.render.raycast import RayPainter


@dataclass(frozen=True)
class Camera:
    """A view of the world; the angles, in degrees, are MuJoCo's, of the line of sight."""

    lookat: tuple[float, ...] | np.ndarray  # (3,) m, in the middle of the picture
    distance: float  # m, from there to the eye
    azimuth: float
    elevation: float


class Canvas:
    """A drawer of poses of `model`, with its visual shapes, `width` by `height` pixels."""

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
        self.library = library or "rays"

    def draw(self, qpos: np.ndarray, camera: Camera) -> np.ndarray:
        """Return a picture of the pose `qpos` (nq,), (height, width, 3) uint8."""
        data, view = self._data, mujoco.MjvCamera()
        data.qpos[:] = qpos
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
    """Return a picture of a model in its pose `home`, (height, width, 3) uint8."""
    home = model.key("home").qpos
    data = mujoco.MjData(model)
    data.qpos[:] = home
    mujoco.mj_kinematics(model, data)
    shapes = model.geom_bodyid > 0
    reach = model.geom_rbound[shapes, None]
    low = (data.geom_xpos[shapes] - reach).min(axis=0)
    high = (data.geom_xpos[shapes] + reach).max(axis=0)
    # The whole robot fits across the picture, and within its 45 degrees of height. Its feet are
    # near and take more room.
    size = high - low
    middle = (low + high) / 2 - [0, 0, 0.12 * size[2]]
    distance = float(max(1.1 * np.linalg.norm(size), 1.6 * size[2]))
    return Canvas(model, width, height).draw(home, Camera(middle, distance, 140.0, -16.0))
