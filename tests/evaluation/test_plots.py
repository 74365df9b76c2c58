"""Plots show what they are drawn from, however short the episode is."""

import dataclasses

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from quadwalk.evaluation.report.comparison import draw_comparison, print_comparison
from quadwalk.evaluation.report.plots import draw_footfalls, draw_report
from quadwalk.evaluation.rollout import slice_steps
from quadwalk.evaluation.sweep import draw_sweep
from quadwalk.render.figures import LEG_COLORS, save_figure

# A layout that does not fit, or a limit that is not finite, comes as a warning.
pytestmark = pytest.mark.filterwarnings("error")


def find_panel(figure: Figure, title: str):
    """Return the panel whose title has these words."""
    (panel,) = [axes for axes in figure.axes if title in axes.get_title(loc="left")]
    return panel


def read_line(figure: Figure, title: str, label: str) -> np.ndarray:
    """Return the values of the line with this label, in the panel of this title."""
    (line,) = [line for line in find_panel(figure, title).lines if line.get_label() == label]
    return np.asarray(line.get_ydata())


def test_the_report_says_what_is_in_it(trot, quadruped):
    figure = draw_report(dataclasses.replace(trot, episode=3, seed=5, end="low"), quadruped, "try")
    headline = figure.get_suptitle()
    assert headline.startswith("try\naliengo, episode 3, seed 5  ·  fell (low) after 2.0 s")
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert len(titles) == 11
    assert all(titles)
    feet = [label.get_text()[:2] for label in figure.axes[0].get_yticklabels()]
    assert feet == ["RL", "RR", "FL", "FR"]  # from the lowest line up
    for title in ("Hip angles", "Calf torques"):
        legend = find_panel(figure, title).get_legend()
        assert [text.get_text() for text in legend.get_texts()] == feet[::-1]
    for axes in figure.axes[1:]:
        assert axes.get_xlabel(), axes.get_title(loc="left")
        assert axes.get_ylabel(), axes.get_title(loc="left")
    rewards = find_panel(figure, "Reward")
    names = [text.get_text().split()[0] for text in rewards.get_legend().get_texts()]
    assert names == ["total", *trot.reward_terms]


def test_the_report_shows_the_episode(trot, quadruped):
    figure = draw_report(trot, quadruped)
    np.testing.assert_array_equal(read_line(figure, "Speed of the base", "ahead"), trot.qvel[:, 0])
    np.testing.assert_array_equal(read_line(figure, "Speed of the base", "left"), trot.qvel[:, 1])
    np.testing.assert_array_equal(read_line(figure, "Height", "height, m"), trot.qpos[:, 2])
    limits = [line.get_ydata()[0] for line in find_panel(figure, "Hip torques").lines[-2:]]
    assert limits == [-quadruped.effort[0], quadruped.effort[0]]


