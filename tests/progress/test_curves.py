import itertools
import math

import numpy as np
import pytest

from quadwalk.progress.curves import RANDOMIZED, draw_learning_curve, save_learning_curve

REWARDS = {"train/reward/forward": 2.0, "train/reward/energy": -0.5}
ROWS = [
    {
        "steps": 1000 * k,
        "eval/speed": math.sqrt(k),
        "eval/fall_rate": 1 / k,
        "train/reward": k,
        "train/speed": 9.0,  # not shown: the evaluation environments tell how good the policy is
        "time/elapsed": 30.0 * k,
        **REWARDS,
    }
    for k in range(1, 21)
]


def panels(rows, best=None):
    """Panels by title, without those that are hidden."""
    figure = draw_learning_curve(rows, best)
    figure.draw_without_rendering()
    return {axes.get_title("left"): axes for axes in figure.axes if axes.get_visible()}


def values(axes):
    (line,) = axes.get_lines()
    return line.get_ydata()


def test_every_figure_is_drawn_over_the_steps():
    shown = panels(ROWS)
    del shown[""]  # the axis of minutes
    assert list(shown) == [
        *("Speed, m/s", "Episodes that fell, %", "Reward", "Forward", "Energy"),
    ]
    for axes, key, factor in zip(
        shown.values(),
        ("eval/speed", "eval/fall_rate", "train/reward", *REWARDS),
        (1, 100, 1, 1, 1),
        strict=True,
    ):
        assert values(axes) == pytest.approx([factor * row[key] for row in ROWS])
        assert list(axes.get_lines()[0].get_xdata()) == [row["steps"] for row in ROWS]
        low, high = axes.get_ylim()
        assert low <= min(0, *values(axes)) <= max(0, *values(axes)) <= high


def test_the_levels_of_a_curriculum_are_drawn_by_kind_of_ground():
    rows = [row | {"train/level/stairs_up": row["steps"] / 5000} for row in ROWS]
    shown = panels(rows)
    assert [title for title in shown if title][-3:] == ["Forward", "Energy", "Stairs up"]
    assert values(shown["Stairs up"]) == pytest.approx([row["steps"] / 5000 for row in ROWS])
    alone = [{"steps": 1, "train/level/flat": 2.0}]
    assert values(panels(alone)["Flat"]).tolist() == [2.0]


def test_with_commands_the_largest_panel_shows_the_error_and_not_a_mean_speed():
    rows = [row | {"eval/velocity_error": 1.0 / row["steps"]} for row in ROWS]
    shown = panels(rows)
    assert "Speed, m/s" not in shown
    assert values(shown["Velocity error, m/s"]) == pytest.approx([1 / r["steps"] for r in ROWS])
    standing = panels([row | {"eval/standing": 0.25} for row in ROWS])
    assert set(values(standing["Standing, % of the time"])) == {25.0}


def test_the_best_checkpoint_is_marked():
    for best in (None, 7000):
        shown = panels(ROWS, best)
        for title in ("Speed, m/s", "Episodes that fell, %", "Reward"):
            marks = [line.get_xdata()[0] for line in shown[title].get_lines()[1:]]
            assert marks == ([] if best is None else [7000])
        assert (shown["Speed, m/s"].get_legend() is None) == (best is None)
        assert len(shown["Energy"].get_lines()) == 1


def test_a_note_tells_why_an_evaluation_is_better():
    assert (
        "eval measures without them" in draw_learning_curve(ROWS, 7000, RANDOMIZED).get_suptitle()
    )
    assert draw_learning_curve(ROWS).get_suptitle() == ""


def test_rows_are_drawn_in_the_order_of_their_steps():
    assert list(values(panels(ROWS[::-1])["Reward"])) == list(range(1, 21))


def test_what_is_no_number_is_a_gap():
    for bad in (math.nan, None):
        rows = [*ROWS[:3], {"steps": 4000, "train/reward": bad}, *ROWS[4:]]
        assert list(np.isnan(values(panels(rows)["Reward"]))) == [False] * 3 + [True] + [False] * 16


def test_a_single_point_is_seen():
    for rows, mark in ((ROWS[:1], "."), (ROWS, "None")):
        assert panels(rows)["Reward"].get_lines()[0].get_marker() == mark


@pytest.mark.parametrize("rows", [[], [{"steps": 0}], [{"steps": 5}, {"steps": 6}]])
def test_what_was_never_recorded_leaves_its_panel_empty(rows):
    shown = panels(rows)
    assert len(shown) == 3
    assert all(np.isnan(values(axes)).all() for axes in shown.values())


def test_minutes_stand_above_the_steps_at_which_they_passed():
    top = [axes for axes in draw_learning_curve(ROWS).axes if axes.get_xlabel() == "minutes"]
    assert len(top) == 3
    labels = [tick.get_text() for tick in top[0].get_xticklabels()]
    places = dict(zip(labels, top[0].get_xticks(), strict=True))
    assert places["10"] == pytest.approx(20_000)
    assert places["2"] == pytest.approx(4000)
    # A clock that stands still, or one row, has no course to tell of.
    still = [{**row, "time/elapsed": 3.0} for row in ROWS]
    for rows in (still, ROWS[:1]):
        labels = [
            a.get_xticklabels()
            for a in draw_learning_curve(rows).axes
            if a.get_xlabel() == "minutes"
        ]
        assert all(len(ticks) < 2 for ticks in labels)


def test_every_term_has_a_panel_of_its_own():
    rows = [{"steps": k, **{f"train/reward/term_{n}": n for n in range(13)}} for k in range(3)]
    terms = [axes for title, axes in panels(rows).items() if title.startswith("Term ")]
    assert [values(axes)[0] for axes in terms] == list(range(13))
    boxes = [axes.get_window_extent() for axes in terms]
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


def test_the_same_metrics_give_the_same_picture(tmp_path):
    for name, rows in (("a", ROWS), ("b", ROWS), ("c", ROWS[:9])):
        save_learning_curve(rows, tmp_path / name)
    a, b, c = ((tmp_path / name).read_bytes() for name in "abc")
    assert a == b
    assert a != c
