"""The environment: a task for one quadruped, as the pure functions `reset` and `step`."""

import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.typing import ArrayLike

from quadwalk.brax import Env, State
from quadwalk.env.command import counted, first_command, next_command
from quadwalk.env.curriculum import begin_travel, make_curriculum, travel_on
from quadwalk.env.randomization import (
    EpisodeRandomization,
    delayed,
    draw_conditions,
    pushed,
)
from quadwalk.env.reflections import Mirrors
from quadwalk.env.reset import fresh_start, on_tile
from quadwalk.env.rewards import reward_terms, total_reward
from quadwalk.env.robot_arrays import (
    RobotArrays,
    above_ground,
    is_standing,
    robot_arrays,
    task_robot,
)
from quadwalk.env.sensors import make_sensors
from quadwalk.env.state import (
    EnvState,
    Step,
    commanded_speed,
    heading_velocity,
    mean_velocity,
    velocity_error,
)
from quadwalk.env.terminations import TIME_LIMIT, episode_end, names_of_ends, terminations
from quadwalk.physics.engines import ENGINES, EngineName, fast, mujoco_c
from quadwalk.physics.motor import Effort, PhysicsState, make_standing_motor
from quadwalk.physics.surface import Ground
from quadwalk.robot.mirror import find_robot_mirror
from quadwalk.robot.quadruped import Quadruped
from quadwalk.settings.environment import EnvConfig
from quadwalk.terrain.terrain import leg_length, make_terrain

CONTACT_GAP = 1e-3  # m: a foot closer to the floor than this counts as touching it
FARTHEST = 1e6  # m or rad: no sound state of a robot has a place, or an angle, beyond
MAX_SPEED = 1e3  # m/s or rad/s: no sound state of a robot is faster, so physics has diverged


class EnvParams(NamedTuple):
    """The data that programs read: an argument of theirs, since as constants it compiles slowly.

    The robot's numbers are not among it. They are constants, which XLA folds: zeros vanish.
    """

    ground: Ground | None  # None: level, at height 0, without end


