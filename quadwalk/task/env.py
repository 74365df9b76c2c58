"""The environment: a task for one quadruped, as the pure functions `reset` and `step`."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from brax.envs.base import Env, State
from jax.typing import ArrayLike

from quadwalk.errors import UserError
from quadwalk.ground.terrain import leg_length, make_terrain
from quadwalk.physics.constraints.surface import Surface
from quadwalk.physics.engines import ENGINES, EngineName, fast, mujoco_c
from quadwalk.physics.motor import Effort, PhysicsState, make_motor
from quadwalk.robot.mirror import Mirror, RobotMirror, joined, robot_mirror
from quadwalk.robot.quadruped import Quadruped
from quadwalk.settings.environment import EnvConfig
from quadwalk.settings.terms import Observation, Term
from quadwalk.task.episode.command import first_command, next_command
from quadwalk.task.episode.curriculum import begin_travel, make_curriculum, travel_on
from quadwalk.task.episode.randomization import (
    EpisodeRandomization,
    delayed,
    draw_conditions,
    latest_drawn,
    measured,
    pushed,
    reading,
    readings_needed,
    sensed,
)
from quadwalk.task.episode.reset import fresh_start, on_tile
from quadwalk.task.observation import observe
from quadwalk.task.reflections import Mirrors, mirror_of, with_history
from quadwalk.task.reward import reward_terms, total_reward
from quadwalk.task.robot_arrays import above_ground, robot_arrays, task_robot
from quadwalk.task.state import (
    EnvState,
    Step,
    commanded_speed,
    heading_velocity,
    mean_velocity,
)
from quadwalk.task.termination import terminations

CONTACT_GAP = 1e-3  # m: a foot closer to the floor than this counts as touching it
FARTHEST = 1e6  # m or rad: no sound state of a robot has a place, or an angle, beyond
MAX_SPEED = 1e3  # m/s or rad/s: no sound state of a robot is faster, so physics has diverged

_RUNNING, _TIME_LIMIT, _FIRST_FALL = 0, 1, 2


class QuadrupedEnv(Env):
    """A task for one quadruped as a `brax.envs.base.Env`; vmap `reset` and `step` for a batch.

    It does not reset itself: a step past the end of an episode continues from there. Use
    `quadwalk.train.ppo`, which starts a fresh episode after each, for training.

    `engine` steps its physics, by default that of `config`. MuJoCo C ("mujoco") steps the full
    model, in which every shape collides and the solver converges.
    """

    def __init__(
        self, quadruped: Quadruped, config: EnvConfig, engine: EngineName | None = None
    ) -> None:
        leg = leg_length(quadruped.full_model(visuals=False), quadruped.feet[0])
        config = replace(config.as_seen, command=config.command.of_leg(leg))
        self.config = config
        self.engine: EngineName = engine or config.engine
        self.terrain = None if config.ground.flat else make_terrain(config.ground, leg)
        self.curriculum = make_curriculum(config, self.terrain)
        field = None if self.terrain is None else self.terrain.field
        self.quadruped = task_robot(quadruped, config, field)
        self.stepping = config.stepping
        self.mj_model = self._training_model(self.quadruped)
        self.motor = make_motor(self.mj_model, self.quadruped, config.motor)
        self.geometry = fast.make_model(self.mj_model, self.quadruped, self.motor)
        self.robot = robot_arrays(self.quadruped, self.mj_model, self.geometry)
        if self.engine == "mujoco":
            self.stepping = self.stepping.with_dt(mujoco_c.TIMESTEP)
        self.model = self.geometry
        if self.engine != "fast":
            stepped = self.mj_model_of(self.quadruped)
            self.model = ENGINES[self.engine].make_model(stepped, self.quadruped, self.motor)
        geoms = ("floor", *self.quadruped.feet)
        self.friction = float(max(self.mj_model.geom(name).friction[0] for name in geoms))
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

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """All of the ground that programs read; none for a flat floor."""
        ground = self.geometry.ground
        if ground is None:
            return ()
        return (ground, *(c.surface for c in self.geometry.contacts if c.surface is not None))

    def jit(
        self,
        function: Callable[..., Any],
        donate: tuple[int, ...] = (),
        **options: Any,
    ) -> Callable[..., Any]:
        """function(env, ...) compiled for this `env`, whose ground is an argument of the program.

        `function` is to use the `env` that it gets: this one has the ground as a constant. Its
        arguments number `donate`, after `env`, are donated; `options` are others of `jax.jit`.
        """

        @partial(jax.jit, donate_argnums=tuple(1 + number for number in donate), **options)
        def program(heights: list[jax.Array], *arguments: Any) -> Any:
            return function(self.reading(heights), *arguments)

        return partial(program, self._heights)

    def reading(self, heights: Sequence[jax.Array]) -> "QuadrupedEnv":
        """The same environment, whose `surfaces` read these `heights`, as `Surface` has them."""
        if not self.surfaces:
            return self
        ground, *touched = map(Surface.reading, self.surfaces, heights)
        env, contacts, left = copy.copy(self), self.geometry.contacts, iter(touched)
        env.geometry = self.geometry._replace(
            ground=ground,
            contacts=tuple(
                contact if contact.surface is None else replace(contact, surface=next(left))
                for contact in contacts
            ),
        )
        env.robot = replace(self.robot, ground=ground)
        if self.model is self.geometry:
            env.model = env.geometry
        return env

    @cached_property
    def _heights(self) -> list[jax.Array]:
        """Of each of `surfaces` its grids (n,), m, on the device."""
        return jax.device_put([surface.grids.reshape(-1) for surface in self.surfaces])

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
        if config.command.given:
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
            metrics=_metrics(zero, zero, zero, terms),
            info=_info(jnp.zeros((), jnp.int32), Effort(jnp.zeros(12), zero), jnp.zeros(4, bool)),
        )
        return self.begun(state)

    def _start(
        self, rng: jax.Array, tile: jax.Array | None
    ) -> tuple[PhysicsState, jax.Array | None]:
        """A start, and the tile that it is on."""
        # Drawn as on a flat floor, then put on the ground.
        level = self.geometry._replace(ground=None)
        physics = fresh_start(level, self.robot, self.config.reset, rng)
        if self.terrain is None:
            return physics, None
        which, where = jax.random.split(jax.random.fold_in(rng, 2))
        if tile is None:
            tile = jax.random.randint(which, (), 0, len(self.terrain.tiles))
        return on_tile(self.geometry, self.terrain, physics, tile, where), tile

    def _outside(self, state: EnvState) -> jax.Array:
        """Whether the trunk is where its episode ends.

        Beyond the field or half of the level ground around its tiles, or beyond its own tile.
        """
        assert self.terrain is not None
        field, edge = self.terrain.field, self.config.ground.border / 2
        low: Any = np.array(field.origin) + edge
        high: Any = low + np.array(field.size) - 2 * edge
        if self.config.ground.confined:
            tiles = self.terrain.tiles
            middle = jnp.asarray([tile.middle for tile in tiles], jnp.float32)[state.tile]
            half = np.array(tiles[0].size) / 2
            low, high = middle - half, middle + half
        return jnp.any((state.qpos[:2] < low) | (state.qpos[:2] > high))

    def step(self, state: State, action: jax.Array) -> State:
        """One control step with `action` (12,) in [-1, 1].

        A state or action that is not finite ends its episode with reward 0, and the pose before
        it stands in its place, so that nothing downstream ever sees it.
        """
        before: EnvState = state.pipeline_state
        model, physics, conditions, target = self.driven(before, action)
        physics, effort = ENGINES[self.engine].control_step(model, self.stepping, physics, target)
        sane, physics, effort, action = self._kept_sane(before.qpos, physics, effort, action)
        command, steps = before.command, before.steps + 1
        if command is not None:
            grip, dt = self._grip(conditions), self.config.control_dt
            command = next_command(self.config.command, command, steps, dt, grip)
        after = EnvState(
            physics,
            action,
            steps,
            command,
            conditions,
            before.frames,
            tile=before.tile,
            travel=before.travel,
        )
        following = self.finish_step(before, after, effort, sane)
        # What wrappers keep there, as Brax's do, stays.
        return following.replace(
            info=state.info | following.info, metrics=state.metrics | following.metrics
        )

    def driven(
        self, before: EnvState, action: jax.Array
    ) -> tuple[Any, PhysicsState, EpisodeRandomization | None, jax.Array]:
        """What the engine steps in a control step from `before` with `action` (12,).

        The model, the state that it begins in, the conditions from then on, and the joint targets,
        (12,) or (substeps, 12), rad.
        """
        model, conditions, physics = self.model, before.conditions, before.physics
        target = self.config.action(self.robot, action, physics.qpos[7:])
        if conditions is not None:
            physics = pushed(conditions, physics, before.steps, self.config.push_steps)
            substeps = self.stepping.substeps
            conditions, target = delayed(conditions, target, substeps, before.steps)
            if conditions.variation is not None:
                model = ENGINES[self.engine].vary(model, conditions.variation)
        return model, physics, conditions, target

    def begun(self, state: State, latest: int | None = None, **changes: Any) -> State:
        """`state`, of an episode's start, with `changes` of its `EnvState`, as it is then seen.

        Sensors may be late by `latest` control steps; None: by as many as the task draws.
        """
        start: EnvState = state.pipeline_state._replace(**changes)
        if latest is None:
            late = start.conditions is not None and start.conditions.sensor_delay is not None
            longest = latest_drawn(self.config.randomization)[1]
            latest = readings_needed(longest, self.config.control_dt) if late else 0
        kept = 1 + latest + max(part.history for part in self.config.observation.values())
        start = start._replace(
            frames=jnp.tile(self._frame(start), (kept, 1)) if kept > 1 else None,
            contact=jnp.zeros(4, bool) if self.config.critic else None,
        )
        return state.replace(pipeline_state=start, obs=self.observation(start))

    def applied_target(self, state: EnvState, action: jax.Array) -> jax.Array:
        """The joint angles (12,), rad, that motors go to at the end of a step with `action`."""
        target = self.config.action(self.robot, action, state.qpos[7:])
        if state.conditions is None:
            return target
        return delayed(state.conditions, target, self.stepping.substeps, state.steps)[1][-1]

    def truth(self, state: EnvState) -> jax.Array:
        """What the observation's first numbers (n,) are without delay, noise and offsets."""
        return observe(self.config.observation, self.robot, state)

    def _drawn(self, key: jax.Array) -> EpisodeRandomization | None:
        """The conditions of an episode; None in an ideal world."""
        ranges = self.config.randomization
        if not ranges.enabled:
            return None
        return draw_conditions(ranges, self.robot, self.stepping, key, self.friction)

    def _grip(self, conditions: EpisodeRandomization | None) -> ArrayLike:
        """The acceleration () that friction bears, m/s^2."""
        if conditions is None or conditions.variation is None:
            return self.config.gravity * self.friction
        return self.config.gravity * conditions.variation.friction

    def _frame(self, state: EnvState) -> jax.Array:
        """What is measured and known in one control step (n,), float32."""
        parts, conditions = self.config.observation, state.conditions
        if conditions is None:
            return observe(parts, self.robot, state)
        disturbed = state._replace(physics=measured(conditions, state.physics))
        seen = observe(parts, self.robot, disturbed)
        return sensed(conditions, seen, self.noise_scale, state.steps)

    def with_frame(self, state: EnvState) -> EnvState:
        """`state` with what is measured in it as the newest of its frames, if it keeps any."""
        frames = state.frames
        if frames is None:
            return state
        late = self._late(frames)
        rows = [self._frame(state)[None], frames[:late]]
        if max(self._history):
            rows += [self._sensed(state)[None], frames[late + 1 : -1]]
        return state._replace(frames=jnp.concatenate(rows))

    def _late(self, frames: jax.Array) -> int:
        """By how many control steps sensors may be late where these are kept."""
        return len(frames) - 1 - int(max(self._history))

    def _sensed(self, state: EnvState) -> jax.Array:
        """Delayed sensor readings of this step, and what needs no sensor (n,)."""
        frames, conditions = state.frames, state.conditions
        assert frames is not None
        late = self._late(frames)
        if not late or conditions is None or conditions.sensor_delay is None:
            return frames[0]
        return jnp.where(self._sensors, reading(conditions, frames[: late + 1]), frames[0])

    def observation(self, state: EnvState) -> jax.Array:
        """What the policy sees, then what the value network sees besides, float32."""
        if state.frames is None:
            seen = [self._frame(state)]
        else:
            seen, late = [self._sensed(state)], self._late(state.frames)
            for ago in range(1, 1 + max(self._history)):
                seen.append(state.frames[late + ago][np.flatnonzero(self._history >= ago)])
        if self.config.critic:
            seen.append(observe(self.config.critic, self.robot, state))
        return jnp.concatenate(seen)

    def _kept_sane(
        self, start: jax.Array, physics: PhysicsState, effort: Effort, action: jax.Array
    ) -> tuple[jax.Array, PhysicsState, Effort, jax.Array]:
        """Whether all numbers are finite and no speed absurd, and the three, harmless if not.

        Then it stands where it was, at `start` (19,), or if that is no place either, at home.
        """
        numbers = jnp.concatenate(
            [physics.qpos, physics.qvel, action, effort.torque, effort.energy[None]]
        )
        sane = jnp.all(jnp.isfinite(numbers)) & jnp.all(jnp.abs(physics.qvel) < MAX_SPEED)
        action = jnp.where(sane, action, 0.0)
        place = jnp.where(jnp.all(jnp.abs(start) < FARTHEST), start, self.robot.home)
        still = PhysicsState(place, jnp.zeros(18), jnp.zeros(18))
        physics = jax.tree.map(lambda x, safe: jnp.where(sane, x, safe), physics, still)
        effort = jax.tree.map(lambda x: jnp.where(sane, x, 0.0), effort)
        return sane, physics, effort, action

    def finish_step(
        self, before: EnvState, after: EnvState, effort: Effort, sane: jax.Array
    ) -> State:
        """The state that a control step led to, with its reward and whether the episode ended."""
        config, robot = self.config, self.robot
        soles, lowest = fast.lowest_points(self.geometry, after.qpos)
        start = jnp.where(sane, before.qpos, after.qpos)
        contact = soles[:, 2] < CONTACT_GAP
        # MuJoCo's ground gives way: a foot that lands sinks in, up to 2 cm at a run, its shin too.
        radius = self.geometry.contacts[0].radius
        legs = lowest[1:] - jnp.clip(soles[:, 2], -radius, 0.0)
        step = Step(
            dt=config.control_dt,
            steps=after.steps,
            start=start,
            qpos=after.qpos,
            qvel=after.qvel,
            action=after.last_action,
            last_action=before.last_action,
            power=effort.energy / config.control_dt,
            fell=jnp.zeros((), bool),
            command=before.velocity_command,
            start_soles=fast.lowest_points(self.geometry, start)[0],
            soles=soles,
            contact=contact,
            lowest=jnp.stack([lowest[0], jnp.min(legs)]),
            ground=None
            if self.terrain is None
            else after.qpos[2] - above_ground(robot, after.qpos),
        )
        falls = terminations(config.termination, robot, step)
        fell = jnp.any(falls) & sane
        end = jnp.where(after.steps >= config.episode_steps, _TIME_LIMIT, _RUNNING)
        if self.terrain is not None:  # no failure either
            end = jnp.where(self._outside(after), _TIME_LIMIT, end)
        if config.termination:
            end = jnp.where(fell, _FIRST_FALL + jnp.argmax(falls), end)
        end = jnp.where(sane, end, len(self.ends) - 1).astype(jnp.int32)
        step = step._replace(fell=fell)
        if after.travel is not None:
            assert self.curriculum is not None
            velocity, wanted = heading_velocity(step), step.command[:2]
            if not config.command.given:
                velocity, wanted = mean_velocity(step), jnp.array([self.curriculum.pace, 0.0])
            after = after._replace(travel=travel_on(after.travel, velocity, wanted, step.dt))
        after = self.with_frame(after)
        if config.critic:
            after = after._replace(contact=contact)
        terms = {
            name: jnp.where(sane, value, 0.0)
            for name, value in reward_terms(config.reward, robot, step).items()
        }
        speed = commanded_speed(step) if config.command.given else mean_velocity(step)[0]
        return State(
            pipeline_state=after,
            obs=self.observation(after),
            reward=total_reward(config.reward, terms),
            done=(end > 0).astype(jnp.float32),
            metrics=_metrics(
                speed, fell.astype(jnp.float32), 1.0 - sane.astype(jnp.float32), terms
            ),
            info=_info(end, effort, contact),
        )

    def _names(self, parts: dict[str, Observation]) -> dict[str, tuple[str, ...]]:
        """Names of the numbers of each part of an observation, in one control step."""
        state = jax.eval_shape(self._example)
        sizes = {
            name: jax.eval_shape(
                partial(part.value, f"observation {name!r}", self.robot), state
            ).size
            for name, part in parts.items()
        }
        return {
            name: parts[name].names(name, size, self.quadruped.joints)
            for name, size in sizes.items()
        }

    def _example(self) -> EnvState:
        """A state, for the shapes of what is computed from it."""
        config, key = self.config, jax.random.PRNGKey(0)
        home = jnp.asarray(self.robot.home, jnp.float32)
        return EnvState(
            PhysicsState(home, jnp.zeros(18), jnp.zeros(18)),
            jnp.zeros(12),
            jnp.zeros((), jnp.int32),
            first_command(config.command, key, config.control_dt) if config.command.given else None,
            self._drawn(key),
            contact=jnp.zeros(4, bool),
        )

    @cached_property
    def part_names(self) -> dict[str, tuple[str, ...]]:
        """Names of the numbers of each part that the policy sees, in one control step."""
        return self._names(self.config.observation)

    def _of_parts(self, value: Callable[[Observation], Any]) -> np.ndarray:
        """`value` of the part that each number of a control step belongs to."""
        parts = self.config.observation
        return np.array(
            [value(parts[part]) for part, names in self.part_names.items() for _ in names]
        )

    @cached_property
    def _history(self) -> np.ndarray:
        """(n,) how many earlier control steps are seen of each number of one."""
        return self._of_parts(lambda part: part.history)

    @cached_property
    def _sensors(self) -> np.ndarray:
        """(n,) whether each number of a control step is measured."""
        return self._of_parts(lambda part: part.sensor)

    @cached_property
    def noise_scale(self) -> np.ndarray:
        """(n,) standard deviation of each number of a control step at noise level 1."""
        return self._of_parts(lambda part: part.noise).astype(np.float32)

    @cached_property
    def observation_names(self) -> tuple[str, ...]:
        """A name for each number that the policy sees; `gravity_x[-2]` is of two steps before."""
        names = np.array([name for own in self.part_names.values() for name in own])
        return tuple(
            f"{name}[-{ago}]" if ago else str(name)
            for ago in range(1 + max(self._history))
            for name in names[self._history >= ago]
        )

    @cached_property
    def critic_names(self) -> tuple[str, ...]:
        """A name for each number that the value network sees besides."""
        return tuple(n for names in self._names(self.config.critic).values() for n in names)

    @property
    def mirrors(self) -> Mirrors | None:
        """How observation and action look in the sagittal mirror; None: see `asymmetry`."""
        return None if isinstance(self._mirrored, str) else self._mirrored

    @property
    def asymmetry(self) -> str | None:
        """In one line, why there are no `mirrors`; None where there are."""
        return self._mirrored if isinstance(self._mirrored, str) else None

    @cached_property
    def _mirrored(self) -> Mirrors | str:
        """`mirrors`, or why there are none; `UserError` where a term says it of another size."""
        robot = robot_mirror(self.quadruped, self.mj_model)
        return robot if isinstance(robot, str) else self.mirrored_as(robot)

    def mirrored_as(self, robot: RobotMirror) -> Mirrors | str:
        """How observation and action look where the parts of the robot mirror so."""
        config, found = self.config, list[Mirror]()
        terms: list[tuple[str, Term, int]] = [("action", config.action, 12)]
        for group, parts in (("observation", config.observation), ("critic", config.critic)):
            terms += [
                (f"{group} {name!r}", parts[name], len(names))
                for name, names in self._names(parts).items()
            ]
        for what, term, size in terms:
            own = mirror_of(term.function, term.params, robot) if size else joined()
            if own is None:
                return f"the {what} does not say how it mirrors; expected @mirrors on its function"
            if len(own.source) != size:
                raise UserError(
                    f"the {what} has {size} numbers, and its function says how "
                    f"{len(own.source)} mirror; expected as many"
                )
            found.append(own)
        action, seen = found[0], found[1 : 1 + len(config.observation)]
        critic = found[1 + len(config.observation) :]
        return Mirrors(joined(with_history(joined(*seen), self._history), *critic), action)

    @property
    def policy_size(self) -> int:
        """How many of the observation's first numbers the policy sees."""
        return len(self.observation_names)

    @property
    def observation_size(self) -> int:
        return self.policy_size + len(self.critic_names)

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
