"""Metrics against courses with a known error, intervals against tables and equations."""

import dataclasses
import math
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadwalk.evaluation.gait import measure_gait
from quadwalk.evaluation.metrics import (
    compare_engines,
    compute_heading_velocity,
    compute_mean_interval,
    compute_metrics,
    compute_share_interval,
    compute_tracking_errors,
    find_typical_episode,
    measure_path,
    summarize_episodes,
    to_json_number,
    to_roll_pitch_yaw,
    to_rotations,
)
from quadwalk.evaluation.rollout import Rollout, slice_steps
from quadwalk.evaluation.suites import gaits
from quadwalk.settings.environment import CommandConfig
from quadwalk.tasks import sprint
from tests.evaluation.conftest import make_glide_poses

DT, STEPS = 0.02, 200
WEIGHT = 200.0  # N
EFFORT = np.full(12, 44.0)  # Nm
# Two-sided 95 % points of Student's t by degrees of freedom, as tables print them (Fisher,
# "Statistical Methods for Research Workers", 1925, table IV).
STUDENT = {1: 12.706, 2: 4.303, 3: 3.182, 7: 2.365, 15: 2.131, 29: 2.045}
NORMAL = 1.959964


@pytest.fixture(scope="module")
def glide(simulate):
    """Return glide(velocity, command): the rollout of a trunk with this velocity.

    Both are (3,) or (T, 3), in the frame of its heading.
    """
    base = simulate(STEPS)

    def draw(velocity, command, yaw=2.5, tilt=(0.1, -0.2)):
        velocity = np.broadcast_to(np.asarray(velocity, float), (STEPS, 3))
        command = np.broadcast_to(np.asarray(command, float), (STEPS, 3))
        qpos = np.array(base.qpos, float)
        turn = Rotation.from_euler("ZYX", [yaw, *tilt])
        qpos[0, :7] = 0.0, 0.0, qpos[0, 2], *turn.as_quat(scalar_first=True)
        qpos[1:, :7] = make_glide_poses(qpos[0], velocity)
        return dataclasses.replace(base, qpos=qpos, command=command)

    return draw


def test_velocity_in_the_frame_of_the_heading(glide):
    velocity = np.random.default_rng(0).uniform(-3, 3, (STEPS, 3))
    np.testing.assert_allclose(
        compute_heading_velocity(glide(velocity, 0.0).qpos, DT), velocity, atol=1e-9
    )


def compute_errors(rollout: Rollout) -> tuple[float, float]:
    """Return the errors of a rollout, m/s and rad/s."""
    return compute_tracking_errors(compute_heading_velocity(rollout.qpos, DT), rollout.command, DT)


def test_a_constant_error_is_found(glide):
    actual = compute_errors(glide((1.3, -0.4, 0.75), (1.0, 0.0, 1.0)))
    assert actual == pytest.approx((0.5, 0.25))


def test_swaying_within_a_stride_is_no_error(glide):
    sway = np.sin(2 * np.pi * np.arange(STEPS) / 25)[:, None]  # a period of half a second
    actual = compute_errors(glide([0.5, 0.2, -0.3] + 0.4 * sway, (0.5, 0.2, -0.3)))
    assert actual == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_second_to_obey_is_given_at_the_start_and_after_a_change(glide):
    command = np.where(np.arange(STEPS)[:, None] < 100, [1.0, 0.0, 0.0], [0.0, 0.5, -1.0])
    late = np.concatenate([np.zeros((50, 3)), command[:-50]])  # 1 s behind
    assert compute_errors(glide(late, command)) == pytest.approx((0.0, 0.0), abs=1e-9)
    later = np.concatenate([np.zeros((75, 3)), command[:-75]])  # 1.5 s behind
    assert compute_errors(glide(later, command)) > (0.2, 0.1)
    # Of each command the windows that begin 1 s after it: 26 of 0.5 s, of which the first is off.
    ramp = np.linspace(1, 0, 26)[:, None]
    sizes = np.array([1.0, np.hypot(1.0, 0.5)]) * ramp
    assert compute_errors(glide(later, command))[0] == pytest.approx(sizes.mean())