def make_strides(rollout, period: int):
    """Return a rollout whose feet touch the ground for half of every `period` control steps."""
    on = np.arange(rollout.steps)[:, None] + np.array([0, period // 2, period // 2, 0])
    return dataclasses.replace(rollout, contact=on % period < period // 2)


@pytest.mark.parametrize("period", [10, 16])
def test_joints_are_shown_over_two_strides_and_scaled_to_them(trot, quadruped, period):
    figure = draw_report(make_strides(trot, period), quadruped)
    middle = trot.steps // 2
    states = slice(middle - period, middle + period + 1)  # a stride before, a stride after
    angles = find_panel(figure, "Thigh angles")
    np.testing.assert_array_equal(read_line(figure, "Thigh angles", "RL"), trot.qpos[states, 17])
    steps = slice(middle - period, middle + period)
    calf = read_line(figure, "Calf torques", "FL")
    np.testing.assert_array_equal(calf[1:], trot.torque[steps, 5])
    assert angles.get_xlim() == pytest.approx(
        ((middle - period) * trot.control_dt, (middle + period) * trot.control_dt)
    )
    plotted = np.concatenate([trot.qpos[states, 8::3].ravel(), trot.target[steps, 1::3].ravel()])
    low, high = angles.get_ylim()
    assert low < plotted.min() < plotted.max() < high
    assert high - low < 1.5 * np.ptp(plotted)


def test_a_robot_without_strides_is_shown_whole(trot, quadruped):
    still = dataclasses.replace(trot, contact=np.ones((trot.steps, 4), bool))
    figure = draw_report(still, quadruped)
    np.testing.assert_array_equal(read_line(figure, "Thigh angles", "RL"), trot.qpos[:, 17])
    assert "nan" not in figure.get_suptitle()


def test_a_bar_is_a_foot_on_the_ground(trot, quadruped):
    contact = np.zeros((trot.steps, 4), dtype=bool)
    contact[10:25, 1] = contact[50:60, 1] = contact[30:, 2] = True
    axes = Figure().subplots()
    draw_footfalls(axes, dataclasses.replace(trot, contact=contact), quadruped)
    spans_by_color = {}
    for bars in axes.collections:
        spans = [path.get_extents() for path in bars.get_paths()]
        color = to_hex(bars.get_facecolor()[0]) if spans else None
        spans_by_color[color] = [(span.x0, span.x1) for span in spans]
    spans_by_color.pop(None)  # feet that never were
    assert list(spans_by_color) == [LEG_COLORS[2], LEG_COLORS[1]]  # from the lowest line up: RR, FL
    np.testing.assert_allclose(spans_by_color[LEG_COLORS[1]], [(0.2, 0.5), (1.0, 1.2)])
    np.testing.assert_allclose(spans_by_color[LEG_COLORS[2]], [(0.6, 2.0)])


def test_commands_are_drawn_beside_what_became_of_them(trot, quadruped):
    commanded = np.tile([0.5, -0.25, 1.0], (trot.steps, 1))
    figure = draw_report(dataclasses.replace(trot, command=commanded), quadruped)
    axes = find_panel(figure, "velocity command")
    dashed = [line.get_ydata() for line in axes.lines if line.get_linestyle() == "--"]
    np.testing.assert_array_equal(np.transpose(dashed), commanded)
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["forward, m/s", "lateral, m/s", "yaw rate, rad/s"]


@pytest.mark.parametrize("commanded", [False, True])
@pytest.mark.parametrize("steps", [0, 1, 2])
def test_a_fall_at_once(trot, quadruped, steps, commanded):
    command = np.zeros((trot.steps, 3)) if commanded else None
    rollout = slice_steps(dataclasses.replace(trot, command=command, end="tipped"), 0, steps)
    figure = draw_report(rollout, quadruped)
    assert "fell (tipped) after 0.0 s" in figure.get_suptitle()
    assert "strides/s" not in figure.get_suptitle()  # there were none
    np.testing.assert_array_equal(read_line(figure, "Height", "height, m"), rollout.qpos[:, 2])
    for axes in figure.axes:
        assert axes.get_xlim()[0] < axes.get_xlim()[1]
    figure.draw_without_rendering()  # the layout fits, without a warning


def test_a_name_that_looks_like_markup_is_shown_as_it_is(trot, quadruped, tmp_path, capsys):
    name = r"a$\b$ [/red] :b:"
    save_figure(draw_report(trot, quadruped, name), tmp_path / "report.png")
    assert (tmp_path / "report.png").exists()
    summary = {"episodes": 1, "fall_rate": 0.0, "fall_rate_ci95": (0.0, 1.0)}
    result = {"training_steps": 1, "engine": name, "summary": summary}
    print_comparison([name], [result | {"typical_episode": {"gait": name}}])
    assert capsys.readouterr().out.count(name) == 3


def test_a_sweep_is_drawn_point_by_point(tmp_path):
    points = [
        {
            "value": float(value),
            "success": 1.0 - 0.2 * value,
            "success_ci95": [0.9 - 0.2 * value, 1.0],
            "speed": {"mean": 3.0 - value, "ci95": None if value else 0.25},
        }
        for value in range(4)
    ]
    sweep = {"heading": "pushes", "unit": "m/s", "nominal": 1.0, "points": points}
    sweep["range"] = (-1.0, 2.0)  # beyond what is drawn
    sweeps = {str(number): sweep for number in range(6)}
    run = {"run": "one", "seconds": 20.0, "episodes": 8, "sweeps": sweeps}
    figure = draw_sweep([run], ["5", *"01234"], columns=3)
    for name in ("a.png", "b.png"):
        save_figure(figure, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert "one: robustness (8 episodes of 20 s" in figure.get_suptitle()
    assert [axes.get_title(loc="left") for axes in figure.axes[:6]] == ["Pushes, m/s"] * 6
    axes, speed = figure.axes[0], figure.axes[6]
    (shaded,) = axes.patches
    assert (shaded.get_x(), shaded.get_x() + shaded.get_width()) == pytest.approx((-0.15, 2.0))
    nominal, success = axes.lines
    np.testing.assert_allclose(success.get_xydata(), [(0, 100), (1, 80), (2, 60), (3, 40)])
    assert list(nominal.get_xdata()) == [1.0, 1.0]
    band = axes.collections[0].get_paths()[0].vertices
    np.testing.assert_allclose(band[:, 1].max(), 100)
    np.testing.assert_allclose(band[band[:, 0] == 3.0, 1].min(), 30)
    means, (bars,) = speed.containers[0].lines[0], speed.containers[0].lines[2]
    np.testing.assert_allclose(means.get_xydata(), [(0, 3), (1, 2), (2, 1), (3, 0)])
    ends = np.array([segment[:, 1] for segment in bars.get_segments()])
    np.testing.assert_allclose(ends, [(2.75, 3.25), (2, 2), (1, 1), (0, 0)])


def test_the_sweeps_of_two_runs_are_drawn_together():
    def make_result(run, success):
        points = [
            {"value": value, "success": success, "success_ci95": [0.1, 0.9],
             "speed": {"mean": 1.0 + success, "ci95": 0.1}}
            for value in (0.0, 1.0)
        ]  # fmt: skip
        sweep = {"heading": "noise", "unit": "", "nominal": 0.0, "points": points, "range": (0, 1)}
        return {"run": run, "seconds": 20.0, "episodes": 8, "sweeps": {"noise": sweep}}

    figure = draw_sweep([make_result("real", 0.8), make_result("ideal", 0.2)])
    axes = figure.axes[0]
    _, real, ideal = axes.lines
    assert (list(real.get_ydata()), list(ideal.get_ydata())) == ([80, 80], [20, 20])
    assert real.get_color() != ideal.get_color()
    assert [text.get_text() for text in figure.legends[0].get_texts()][:2] == ["real", "ideal"]


def test_each_episode_of_a_comparison_is_a_dot():
    def make_result(speeds, drift):
        return {
            "engine": "mjx",
            "seconds": 20.0,
            "episodes": [{"speed": speed, "lateral_drift": drift} for speed in speeds],
            "summary": {
                "episodes": len(speeds),
                "fall_rate": 0.25,
                "fall_rate_ci95": [0.1, 0.6],
                "speed": {"mean": float(np.mean(speeds)), "ci95": 0.5},
                "lateral_drift": None if drift is None else {"mean": drift, "ci95": 0.0},
            },
        }

    results = [make_result((1.0, 2.0, 4.0), 0.5), make_result((3.0, 5.0), None)]
    figure = draw_comparison(["first", "second"], results)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == ["Episodes that end by a fall, %", "Speed along x, m/s", "Lateral drift, m"]
    falls, speed, drift = figure.axes
    assert [bar.get_height() for bar in falls.patches] == [25.0, 25.0]
    assert [label.get_text() for label in speed.get_xticklabels()] == ["first", "second"]
    dots = [line.get_xydata() for line in speed.lines if line.get_marker() == "o"]
    assert [list(one[:, 1]) for one in dots] == [[1.0, 2.0, 4.0], [3.0, 5.0]]
    assert [round(one[:, 0].mean()) for one in dots] == [0, 1]
    means = [container.lines[0].get_ydata()[0] for container in speed.containers]
    np.testing.assert_allclose(means, [7 / 3, 4.0])
    assert "none" in [text.get_text() for text in drift.texts]
