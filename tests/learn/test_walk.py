"""The `walk` task, trained for a moment."""

import dataclasses

import jax
import numpy as np
import pytest

from quadwalk.env.env import QuadrupedEnv
from quadwalk.learn import ppo
from quadwalk.learn.devices import make_mesh, place_like
from quadwalk.learn.networks import make_env_networks
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.runs import checkpoint
from quadwalk.task_files import load_task

ENVS = 16


@pytest.fixture(scope="module")
def course():
    """Run three iterations; return command, iteration, last state, all states and numbers.

    The states are those before the first iteration and after each.
    """
    task = load_task("walk")
    config = dataclasses.replace(task.ppo, eval_envs=2, unroll=4, minibatches=2, hidden=(16,))
    # A command lasts for two steps: each environment gets a new one in every iteration.
    command = dataclasses.replace(task.env.command, seconds=2 * task.env.control_dt)
    env = QuadrupedEnv(load_quadruped(), dataclasses.replace(task.env, command=command))
    networks, mesh = make_env_networks(env, config), make_mesh()
    state = ppo.init_state(env, networks, config, mesh, ENVS, seed=0)
    iterate = ppo.Iteration(env, networks, config, mesh, iterations=10)
    states, rows = [jax.device_get(state)], []
    for _ in range(3):
        state, numbers = iterate(state)
        states.append(jax.device_get(state))
        rows.append(jax.device_get(numbers))
    return command, iterate, state, states, rows


def test_all_numbers_are_finite_and_the_command_is_rewarded(course):
    *_, states, rows = course
    for leaf in jax.tree.leaves(states[-1]):
        assert np.isfinite(np.asarray(leaf, float)).all()
    for row in rows:
        assert row["learner/finite"]
        assert row["count/nan"] == 0
        for name in ("follow", "follow_yaw_rate", "trot"):
            assert 0 < row[f"reward/{name}"] <= 1
        assert row["reward/drag"] >= 0


def test_commands_change_as_it_trains_and_stay_in_their_ranges(course):
    command, _, _, states, _ = course
    velocities = np.array([state.workers.envs.pipeline_state.command.velocity for state in states])
    moving = velocities.any(axis=2)
    assert velocities.shape == (4, ENVS + 2, 3)
    for column, (low, high) in enumerate((command.forward, command.lateral, command.yaw_rate)):
        values = velocities[moving][:, column]
        assert low <= values.min() < values.max() <= high
    changed = (np.diff(velocities, axis=0) != 0).any(axis=2)
    assert changed[moving[1:] | moving[:-1]].all()


def test_a_saved_state_goes_on_as_if_it_had_not_been_saved(course, tmp_path):
    _, iterate, state, states, _ = course
    checkpoint.save(tmp_path / "c.npz", states[2], {"kind": "checkpoint"})
    saved, _ = checkpoint.load(tmp_path / "c.npz", "checkpoint", like=states[0])
    after, _ = iterate(place_like(saved, state))
    jax.tree.map(np.testing.assert_array_equal, jax.device_get(after), states[3])
