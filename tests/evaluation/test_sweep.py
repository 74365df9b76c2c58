"""Sweeps: what a point is, and the ranges of the task beside it."""

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
from tests.evaluation.conftest import glided


def make_ranged_env(quadruped, **ranges) -> QuadrupedEnv:
    """The task `run`, but with these ranges of its randomization."""
    changed = dataclasses.replace(run.TASK.env.randomization, **ranges)
    config = dataclasses.replace(run.TASK.env, randomization=changed)
    return QuadrupedEnv(quadruped, config, "fast")


def test_a_point_is_begun_and_tracked_as_it_is_called(quadruped, monkeypatch):
    """A swept delay is the one named, and errors are of half seconds from 1 s on."""
    config = dataclasses.replace(walk.TASK.env, physics_dt=0.005, substeps=4)
    env, begun, count = QuadrupedEnv(quadruped, config), [], 110
    off = np.random.default_rng(0).uniform(-1, 1, (2, count, 3))

    def glide(env, policy, starts, *_):
        """Episodes as fast as the command and `off`, in place of simulated ones."""
        begun.append(starts.pipeline_state.conditions)
        commands = np.asarray(starts.pipeline_state.command.velocity)
        for number, start in enumerate(np.asarray(starts.pipeline_state.qpos)):
            poses = glided(start, commands[number] + off[number])
            yield number, "tipped" if number else "time limit", poses

    monkeypatch.setattr("quadwalk.evaluation.rollout.roll_out", glide)
    loaded = SimpleNamespace(env=env, policy=SimpleNamespace(act=None))
    points = [Point(friction=1.0, delay=delay) for delay in (8.0, 12.0)]
    found = measure_points(loaded, points, 1, 0)
    np.testing.assert_allclose(begun[0].delay * env.stepping.dt, [0.008, 0.012], rtol=1e-6)
    # Of 12 ms a control step of 20 ms has none, or all, from the one before.
    assert begun[0].targets.shape[1] == 2
    means = off[:, 50:100].reshape(2, 2, 25, 3).mean(axis=2)
    for point, mean, success in zip(found, means, (1.0, 0.0), strict=True):
        expected = np.linalg.norm(mean[:, :2], axis=1).mean()
        assert point["success"] == success
        assert point["velocity_error"]["mean"] == pytest.approx(expected, rel=1e-4)
        assert point["yaw_rate_error"]["mean"] == pytest.approx(np.abs(mean[:, 2]).mean(), rel=1e-4)


def test_half_as_wide_again_as_training_is_still_a_robot_on_a_floor(quadruped):
    names = ("friction", "link_mass", "strength", "kp", "joint_friction")
    env = make_ranged_env(quadruped, **dict.fromkeys(names, (0.2, 1.0)), trunk_mass=(-0.4, 0.0))
    drawn = jax.jit(
        jax.vmap(lambda key: sample_conditions_at(env, Point(0.8, everything=1.5), key, 3))
    )(jax.random.split(jax.random.PRNGKey(0), 500))
    floors = drawn.variation.friction
    assert 0.0 < floors.min() < 0.02 < 1.0 < floors.max()
    for name in names[1:]:
        assert 0.0 <= getattr(drawn.variation, name).min() < 0.15
    trunk = env.mj_model.body(quadruped.trunk).mass[0]
    assert 0.0 < trunk + drawn.variation.trunk_mass.min() < 0.2 * trunk
    assert min(drawn.noise.min(), drawn.delay.min(), drawn.sensor_delay.min()) >= 0.0


def test_the_ranges_that_are_shaded_are_the_tasks_in_the_units_of_the_sweep(quadruped):
    env = QuadrupedEnv(quadruped, run.TASK.env, "fast")
    found = make_task_ranges(env, Point(friction=env.friction))
    assert set(found) == set(SWEEPS)
    known = {"friction": (0.3, 1.25), "strength": (80, 110), "delay": (0, 20), "everything": (0, 1)}
    for name, between in known.items():
        assert found[name] == pytest.approx(between)
    assert found["mass"] == pytest.approx((-2.0, 5.0), abs=0.2)  # kg, on an AlienGo
    assert found["push"] == pytest.approx((0.0, 1.0), abs=0.01)  # m/s
    without = make_ranged_env(quadruped, noise=None)
    assert make_task_ranges(without, Point(friction=0.8))["noise"] == (0.0, 0.0)
