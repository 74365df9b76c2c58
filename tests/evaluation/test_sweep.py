"""Sweeps: the points, and the ranges of the task beside them."""

import dataclasses
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.sweep import (
    SWEEPS,
    Point,
    make_task_ranges,
    measure_points,
    sample_conditions_at,
)
from quadwalk.tasks import run, walk
from tests.evaluation.conftest import make_glide_poses


def make_ranged_env(quadruped, **ranges) -> QuadrupedEnv:
    """Return the task `run` with these ranges of its randomization."""
    changed = dataclasses.replace(run.TASK.env.randomization, **ranges)
    config = dataclasses.replace(run.TASK.env, randomization=changed)
    return QuadrupedEnv(quadruped, config, "fast")


def test_a_point_is_begun_and_tracked_as_it_is_called(quadruped, monkeypatch):
    """Check delays that are swept, and errors of half seconds from 1 s on."""
    config = dataclasses.replace(walk.TASK.env, physics_dt=0.005, substeps=4)
    env, conditions, count = QuadrupedEnv(quadruped, config), [], 110
    off = np.random.default_rng(0).uniform(-1, 1, (2, count, 3))

    def glide(env, policy, starts, *_):
        """Yield episodes as fast as the command and `off`, in place of simulated ones."""
        conditions.append(starts.pipeline_state.conditions)
        commands = np.asarray(starts.pipeline_state.command.velocity)
        for number, start in enumerate(np.asarray(starts.pipeline_state.qpos)):
            poses = make_glide_poses(start, commands[number] + off[number])
            yield number, "tipped" if number else "time limit", poses

    monkeypatch.setattr("quadwalk.evaluation.rollout.roll_out", glide)
    loaded = SimpleNamespace(env=env, policy=SimpleNamespace(act=None))
    points = [Point(friction=1.0, delay=delay) for delay in (8.0, 12.0)]
    actual = measure_points(loaded, points, 1, 0)
    np.testing.assert_allclose(conditions[0].delay * env.stepping.dt, [0.008, 0.012], rtol=1e-6)
    # Of 12 ms a control step of 20 ms has none, or all, from the one before.
    assert conditions[0].targets.shape[1] == 2
    means = off[:, 50:100].reshape(2, 2, 25, 3).mean(axis=2)
    for point, mean, success in zip(actual, means, (1.0, 0.0), strict=True):
        expected = np.linalg.norm(mean[:, :2], axis=1).mean()
        assert point["success"] == success
        assert point["velocity_error"]["mean"] == pytest.approx(expected, rel=1e-4)
        assert point["yaw_rate_error"]["mean"] == pytest.approx(np.abs(mean[:, 2]).mean(), rel=1e-4)


def test_half_as_wide_again_as_training_is_still_a_robot_on_a_floor(quadruped):
    names = ("friction", "link_mass", "strength", "kp", "joint_friction")
    env = make_ranged_env(quadruped, **dict.fromkeys(names, (0.2, 1.0)), trunk_mass=(-0.4, 0.0))
    sampled = jax.jit(
        jax.vmap(lambda key: sample_conditions_at(env, Point(0.8, everything=1.5), key, 3))
    )(jax.random.split(jax.random.PRNGKey(0), 500))
    floors = sampled.variation.friction
    assert 0.0 < floors.min() < 0.02 < 1.0 < floors.max()
    for name in names[1:]:
        assert 0.0 <= getattr(sampled.variation, name).min() < 0.15
    trunk = env.mj_model.body(quadruped.trunk).mass[0]
    assert 0.0 < trunk + sampled.variation.trunk_mass.min() < 0.2 * trunk
    assert min(sampled.noise.min(), sampled.delay.min(), sampled.sensor_delay.min()) >= 0.0


def test_the_ranges_that_are_shaded_are_the_tasks_in_the_units_of_the_sweep(quadruped):
    env = QuadrupedEnv(quadruped, run.TASK.env, "fast")
    actual = make_task_ranges(env, Point(friction=env.friction))
    assert set(actual) == set(SWEEPS)
    expected = {
        "friction": (0.3, 1.25),
        "strength": (80, 110),
        "delay": (0, 20),
        "everything": (0, 1),
    }
    for name, between in expected.items():
        assert actual[name] == pytest.approx(between)
    assert actual["mass"] == pytest.approx((-2.0, 5.0), abs=0.2)  # kg, on an AlienGo
    assert actual["push"] == pytest.approx((0.0, 1.0), abs=0.01)  # m/s
    without = make_ranged_env(quadruped, noise=None)
    assert make_task_ranges(without, Point(friction=0.8))["noise"] == (0.0, 0.0)
