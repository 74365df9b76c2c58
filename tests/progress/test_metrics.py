"""The row of metrics of an iteration, and the score of a policy."""

import json
import math

import pytest

from quadwalk.progress.metrics import FallRate, TrainingMetrics
from quadwalk.settings.serialize import change_settings
from quadwalk.tasks import sprint

COUNTS = {
    "reward": 1.5,
    "reward/forward": 2.0,
    "reward/yaw": 0.5,
    "speed": 1.0,
    "eval/speed": 3.0,
    "count/ended": 8,
    "count/fell": 6,
    "count/nan": 1,
    "eval/count/ended": 4,
    "eval/count/fell": 1,
    "loss/kl": 0.01,
}
NO_FALLS = {"eval/count/fell": 0}
NO_ENDS = {"eval/count/ended": 0, "eval/count/fell": 0}


@pytest.fixture
def metrics() -> TrainingMetrics:
    scales = {"env.reward.forward": 2.0, "env.reward.yaw": -3.0}
    return TrainingMetrics(change_settings(sprint.TASK, scales).env.reward)


def test_the_share_of_falls_is_over_the_last_episodes():
    falls = FallRate(10)
    assert math.isnan(falls.add(0, 0))
    assert falls.add(4, 4) == 1.0
    assert falls.add(0, 4) == 0.5
    assert falls.add(0, 5) == pytest.approx(4 / 13)  # without the first four, nine: too few
    assert falls.add(0, 4) == 0.0  # 4 + 5 + 4 are enough


def test_a_row_tells_training_from_evaluation_and_scales_the_terms(metrics):
    metrics.make_row(100, COUNTS)
    levels = {"count/level/blocks": 30.0, "count/robots/blocks": 12.0}
    empty = {"count/level/flat": 0.0, "count/robots/flat": 0.0}
    commanded = {"velocity_error": 0.4, "eval/velocity_error": 0.3}
    assert metrics.make_row(200, {**COUNTS, **levels, **empty, **commanded}) == {
        "steps": 200,
        "train/speed": 1.0,
        "train/fall_rate": 0.75,
        "train/reward": 1.5,
        "train/nan": 2.0,
        "eval/speed": 3.0,
        "eval/fall_rate": 0.25,
        "eval/velocity_error": 0.3,
        "train/reward/forward": 4.0,
        "train/reward/yaw": -1.5,
        "train/level/blocks": 2.5,
        "train/level/flat": 0.0,
        "loss/kl": 0.01,
    }
    assert "eval/velocity_error" not in metrics.make_row(300, COUNTS)


def test_figures_of_a_class_of_bodies_are_means_over_its_control_steps(metrics):
    light = {"count/bodies/light": 20.0, "count/fell/light": 1.0, "count/standing/light": 15.0}
    row = metrics.make_row(100, {**COUNTS, **light})
    of_light = {name: value for name, value in row.items() if name.endswith("/light")}
    assert of_light == {"train/fell/light": 0.05, "train/standing/light": 0.75}


def test_the_score_is_the_evaluation_speed_less_the_falls(metrics):
    assert metrics.score == 0.0
    for speed in (9.0, *[3.0] * 10, *[5.0] * 10):  # the last twenty count
        metrics.make_row(0, {**COUNTS, **NO_ENDS, "eval/speed": speed})
    assert metrics.score == pytest.approx(4.0)
    metrics.make_row(0, {**COUNTS, "eval/speed": 3.0})
    assert metrics.score == pytest.approx(4.0 * 0.75)
    for _ in range(20):
        metrics.make_row(0, {**COUNTS, "eval/speed": -2.0})
    assert metrics.score == pytest.approx(-2.0)  # falls do not make it better


def test_the_score_of_a_task_that_starts_in_any_pose_is_the_share_of_time_standing(metrics):
    for speed, standing in ((0.3, 0.0), (0.0, 0.5)):
        figures = {"eval/speed": speed, "eval/standing": standing}
        row = metrics.make_row(0, {**COUNTS, **NO_FALLS, **figures})
    assert row["eval/standing"] == 0.5
    assert metrics.score == pytest.approx(0.25)


def test_counting_goes_on_from_a_saved_state():
    whole, first, second = (TrainingMetrics(sprint.TASK.env.reward) for _ in range(3))
    rows = [{**COUNTS, "eval/count/fell": k % 3, "count/nan": k} for k in range(40)]
    expected = [whole.make_row(k, row) for k, row in enumerate(rows)]
    for k, row in enumerate(rows[:25]):
        first.make_row(k, row)
    second.restore(json.loads(json.dumps(first.get_state())))
    assert [second.make_row(k, row) for k, row in enumerate(rows[25:], 25)] == expected[25:]
    assert second.score == whole.score
