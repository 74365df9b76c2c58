"""A policy that acts in Python for a page, where its observation is Python of the user's own."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.command import Command
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.state import EnvState
from quadwalk.evaluation.load import LoadedRun
from quadwalk.physics.motor import PhysicsState


class PythonActor:
    """The policy of one page: it computes joint targets with the task's own functions.

    It works on a flat floor, without noise and latency.
    """

    def __init__(self, loaded: LoadedRun) -> None:
        self._env = loaded.env
        key = jax.random.PRNGKey(0)
        self._first: EnvState = loaded.env.reset(key).pipeline_state
        self._state = self._first
        self._last_time = np.inf
        self._act = jax.jit(partial(act, loaded.policy.act))

    def __call__(
        self, time: float, qpos: list[float], qvel: list[float], command: list[float]
    ) -> list[float]:
        """Return the joint targets (12,), rad, of a state `time` s after the start."""
        starts = time <= self._last_time
        self._last_time = time
        physics = PhysicsState(jnp.asarray(qpos, jnp.float32), jnp.asarray(qvel, jnp.float32))
        before = self._first if starts else self._state
        state = before._replace(physics=physics)
        if state.command is not None:
            velocity = Command(jnp.float32(command), state.command.key)
            state = state._replace(command=velocity)
        self._state, targets = self._act(self._env, state, starts)
        return np.asarray(targets, float).tolist()


def act(
    policy: Any, env: QuadrupedEnv, state: EnvState, starts: jax.Array
) -> tuple[EnvState, jax.Array]:
    """Return the state to pass to the next call, and the joint targets (12,), rad, of `state`.

    The returned state holds the action, one more step and the new measurement. Its physics is that
    of `state`: the page simulates the step. Where `starts` () bool, earlier measurements are
    forgotten.
    """
    measured = env.sensors.measure(env.robot, state)
    first = env.sensors.start_history(env.robot, state, 0)
    if measured.frames is not None and first.frames is not None:
        measured = measured._replace(frames=jnp.where(starts, first.frames, measured.frames))
    action = policy(env.sensors.observe(env.robot, measured)[: env.policy_size])
    targets = env.config.action(env.robot, action, state.qpos[7:])
    return measured._replace(last_action=action, steps=state.steps + 1), targets
