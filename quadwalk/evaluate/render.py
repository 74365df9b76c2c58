"""Pictures of an episode as MuJoCo draws it: a film strip, a GIF, an MP4.

Drawn offscreen, by OSMesa (software, Debian's libosmesa6) where there is neither a display nor a
choice in the environment variable MUJOCO_GL (egl, osmesa, glfw).
"""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from quadwalk.errors import UserError
from quadwalk.evaluate.rollout import Rollout, finite_part
from quadwalk.files import atomic_write
from quadwalk.robot.quadruped import Quadruped
from quadwalk.robot.render import NEEDS, choose_backend

FPS = 25  # a GIF counts in hundredths of a second: 4 of them
CAMERA = {"distance": 1.45, "azimuth": 118.0, "elevation": -14.0}  # m, degrees, degrees
_SMOOTHING = 0.8  # s: the camera follows the mean of this much of the path, not each step's sway
_STRIP = (4, 2)  # pictures across and down


def render_film_strip(
    rollout: Rollout,
    quadruped: Quadruped,
    path: str | Path,
    seconds: float = 0.7,
    width: int = 480,
    height: int = 300,
) -> None:
    """Write eight pictures, evenly spaced over the `seconds` about the episode's middle, as a PNG.

    0.7 s are some two strides of a run. `width` and `height` in pixels are those of one picture.
    Raises `UserError` without a GL library or where the file cannot be written.
    """
    rollout = finite_part(rollout)
    across, down = _STRIP
    count = across * down
    rows = middle_rows(rollout, count, seconds)
    gap = 4
    size = (across * (width + gap) - gap, down * (height + gap) - gap)
    strip = Image.new("RGB", size, "white")
    for index, picture in enumerate(_pictures(rollout, quadruped, rows, width, height)):
        place = (index % across * (width + gap), index // across * (height + gap))
        strip.paste(picture, place)
    with atomic_write(path) as file:
        strip.save(file, format="PNG", optimize=True)


def middle_rows(rollout: Rollout, count: int, seconds: float) -> np.ndarray:
    """Rows (count,) of states, evenly spaced over the `seconds` about the episode's middle."""
    middle, half = rollout.steps / 2, seconds / rollout.control_dt / 2
    rows = np.linspace(middle - half, middle + half, count).round().astype(int)
    return np.clip(rows, 0, rollout.steps)


def render_gif(
    rollout: Rollout,
    quadruped: Quadruped,
    path: str | Path,
    seconds: float = 3.0,
    width: int = 480,
    height: int = 300,
) -> None:
    """Write up to `seconds` from the episode's middle in real time; MP4 if `path` ends so.

    An MP4 needs ffmpeg on the PATH or the package imageio-ffmpeg. Raises `UserError` where what is
    needed is missing or the file cannot be written.
    """
    rollout = finite_part(rollout)
    wanted = min(seconds, rollout.steps * rollout.control_dt)
    start = (rollout.steps * rollout.control_dt - wanted) / 2
    times = start + np.arange(max(round(wanted * FPS), 1)) / FPS
    rows = np.clip((times / rollout.control_dt).round().astype(int), 0, rollout.steps)
    pictures = _pictures(rollout, quadruped, rows, width, height)
    if Path(path).suffix.lower() == ".mp4":
        _write_mp4(pictures, path, width, height)
    else:
        _write_gif(pictures, path)


def _write_gif(pictures: Iterator[Image.Image], path: str | Path) -> None:
    first = next(pictures)
    # One palette for all: each picture's own would make the background flicker.
    palette = first.quantize(128, method=Image.Quantize.MEDIANCUT)

    def reduced(picture: Image.Image) -> Image.Image:
        return picture.quantize(palette=palette, dither=Image.Dither.NONE)

    with atomic_write(path) as file:
        reduced(first).save(
            file,
            format="GIF",
            save_all=True,
            append_images=(reduced(picture) for picture in pictures),
            duration=1000 // FPS,
            loop=0,
        )


def _write_mp4(pictures: Iterator[Image.Image], path: str | Path, width: int, height: int) -> None:
    program = _ffmpeg()
    with tempfile.TemporaryDirectory() as folder, atomic_write(path) as file:
        # H.264 in MP4 is not written front to back, so it cannot go straight to `file`.
        output = Path(folder) / "episode.mp4"
        command = [program, "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        command += ["-s", f"{width}x{height}", "-r", str(FPS), "-i", "-", "-an"]
        # yuv420p is what browsers play; +bitexact leaves out versions and dates.
        command += ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-fflags", "+bitexact", str(output)]
        with tempfile.TemporaryFile() as complaints:
            with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=complaints) as encoder:
                assert encoder.stdin is not None
                try:
                    for picture in pictures:
                        encoder.stdin.write(picture.tobytes())
                except BrokenPipeError:
                    pass  # it has given up; what it says about that is read below
            if encoder.returncode:
                complaints.seek(0)
                reason = " ".join(complaints.read().decode(errors="replace").split())
                raise UserError(f"cannot write {path}: ffmpeg: {reason or 'failed'}")
        with open(output, "rb") as source:
            shutil.copyfileobj(source, file)


def _ffmpeg() -> str:
    program = shutil.which("ffmpeg")
    if program is None:
        try:
            import imageio_ffmpeg

            program = imageio_ffmpeg.get_ffmpeg_exe()
        except (ImportError, RuntimeError):
            raise UserError(
                "an MP4 needs ffmpeg on the PATH or pip install imageio-ffmpeg; a GIF needs neither"
            ) from None
    return program


def _pictures(
    rollout: Rollout, quadruped: Quadruped, rows: np.ndarray, width: int, height: int
) -> Iterator[Image.Image]:
    """The states `rows` of an episode, each with its time and speed written on it."""
    model = quadruped.full_model()
    data = mujoco.MjData(model)
    model.mat_reflectance[:] = 0.0  # a mirror image costs as much again as the picture itself
    focus = _camera_path(rollout)
    font = ImageFont.load_default(size=max(height // 20, 10))
    with _Canvas(model, width, height) as canvas:
        for row in rows:
            data.qpos[:] = rollout.qpos[row]
            # Whole metres back to the origin, which the floor's pattern does not show: far from
            # there MuJoCo draws the endless floor with gaps.
            metres = np.append(np.floor(focus[row, :2]), 0.0)
            data.qpos[:3] -= metres
            # Only qpos is known of a state: what is drawn follows from it.
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_camlight(model, data)
            picture = Image.fromarray(canvas.draw(data, focus[row] - metres))
            text = f"{row * rollout.control_dt:.2f} s   {rollout.qvel[row, 0]:.1f} m/s"
            ImageDraw.Draw(picture).text((8, 6), text, fill=(30, 34, 40), font=font)
            yield picture


def _camera_path(rollout: Rollout) -> np.ndarray:
    """(T + 1, 3) m: where the camera looks, the smoothed path of the base at a steady height."""
    width = max(round(_SMOOTHING / rollout.control_dt) // 2 * 2 + 1, 1)
    padded = np.pad(rollout.qpos[:, :2].astype(float), ((width // 2, width // 2), (0, 0)), "edge")
    sums = np.cumsum(np.concatenate([np.zeros((1, 2)), padded]), axis=0)
    smooth = (sums[width:] - sums[:-width]) / width
    height = np.full((len(smooth), 1), 0.75 * np.median(rollout.qpos[:, 2]))
    return np.concatenate([smooth, height], axis=1)


class _Canvas:
    """An offscreen picture of a model. Used instead of `mujoco.Renderer`, whose GL library is
    settled when mujoco is first imported, which may be long before anyone asks for a picture."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
        model.vis.global_.offheight = max(model.vis.global_.offheight, height)
        self._model, self._size = model, (width, height)
        self._context: Any = None
        self._resources: mujoco.MjrContext | None = None

    def __enter__(self) -> Self:
        try:
            self._context = _context_class()(*self._size)
            self._context.make_current()
            self._scene = mujoco.MjvScene(self._model, maxgeom=2000)
            self._resources = mujoco.MjrContext(
                self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value
            )
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._resources)
        except UserError:
            raise
        except Exception as error:  # a GL library fails as it likes: ImportError, FatalError, ...
            self.__exit__(None, None, None)
            reason = " ".join(str(error).split())
            raise UserError(f"cannot draw ({reason}); {NEEDS}") from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # In this order, and here: left to the interpreter's end, both complain on stderr.
        if self._resources is not None:
            self._resources.free()
        if self._context is not None:
            self._context.free()
        self._context, self._resources = None, None

    def draw(self, data: mujoco.MjData, focus: np.ndarray) -> np.ndarray:
        """(height, width, 3) uint8, of a scene whose kinematics are up to date."""
        camera = mujoco.MjvCamera()
        camera.lookat = focus
        for name, value in CAMERA.items():
            setattr(camera, name, value)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._model, data, mujoco.MjvOption(), None, camera, everything, self._scene
        )
        width, height = self._size
        frame = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(frame, self._scene, self._resources)
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, frame, self._resources)
        return pixels[::-1]  # OpenGL's first row is the lowest


def _context_class() -> type:
    """The class of GL contexts to draw in, by MUJOCO_GL, else by what the machine has."""
    choose_backend()
    chosen = os.environ.get("MUJOCO_GL", "").strip().lower()
    if chosen == "osmesa":
        from mujoco.osmesa import GLContext
    elif chosen == "egl":
        from mujoco.egl import GLContext
    else:
        from mujoco import GLContext
    return GLContext
