"""Pictures of an episode, and what they show of it."""

import dataclasses

import numpy as np
import pytest
from PIL import Image

from quadwalk.evaluation.report import pictures
from quadwalk.evaluation.report.pictures import draw_film_strip, render_video
from quadwalk.evaluation.rollout import slice_steps

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


@pytest.mark.parametrize("period", [7, 20, 45])
def test_a_film_strip_is_two_strides_at_the_measured_frequency(
    trot, quadruped, monkeypatch, period
):
    def remember_rows(rollout, quadruped, rows, width, height):
        rows_drawn.extend(rows)
        return [np.zeros((height, width, 3), np.uint8)] * len(rows)

    rows_drawn: list[int] = []
    monkeypatch.setattr(pictures, "_draw_pictures", remember_rows)
    steps = np.arange(trot.steps)
    foot = steps % period < period // 2
    contact = np.stack([foot, ~foot, ~foot, foot], axis=1)
    draw_film_strip(dataclasses.replace(trot, contact=contact), quadruped, **SMALL)
    assert len(rows_drawn) == 8
    # A line of pictures is a stride: the same moments, one period later. Rows are whole.
    np.testing.assert_allclose(np.subtract(rows_drawn[4:], rows_drawn[:4]), period, atol=1)
    np.testing.assert_allclose(np.diff(rows_drawn), period / 4, atol=1)
    assert abs(rows_drawn[4] - trot.steps / 2) <= 1


def test_no_speed_is_written_as_minus_zero(trot, quadruped, monkeypatch):
    def remember_text(self, place, text, **_):
        texts.append(text)

    texts: list[str] = []
    monkeypatch.setattr(pictures.ImageDraw.ImageDraw, "text", remember_text)
    qvel = np.full_like(trot.qvel, -0.01)
    draw_film_strip(dataclasses.replace(trot, qvel=qvel), quadruped, **SMALL)
    assert {text.split("s   ")[1] for text in texts} == {"0.0 m/s"}


def test_with_commands_the_speed_is_that_along_the_heading(trot, quadruped, monkeypatch):
    def remember_text(self, place, text, **_):
        texts.append(text)

    texts: list[str] = []
    monkeypatch.setattr(pictures.ImageDraw.ImageDraw, "text", remember_text)
    qpos, qvel = trot.qpos.copy(), np.zeros_like(trot.qvel)
    qpos[:, 3:7] = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]  # it faces along y
    qvel[:, 1] = 1.5
    command = np.zeros((trot.steps, 3))
    walking = dataclasses.replace(trot, qpos=qpos, qvel=qvel, command=command)
    draw_film_strip(walking, quadruped, **SMALL)
    assert {text.split("s   ")[1] for text in texts} == {"1.5 m/s"}


def test_a_gif_plays_in_real_time(trot, quadruped, tmp_path):
    path = tmp_path / "a.gif"
    render_video(trot, quadruped, path, seconds=0.4, **SMALL)
    with Image.open(path) as gif:
        assert (gif.n_frames, gif.info["duration"], gif.size) == (10, 40, (96, 64))


@pytest.mark.parametrize("steps", [0, 1])
def test_an_episode_shows_no_more_states_than_it_has(trot, quadruped, tmp_path, steps):
    strip = draw_film_strip(slice_steps(trot, 0, steps), quadruped, **SMALL)
    pictures = {
        strip[y : y + 64, x : x + 96].tobytes() for y in (0, 68) for x in range(0, 400, 100)
    }
    assert len(pictures) == steps + 1
    render_video(slice_steps(trot, 0, steps), quadruped, tmp_path / "a.gif", **SMALL)
    assert Image.open(tmp_path / "a.gif").n_frames == 1