def test_an_episode_too_short_has_no_error(glide):
    rollout = glide((1.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    assert np.isnan(compute_errors(slice_steps(rollout, 0, 74))).all()
    short = compute_metrics(slice_steps(rollout, 0, 74), sprint.TASK.env.reward, WEIGHT, EFFORT)
    assert (short["velocity_error"], short["yaw_rate_error"]) == (None, None)
    assert compute_errors(slice_steps(rollout, 0, 75)) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_windows_apart_are_a_part_of_all(glide):
    velocity = np.array([1.0, 0.2, 0.5]) + np.random.default_rng(0).uniform(-1, 1, (STEPS, 3))
    command = np.broadcast_to([1.0, 0.0, 0.3], (STEPS, 3))
    means = (velocity - command)[50:].reshape(6, 25, 3).mean(axis=1)
    expected = (np.linalg.norm(means[:, :2], axis=1).mean(), np.abs(means[:, 2]).mean())
    assert compute_tracking_errors(velocity, command, DT, apart=25) == pytest.approx(expected)


def test_the_path_is_as_long_as_the_way_it_went(glide):
    assert measure_path(glide((0.6, 0.8, 0.0), 0.0)) == pytest.approx(4.0)
    # A circle, as chords of half a second.
    chords = 8 * 2 * np.sin(0.25)
    assert measure_path(glide((1.0, 0.0, 1.0), 0.0)) == pytest.approx(chords, rel=1e-3)
    sway = np.zeros((STEPS, 3))
    sway[:, 1] = np.sin(2 * np.pi * (np.arange(STEPS) + 0.5) / 25)
    assert measure_path(glide(sway, 0.0)) == pytest.approx(0.0, abs=1e-9)


def test_figures_of_an_episode_with_commands(glide, quadruped):
    rollout = glide((1.0, 0.0, 1.0), (1.0, 0.3, 0.5))
    rollout = dataclasses.replace(rollout, energy=np.full(STEPS, 2.0))
    figures = compute_metrics(rollout, sprint.TASK.env.reward, WEIGHT, EFFORT)
    length = 8 * 2 * np.sin(0.25)
    assert figures["velocity_error"] == pytest.approx(0.3)
    assert figures["yaw_rate_error"] == pytest.approx(0.5)
    assert figures["path"] == pytest.approx(length, rel=1e-3)
    assert figures["path_speed"] == pytest.approx(length / 4, rel=1e-3)
    assert figures["energy_per_meter"] == pytest.approx(400 / length, rel=1e-3)
    assert figures["cost_of_transport"] == pytest.approx(400 / length / WEIGHT, rel=1e-3)
    assert figures["command"] == [1.0, 0.3, 0.5]
    assert not {"speed", "distance", "lateral_drift", "heading_error"} & figures.keys()
    gait = measure_gait(rollout, quadruped)
    assert gait.speed == pytest.approx(length / 4, rel=1e-3)
    assert gait.stride_length * gait.stride_frequency == pytest.approx(1.0)


def test_a_gait_at_a_speed_has_no_start_in_it(glide, quadruped, monkeypatch):
    """Check a robot that stands for 2 s and burns 5 kW, then glides at 2 m/s for 50 W."""
    velocity, energy = np.zeros((STEPS, 3)), np.full(STEPS, 100.0)
    velocity[100:, 0], energy[100:] = 2.0, 1.0
    rollout = dataclasses.replace(glide(velocity, (2.0, 0.0, 0.0)), energy=energy)
    fallen = slice_steps(rollout, 0, 50)
    monkeypatch.setattr(gaits, "SPEEDS", 2)
    monkeypatch.setattr(gaits, "reset_with_commands", lambda *_: None)
    monkeypatch.setattr(gaits, "simulate_episodes", lambda *_, **__: iter([rollout, fallen]))
    config = SimpleNamespace(control_dt=DT, command=CommandConfig((0, 2), (0, 0), (0, 0), 0, 5))
    env = SimpleNamespace(quadruped=quadruped, config=config)
    loaded = SimpleNamespace(env=env, policy=SimpleNamespace(act=None))
    gait, none = gaits.measure_gaits(loaded, 0)
    assert gait["speed"] == pytest.approx(2.0, rel=1e-3)
    weight = 9.81 * quadruped.make_full_model().body_mass.sum()
    assert gait["cost_of_transport"] == pytest.approx(50.0 / (2.0 * weight), rel=1e-3)
    assert (none["speed"], none["cost_of_transport"]) == (None, None)


def test_the_typical_episode_is_the_one_of_median_speed_along_its_path(glide):
    rollouts = [glide((speed, 0.0, 0.5), 0.0) for speed in (1.0, 0.0, 0.4)]
    episodes = [
        compute_metrics(rollout, sprint.TASK.env.reward, WEIGHT, EFFORT) for rollout in rollouts
    ]
    assert find_typical_episode(episodes) == 2
    summary = summarize_episodes(episodes)
    assert summary["velocity_error"]["mean"] == pytest.approx(1.4 / 3)
    assert summary["velocity_error"]["worst"] == pytest.approx(1.0)
    assert summary["path_speed"]["worst"] == pytest.approx(0.0, abs=1e-6)
    assert "speed" not in summary


def test_differences_of_what_is_not_there_or_zero():
    figure, names = {"mean": 2.0}, ("speed", "distance", "duration", "energy_per_meter")
    mjx = {**dict.fromkeys(names, figure), "fall_rate": 0.0, "energy_per_meter": None}
    mujoco = {**{name: {"mean": 1.5} for name in names}, "fall_rate": 0.25}
    actual = compare_engines(mjx, mujoco)
    assert actual["fall_rate"] == {"difference": 0.25, "percent": None}
    assert actual["energy_per_meter"] == {"difference": None, "percent": None}
    assert actual["speed"] == {"difference": -0.5, "percent": -25.0}


@pytest.mark.parametrize("freedom", STUDENT)
def test_the_interval_of_a_mean(freedom):
    values = np.random.default_rng(freedom).normal(3.0, 2.0, freedom + 1)
    mean, half_width = compute_mean_interval(values)
    variance = sum((value - mean) ** 2 for value in values) / freedom
    assert mean == pytest.approx(math.fsum(values) / len(values))
    error = math.sqrt(variance / len(values))
    assert half_width == pytest.approx(STUDENT[freedom] * error, rel=3e-4)


def test_one_value_has_no_interval():
    assert compute_mean_interval([4.0]) == (4.0, None)


@pytest.mark.parametrize(("count", "total"), [(3, 16), (1, 2), (500, 512)])
def test_the_ends_of_a_share_are_those_that_a_test_would_just_not_reject(count, total):
    for end in compute_share_interval(count, total):
        error = math.sqrt(end * (1 - end) / total)
        assert abs(count / total - end) == pytest.approx(NORMAL * error, rel=1e-5)


def test_none_or_all_of_a_few_are_no_certainty():
    # Where Wilson's equation has a solution in one line.
    expected = NORMAL**2 / (16 + NORMAL**2)
    assert compute_share_interval(0, 16) == pytest.approx((0.0, expected), abs=1e-6)
    assert compute_share_interval(16, 16) == pytest.approx((1 - expected, 1.0), abs=1e-6)


def test_json_has_none_for_what_is_no_number():
    actual = [to_json_number(value) for value in (1, np.float32(0.5), math.nan, -math.inf)]
    assert actual == [1.0, 0.5, None, None]


@pytest.mark.filterwarnings("error")
def test_angles_are_those_that_mujoco_turns_by():
    angles = np.random.default_rng(0).uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (50, 3))
    quats = np.empty((50, 4))
    for quat, (roll, pitch, yaw) in zip(quats, angles, strict=True):
        mujoco.mju_euler2Quat(quat, [yaw, pitch, roll], "zyx")
    np.testing.assert_allclose(to_roll_pitch_yaw(3.0 * quats), angles, atol=1e-9)
    # Nose up: of roll and yaw only the sum is determined, and there is no warning of it.
    up = to_roll_pitch_yaw(np.array([[np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0]]))
    assert up[0, 1] == pytest.approx(-np.pi / 2)


def test_a_quaternion_without_length_is_no_rotation():
    quats = np.array([[0.0] * 4, [np.nan] * 4, [1e-200, 0, 0, 0], [0, 0, 0, 2.0]])
    vectors = to_rotations(quats).apply([1.0, 2.0, 3.0])
    np.testing.assert_allclose(vectors, [[1, 2, 3]] * 3 + [[-1, -2, 3]])
    assert to_roll_pitch_yaw(np.empty((0, 4))).shape == (0, 3)
