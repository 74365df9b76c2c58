"""How far an episode was from its commands, on courses drawn with a known error."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadwalk.evaluation.gait import measure_gait
from quadwalk.evaluation.metrics import (
    compute_heading_velocity,
    compute_metrics,
    compute_tracking_errors,
    find_typical_episode,
    measure_path,
    summarize_episodes,
)
from quadwalk.evaluation.rollout import Rollout, take_first_steps
from quadwalk.evaluation.suites import commands as steering
from quadwalk.settings.environment import CommandConfig
from quadwalk.tasks import sprint
from tests.evaluation.conftest import glided

DT, STEPS = 0.02, 200
WEIGHT = 200.0  # N
EFFORT = np.full(12, 44.0)  # Nm


@pytest.fixture(scope="module")
def glide(simulate):
    """glide(velocity, command): a trunk that moves so, (T, 3) in the frame of its heading."""
    base = simulate(STEPS)

    def draw(velocity, command, yaw=2.5, tilt=(0.1, -0.2)):
        velocity = np.broadcast_to(np.asarray(velocity, float), (STEPS, 3))
        command = np.broadcast_to(np.asarray(command, float), (STEPS, 3))
        qpos = np.array(base.qpos, float)
        turn = Rotation.from_euler("ZYX", [yaw, *tilt])
        qpos[0, :7] = 0.0, 0.0, qpos[0, 2], *turn.as_quat(scalar_first=True)
        qpos[1:, :7] = glided(qpos[0], velocity)
        return dataclasses.replace(base, qpos=qpos, command=command)

    return draw


def test_velocity_in_the_frame_of_the_heading(glide):
    velocity = np.random.default_rng(0).uniform(-3, 3, (STEPS, 3))
    np.testing.assert_allclose(
        compute_heading_velocity(glide(velocity, 0.0).qpos, DT), velocity, atol=1e-9
    )


def errors_of(rollout: Rollout) -> tuple[float, float]:
    """m/s and rad/s, of the rollout's velocity and commands."""
    return compute_tracking_errors(compute_heading_velocity(rollout.qpos, DT), rollout.command, DT)


def test_a_constant_error_is_found(glide):
    found = errors_of(glide((1.3, -0.4, 0.75), (1.0, 0.0, 1.0)))
    assert found == pytest.approx((0.5, 0.25))


def test_swaying_within_a_stride_is_no_error(glide):
    sway = np.sin(2 * np.pi * np.arange(STEPS) / 25)[:, None]  # a period of half a second
    found = errors_of(glide([0.5, 0.2, -0.3] + 0.4 * sway, (0.5, 0.2, -0.3)))
    assert found == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_second_to_obey_is_given_at_the_start_and_after_a_change(glide):
    command = np.where(np.arange(STEPS)[:, None] < 100, [1.0, 0.0, 0.0], [0.0, 0.5, -1.0])
    late = np.concatenate([np.zeros((50, 3)), command[:-50]])  # 1 s behind
    assert errors_of(glide(late, command)) == pytest.approx((0.0, 0.0), abs=1e-9)
    later = np.concatenate([np.zeros((75, 3)), command[:-75]])  # 1.5 s behind
    assert errors_of(glide(later, command)) > (0.2, 0.1)
    # Of each command the windows that begin 1 s after it: 26 of 0.5 s, of which the first is off.
    ramp = np.linspace(1, 0, 26)[:, None]
    sizes = np.array([1.0, np.hypot(1.0, 0.5)]) * ramp
    assert errors_of(glide(later, command))[0] == pytest.approx(sizes.mean())


def test_an_episode_too_short_has_no_error(glide):
    rollout = glide((1.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    assert np.isnan(errors_of(take_first_steps(rollout, 74))).all()
    short = compute_metrics(take_first_steps(rollout, 74), sprint.TASK.env.reward, WEIGHT, EFFORT)
    assert (short["velocity_error"], short["yaw_rate_error"]) == (None, None)
    assert errors_of(take_first_steps(rollout, 75)) == pytest.approx((0.0, 0.0), abs=1e-9)


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
    """Of a robot that stands for 2 s and burns 5 kW, then glides at 2 m/s for 50 W."""
    velocity, energy = np.zeros((STEPS, 3)), np.full(STEPS, 100.0)
    velocity[100:, 0], energy[100:] = 2.0, 1.0
    rollout = dataclasses.replace(glide(velocity, (2.0, 0.0, 0.0)), energy=energy)
    fallen = take_first_steps(rollout, 50)
    monkeypatch.setattr(steering, "FORWARD", 1)
    monkeypatch.setattr(steering, "reset_with_commands", lambda *_: None)
    monkeypatch.setattr(steering, "simulate_episodes", lambda *_, **__: iter([rollout, fallen]))
    config = SimpleNamespace(control_dt=DT, command=CommandConfig((0, 2), (0, 0), (0, 0), 0, 5))
    env = SimpleNamespace(quadruped=quadruped, config=config)
    loaded = SimpleNamespace(env=env, policy=SimpleNamespace(act=None))
    gait, none = steering.measure_gaits(loaded, 0)
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
