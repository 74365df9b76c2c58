"""The tasks as Gymnasium environments: its own checks, and what happens between two episodes."""

import re
import warnings

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import quadwalk.gym
from quadwalk.cli.shell import suggest_install
from quadwalk.errors import UsageError
from quadwalk.tasks import list_tasks
from tests.programs import ROOT, python

STEPS = 5  # control steps of an episode
ENVS = 4
SHORT = {"env.episode_seconds": STEPS * 0.02}  # as the fixture `env` has it


@pytest.fixture(scope="module")
def envs():
    vector_env = gymnasium.make_vec("quadwalk/Sprint-v0", num_envs=ENVS, overrides=SHORT)
    yield vector_env
    vector_env.close()


def sample_actions() -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (2 * STEPS, ENVS, 12)).astype(np.float32)


def test_every_task_is_registered_and_on_the_page():
    names = re.findall(r"`(\w+)-v0`", (ROOT / "docs/gymnasium.md").read_text())
    assert [name.lower() for name in names] == sorted(list_tasks())
    for name in list_tasks():
        spec = gymnasium.spec(f"quadwalk/{name.capitalize()}-v0")
        assert spec.kwargs == {"task": name}
        assert spec.vector_entry_point is not None


def test_one_robot_passes_the_checker_of_gymnasium():
    env = gymnasium.make("quadwalk/Sprint-v0", overrides=SHORT)
    with warnings.catch_warnings(record=True) as records:
        check_env(env.unwrapped)
    # An observation has no bounds.
    assert [str(w.message) for w in records if "infinity" not in str(w.message)] == []
    env.reset(seed=1)
    for step in range(STEPS):
        *_, terminated, truncated, info = env.step(np.zeros(12, np.float32))
        assert not terminated
        assert truncated == (step == STEPS - 1)
    assert info == {"end": "time limit"}


def test_many_robots_are_stepped_as_the_environment_steps_them(envs, env, step):
    """Compare with the environment itself, stepped without Gymnasium from the same starts."""
    assert envs.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    obs, infos = envs.reset(seed=3)
    assert infos == {}
    assert obs in envs.observation_space
    reset = jax.jit(jax.vmap(env.reset))
    seed = np.random.default_rng(3).integers(2**32, dtype=np.uint32)
    keys = jax.vmap(jax.random.split)(jax.random.split(jax.random.PRNGKey(seed), ENVS))
    state = reset(keys[:, 0])
    np.testing.assert_array_equal(obs, state.obs)
    fresh = reset(jax.vmap(jax.random.split)(keys[:, 1])[:, 0]).obs
    for number, action in enumerate(sample_actions()[:STEPS]):
        obs, reward, terminated, truncated, infos = envs.step(action)
        state = step(state, action)
        np.testing.assert_allclose(reward, state.reward, atol=1e-4)
        ended = number == STEPS - 1
        assert truncated.all() == ended
        assert not terminated.any()
        assert bool(infos) == ended
        last = np.stack(infos["final_obs"]) if ended else obs
        np.testing.assert_allclose(last, state.obs, atol=1e-3)
    np.testing.assert_allclose(obs, fresh, atol=1e-5)
    assert list(infos["final_info"]["end"]) == ["time limit"] * ENVS


def test_the_same_seed_gives_the_same_episodes(envs):
    def play(seed: int | None) -> np.ndarray:
        observations = [envs.reset(seed=seed)[0]]
        copy = observations[0].copy()
        observations += [envs.step(action)[0] for action in sample_actions()]
        np.testing.assert_array_equal(observations[0], copy)  # what is returned is the caller's
        return np.stack(observations)

    first = play(5)
    np.testing.assert_array_equal(first, play(5))
    assert not np.array_equal(first, play(None))
    # Robots differ, and so do the episodes of one.
    assert len(np.unique(first[0], axis=0)) == ENVS
    assert not np.array_equal(first[0], first[STEPS])


def test_a_step_that_cannot_be_taken_is_said(envs):
    one = gymnasium.make("quadwalk/Sprint-v0", overrides=SHORT).unwrapped
    fresh = gymnasium.make_vec("quadwalk/Sprint-v0", num_envs=ENVS, overrides=SHORT)
    for env, shape in ((one, (12,)), (fresh, (ENVS, 12))):
        with pytest.raises(UsageError, match=r"^step was called before reset; expected reset"):
            env.step(np.zeros(shape))
    one.reset(seed=0)
    envs.reset(seed=0)
    for env, shape, wrong in ((one, (12,), (1, 12)), (envs, (ENVS, 12), (12,))):
        message = f"an action has the shape {wrong}; expected {shape}"
        with pytest.raises(UsageError, match=f"^{re.escape(message)}$"):
            env.step(np.zeros(wrong))
        env.step(np.zeros(shape))  # the next one can
    with pytest.raises(UsageError, match=r"^num_envs is 0; expected 1 or more$"):
        quadwalk.gym.QuadrupedGymVectorEnv(0, "walk")


def test_actions_are_clipped(envs):
    observations = []
    for scale in (1.0, 5.0):
        envs.reset(seed=2)
        observations.append(envs.step(scale * np.sign(sample_actions()[0]))[0])
    np.testing.assert_array_equal(*observations)


def test_without_gymnasium_one_line_says_how_to_get_it():
    code = "import sys; sys.modules['gymnasium'] = None; import quadwalk.gym"
    done = python("-c", code)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert last == f"ImportError: quadwalk.gym needs Gymnasium: {suggest_install('gym')}"
