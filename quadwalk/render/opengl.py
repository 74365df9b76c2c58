"""Pictures by MuJoCo's OpenGL renderer, where the machine has a GL library that works."""

import contextlib
import ctypes.util
import functools
import importlib
import io
import os
import sys
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

_OFF = ("disable", "disabled", "off", "false", "0")  # MuJoCo's words for no in MUJOCO_GL
_TRIAL = """
<mujoco><worldbody><light pos="0 0 3"/><geom type="plane" size="1 1 1"/></worldbody></mujoco>
"""


@functools.cache
def find_working_library() -> str | None:
    """Return the GL library to draw with, "osmesa", "egl" or "window"; None if none works.

    Only the library that `choose_library` names is tried, once in a process.
    """
    library = choose_library()
    if library is None:
        return None
    model = mujoco.MjModel.from_xml_string(_TRIAL)
    data, scene = mujoco.MjData(model), mujoco.MjvScene(model, maxgeom=10)
    mujoco.mj_forward(model, data)
    everything = mujoco.mjtCatBit.mjCAT_ALL
    camera = mujoco.MjvCamera()
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera, everything, scene)
    # The libraries fail as they like: ImportError, AttributeError, RuntimeError, FatalError.
    with _silence(), contextlib.suppress(Exception):
        painter = GlPainter(model, 16, 16, library)
        try:
            return library if painter.paint(data, scene).any() else None
        finally:
            painter.close()
    return None


def choose_library() -> str | None:
    """Return the GL library to try, "osmesa", "egl" or "window" (of a window system), or None.

    `MUJOCO_GL` decides, if it is set: `osmesa`, `egl`, `glfw` (the window system) or `disable`.
    Without it a machine that has a screen, or is not Linux, uses its window system. Others use
    OSMesa or EGL, whichever is installed.
    """
    choice = os.environ.get("MUJOCO_GL", "").strip().lower()
    if choice in _OFF:
        return None
    if choice in ("osmesa", "egl"):
        return choice
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if choice or screen or sys.platform != "linux":
        return "window"
    for library, name in (("OSMesa", "osmesa"), ("EGL", "egl")):
        if ctypes.util.find_library(library):
            return name
    return None


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Return a context that keeps everything from stderr, of C libraries and destructors too."""
    stderr = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stderr(io.StringIO()):
            os.dup2(nowhere.fileno(), 2)
            yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)


class GlPainter:
    """Paints scenes of one model, `width` by `height` pixels, with one of the GL libraries.

    It stands in for `mujoco.Renderer`, whose library is settled when mujoco is first imported, long
    before a picture is needed. Close it: contexts complain at the interpreter's end.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, library: str) -> None:
        self._size = width, height
        self._resources: mujoco.MjrContext | None = None
        self._context: Any = _load_context_class(library)(width, height)
        try:
            self._context.make_current()
            scale = mujoco.mjtFontScale.mjFONTSCALE_100.value
            self._resources = mujoco.MjrContext(model, scale)
            mujoco.mjr_resizeOffscreen(width, height, self._resources)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._resources)
        except BaseException:
            self.close()
            raise

    def paint(self, data: mujoco.MjData, scene: mujoco.MjvScene) -> np.ndarray:
        """Return the picture of a scene made by `mjv_updateScene`, (height, width, 3) uint8."""
        _move_to_origin(scene)
        width, height = self._size
        frame = mujoco.MjrRect(0, 0, width, height)
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        self._context.make_current()
        mujoco.mjr_render(frame, scene, self._resources)
        mujoco.mjr_readPixels(pixels, None, frame, self._resources)
        return pixels[::-1].copy()  # OpenGL's first row is the lowest

    def close(self) -> None:
        """Free the library's resources; it may be called again."""
        if self._resources is not None:
            self._context.make_current()
            self._resources.free()
        if self._context is not None:
            self._context.free()
        self._context = self._resources = None


def _load_context_class(library: str) -> type:
    """Import MuJoCo's class of contexts of this library."""
    module = {"osmesa": "mujoco.osmesa", "egl": "mujoco.egl"}.get(library, "mujoco")
    context: type = importlib.import_module(module).GLContext
    return context


def _move_to_origin(scene: mujoco.MjvScene) -> None:
    """Move the scene and its eye to the origin, and endless planes below the eye, in place.

    MuJoCo's own floor follows the eye only half of the way, so that some 100 m away there is none.
    OpenGL's single precision speckles everything with shadow there. Planes move by whole repeats of
    their texture.
    """
    eye = (scene.camera[0].pos + scene.camera[1].pos) / 2
    offset = np.floor(eye)
    for item in (*scene.geoms[: scene.ngeom], *scene.lights[: scene.nlight], *scene.camera):
        item.pos = item.pos - offset
    for geom in scene.geoms[: scene.ngeom]:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE and not geom.size[:2].any():
            axes = geom.mat.reshape(3, 3)[:, :2]
            repeat = 2 / np.where(geom.texrepeat > 0, geom.texrepeat, 2)  # m
            steps = np.round((eye - offset - geom.pos) @ axes / repeat)
            geom.pos = geom.pos + axes @ (steps * repeat)
