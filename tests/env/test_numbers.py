"""Numbers of a task as arguments of a program, compared with the same numbers as its constants."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.numbers import get_numbers, list_numbers, replace_numbers
from quadwalk.settings.environment import EnvConfig
from quadwalk.settings.serialize import change_settings
from quadwalk.settings.terms import Reward
from quadwalk.tasks import drive, run
from quadwalk.terms import rewards

CHANGES = {
    "env.reward.track.scale": -3.0,
    "env.reward.track.width": 0.4,
    "env.reward.unused.scale": 0.7,
    "env.termination.tipped.angle": 0.02,
    "env.command.forward.0": 0.5,
    "env.command.forward.1": 0.75,
    "env.command.yaw_rate.1": 0.5,
    "env.command.turning": 1.0,
    "env.command.standing": 0.0,
    "env.command.spot": 0.5,
    "env.command.slow": 0.2,
    "env.command.still": 0.2,
    "env.randomization.friction.0": 1.1,
    "env.randomization.push.1": 0.1,
}


@pytest.fixture(scope="module")
def config() -> EnvConfig:
    """Return the settings of `drive` with a term of scale 0."""
    env = drive.TASK.env
    unused = Reward(rewards.joint_speed, scale=0.0)
    return dataclasses.replace(env, reward={**env.reward, "unused": unused})


def list_names(config) -> list[str]:
    return [number.name for number in list_numbers(config)]


def test_numbers_are_named_as_flags_and_have_their_bounds(config):
    numbers = {number.name: number for number in list_numbers(config)}
    assert set(CHANGES) <= set(numbers)
    assert numbers["env.command.standing"].bounds.ends == (0.0, 1.0)
    assert numbers["env.randomization.friction.1"].bounds.ends == (0.0, 100.0)
    assert numbers["env.reward.track.scale"].bounds.ends == (None, None)
    assert numbers["env.command.yaw_rate.0"].unit == "rad/s"
    assert numbers["env.reward.track.width"].help.startswith("1 at the commanded velocity")
    # What shapes a program is not among them.
    assert not [name for name in numbers if "latency" in name or "seconds" in name]
    assert not [name for name in list_names(run.TASK.env) if "command" in name]


def test_values_come_back(config):
    changed = replace_numbers(config, CHANGES)
    assert get_numbers(changed, CHANGES) == CHANGES
    assert get_numbers(config, ["env.reward.track.width", "env.command.forward.1"]) == {
        "env.reward.track.width": 0.15,
        "env.command.forward.1": 4.5,
    }
    same = change_settings(config, {"reward.track.width": 0.4, "reward.track": -3.0})
    two = ["env.reward.track.width", "env.reward.track.scale"]
    assert replace_numbers(config, {name: CHANGES[name] for name in two}) == same


def test_without_them_an_environment_has_no_more_leaves(quadruped, config):
    env = QuadrupedEnv(quadruped, config)
    assert not jax.tree.leaves(env)
    assert len(jax.tree.leaves(env.set_numbers(config, list_names(config)))) == len(
        list_names(config)
    )


def test_one_program_computes_what_programs_with_constants_do(quadruped, config):
    """Check also commands, scaled to the robot's legs, and a term whose scale was 0."""

    def run_episodes(env, keys, actions):
        def step(state, action):
            state = jax.vmap(env.step)(state, action)
            return state, (state.reward, state.done, state.metrics, state.obs)

        return jax.lax.scan(step, jax.vmap(env.reset)(keys), actions)[1]

    keys = jax.random.split(jax.random.PRNGKey(3), 8)
    actions = 0.3 * jax.random.normal(jax.random.PRNGKey(4), (6, 8, 12))
    names = list_names(config)
    env = QuadrupedEnv(quadruped, config).set_numbers(config, names)
    compiled = jax.jit(run_episodes).lower(env, keys, actions).compile()
    results = []
    for numbers in (config, replace_numbers(config, CHANGES)):
        reward, done, metrics, obs = compiled(env.set_numbers(numbers, names), keys, actions)
        other = QuadrupedEnv(quadruped, numbers)
        expected = jax.jit(run_episodes)(other, keys, actions)
        np.testing.assert_array_equal(done, expected[1])
        np.testing.assert_allclose(obs, expected[3], rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(reward, expected[0], rtol=1e-4, atol=1e-4)
        unused = metrics.pop("reward/unused"), expected[2].pop("reward/unused", None)
        assert (unused[1] is None) == (numbers is config)
        assert jnp.max(unused[0]) > 0.0
        jax.tree.map(
            lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4),
            metrics,
            expected[2],
        )
        results.append((reward, done))
    assert not np.allclose(results[0][0], results[1][0])
    assert np.sum(results[1][1]) > np.sum(results[0][1])  # the limit of the tilt is lower
