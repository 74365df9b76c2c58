"""Pictures as files: PNG, a film strip, GIF, MP4."""

import contextlib
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
from quadwalk.files import atomic_write

FPS = 25  # of a video; a GIF counts in hundredths of a second: 4 of them
_GAP = 4  # pixels between the pictures of a strip


def save_png(pixels: np.ndarray, path: str | Path) -> None:
    """Write (height, width, 3) uint8 as PNG, always the same bytes, or raise a `UserError`."""
    with atomic_write(path) as file:
        Image.fromarray(pixels).save(file, format="PNG", optimize=True)


def make_film_strip(pictures: list[np.ndarray], across: int) -> np.ndarray:
    """(H, W, 3) uint8: pictures (h, w, 3) of one size, `across` in a row, with white gaps."""
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
            duration=round(1000 / fps),
            loop=0,
        )


def _save_mp4(pictures: Iterator[np.ndarray], path: str | Path, fps: float) -> None:
    program = _ffmpeg()
    first = next(pictures)
    height, width, _ = first.shape
    with tempfile.TemporaryDirectory() as folder, atomic_write(path) as file:
        # H.264 in MP4 is not written front to back, so it cannot go straight to `file`.
        output = Path(folder) / "episode.mp4"
        command = [program, "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        command += ["-s", f"{width}x{height}", "-r", str(fps), "-i", "-", "-an"]
        # yuv420p is what browsers play; +bitexact leaves out versions and dates.
        command += ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-fflags", "+bitexact", str(output)]
        with tempfile.TemporaryFile() as complaints:
            encoder = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=complaints)
            # A broken pipe: it has given up; what it says about that is read below.
            with contextlib.suppress(BrokenPipeError), encoder:
                assert encoder.stdin is not None
                for picture in itertools.chain([first], pictures):
                    encoder.stdin.write(picture.tobytes())
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
                f"an MP4 needs ffmpeg on the PATH, or: {suggest_install('video')}; "
                "a GIF needs neither"
            ) from None
    return program
