"""Pictures as files."""

import os
import sys

import numpy as np
import pytest
from PIL import Image

from quadwalk.errors import UserError
from quadwalk.render.images import make_film_strip, save_png, save_video

# Stands in for ffmpeg: writes the size of its input file, or fails.
FFMPEG = """#!{python}
import os, sys
if {fails}:
    sys.exit("no such\\nencoder")
open(sys.argv[-1], "w").write(str(os.path.getsize(sys.argv[sys.argv.index("-i") + 1])))
"""


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    """Return ten pictures of a square that moves to the right."""
    pictures = np.full((10, 40, 60, 3), 200, np.uint8)
    for index, picture in enumerate(pictures):
        picture[10:20, 4 * index : 4 * index + 10] = (250, 120, 0)
    return list(pictures)


def test_a_png_has_the_pixels_and_always_the_same_bytes(pictures, tmp_path):
    for name in ("a.png", "b.png"):
        save_png(pictures[3], tmp_path / name)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), pictures[3])
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with pytest.raises(UserError, match=r"^cannot write .*none.*: No such file or directory$"):
        save_png(pictures[0], tmp_path / "none" / "a.png")


def test_a_film_strip_is_read_like_a_page(pictures):
    strip = make_film_strip(pictures[:5], across=3)
    assert strip.shape == (2 * 40 + 4, 3 * 60 + 2 * 4, 3)
    for index, (top, left) in enumerate([(0, 0), (0, 64), (0, 128), (44, 0), (44, 64)]):
        np.testing.assert_array_equal(strip[top : top + 40, left : left + 60], pictures[index])
    assert (strip[40:44] == 255).all()
    assert (strip[44:, 128:] == 255).all()


def test_a_gif_plays_them_in_real_time(pictures, tmp_path):
    save_video(iter(pictures), tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as gif:
        assert (gif.n_frames, gif.info["duration"], gif.info["loop"]) == (10, 40, 0)
        for index, picture in enumerate(pictures):
            gif.seek(index)
            difference = np.abs(np.asarray(gif.convert("RGB")).astype(int) - picture)
            assert difference.max() < 16


@pytest.mark.parametrize("fails", [False, True])
def test_an_mp4_is_what_ffmpeg_makes_of_the_pictures(pictures, tmp_path, monkeypatch, fails):
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text(FFMPEG.format(python=sys.executable, fails=fails))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent))
    video = tmp_path / "a.mp4"
    if fails:
        with pytest.raises(UserError) as caught:
            save_video(pictures, video)
        assert str(caught.value) == f"cannot write {video}: ffmpeg: no such encoder"
        assert os.listdir(tmp_path) == ["bin"]
    else:
        save_video(pictures, video)
        assert video.read_text() == str(10 * 40 * 60 * 3)


def test_an_mp4_without_ffmpeg_is_one_line(pictures, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UserError, match=r"^an MP4 needs ffmpeg on the PATH, or: "):
        save_video(pictures, tmp_path / "a.mp4")
    assert os.listdir(tmp_path) == []
