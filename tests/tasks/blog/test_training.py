"""A short training of the blog post's task."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from quadwalk.env.env import QuadrupedEnv
from quadwalk.learn import ppo
from quadwalk.learn.devices import make_mesh
from quadwalk.learn.networks import make_env_networks
from quadwalk.progress.metrics import TrainingMetrics
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.task_files import load_task

ITERATIONS, ENVS = 4, 8


def test_it_learns_from_numbers_that_are_finite():
    task = load_task("blog")
    config = replace(task.ppo, eval_envs=2, unroll=8, minibatches=2, hidden=(16,))
    env = QuadrupedEnv(load_quadruped(), task.env)
    networks, mesh = make_env_networks(env, config), make_mesh()
    state = ppo.init_state(env, networks, config, mesh, ENVS, seed=0)
    begun = jax.device_get(state.learner.params)
    iterate = ppo.Iteration(env, networks, config, mesh, ITERATIONS)
    metrics = TrainingMetrics(task.env.reward)
    for number in range(ITERATIONS):
        state, numbers = iterate(state)
        row = metrics.make_row(number, numbers)
        falls = ("train/fall_rate", "eval/fall_rate")  # none before an episode has ended
        assert np.isfinite([value for name, value in row.items() if name not in falls]).all()
        terms = {name: value for name, value in row.items() if name.startswith("train/reward/")}
        assert {name.rpartition("/")[2] for name in terms} == {
            "progress", "inclined", "heading", "movement",
        }  # fmt: skip
        assert sum(terms.values()) == pytest.approx(row["train/reward"], abs=1e-4)
    assert row["train/nan"] == 0
    for leaf in jax.tree.leaves(jax.device_get(state)):
        assert np.isfinite(np.asarray(leaf, float)).all()
    learnt = jax.device_get(state.learner.params)
    for old, new in zip(jax.tree.leaves(begun), jax.tree.leaves(learnt), strict=True):
        assert not np.array_equal(old, new)
