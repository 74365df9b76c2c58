"""The learning curve: its panels, gaps, marks and second axis."""

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


def draw_panels(rows, best=None):
    """Return panels by title, without those that are hidden."""
    figure = draw_learning_curve(rows, best)
    figure.draw_without_rendering()
    return {axes.get_title("left"): axes for axes in figure.axes if axes.get_visible()}


def get_values(axes):
    (line,) = axes.get_lines()
    return line.get_ydata()


def test_every_figure_is_drawn_over_the_steps_in_their_order():
    panels = draw_panels(ROWS[::-1])
    del panels[""]  # the axis of minutes
    assert list(panels) == [
        *("Speed, m/s", "Episodes that fell, %", "Reward", "Forward", "Energy"),
    ]
    for axes, key, factor in zip(
        panels.values(),
        ("eval/speed", "eval/fall_rate", "train/reward", *REWARDS),
        (1, 100, 1, 1, 1),
        strict=True,
    ):
        values = get_values(axes)
        assert values == pytest.approx([factor * row[key] for row in ROWS])
        assert list(axes.get_lines()[0].get_xdata()) == [row["steps"] for row in ROWS]
        low, high = axes.get_ylim()
        assert low <= min(0, *values) <= max(0, *values) <= high


@pytest.mark.parametrize(
    ("figure", "title", "value"),
    [
        ({"eval/velocity_error": 0.25}, "Velocity error, m/s", 0.25),  # no mean speed of commands
        ({"eval/standing": 0.25}, "Standing, % of the time", 25.0),
        ({"train/level/stairs_up": 2.0}, "Stairs up", 2.0),
    ],
)
def test_figures_of_some_tasks_have_panels(figure, title, value):
    panels = draw_panels([row | figure for row in ROWS])
    assert set(get_values(panels[title])) == {value}
    assert ("Speed, m/s" in panels) == (title == "Stairs up")
    alone = draw_panels([{"steps": 1, **figure}])
    assert get_values(alone[title]).tolist() == [value]
    assert alone[title].get_lines()[0].get_marker() == "."  # a single point is seen


def test_the_best_checkpoint_is_marked_and_a_note_stands_above():
    for best in (None, 7000):
        panels = draw_panels(ROWS, best)
        for title in ("Speed, m/s", "Episodes that fell, %", "Reward"):
            marks = [line.get_xdata()[0] for line in panels[title].get_lines()[1:]]
            assert marks == ([] if best is None else [7000])
        assert (panels["Speed, m/s"].get_legend() is None) == (best is None)
        assert len(panels["Energy"].get_lines()) == 1
    for note in ("", RANDOMIZED):
        assert draw_learning_curve(ROWS, 7000, note).get_suptitle() == note


def test_what_is_no_number_is_a_gap():
    for bad in (math.nan, None):
        rows = [*ROWS[:3], {"steps": 4000, "train/reward": bad}, *ROWS[4:]]
        values = get_values(draw_panels(rows)["Reward"])
        assert list(np.isnan(values)) == [False] * 3 + [True] + [False] * 16


@pytest.mark.parametrize("rows", [[], [{"steps": 0}], [{"steps": 5}, {"steps": 6}]])
def test_what_was_never_recorded_leaves_its_panel_empty(rows):
    panels = draw_panels(rows)
    assert len(panels) == 3
    assert all(np.isnan(get_values(axes)).all() for axes in panels.values())


def test_minutes_stand_above_the_steps_at_which_they_passed():
    def read_ticks(rows) -> list[dict[str, float]]:
        tops = [axes for axes in draw_learning_curve(rows).axes if axes.get_xlabel() == "minutes"]
        return [
            {
                tick.get_text(): place
                for tick, place in zip(a.get_xticklabels(), a.get_xticks(), strict=True)
            }
            for a in tops
        ]

    ticks = read_ticks(ROWS)
    assert len(ticks) == 3
    assert (ticks[0]["2"], ticks[0]["10"]) == pytest.approx((4000, 20_000))
    # A clock that stands still, or one row, has no course to tell of.
    for rows in ([{**row, "time/elapsed": 3.0} for row in ROWS], ROWS[:1]):
        assert all(len(places) < 2 for places in read_ticks(rows))


def test_every_term_has_a_panel_of_its_own():
    rows = [{"steps": k, **{f"train/reward/term_{n}": n for n in range(13)}} for k in range(3)]
    terms = [axes for title, axes in draw_panels(rows).items() if title.startswith("Term ")]
    assert [get_values(axes)[0] for axes in terms] == list(range(13))
    boxes = [axes.get_window_extent() for axes in terms]
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


def test_the_same_metrics_give_the_same_picture(tmp_path):
    for name, rows in (("a", ROWS), ("b", ROWS), ("c", ROWS[:9])):
        save_learning_curve(rows, tmp_path / name)
    a, b, c = ((tmp_path / name).read_bytes() for name in "abc")
    assert a == b
    assert a != c
