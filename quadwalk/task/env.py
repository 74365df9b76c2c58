"""The environment: a task for one quadruped, as the pure functions `reset` and `step`."""

from functools import cached_property, partial
from typing import Any

from quadwalk.physics.engines import ENGINES, EngineName, fast, mujoco_c  # before Brax's MJX

# isort: split
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from brax.envs.base import Env, State

from quadwalk.physics.motor import Effort, Physics, make_motor
from quadwalk.robot.quadruped import Quadruped
from quadwalk.task.command import first_command, next_command
from quadwalk.task.conditions import Conditions, delayed, pushed, sensed
from quadwalk.task.config import EnvConfig
from quadwalk.task.observation import observe
from quadwalk.task.reset import fresh_start
from quadwalk.task.reward import reward_terms, total_reward
from quadwalk.task.robot_arrays import robot_arrays, task_robot
from quadwalk.task.state import EnvState, Step, commanded_speed, mean_velocity
from quadwalk.task.termination import terminations

CONTACT_GAP = 1e-3  # m: a foot closer to the floor than this counts as touching it
MAX_SPEED = 1e3  # m/s or rad/s: no sound state of a robot is faster, so physics has diverged

_RUNNING, _TIME_LIMIT, _FIRST_FALL = 0, 1, 2


class QuadrupedEnv(Env):
    """A task for one quadruped as a `brax.envs.base.Env`; vmap `reset` and `step` for a batch.

    It does not reset itself: a step past the end of an episode goes on from where it was. Use
    `quadwalk.train.ppo`, which starts a fresh episode after each, for training.

    `engine` steps its physics, by default that of `config`. MuJoCo C ("mujoco") steps the full
    model, in which every shape collides and the solver converges.
    """

    def __init__(
        self, quadruped: Quadruped, config: EnvConfig, engine: EngineName | None = None
    ) -> None:
        self.config = config
        self.engine: EngineName = engine or config.engine
        self.quadruped = task_robot(quadruped, config)
        self.stepping = config.stepping
        self.mj_model = self._training_model(self.quadruped)
        self.robot = robot_arrays(self.quadruped, self.mj_model)
        self.motor = make_motor(self.mj_model, self.quadruped, config.motor)
        self.geometry = fast.make_model(self.mj_model, self.quadruped, self.motor)
        if self.engine == "mujoco":
            self.stepping = self.stepping.with_dt(mujoco_c.TIMESTEP)
        self.model = self.geometry if self.engine == "fast" else self.model_of(self.quadruped)
        self.ends = ("running", "time limit", *config.termination, "nan")

    def _training_model(self, quadruped: Quadruped) -> mujoco.MjModel:
        config = self.config
        return quadruped.training_model(
            config.physics_dt,
            config.solver_iterations,
            config.line_search_iterations,
            config.contacts,
        )

    def mj_model_of(self, quadruped: Quadruped) -> mujoco.MjModel:
        """The MuJoCo model of a robot that the engine steps."""
        if self.engine == "mujoco":
            return quadruped.full_model(self.stepping.dt)
        return self._training_model(quadruped)

    def model_of(self, quadruped: Quadruped) -> Any:
        """The engine's constants of `quadruped`, with the motors of the environment's own robot."""
        model = self.mj_model_of(quadruped)
        return ENGINES[self.engine].make_model(model, quadruped, self.motor)

    def in_engine(self, engine: EngineName) -> "QuadrupedEnv":
        """The same environment with its physics stepped by `engine`."""
        return self if engine == self.engine else QuadrupedEnv(self.quadruped, self.config, engine)

    def reset(self, rng: jax.Array) -> State:
        """A fresh episode; `rng` is a JAX random key."""
        config = self.config
        physics = fresh_start(self.geometry, self.robot, config.reset, rng)
        command = first_command(config.command, rng) if config.command.given else None
        state = EnvState(physics, jnp.zeros(12), jnp.zeros((), jnp.int32), command)
        zero = jnp.zeros(())
        terms = {name: zero for name, term in config.reward.items() if term.scale != 0.0}
        return State(
            pipeline_state=state,
            obs=self.observe(state),
            reward=zero,
            done=zero,
            metrics=_metrics(zero, zero, zero, terms),
            info=_info(jnp.zeros((), jnp.int32), Effort(jnp.zeros(12), zero), jnp.zeros(4, bool)),
        )

    def step(self, state: State, action: jax.Array) -> State:
        """One control step with `action` (12,) in [-1, 1]."""
        return self.step_with(self.model, state, action)

    def step_with(self, model: Any, state: State, action: jax.Array) -> State:
        """`step` of a robot whose constants are `model`, of which any may differ from `self.model`.

        A state or action that is not finite ends its episode with reward 0, and the home pose
        stands in its place, so that nothing downstream ever sees it.
        """
        before: EnvState = state.pipeline_state
        conditions, physics = before.conditions, before.physics
        target = self.config.action(self.robot, action, physics.qpos[7:])
        if conditions is not None:
            physics = pushed(conditions, physics, before.steps, self.config.control_dt)
            conditions, target = delayed(conditions, target, self.stepping.substeps)
        physics, effort = ENGINES[self.engine].control_step(model, self.stepping, physics, target)
        sane, physics, effort, action = self._kept_sane(physics, effort, action)
        command, steps = before.command, before.steps + 1
        if command is not None:
            command = next_command(self.config.command, command, steps, self.config.command_steps)
        after = EnvState(physics, action, steps, command, conditions)
        return self.finish_step(before, after, effort, sane)

    def with_conditions(self, state: State, conditions: Conditions) -> State:
        """`state`, of an episode's start, under conditions that last for the episode."""
        begun = state.pipeline_state._replace(conditions=conditions)
        return state.replace(pipeline_state=begun, obs=self.observe(begun))

    def observe(self, state: EnvState) -> jax.Array:
        """The observation (n,), float32, with the noise that the episode's conditions give it."""
        seen = observe(self.config.observation, self.robot, state)
        if state.conditions is None:
            return seen
        return sensed(state.conditions, seen, self.noise_scale, state.steps)

    def _kept_sane(
        self, physics: Physics, effort: Effort, action: jax.Array
    ) -> tuple[jax.Array, Physics, Effort, jax.Array]:
        """Whether all numbers are finite and no speed absurd, and the three, harmless if not."""
        numbers = jnp.concatenate(
            [physics.qpos, physics.qvel, action, effort.torque, effort.energy[None]]
        )
        sane = jnp.all(jnp.isfinite(numbers)) & jnp.all(jnp.abs(physics.qvel) < MAX_SPEED)
        action = jnp.where(sane, action, 0.0)
        home = Physics(jnp.asarray(self.robot.home, jnp.float32), jnp.zeros(18), jnp.zeros(18))
        physics = jax.tree.map(lambda x, safe: jnp.where(sane, x, safe), physics, home)
        effort = jax.tree.map(lambda x: jnp.where(sane, x, 0.0), effort)
        return sane, physics, effort, action

    def finish_step(
        self, before: EnvState, after: EnvState, effort: Effort, sane: jax.Array
    ) -> State:
        """The state that a control step led to, with its reward and whether the episode ended."""
        config, robot = self.config, self.robot
        feet, lowest = fast.heights(self.geometry, after.qpos)
        start = jnp.where(sane, before.qpos, after.qpos)
        contact = feet < CONTACT_GAP
        step = Step(
            dt=config.control_dt,
            start=start,
            qpos=after.qpos,
            qvel=after.qvel,
            action=after.last_action,
            last_action=before.last_action,
            power=effort.energy / config.control_dt,
            fell=jnp.zeros((), bool),
            command=before.velocity_command,
            start_soles=fast.soles(self.geometry, start),
            soles=fast.soles(self.geometry, after.qpos),
            contact=contact,
            lowest=lowest,
        )
        falls = terminations(config.termination, robot, step)
        fell = jnp.any(falls) & sane
        end = jnp.where(after.steps >= config.episode_steps, _TIME_LIMIT, _RUNNING)
        end = jnp.where(fell, _FIRST_FALL + jnp.argmax(falls), end)
        end = jnp.where(sane, end, len(self.ends) - 1).astype(jnp.int32)
        step = step._replace(fell=fell)
        terms = {
            name: jnp.where(sane, value, 0.0)
            for name, value in reward_terms(config.reward, robot, step).items()
        }
        speed = commanded_speed(step) if config.command.given else mean_velocity(step)[0]
        return State(
            pipeline_state=after,
            obs=self.observe(after),
            reward=total_reward(config.reward, terms),
            done=(end > 0).astype(jnp.float32),
            metrics=_metrics(
                speed, fell.astype(jnp.float32), 1.0 - sane.astype(jnp.float32), terms
            ),
            info=_info(end, effort, contact),
        )

    @cached_property
    def _observation_parts(self) -> dict[str, tuple[str, ...]]:
        """Names of the numbers of each part of the observation."""
        robot = self.robot
        state = EnvState(
            Physics(jnp.asarray(robot.home, jnp.float32), jnp.zeros(18), jnp.zeros(18)),
            jnp.zeros(12),
            jnp.zeros((), jnp.int32),
        )
        sizes = {
            name: jax.eval_shape(partial(part, robot), state).size
            for name, part in self.config.observation.items()
        }
        parts = self.config.observation
        return {
            name: parts[name].names(name, size, self.quadruped.joints)
            for name, size in sizes.items()
        }

    @property
    def observation_names(self) -> tuple[str, ...]:
        """A name for each number of the observation."""
        return tuple(name for names in self._observation_parts.values() for name in names)

    @cached_property
    def noise_scale(self) -> np.ndarray:
        """(n,) standard deviation of each number of the observation at noise level 1."""
        parts = self._observation_parts.items()
        scales = [np.full(len(n), self.config.observation[part].noise) for part, n in parts]
        return np.concatenate(scales).astype(np.float32)

    @property
    def observation_size(self) -> int:
        return len(self.observation_names)

    @property
    def action_size(self) -> int:
        return 12

    @property
    def backend(self) -> str:
        return self.engine


def _metrics(
    speed: jax.Array, fell: jax.Array, nan: jax.Array, terms: dict[str, jax.Array]
) -> dict[str, jax.Array]:
    rewards = {f"reward/{name}": value for name, value in terms.items()}
    return {"speed": speed, "fell": fell, "nan": nan, **rewards}


def _info(end: jax.Array, effort: Effort, contact: jax.Array) -> dict[str, Any]:
    return {
        "end": end,  # index into `QuadrupedEnv.ends`
        "truncation": (end == _TIME_LIMIT).astype(jnp.float32),
        "torque": effort.torque,
        "energy": effort.energy,
        "contact": contact,
    }
