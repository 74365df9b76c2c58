"""Pictures of an episode: a film strip, a video."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from quadwalk.evaluation.gait import find_middle_strides
from quadwalk.evaluation.metrics import average_windows, rotate_planar, to_roll_pitch_yaw
from quadwalk.evaluation.rollout import Rollout
from quadwalk.render.canvas import Camera, Canvas
from quadwalk.render.images import FPS, make_film_strip, save_video
from quadwalk.robot.quadruped import Quadruped
from quadwalk.terrain.heightfield import compute_floor_height

_SMOOTHING = 0.8  # s: the camera follows the mean of this much of the path, not each step's sway
_STRIP = (4, 2)  # pictures of a stride across, strides down
_WITHOUT_STRIDES = 0.7  # s shown of a robot that makes none


def draw_film_strip(
    rollout: Rollout, quadruped: Quadruped, width: int = 480, height: int = 300
) -> np.ndarray:
    """Return eight pictures of two strides in the middle of the episode, as one, uint8.

    Each picture is `width` by `height` pixels. A row is one stride, so pictures one above the other
    show the same moment of it.
    """
    across, down = _STRIP
    start, end = find_middle_strides(rollout, down, otherwise=_WITHOUT_STRIDES)
    rows = np.linspace(start, end, across * down, endpoint=False).round().astype(int)
    return make_film_strip(list(_draw_pictures(rollout, quadruped, rows, width, height)), across)


def render_video(
    rollout: Rollout,
    quadruped: Quadruped,
    path: str | Path,
    seconds: float = 3.0,
    width: int = 480,
    height: int = 300,
) -> None:
    """Write a video of up to `seconds` from the middle of the episode to `path`, in real time.

    It is an MP4 if `path` ends so, or a GIF. A picture is `width` by `height` pixels.
    """
    span = min(seconds, rollout.steps * rollout.control_dt)
    start = (rollout.steps * rollout.control_dt - span) / 2
    times = start + np.arange(max(round(span * FPS), 1)) / FPS
    rows = np.clip((times / rollout.control_dt).round().astype(int), 0, rollout.steps)
    save_video(_draw_pictures(rollout, quadruped, rows, width, height), path)


def _draw_pictures(
    rollout: Rollout, quadruped: Quadruped, rows: np.ndarray, width: int, height: int
) -> Iterator[np.ndarray]:
    """Yield a picture of each of the states `rows`, with its time and speed written on it.

    The speed is that along world x; with velocity commands it is that along the heading.
    """
    model = quadruped.make_full_model()
    canvas = Canvas(model, width, height)
    focus = _compute_camera_path(rollout, compute_floor_height(model, rollout.qpos[:, :2]))
    velocity = rollout.qvel[:, :2].T
    if rollout.command is not None:
        velocity = rotate_planar(velocity, -to_roll_pitch_yaw(rollout.qpos[:, 3:7])[:, 2])
    font = ImageFont.load_default(size=max(height // 20, 10))
    for row in rows:
        camera = Camera(focus[row], distance=1.45, azimuth=118.0, elevation=-14.0)
        picture = Image.fromarray(canvas.draw(rollout.qpos[row], camera))
        text = f"{row * rollout.control_dt:.2f} s   {velocity[0, row]:z.1f} m/s"
        ImageDraw.Draw(picture).text((8, 6), text, fill=(30, 34, 40), font=font)
        yield np.asarray(picture)


def _compute_camera_path(rollout: Rollout, ground: np.ndarray) -> np.ndarray:
    """Return the points that the camera looks at, (T + 1, 3) m: above the smoothed path.

    `ground` (T + 1,), m, is the height under the trunk.
    """
    width = max(round(_SMOOTHING / rollout.control_dt) // 2 * 2 + 1, 1)
    path = np.concatenate([rollout.qpos[:, :2].astype(float), ground[:, None]], axis=1)
    padded = np.pad(path, ((width // 2, width // 2), (0, 0)), "edge")
    smooth = average_windows(padded, width)
    smooth[:, 2] += 0.75 * np.median(rollout.qpos[:, 2] - ground)
    return smooth
