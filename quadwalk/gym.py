"""The tasks as Gymnasium environments, "quadwalk/Run-v0" and so on, stepped by the fast engine.

    import gymnasium
    import quadwalk.gym  # registers them

    env = gymnasium.make("quadwalk/Run-v0")
    envs = gymnasium.make_vec("quadwalk/Run-v0", num_envs=1024)

Both take `task`, `robot` and `overrides` as `quadwalk.make` does. An observation is what the policy
sees; what the value network sees besides is left out.
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from quadwalk.cli.shell import suggest_install

try:
    import gymnasium
except ModuleNotFoundError as error:
    raise ImportError(f"quadwalk.gym needs Gymnasium: {suggest_install('gym')}") from error
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P

from quadwalk.api import make
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.state import select_rows
from quadwalk.errors import UsageError
from quadwalk.settings.training import TrainConfig
from quadwalk.tasks import list_tasks


class QuadrupedGymEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One robot. `info["end"]` is "running", "time limit", or how it fell."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - as Gymnasium has it

    def __init__(
        self,
        task: str | Path | TrainConfig,
        robot: str | Path | None = None,
        overrides: Mapping[str, Any] | None = None,
        render_mode: None = None,
    ) -> None:
        env = make(task, robot, overrides)
        self.render_mode = render_mode
        self.observation_space, self.action_space = _make_spaces(env)
        self._ends, self._size = env.ends, env.policy_size
        self._reset = partial(jax.jit(QuadrupedEnv.reset), env)
        self._step = partial(jax.jit(QuadrupedEnv.step, donate_argnums=1), env)
        self._state: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; the same seed gives the same. `options` are ignored."""
        super().reset(seed=seed, options=options)
        self._state = self._reset(_sample_key(self.np_random))
        return self._get_observation(), {"end": self._ends[0]}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take a control step with `action` (12,), which is clipped to [-1, 1]."""
        clipped = _clip_action(self._state, action, self.action_space)
        self._state = state = self._step(self._state, clipped)
        truncated = bool(state.info["truncation"])
        terminated = bool(state.done) and not truncated
        info = {"end": self._ends[int(state.info["end"])]}
        return self._get_observation(), float(state.reward), terminated, truncated, info

    def _get_observation(self) -> np.ndarray:
        return np.array(self._state.obs[: self._size])


class QuadrupedGymVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many robots, shared out between the cores.

    An episode that ends is followed by the next in the same step: the observation is the first of
    the new one, `infos["final_obs"]` and `infos["final_info"]` are of the old one's last step.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium has it
        "render_modes": [],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        task: str | Path | TrainConfig,
        robot: str | Path | None = None,
        overrides: Mapping[str, Any] | None = None,
    ) -> None:
        if num_envs < 1:
            raise UsageError(f"num_envs is {num_envs}; expected 1 or more")
        env = make(task, robot, overrides)
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = _make_spaces(env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ends = np.array(env.ends, object)
        self._start, self._step, self._restart = _make_programs(env, num_envs)
        self._state: Any = None
        self._keys: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in each environment; the same seed gives the same ones, for ever."""
        super().reset(seed=seed, options=options)
        self._keys = jax.random.split(_sample_key(self.np_random), self.num_envs)
        self._state, self._keys, observations = self._start(self._keys)
        return np.array(observations), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take a control step with `actions` (num_envs, 12), which are clipped to [-1, 1]."""
        clipped = _clip_action(self._state, actions, self.action_space)
        self._state, observations, reward, end = self._step(self._state, clipped)
        end = np.asarray(end)
        done, truncated = end > 0, self._ends[end] == "time limit"
        infos: dict[str, Any] = {}
        if done.any():
            infos = self._make_infos(np.array(observations), end, done)
            fresh, later, _ = self._start(self._keys)
            old = self._state, self._keys
            self._state, self._keys, observations = self._restart(done, (fresh, later), old)
        return np.array(observations), np.array(reward), done & ~truncated, truncated, infos

    def _make_infos(
        self, observations: np.ndarray, end: np.ndarray, done: np.ndarray
    ) -> dict[str, Any]:
        """Return what Gymnasium wants to know of the episodes that ended."""
        last = np.full(self.num_envs, None, object)
        for index in np.flatnonzero(done):
            last[index] = observations[index]
        ends = np.where(done, self._ends[end], None)
        return {
            "final_obs": last,
            "_final_obs": done,
            "final_info": {"end": ends, "_end": done},
            "_final_info": done,
        }


def _make_programs(env: QuadrupedEnv, num_envs: int) -> tuple[Any, Any, Any]:
    """Return programs that start, step and restart `num_envs` episodes, split over the devices."""
    size = env.policy_size

    def start(env: QuadrupedEnv, keys: Any) -> Any:
        now, later = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
        state = jax.vmap(env.reset)(now)
        return state, later, state.obs[:, :size]

    def step(env: QuadrupedEnv, state: Any, actions: Any) -> Any:
        after = jax.vmap(env.step)(state, actions)
        return after, after.obs[:, :size], after.reward, after.info["end"]

    def restart(env: QuadrupedEnv, done: Any, fresh: Any, old: Any) -> Any:
        state, keys = select_rows(done, fresh, old)
        return state, keys, state.obs[:, :size]

    count = max(n for n in range(1, len(jax.devices()) + 1) if num_envs % n == 0)
    mesh = Mesh(np.array(jax.devices()[:count]), ("envs",))

    def compile_program(function: Any, donate: tuple[int, ...] = ()) -> Any:
        def share(env: QuadrupedEnv, *arguments: Any) -> Any:
            split = P("envs")
            shared = jax.shard_map(
                partial(function, env), mesh=mesh, in_specs=split, out_specs=split, check_vma=False
            )
            return shared(*arguments)

        return partial(jax.jit(share, donate_argnums=donate), env)

    return (
        compile_program(start),
        compile_program(step, donate=(1,)),
        compile_program(restart, donate=(2, 3)),
    )


def _make_spaces(env: Any) -> tuple[spaces.Box, spaces.Box]:
    """Return the spaces of observations, unbounded, and actions, -1 to 1, of one robot."""
    observations = spaces.Box(-np.inf, np.inf, (env.policy_size,), np.float32)
    return observations, spaces.Box(-1.0, 1.0, (env.action_size,), np.float32)


def _clip_action(state: Any, action: np.ndarray, space: spaces.Space[np.ndarray]) -> np.ndarray:
    """Return `action` as float32, clipped to [-1, 1]; `UsageError` where no step can be taken."""
    if state is None:
        raise UsageError("step was called before reset; expected reset first")
    array = np.asarray(action, np.float32)
    if array.shape != space.shape:
        raise UsageError(f"an action has the shape {array.shape}; expected {space.shape}")
    return np.clip(array, -1.0, 1.0)


def _sample_key(random: np.random.Generator) -> Any:
    """Return a JAX random key that NumPy's generator draws."""
    return jax.random.PRNGKey(random.integers(2**32, dtype=np.uint32))


def register() -> None:
    """Register every task with Gymnasium, "run" as quadwalk/Run-v0; importing this file does it."""
    for name in list_tasks():
        gymnasium.register(
            f"quadwalk/{name.capitalize()}-v0",
            entry_point="quadwalk.gym:QuadrupedGymEnv",
            vector_entry_point="quadwalk.gym:QuadrupedGymVectorEnv",
            kwargs={"task": name},
        )


register()
