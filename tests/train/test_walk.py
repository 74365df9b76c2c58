"""The `walk` task, trained for a moment."""

import dataclasses

import jax
import numpy as np
import pytest

from quadwalk.robot.quadruped import load_quadruped
from quadwalk.task.env import QuadrupedEnv
from quadwalk.task_files import load_task
from quadwalk.train.learner import iteration
from quadwalk.train.learner.networks import networks_for
from quadwalk.train.runs import checkpoint

ENVS = 16


@pytest.fixture(scope="module")
def training():
    """An environment, the state before training, and the compiled iteration."""
    task = load_task("walk")
    config = dataclasses.replace(task.ppo, eval_envs=2, unroll=4, minibatches=2, hidden=(16,))
    # A command stays for two steps: each environment is told anew in every iteration.
    command = dataclasses.replace(task.env.command, seconds=2 * task.env.control_dt)
    env = QuadrupedEnv(load_quadruped(), dataclasses.replace(task.env, command=command))
    networks = networks_for(env, config)
    mesh = iteration.make_mesh()
    state = iteration.init_state(env, networks, config, mesh, ENVS, seed=0)
    return env, state, iteration.Iteration(env, networks, config, mesh, iterations=10)


@pytest.fixture(scope="module")
def course(training, tmp_path_factory):
    """The states before and after each of three iterations, and their numbers."""
    _, state, iterate = training
    states, rows = [jax.device_get(state)], []
    for _ in range(3):
        state, numbers = iterate(state)
        states.append(jax.device_get(state))
        rows.append(jax.device_get(numbers))
    return states, rows


def test_all_numbers_are_finite_and_the_command_is_rewarded(course):
    states, rows = course
    for leaf in jax.tree.leaves(states[-1]):
        assert np.isfinite(np.asarray(leaf, float)).all()
    for row in rows:
        assert row["learner/finite"]
        assert row["count/nan"] == 0
        for name in ("follow", "follow_yaw_rate", "trot"):
            assert 0 < row[f"reward/{name}"] <= 1
        assert row["reward/drag"] >= 0


def test_commands_change_as_it_trains_and_stay_in_their_ranges(training, course):
    command = training[0].config.command
    told = np.array([state.workers.envs.pipeline_state.command.velocity for state in course[0]])
    moving = told.any(axis=2)
    assert told.shape == (4, ENVS + 2, 3)
    for column, (low, high) in enumerate((command.forward, command.lateral, command.yaw_rate)):
        values = told[moving][:, column]
        assert low <= values.min() < values.max() <= high
    changed = (np.diff(told, axis=0) != 0).any(axis=2)
    assert changed[moving[1:] | moving[:-1]].all()


def test_a_saved_state_goes_on_as_if_it_had_not_been_saved(training, course, tmp_path):
    _, state, iterate = training
    states, _ = course
    checkpoint.save(tmp_path / "c.npz", states[2], {"kind": "checkpoint"})
    saved, _ = checkpoint.load(tmp_path / "c.npz", "checkpoint", like=states[0])
    after, _ = iterate(iteration.placed_like(saved, jax.tree.map(lambda x: x, state)))
    for a, b in zip(
        jax.tree.leaves(jax.device_get(after)), jax.tree.leaves(states[3]), strict=True
    ):
        np.testing.assert_array_equal(a, b)
