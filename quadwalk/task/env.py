"""The environment: pure functions of (legged, robot, config, state), and the Brax `Env` of them."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from quadwalk.physics.quiet_mjx import mjx  # first: Brax imports it too, but not as quietly

# isort: split
import jax
import jax.numpy as jnp
import mujoco
from brax.envs.base import Env, State

from quadwalk.physics.fast import heights, simulate, soles
from quadwalk.physics.mjx_engine import Effort, Physics
from quadwalk.physics.mjx_engine import simulate as simulate_in_mjx
from quadwalk.physics.model import Legged, legged
from quadwalk.physics.motor import joint_target
from quadwalk.physics.robot_arrays import RobotArrays, robot_arrays, task_robot
from quadwalk.robot.quadruped import Quadruped
from quadwalk.task.command import Command, first_command, next_command, velocity_of
from quadwalk.task.config import EnvConfig
from quadwalk.task.observation import observation_names, observe
from quadwalk.task.reset import fresh_start
from quadwalk.task.reward import (
    Step,
    active_terms,
    commanded_speed,
    mean_velocity,
    reward_terms,
    total_reward,
)
from quadwalk.task.termination import REASONS, fall_reasons

CONTACT_GAP = 1e-3  # m: a foot closer to the floor than this counts as touching it
MAX_SPEED = 1e3  # m/s or rad/s: no sound state of a robot is faster, so physics has diverged

# How an episode can end, by the number in `State.info["end"]`.
ENDS = ("running", "time limit", *REASONS, "nan")
_TIME_LIMIT, _FIRST_REASON, _NAN = 1, 2, 2 + len(REASONS)


class EnvState(NamedTuple):
    """What one environment carries from step to step."""

    physics: Physics
    last_action: jax.Array  # (12,)
    steps: jax.Array  # () int32, control steps since the episode's start
    command: Command | None = None  # None where the robot is told nothing


def reset(legged: Legged, robot: RobotArrays, config: EnvConfig, key: jax.Array) -> State:
    """A fresh episode; `key` is a JAX random key."""
    physics = fresh_start(legged, robot, config.reset, key)
    command = first_command(config.command, key) if config.command.given else None
    state = EnvState(physics, jnp.zeros(12), jnp.zeros((), jnp.int32), command)
    zero = jnp.zeros(())
    return State(
        pipeline_state=state,
        obs=observe(
            robot, config, physics.qpos, physics.qvel, state.last_action, velocity_of(command)
        ),
        reward=zero,
        done=zero,
        metrics={
            "speed": zero,
            "fell": zero,
            "nan": zero,
            **{f"reward/{name}": zero for name in active_terms(config.reward)},
        },
        info=_info(jnp.zeros((), jnp.int32), Effort(jnp.zeros(12), zero), jnp.zeros(4, bool)),
    )


def step(
    legged: Legged,
    robot: RobotArrays,
    config: EnvConfig,
    simulate: Callable[[Physics, jax.Array], tuple[Physics, Effort]],
    state: State,
    action: jax.Array,
) -> State:
    """One control step with `action` (12,) in [-1, 1].

    `simulate` steps the physics, from a state and joint targets (12,), rad.
    """
    before: EnvState = state.pipeline_state
    target = joint_target(robot, config.actuation, action, before.physics.qpos[7:])
    physics, effort = simulate(before.physics, target)
    return conclude(legged, robot, config, before, action, physics, effort)


def conclude(
    legged: Legged,
    robot: RobotArrays,
    config: EnvConfig,
    before: EnvState,
    action: jax.Array,
    physics: Physics,
    effort: Effort,
) -> State:
    """The state after a control step, whichever engine stepped the physics.

    A state or action that is not finite ends its episode with reward 0, and the home pose stands
    in its place, so that nothing downstream ever sees it.
    """
    numbers = jnp.concatenate(
        [physics.qpos, physics.qvel, action, effort.torque, effort.energy[None]]
    )
    sane = jnp.all(jnp.isfinite(numbers)) & jnp.all(jnp.abs(physics.qvel) < MAX_SPEED)
    action = jnp.where(sane, action, 0.0)
    home = Physics(jnp.asarray(robot.home, jnp.float32), jnp.zeros(18), jnp.zeros(18))
    physics = jax.tree.map(lambda x, safe: jnp.where(sane, x, safe), physics, home)
    effort = jax.tree.map(lambda x: jnp.where(sane, x, 0.0), effort)

    feet, lowest = heights(legged, physics.qpos)
    reasons = fall_reasons(robot, config.termination, physics.qpos, lowest)
    fell = jnp.any(reasons) & sane
    steps = before.steps + 1
    end = jnp.where(steps >= config.episode_steps, _TIME_LIMIT, 0)
    end = jnp.where(fell, _FIRST_REASON + jnp.argmax(reasons), end)
    end = jnp.where(sane, end, _NAN).astype(jnp.int32)

    command = before.command
    if command is not None:
        command = next_command(config.command, command, steps, config.command_steps)
    start = jnp.where(sane, before.physics.qpos, physics.qpos)
    contact = feet < CONTACT_GAP
    record = Step(
        dt=config.control_dt,
        start=start,
        qpos=physics.qpos,
        qvel=physics.qvel,
        action=action,
        last_action=before.last_action,
        power=effort.energy / config.control_dt,
        fell=fell,
        command=velocity_of(before.command),
        start_soles=soles(legged, start),
        soles=soles(legged, physics.qpos),
        contact=contact,
    )
    terms = {
        name: jnp.where(sane, value, 0.0)
        for name, value in reward_terms(robot, config.reward, record).items()
    }
    return State(
        pipeline_state=EnvState(physics, action, steps, command),
        obs=observe(robot, config, physics.qpos, physics.qvel, action, velocity_of(command)),
        reward=total_reward(config.reward, terms),
        done=(end > 0).astype(jnp.float32),
        metrics={
            "speed": commanded_speed(record) if config.command.given else mean_velocity(record)[0],
            "fell": fell.astype(jnp.float32),
            "nan": 1.0 - sane.astype(jnp.float32),
            **{f"reward/{name}": value for name, value in terms.items()},
        },
        info=_info(end, effort, contact),
    )


def _info(end: jax.Array, effort: Effort, contact: jax.Array) -> dict[str, Any]:
    return {
        "end": end,  # index into ENDS
        "truncation": (end == _TIME_LIMIT).astype(jnp.float32),
        "torque": effort.torque,
        "energy": effort.energy,
        "contact": contact,
    }


class QuadrupedEnv(Env):
    """`reset` and `step` of one quadruped as a `brax.envs.base.Env`; vmap them for a batch.

    It does not reset itself: a step past the end of an episode goes on from where it was. Use
    `quadwalk.train.ppo`, which starts a fresh episode after each, for training.
    """

    def __init__(self, quadruped: Quadruped, config: EnvConfig | None = None) -> None:
        self.config = config or EnvConfig()
        self.quadruped = task_robot(quadruped, self.config)
        self.mj_model: mujoco.MjModel = self.quadruped.training_model(
            self.config.physics_dt,
            self.config.solver_iterations,
            self.config.line_search_iterations,
            self.config.contacts,
        )
        # By default MJX takes the first of all devices, which may be another process's.
        self.model = mjx.put_model(self.mj_model, device=jax.local_devices()[0])
        self.robot = robot_arrays(self.quadruped, self.mj_model)
        self.legged = legged(self.mj_model, self.robot)

    def reset(self, rng: jax.Array) -> State:
        """A fresh episode."""
        return reset(self.legged, self.robot, self.config, rng)

    def step(self, state: State, action: jax.Array) -> State:
        """One control step with `action` (12,) in [-1, 1]."""
        physics = partial(simulate, self.legged, self.robot, self.config)
        return step(self.legged, self.robot, self.config, physics, state, action)

    def step_in_mjx(self, state: State, action: jax.Array) -> State:
        """The same control step with the physics left to MJX: slower, to judge and to check by."""
        physics = partial(simulate_in_mjx, self.model, self.robot, self.config)
        return step(self.legged, self.robot, self.config, physics, state, action)

    @property
    def observation_size(self) -> int:
        return len(self.observation_names)

    @property
    def observation_names(self) -> tuple[str, ...]:
        return observation_names(self.config, self.quadruped.joints)

    @property
    def action_size(self) -> int:
        return 12

    @property
    def backend(self) -> str:
        return "mjx"
