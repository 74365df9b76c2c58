"""Pictures as files: PNG, a film strip, GIF, MP4."""

import itertools
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from quadwalk.cli.shell import suggest_install
from quadwalk.errors import UserError
from quadwalk.files import open_atomic

FPS = 25  # of a video; a GIF counts in hundredths of a second: 4 of them
_GAP = 4  # pixels between the pictures of a strip


def save_png(pixels: np.ndarray, path: str | Path) -> None:
    """Write (height, width, 3) uint8 as PNG, always the same bytes, or raise a `UserError`."""
    with open_atomic(path) as file:
        Image.fromarray(pixels).save(file, format="PNG", optimize=True)


def make_film_strip(pictures: list[np.ndarray], across: int) -> np.ndarray:
    """Join pictures (h, w, 3) of one size into one, (H, W, 3) uint8, with white gaps.

    There are `across` pictures in a row; the rest of the last row is white.
    """
    height, width, _ = pictures[0].shape
    down = -(-len(pictures) // across)
    size = (down * (height + _GAP) - _GAP, across * (width + _GAP) - _GAP, 3)
    strip = np.full(size, 255, np.uint8)
    for index, picture in enumerate(pictures):
        top, left = index // across * (height + _GAP), index % across * (width + _GAP)
        strip[top : top + height, left : left + width] = picture
    return strip


def save_video(pictures: Iterable[np.ndarray], path: str | Path, fps: float = FPS) -> None:
    """Write pictures (height, width, 3) of one size, `fps` a second: MP4 if `path` ends so, or GIF.

    An MP4 needs ffmpeg on the PATH or the package imageio-ffmpeg. Raises `UserError` where that is
    missing or the file cannot be written.
    """
    if Path(path).suffix.lower() == ".mp4":
        _save_mp4(iter(pictures), path, fps)
    else:
        _save_gif((Image.fromarray(picture) for picture in pictures), path, fps)


def _save_gif(pictures: Iterator[Image.Image], path: str | Path, fps: float) -> None:
    """Write pictures of one size as a GIF that repeats, `fps` a second, with one palette."""
    first = next(pictures)
    # One palette for all: each picture's own would make the background flicker.
    palette = first.quantize(128, method=Image.Quantize.MEDIANCUT)

    def reduce_colors(picture: Image.Image) -> Image.Image:
        return picture.quantize(palette=palette, dither=Image.Dither.NONE)

    with open_atomic(path) as file:
        reduce_colors(first).save(
            file,
            format="GIF",
            save_all=True,
            append_images=map(reduce_colors, pictures),
            duration=round(1000 / fps),
            loop=0,
        )


def _save_mp4(pictures: Iterator[np.ndarray], path: str | Path, fps: float) -> None:
    """Write pictures (height, width, 3) of one size as H.264 in MP4, `fps` a second, by ffmpeg."""
    ffmpeg = _find_ffmpeg()
    first = next(pictures)
    height, width, _ = first.shape
    # H.264 in MP4 is not written front to back, so it cannot go straight to `file`.
    with tempfile.TemporaryDirectory() as folder, open_atomic(path) as file:
        frames, video = Path(folder) / "frames.rgb", Path(folder) / "video.mp4"
        with open(frames, "wb") as raw:
            raw.writelines(picture.tobytes() for picture in itertools.chain([first], pictures))
        command = [ffmpeg, "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        command += ["-s", f"{width}x{height}", "-r", str(fps), "-i", str(frames), "-an"]
        # yuv420p is what browsers play; +bitexact leaves out versions and dates.
        command += ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-fflags", "+bitexact", str(video)]
        result = subprocess.run(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE)
        if result.returncode:
            reason = " ".join(result.stderr.decode(errors="replace").split())
            raise UserError(f"cannot write {path}: ffmpeg: {reason or 'failed'}")
        file.write(video.read_bytes())


def _find_ffmpeg() -> str:
    """Return the path of ffmpeg; `UserError` if there is none."""
    program = shutil.which("ffmpeg")
    if program is not None:
        return program
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise UserError(
            f"an MP4 needs ffmpeg on the PATH, or: {suggest_install('video')}; a GIF needs neither"
        ) from None
