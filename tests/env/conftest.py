"""One small environment, compiled once for all tests of this folder."""

import dataclasses

import jax
import mujoco
import numpy as np
import pytest

from quadwalk.env.config import EnvConfig
from quadwalk.env.quadruped import QuadrupedEnv
from quadwalk.robot.quadruped import load_quadruped

BATCH = 4
STEPS = 200


@pytest.fixture(scope="session")
def env() -> QuadrupedEnv:
    return QuadrupedEnv(load_quadruped(), EnvConfig(episode_seconds=0.1))


@pytest.fixture(scope="session")
def body_env(env) -> QuadrupedEnv:
    """The same, but that knees and trunk touch the floor too."""
    return QuadrupedEnv(env.quadruped, dataclasses.replace(env.config, contacts="body"))


@pytest.fixture(scope="session")
def reset(env):
    """Compiled: seed -> a batch of fresh states."""
    compiled = jax.jit(jax.vmap(env.reset))
    return lambda seed: compiled(jax.random.split(jax.random.PRNGKey(seed), BATCH))


@pytest.fixture(scope="session")
def step(env):
    """Compiled: (states, actions) -> states."""
    return jax.jit(jax.vmap(env.step))


def step_in_place(
    env: QuadrupedEnv, model: mujoco.MjModel | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """A robot in MuJoCo C stepping in place: torques applied, and the states they led through."""
    model = model or env.mj_model
    data = mujoco.MjData(model)
    data.qpos[:] = env.robot.home
    data.qpos[2] += 0.03  # dropped, so that contacts begin
    data.qvel[:6] = np.random.default_rng(0).uniform(-0.2, 0.2, 6)
    phase = np.pi * np.array([0, 1, 1, 0])
    torques, states = [], [np.r_[data.qpos, data.qvel]]
    for k in range(STEPS):
        lift = np.maximum(np.sin(2 * np.pi * 2.5 * k * model.opt.timestep + phase), 0.0)
        target = env.robot.home_joints.reshape(4, 3) + np.stack([0 * lift, lift, -2 * lift], 1) / 8
        torque = 80 * (target.ravel() - data.qpos[7:]) - 2 * data.qvel[6:]
        data.ctrl[:] = torque = np.clip(torque, -env.robot.effort, env.robot.effort)
        mujoco.mj_step(model, data)
        torques.append(torque)
        states.append(np.r_[data.qpos, data.qvel])
    return np.array(torques), np.array(states)


@pytest.fixture(scope="session")
def stepping_in_place():
    """`step_in_place` as a fixture."""
    return step_in_place