@jax.tree_util.register_pytree_node_class
class QuadrupedEnv(Env):
    """A task for one quadruped as a `brax.envs.base.Env`; vmap `reset` and `step` for a batch.

    It does not reset itself: a step past the end of an episode continues from there. Use
    `quadwalk.learn.ppo`, which starts a fresh episode after each, for training.

    It is a pytree whose leaves are those of `params`: `jax.jit(f)(env, ...)` has the ground as an
    argument of the program, in a program that closes over `env` it is a constant.

    `engine` steps its physics, by default that of `config`. MuJoCo C ("mujoco") steps the full
    model, in which every shape collides and the solver converges.
    """

    def __init__(
        self, quadruped: Quadruped, config: EnvConfig, engine: EngineName | None = None
    ) -> None:
        leg = leg_length(quadruped.make_full_model(visuals=False), quadruped.feet[0])
        command = config.command.scale_to(leg, quadruped.foot_speed)
        config = replace(config.effective, command=command)
        self.config = config
        self.engine: EngineName = engine or config.engine
        self.terrain = None if config.ground.flat else make_terrain(config.ground, leg)
        self.curriculum = make_curriculum(config, self.terrain)
        field = None if self.terrain is None else self.terrain.field
        self.quadruped = task_robot(quadruped, config, field)
        self.stepping = config.stepping
        self.mj_model = self._training_model(self.quadruped)
        # `gains_note` is a line where the default gains do not hold the robot, or ""
        self.motor, self.gains_note = make_standing_motor(
            self.mj_model, self.quadruped, config.motor
        )
        geometry = fast.make_model(self.mj_model, self.quadruped, self.motor)
        level = geometry._replace(ground=None)
        self._level_robot = robot_arrays(self.quadruped, self.mj_model, level)
        if self.engine == "mujoco":
            self.stepping = self.stepping.replace_dt(mujoco_c.TIMESTEP)
        self._model: Any = None
        if self.engine != "fast":
            stepped = self.mj_model_of(self.quadruped)
            self._model = ENGINES[self.engine].make_model(stepped, self.quadruped, self.motor)
        geoms = ("floor", *self.quadruped.feet)
        self.friction = float(max(self.mj_model.geom(name).friction[0] for name in geoms))
        self.ends = names_of_ends(config.termination)
        self.sensors = make_sensors(config, self._level_robot, self.quadruped.joints, self._example)
        self._constants = copy.copy(self)
        self.params = EnvParams(jax.device_put(geometry.ground))

    def tree_flatten(self) -> tuple[tuple[EnvParams], "QuadrupedEnv"]:
        """Return the parameters as a pytree's children, and the rest as its constants."""
        return (self.params,), self._constants

    @classmethod
    def tree_unflatten(
        cls, constants: "QuadrupedEnv", children: tuple[EnvParams]
    ) -> "QuadrupedEnv":
        """Return the environment that `tree_flatten` took apart, with parameters `children`."""
        env = copy.copy(constants)
        env._constants = constants
        (env.params,) = children
        return env

    @property
    def robot(self) -> RobotArrays:
        """The constants of the robot, and the ground that it is on."""
        level = self._level_robot
        return replace(level, geometry=level.geometry._replace(ground=self.params.ground))

    @property
    def model(self) -> Any:
        """The model that the engine steps."""
        return self.robot.geometry if self._model is None else self._model

    def _training_model(self, quadruped: Quadruped) -> mujoco.MjModel:
        config = self.config
        return quadruped.make_training_model(
            config.physics_dt,
            config.solver_iterations,
            config.line_search_iterations,
            config.contacts,
        )

    def mj_model_of(self, quadruped: Quadruped) -> mujoco.MjModel:
        """The MuJoCo model of a robot that the engine steps."""
        if self.engine == "mujoco":
            return quadruped.make_full_model(self.stepping.dt)
        return self._training_model(quadruped)

    def in_engine(self, engine: EngineName) -> "QuadrupedEnv":
        """The same environment with its physics stepped by `engine`."""
        return self if engine == self.engine else QuadrupedEnv(self.quadruped, self.config, engine)

    def reset(self, rng: jax.Array, tile: jax.Array | None = None) -> State:
        """A fresh episode; `rng` is a JAX random key.

        It begins on tile `tile`, () int32, an index into `terrain.tiles`; None: on any of them.
        """
        config = self.config
        physics, tile = self._start(rng, tile)
        drawn = self._drawn(jax.random.fold_in(rng, 1))
        command = None
        if config.command.active:
            command = first_command(config.command, rng, config.control_dt, self._grip(drawn))
        start = EnvState(
            physics, jnp.zeros(12), jnp.zeros((), jnp.int32), command, drawn, tile=tile
        )
        if self.curriculum is not None:
            start = start._replace(travel=begin_travel(physics.qpos))
        zero = jnp.zeros(())
        terms = {name: zero for name, term in config.reward.items() if term.scale != 0.0}
        state = State(
            pipeline_state=start,
            obs=zero,
            reward=zero,
            done=zero,
            metrics=_metrics(zero, zero, zero, terms, self._of_task(zero, zero)),
            info=_info(jnp.zeros((), jnp.int32), Effort(jnp.zeros(12), zero), jnp.zeros(4, bool)),
        )
        return self.begun(state)

    def _start(
        self, rng: jax.Array, tile: jax.Array | None
    ) -> tuple[PhysicsState, jax.Array | None]:
        """A start, and the tile that it is on."""
        # Drawn as on a flat floor, then put on the ground.
        physics = fresh_start(self._level_robot, self.config.reset, rng)
        if self.terrain is None:
            return physics, None
        which, where = jax.random.split(jax.random.fold_in(rng, 2))
        if tile is None:
            tile = jax.random.randint(which, (), 0, len(self.terrain.tiles))
        return on_tile(self.robot.geometry, self.terrain, physics, tile, where), tile

    def step(self, state: State, action: jax.Array) -> State:
        """One control step with `action` (12,) in [-1, 1].

        A state or action that is not finite ends its episode with reward 0, and the pose before
        it stands in its place, so that nothing downstream ever sees it.
        """
        before: EnvState = state.pipeline_state
        # Act: joint targets take effect late, a push may come, the engine moves the robot.
        model, physics, conditions, target = self.driven(before, action)
        physics, effort = ENGINES[self.engine].step(model, self.stepping, physics, target)
        sane, physics, effort, action = _kept_sane(
            self.robot.home, before.qpos, physics, effort, action
        )
        steps, command = before.steps + 1, before.command
        if command is not None:
            config, grip = self.config, self._grip(conditions)
            command = next_command(config.command, command, steps, config.control_dt, grip)
        after = before._replace(
            physics=physics,
            last_action=action,
            steps=steps,
            command=command,
            conditions=conditions,
        )
        # Reward, termination and senses.
        following = self.finish_step(before, after, effort, sane)
        # What wrappers keep there, as Brax's do, stays.
        return following.replace(
            info=state.info | following.info, metrics=state.metrics | following.metrics
        )

    def finish_step(
        self, before: EnvState, after: EnvState, effort: Effort, sane: jax.Array
    ) -> State:
        """The state that a control step led to, with its reward and whether the episode ended."""
        config = self.config
        step = self._step(before, after, effort, sane)
        # End: a fall, the time limit, the edge of the ground, or numbers that are not finite.
        falls = terminations(config.termination, self.robot, step)
        step = step._replace(fell=jnp.any(falls) & sane)
        end = episode_end(config, self.terrain, after, falls, sane)
        # Reward.
        terms = {
            name: jnp.where(sane, value, 0.0)
            for name, value in reward_terms(config.reward, self.robot, step).items()
        }
        # Sense.
        after = self.sensors.measure(self.robot, self._traveled(after, step))
        if config.critic:
            after = after._replace(contact=step.contact)
        speed = commanded_speed(step) if config.command.active else mean_velocity(step)[0]
        failed, fell = 1.0 - sane.astype(jnp.float32), step.fell.astype(jnp.float32)
        standing = is_standing(self.robot, after.qpos).astype(jnp.float32)
        of_task = self._of_task(jnp.linalg.norm(velocity_error(step)), standing)
        return State(
            pipeline_state=after,
            obs=self.sensors.observe(self.robot, after),
            reward=total_reward(config.reward, terms),
            done=(end > 0).astype(jnp.float32),
            metrics=_metrics(speed, fell, failed, terms, of_task),
            info=_info(end, effort, step.contact),
        )

    def _of_task(self, error: jax.Array, standing: jax.Array) -> dict[str, jax.Array]:
        """Return the metrics that only such a task has: with commands, or starting in any pose."""
        errors = {"velocity_error": error} if self.config.command.active else {}
        return errors | ({"standing": standing} if self.config.reset.tumbled else {})

    def driven(
        self, before: EnvState, action: jax.Array
    ) -> tuple[Any, PhysicsState, EpisodeRandomization | None, jax.Array]:
        """What the engine steps in a control step from `before` with `action` (12,).

        The model, its first state, the conditions, and joint targets, (12,) or (substeps, 12), rad.
        """
        model, conditions, physics = self.model, before.conditions, before.physics
        target = self.config.action(self.robot, action, physics.qpos[7:])
        if conditions is not None:
            physics = pushed(conditions, physics, before.steps, self.config.push_steps)
            substeps = self.stepping.substeps
            conditions, target = delayed(conditions, target, substeps, before.steps)
            if conditions.variation is not None:
                model = ENGINES[self.engine].apply_randomization(model, conditions.variation)
        return model, physics, conditions, target

    def begun(self, state: State, latest: int | None = None, **changes: Any) -> State:
        """`state`, of an episode's start, with `changes` of its `EnvState`, as it is then seen.

        Sensors may be late by `latest` control steps; None: by as many as the task draws.
        """
        begun = state.pipeline_state._replace(**changes)
        start = self.sensors.start_history(self.robot, begun, latest)
        return state.replace(pipeline_state=start, obs=self.sensors.observe(self.robot, start))

    def applied_target(self, state: EnvState, action: jax.Array) -> jax.Array:
        """The joint angles (12,), rad, that motors go to at the end of a step with `action`."""
        target = self.config.action(self.robot, action, state.qpos[7:])
        if state.conditions is None:
            return target
        return delayed(state.conditions, target, self.stepping.substeps, state.steps)[1][-1]

    def _drawn(self, key: jax.Array) -> EpisodeRandomization | None:
        """The conditions of an episode; None in an ideal world."""
        ranges = self.config.randomization
        if not ranges.enabled:
            return None
        return draw_conditions(ranges, self._level_robot, self.stepping, key, self.friction)

    def _grip(self, conditions: EpisodeRandomization | None) -> ArrayLike:
        """The acceleration () that friction bears, m/s^2."""
        if conditions is None or conditions.variation is None:
            return self.config.gravity * self.friction
        return self.config.gravity * conditions.variation.friction

    def _step(self, before: EnvState, after: EnvState, effort: Effort, sane: jax.Array) -> Step:
        """The control step as rewards and terminations see it, before it is known which fell."""
        config, dt, qpos = self.config, self.config.control_dt, after.qpos
        start = jnp.where(sane, before.qpos, qpos)
        soles, lowest = fast.compute_lowest_points(self.robot.geometry, qpos)
        # MuJoCo's ground gives way: a foot that lands sinks in, up to 2 cm at a run, its shin too.
        radius = self.robot.geometry.contacts[0].radius
        legs = lowest[1:] - jnp.clip(soles[:, 2], -radius, 0.0)
        level = self.terrain is None
        command = before.velocity_command
        if before.command is not None:
            speed = jnp.linalg.norm(qpos[:2] - start[:2]) / dt
            command = counted(config.command, before.command, speed, self._grip(before.conditions))
        return Step(
            dt=dt,
            steps=after.steps,
            start=start,
            qpos=qpos,
            qvel=after.qvel,
            action=after.last_action,
            last_action=before.last_action,
            power=effort.energy / dt,
            fell=jnp.zeros((), bool),
            command=command,
            start_soles=fast.compute_lowest_points(self.robot.geometry, start)[0],
            soles=soles,
            contact=soles[:, 2] < CONTACT_GAP,
            lowest=jnp.stack([lowest[0], jnp.min(legs)]),
            ground=None if level else qpos[2] - above_ground(self.robot, qpos),
        )

    def _traveled(self, after: EnvState, step: Step) -> EnvState:
        """`after` with how far the episode has come, where a curriculum asks for it."""
        if after.travel is None:
            return after
        assert self.curriculum is not None
        velocity, wanted = heading_velocity(step), step.command[:2]
        if not self.config.command.active:
            velocity, wanted = mean_velocity(step), jnp.array([self.curriculum.pace, 0.0])
        return after._replace(travel=travel_on(after.travel, velocity, wanted, step.dt))

    def _example(self) -> EnvState:
        """A state, for the shapes of what is computed from it."""
        config, key = self.config, jax.random.PRNGKey(0)
        home = jnp.asarray(self._level_robot.home, jnp.float32)
        return EnvState(
            PhysicsState(home, jnp.zeros(18)),
            jnp.zeros(12),
            jnp.zeros((), jnp.int32),
            first_command(config.command, key, config.control_dt)
            if config.command.active
            else None,
            self._drawn(key),
            contact=jnp.zeros(4, bool),
        )

    @cached_property
    def mirrors(self) -> Mirrors:
        """How observation and action look in the sagittal mirror; raises `NotSymmetric`."""
        return self.sensors.find_mirrors(find_robot_mirror(self.quadruped, self.mj_model))

    @property
    def policy_size(self) -> int:
        """How many of the observation's first numbers the policy sees."""
        return len(self.sensors.names)

    @property
    def observation_size(self) -> int:
        return self.policy_size + len(self.sensors.critic_names)

    @property
    def action_size(self) -> int:
        return 12

    @property
    def backend(self) -> str:
        return self.engine


