"""Pictures of an episode: a film strip, a video."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from quadwalk.evaluation.motion.course import window_means
from quadwalk.evaluation.motion.gait import middle_strides
from quadwalk.evaluation.motion.kinematics import roll_pitch_yaw, turned
from quadwalk.evaluation.rollout import Rollout, finite_part
from quadwalk.render.canvas import Camera, Canvas
from quadwalk.render.images import FPS, make_film_strip, save_video
from quadwalk.robot.quadruped import Quadruped
from quadwalk.terrain.heightfield import heights_under

_SMOOTHING = 0.8  # s: the camera follows the mean of this much of the path, not each step's sway
_STRIP = (4, 2)  # pictures of a stride across, strides down
_WITHOUT_STRIDES = 0.7  # s shown of a robot that makes none


def draw_film_strip(
    rollout: Rollout, quadruped: Quadruped, width: int = 480, height: int = 300
) -> np.ndarray:
    """Return eight pictures of `width` by `height` pixels of two strides in the episode's middle.

    Each line is one stride, so pictures one above the other show it at the same moment.
    """
    rollout = finite_part(rollout)
    across, down = _STRIP
    start, end = middle_strides(rollout, down, otherwise=_WITHOUT_STRIDES)
    rows = np.linspace(start, end, across * down, endpoint=False).round().astype(int)
    return make_film_strip(list(_pictures(rollout, quadruped, rows, width, height)), across)


def middle_rows(rollout: Rollout, count: int, seconds: float) -> np.ndarray:
    """Rows (count,) of states, evenly spaced over the `seconds` about the episode's middle."""
    middle, half = rollout.steps / 2, seconds / rollout.control_dt / 2
    rows = np.linspace(middle - half, middle + half, count).round().astype(int)
    return np.clip(rows, 0, rollout.steps)


def render_video(
    rollout: Rollout,
    quadruped: Quadruped,
    path: str | Path,
    seconds: float = 3.0,
    width: int = 480,
    height: int = 300,
) -> None:
    """Write up to `seconds` from the episode's middle in real time, as `save_video` does."""
    rollout = finite_part(rollout)
    wanted = min(seconds, rollout.steps * rollout.control_dt)
    start = (rollout.steps * rollout.control_dt - wanted) / 2
    times = start + np.arange(max(round(wanted * FPS), 1)) / FPS
    rows = np.clip((times / rollout.control_dt).round().astype(int), 0, rollout.steps)
    save_video(_pictures(rollout, quadruped, rows, width, height), path)


def _pictures(
    rollout: Rollout, quadruped: Quadruped, rows: np.ndarray, width: int, height: int
) -> Iterator[np.ndarray]:
    """Yield pictures of the states `rows` of an episode, with its time and speed written on each.

    The speed is that along world x; with velocity commands it is that along the heading.
    """
    model = quadruped.make_full_model()
    canvas = Canvas(model, width, height)
    focus = _camera_path(rollout, heights_under(model, rollout.qpos[:, :2]))
    velocity = rollout.qvel[:, :2].T
    if rollout.command is not None:
        velocity = turned(velocity, -roll_pitch_yaw(rollout.qpos[:, 3:7])[:, 2])
    font = ImageFont.load_default(size=max(height // 20, 10))
    for row in rows:
        camera = Camera(focus[row], distance=1.45, azimuth=118.0, elevation=-14.0)
        picture = Image.fromarray(canvas.draw(rollout.qpos[row], camera))
        text = f"{row * rollout.control_dt:.2f} s   {velocity[0, row]:z.1f} m/s"
        ImageDraw.Draw(picture).text((8, 6), text, fill=(30, 34, 40), font=font)
        yield np.asarray(picture)


def _camera_path(rollout: Rollout, ground: np.ndarray) -> np.ndarray:
    """(T + 1, 3) m: where the camera looks, above the smoothed path and `ground` (T + 1,), m."""
    width = max(round(_SMOOTHING / rollout.control_dt) // 2 * 2 + 1, 1)
    path = np.concatenate([rollout.qpos[:, :2].astype(float), ground[:, None]], axis=1)
    padded = np.pad(path, ((width // 2, width // 2), (0, 0)), "edge")
    smooth = window_means(padded, width)
    smooth[:, 2] += 0.75 * np.median(rollout.qpos[:, 2] - ground)
    return smooth
