"""Pictures of an episode: what of it they show."""

import numpy as np
import pytest
from PIL import Image

from quadwalk.evaluate.report.pictures import draw_film_strip, render_video
from quadwalk.evaluate.rollout import first_steps

SMALL = {"width": 96, "height": 64}


def test_a_film_strip_shows_the_robot_moving(trot, quadruped):
    strip = draw_film_strip(trot, quadruped, **SMALL).astype(float)
    assert strip.shape == (2 * 64 + 4, 4 * 96 + 12, 3)
    first, second = strip[:64, :96], strip[:64, 100:196]
    # Orange is the robot's: neither sky nor floor have it. It is in the middle of the picture.
    orange = (first[..., 0] > 150) & (first[..., 2] < 90)
    assert 20 < orange.sum() < 1500
    assert abs(np.argwhere(orange).mean(axis=0)[1] - 48) < 24
    assert np.abs(first - second).mean() > 1


def test_a_gif_plays_in_real_time(trot, quadruped, tmp_path):
    path = tmp_path / "a.gif"
    render_video(trot, quadruped, path, seconds=0.4, **SMALL)
    with Image.open(path) as gif:
        assert (gif.n_frames, gif.info["duration"], gif.size) == (10, 40, (96, 64))


@pytest.mark.parametrize("steps", [0, 1])
def test_an_episode_shows_no_more_states_than_it_has(trot, quadruped, tmp_path, steps):
    strip = draw_film_strip(first_steps(trot, steps), quadruped, **SMALL)
    pictures = {
        strip[y : y + 64, x : x + 96].tobytes() for y in (0, 68) for x in range(0, 400, 100)
    }
    assert len(pictures) == steps + 1
    render_video(first_steps(trot, steps), quadruped, tmp_path / "a.gif", **SMALL)
    assert Image.open(tmp_path / "a.gif").n_frames == 1
