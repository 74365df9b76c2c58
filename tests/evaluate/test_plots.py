"""The report: drawn for any episode, however short, and whole or absent."""

import dataclasses
import os
import warnings

import numpy as np
import pytest
from PIL import Image

from quadwalk.errors import UserError
from quadwalk.evaluate.report.plots import draw_report, plot_report
from quadwalk.evaluate.rollout import first_steps


@pytest.fixture(autouse=True)
def no_warnings():
    # A layout that does not fit, or a limit that is not finite, comes as a warning.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_a_report_is_a_picture(trot, quadruped, tmp_path):
    path = tmp_path / "report.png"
    plot_report(trot, quadruped, path, title="run one")
    picture = np.asarray(Image.open(path).convert("L"))
    assert picture.shape == (1800, 1600)
    assert picture.std() > 20
    assert os.listdir(tmp_path) == ["report.png"]


def test_the_same_episode_gives_the_same_bytes(trot, quadruped, tmp_path):
    for name in ("a.png", "b.png"):
        plot_report(trot, quadruped, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_the_report_says_what_is_in_it(trot, quadruped):
    figure = draw_report(dataclasses.replace(trot, episode=3, seed=5, end="low"), quadruped, "try")
    headline = figure.get_suptitle()
    assert headline.startswith("try\naliengo, episode 3, seed 5  ·  fell (low) after 2.0 s")
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert len(titles) == 11
    assert all(titles)
    feet = [label.get_text()[:2] for label in figure.axes[0].get_yticklabels()]
    assert feet == ["RR", "RL", "FR", "FL"]
    rewards = next(axes for axes in figure.axes if axes.get_title(loc="left").startswith("Reward"))
    names = [text.get_text().split()[0] for text in rewards.get_legend().get_texts()]
    assert names == ["total", *trot.reward_terms]


def test_commands_are_drawn_beside_what_became_of_them(trot, quadruped):
    told = np.tile([0.5, -0.25, 1.0], (trot.steps, 1))
    figure = draw_report(dataclasses.replace(trot, command=told), quadruped)
    axes = next(axes for axes in figure.axes if "command" in axes.get_title(loc="left"))
    dashed = [line.get_ydata() for line in axes.lines if line.get_linestyle() == "--"]
    np.testing.assert_array_equal(np.transpose(dashed), told)


@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("steps", [0, 1, 2])
def test_a_fall_at_once(trot, quadruped, tmp_path, steps, told):
    command = np.zeros((trot.steps, 3)) if told else None
    rollout = first_steps(dataclasses.replace(trot, command=command, end="tipped"), steps)
    plot_report(rollout, quadruped, tmp_path / "report.png")


def test_states_that_are_not_finite_are_left_out(trot, quadruped, tmp_path):
    qpos = trot.qpos.copy()
    qpos[60:] = np.nan
    rollout = dataclasses.replace(trot, qpos=qpos, end="nan")
    plot_report(rollout, quadruped, tmp_path / "report.png")


def test_an_unwritable_place_is_one_line(trot, quadruped, tmp_path):
    with pytest.raises(UserError, match=r"^cannot write .*: No such file or directory$"):
        plot_report(trot, quadruped, tmp_path / "missing" / "report.png")
