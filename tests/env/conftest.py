"""One small environment, compiled once for all tests of this folder."""

import jax
import pytest

from quadwalk.env.config import EnvConfig
from quadwalk.env.quadruped import QuadrupedEnv
from quadwalk.robot.quadruped import load_quadruped

BATCH = 4


@pytest.fixture(scope="session")
def env() -> QuadrupedEnv:
    return QuadrupedEnv(load_quadruped(), EnvConfig(episode_seconds=0.1))


@pytest.fixture(scope="session")
def reset(env):
    """Compiled: seed -> a batch of fresh states."""
    compiled = jax.jit(jax.vmap(env.reset))
    return lambda seed: compiled(jax.random.split(jax.random.PRNGKey(seed), BATCH))


@pytest.fixture(scope="session")
def step(env):
    """Compiled: (states, actions) -> states."""
    return jax.jit(jax.vmap(env.step))
