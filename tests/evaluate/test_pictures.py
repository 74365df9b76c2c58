"""Pictures drawn by MuJoCo, where there is a GL library; one clear line where there is none."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from quadwalk.evaluate.render import render_film_strip, render_gif

from quadwalk.errors import UserError
from quadwalk.evaluate import render
from quadwalk.evaluate.trim import first_steps

SMALL = {"width": 96, "height": 64}


@pytest.fixture(scope="module")
def gl(quadruped):
    """Skips where nothing can be drawn."""
    try:
        with render._Canvas(quadruped.full_model(), 16, 16):
            pass
    except UserError as error:
        pytest.skip(f"needs a GL library: {error}")


@pytest.mark.usefixtures("gl")
def test_a_film_strip_shows_the_robot_moving(trot, quadruped, tmp_path):
    path = tmp_path / "strip.png"
    render_film_strip(trot, quadruped, path, **SMALL)
    strip = np.asarray(Image.open(path)).astype(float)
    assert strip.shape == (2 * 64 + 4, 4 * 96 + 12, 3)
    first, second = strip[:64, :96], strip[:64, 100:196]
    # Orange is the robot's: neither sky nor floor have it. It is in the middle of the picture.
    orange = (first[..., 0] > 150) & (first[..., 2] < 90)
    assert 20 < orange.sum() < 1500
    assert abs(np.argwhere(orange).mean(axis=0)[1] - 48) < 24
    assert np.abs(first - second).mean() > 1


@pytest.mark.usefixtures("gl")
def test_a_gif_plays_in_real_time(trot, quadruped, tmp_path):
    path = tmp_path / "a.gif"
    render_gif(trot, quadruped, path, seconds=0.4, **SMALL)
    with Image.open(path) as gif:
        assert gif.n_frames == 10
        assert gif.info["duration"] == 40
        assert gif.info["loop"] == 0
        assert gif.size == (96, 64)


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("steps", [0, 1])
def test_an_episode_without_motion(trot, quadruped, tmp_path, steps):
    render_film_strip(first_steps(trot, steps), quadruped, tmp_path / "a.png", **SMALL)
    render_gif(first_steps(trot, steps), quadruped, tmp_path / "a.gif", **SMALL)


@pytest.mark.usefixtures("gl")
def test_nothing_is_said_on_stderr(tmp_path):
    # Contexts that are left to the interpreter's end complain there.
    script = """
import mujoco
from quadwalk.evaluate.render import _Canvas
from quadwalk.robot.quadruped import load_quadruped
model = load_quadruped().full_model()
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
for _ in range(2):
    with _Canvas(model, 32, 32) as canvas:
        assert canvas.draw(data, data.qpos[:3]).shape == (32, 32, 3)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_without_a_gl_library_one_line_says_so(trot, quadruped, tmp_path, monkeypatch):
    def missing():
        raise ImportError("Unable to load\nOSMesa library")

    monkeypatch.setattr(render, "_context_class", missing)
    with pytest.raises(UserError) as caught:
        render_film_strip(trot, quadruped, tmp_path / "a.png")
    message = str(caught.value)
    assert message.startswith("cannot draw (Unable to load OSMesa library); ")
    assert "libosmesa6" in message
    assert "\n" not in message
    with pytest.raises(UserError):
        render_gif(trot, quadruped, tmp_path / "a.gif")
    assert os.listdir(tmp_path) == []


# What stands in for ffmpeg writes the number of bytes it was given, or fails.
ENCODER = """#!{python}
import sys
data = sys.stdin.buffer.read({most})
if {fails}:
    sys.exit("no such\\nencoder")
open(sys.argv[-1], "w").write(str(len(data)))
"""


@pytest.fixture
def encoder(tmp_path, monkeypatch):
    def install(fails: bool, most: int = -1) -> None:
        program = tmp_path / "bin" / "ffmpeg"
        program.parent.mkdir()
        program.write_text(ENCODER.format(python=sys.executable, fails=fails, most=most))
        program.chmod(0o755)
        monkeypatch.setenv("PATH", str(program.parent))

    return install


@pytest.mark.usefixtures("gl")
def test_an_mp4_is_what_ffmpeg_makes_of_the_pictures(trot, quadruped, tmp_path, encoder):
    encoder(fails=False)
    render_gif(trot, quadruped, tmp_path / "a.mp4", seconds=0.2, **SMALL)
    assert (tmp_path / "a.mp4").read_text() == str(5 * 96 * 64 * 3)


@pytest.mark.usefixtures("gl")
def test_an_ffmpeg_that_fails_is_one_line(trot, quadruped, tmp_path, encoder):
    encoder(fails=True, most=10)  # it stops reading early
    with pytest.raises(UserError) as caught:
        render_gif(trot, quadruped, tmp_path / "a.mp4", seconds=0.4, **SMALL)
    assert str(caught.value) == f"cannot write {tmp_path / 'a.mp4'}: ffmpeg: no such encoder"
    assert [Path(name).name for name in os.listdir(tmp_path)] == ["bin"]


def test_an_mp4_without_ffmpeg_is_one_line(trot, quadruped, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UserError, match=r"^an MP4 needs ffmpeg on the PATH or "):
        render_gif(trot, quadruped, tmp_path / "a.mp4")
    assert os.listdir(tmp_path) == []