def _kept_sane(
    home: np.ndarray, start: jax.Array, physics: PhysicsState, effort: Effort, action: jax.Array
) -> tuple[jax.Array, PhysicsState, Effort, jax.Array]:
    """Whether all numbers are finite and no speed absurd, and the three, harmless if not.

    Then it stands where it was, at `start` (19,), or if that is no place either, at `home` (19,).
    """
    each = jnp.concatenate([physics.qpos, physics.qvel, action, effort.torque, effort.energy[None]])
    sane = jnp.all(jnp.isfinite(each)) & jnp.all(jnp.abs(physics.qvel) < MAX_SPEED)
    action = jnp.where(sane, action, 0.0)
    place = jnp.where(jnp.all(jnp.abs(start) < FARTHEST), start, home)
    still = PhysicsState(place, jnp.zeros(18))
    physics = jax.tree.map(lambda x, safe: jnp.where(sane, x, safe), physics, still)
    effort = jax.tree.map(lambda x: jnp.where(sane, x, 0.0), effort)
    return sane, physics, effort, action


def _metrics(
    speed: jax.Array,
    fell: jax.Array,
    nan: jax.Array,
    terms: dict[str, jax.Array],
    of_task: dict[str, jax.Array],
) -> dict[str, jax.Array]:
    rewards = {f"reward/{name}": value for name, value in terms.items()}
    return {"speed": speed, "fell": fell, "nan": nan, **of_task, **rewards}


def _info(end: jax.Array, effort: Effort, contact: jax.Array) -> dict[str, Any]:
    return {
        "end": end,  # index into `QuadrupedEnv.ends`
        "truncation": (end == TIME_LIMIT).astype(jnp.float32),
        "torque": effort.torque,
        "energy": effort.energy,
        "contact": contact,
    }
