"""The environment: a task for one quadruped, as the pure functions `reset` and `step`."""

import copy
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.typing import ArrayLike

from quadwalk.brax import Env, State
from quadwalk.env.actions import delay_targets
from quadwalk.env.bank import FIGURES_BY_CLASS, BodyConstants, find_classes, make_bank
from quadwalk.env.command import advance_command, compute_target_velocity, start_command
from quadwalk.env.constants import make_robot_constants
from quadwalk.env.numbers import get_numbers, replace_numbers
from quadwalk.env.randomization import sample_randomization
from quadwalk.env.reflections import Mirrors
from quadwalk.env.reset import make_curriculum, place_on_tile, put_on_floor, sample_start
from quadwalk.env.rewards import compute_reward_terms, compute_total_reward
from quadwalk.env.sensors import make_sensors
from quadwalk.env.similarity import resize_robot, resize_step
from quadwalk.env.state import (
    PUSH,
    EnvState,
    EpisodeRandomization,
    RobotConstants,
    Step,
    compute_height,
    is_standing,
    start_strides,
    start_travel,
)
from quadwalk.env.terminations import TIME_LIMIT, find_end, find_falls, list_ends
from quadwalk.physics.engines import ENGINES, EngineName, fast, mujoco_c
from quadwalk.physics.motor import Effort, PhysicsState, make_standing_motor
from quadwalk.physics.rotation import compute_yaw, rotate_about_z
from quadwalk.physics.surface import Ground
from quadwalk.robot.mirror import STANDARD_SIGNS, find_robot_mirror, make_mirror
from quadwalk.robot.quadruped import Quadruped
from quadwalk.settings.environment import EnvConfig
from quadwalk.terrain.heightfield import Heightfield, has_field, lay
from quadwalk.terrain.terrain import make_terrain, measure_leg

CONTACT_GAP = 1e-3  # m: a foot closer to the floor than this counts as touching it
FARTHEST = 1e6  # m or rad: no sound state of a robot has a place, or an angle, beyond
MAX_SPEED = 1e3  # m/s or rad/s: no sound state of a robot is faster, so physics has diverged


class EnvParams(NamedTuple):
    """The data that programs read: an argument of theirs, since as constants it compiles slowly.

    A single robot's numbers are not among it. They are constants, which XLA folds: zeros vanish.
    """

    ground: Ground | None  # None: level, at height 0, without end
    # the task's numbers that may change while programs run, by name, each () float32; None: none
    # do, and all are constants
    numbers: dict[str, jax.Array] | None = None
    bodies: jax.Array | None = None  # (bodies, n) rows of the bank; None: there is none


@jax.tree_util.register_pytree_node_class
class QuadrupedEnv(Env):
    """A task for one quadruped as a `brax.envs.base.Env`; vmap `reset` and `step` for a batch.

    It does not reset itself: a step past the end of an episode continues from there. Use
    `quadwalk.learn.ppo`, which starts a fresh episode after each, for training.

    It is a pytree whose leaves are those of `params`: `jax.jit(f)(env, ...)` has the ground as an
    argument of the program, in a program that closes over `env` it is a constant.

    `engine` steps its physics, by default that of `config`. MuJoCo C ("mujoco") steps the full
    model, in which every shape collides and the solver converges.

    With `bodies`, robots with the joints of `quadruped`, each episode takes one of them, at random.
    The environment itself does not read `config.bodies`.
    """

    def __init__(
        self,
        quadruped: Quadruped,
        config: EnvConfig,
        engine: EngineName | None = None,
        bodies: Sequence[Quadruped] = (),
    ) -> None:
        leg = measure_leg(quadruped.make_full_model(visuals=False), quadruped.feet[0])
        self._leg, self._foot_speed = leg, quadruped.foot_speed
        self._has_bodies = bool(bodies)
        config = self._fit_to_robot(config)
        self.config = config
        self.engine: EngineName = engine or config.engine
        self.terrain = None if config.ground.flat else make_terrain(config.ground, leg)
        self.curriculum = make_curriculum(config, self.terrain)
        field = None if self.terrain is None else self.terrain.field
        self.quadruped = make_task_robot(quadruped, config, field)
        self.mj_model = self._make_training_model(self.quadruped)
        # `gains_note` is a line where the default gains do not hold the robot, or ""
        self.motor, self.gains_note = make_standing_motor(
            self.mj_model, self.quadruped, config.motor
        )
        self.stepping = config.stepping
        if self.engine == "mujoco":
            self.stepping = self.stepping.replace_dt(mujoco_c.TIMESTEP)
        self._model: Any = None  # of engines other than "fast"
        if self.engine != "fast":
            mj_model = self.make_mj_model(self.quadruped)
            self._model = ENGINES[self.engine].make_model(mj_model, self.quadruped, self.motor)
        geometry = fast.make_model(self.mj_model, self.quadruped, self.motor)
        level = geometry._replace(ground=None)
        self._level_robot = make_robot_constants(self.quadruped, self.mj_model, level)
        geoms = ("floor", *self.quadruped.feet)
        self.friction = float(max(self.mj_model.geom(name).friction[0] for name in geoms))
        self.ends = list_ends(config.termination)
        terms = [*config.observation.values(), *config.critic.values(), *config.reward.values()]
        self.has_strides = any(hasattr(term.function, "needs_strides") for term in terms)
        example = jax.eval_shape(self.make_example_state)
        self.sensors = make_sensors(config, self._level_robot, self.quadruped.joints, example)
        self.bank = make_bank([self._make_body(body) for body in bodies]) if bodies else None
        rows = None if self.bank is None else jax.device_put(self.bank.rows)
        self._constants = copy.copy(self)
        self.params = EnvParams(jax.device_put(geometry.ground), bodies=rows)

    def tree_flatten(self) -> tuple[tuple[EnvParams], "QuadrupedEnv"]:
        """Return (`params`,) as the pytree's children, and the environment without them."""
        return (self.params,), self._constants

    @classmethod
    def tree_unflatten(
        cls, constants: "QuadrupedEnv", children: tuple[EnvParams]
    ) -> "QuadrupedEnv":
        """Return the environment that `tree_flatten` took apart, with parameters `children`."""
        env = copy.copy(constants)
        env._constants = constants
        (params,) = children
        env.params = params
        if isinstance(params, EnvParams) and params.numbers is not None:
            env.config = replace_numbers(constants.config, params.numbers)
        return env

    def set_numbers(self, config: EnvConfig, names: Iterable[str]) -> "QuadrupedEnv":
        """Return the same task with the numbers of `config` that `names` list, as parameters.

        So a program that has the environment as an argument serves for any values of theirs. What
        the numbers decide on when it is traced, such as whether there are commands, stays as it is.
        """
        values = get_numbers(self._fit_to_robot(config), names)
        numbers = {name: jnp.float32(value) for name, value in values.items()}
        params = self.params._replace(numbers=numbers)
        return QuadrupedEnv.tree_unflatten(self._constants, (params,))

    def _fit_to_robot(self, config: EnvConfig) -> EnvConfig:
        """Return the settings in effect, with commands for the length of the robot's legs.

        Each of several bodies has factors of its own instead, see `_make_body`.
        """
        command = config.command
        if not self._has_bodies:
            command = command.scale_to(self._leg, self._foot_speed)
        return replace(config.effective, command=command)

    @property
    def robot(self) -> RobotConstants:
        """The constants of the robot, and the ground that it is on."""
        level = self._level_robot
        return replace(level, geometry=level.geometry._replace(ground=self.params.ground))

    @property
    def model(self) -> Any:
        """The model that the engine steps."""
        return self.robot.geometry if self._model is None else self._model

    def get_body(self, place: jax.Array | None) -> BodyConstants:
        """Return the body of an episode, `EnvState.body`; None: the environment's robot."""
        if self.bank is None or place is None:
            return BodyConstants(self.robot)
        assert self.params.bodies is not None
        return self.bank.read_body(self.params.bodies[place])

    def _make_body(self, quadruped: Quadruped) -> BodyConstants:
        """Return the constants of one body of the bank, of which all have the same structure."""
        quadruped = make_task_robot(quadruped, self.config)
        model = self._make_training_model(quadruped)
        motor, _ = make_standing_motor(model, quadruped, self.config.motor)
        motor = motor._replace(kp=np.broadcast_to(motor.kp, 12), kd=np.broadcast_to(motor.kd, 12))
        geometry = fast.make_model(model, quadruped, motor)
        robot = make_robot_constants(quadruped, model, geometry)
        scale = self.config.command.compute_scale(robot.leg, quadruped.foot_speed)
        return BodyConstants(robot, np.array(scale, np.float32))

    @cached_property
    def mirrors(self) -> Mirrors:
        """How observation and action look in the sagittal mirror; raises `NotSymmetric`."""
        mirror = find_robot_mirror(self.quadruped, self.mj_model)
        if self.config.unit_leg is not None:
            mirror = mirror._replace(joints=make_mirror(mirror.joints.source, STANDARD_SIGNS))
        return self.sensors.find_mirrors(mirror)

    @property
    def policy_size(self) -> int:
        """How many of the observation's first numbers the policy observes."""
        return len(self.sensors.names)

    @property
    def observation_size(self) -> int:
        return self.policy_size + len(self.sensors.critic_names)

    @property
    def action_size(self) -> int:
        return 12

    @property
    def backend(self) -> str:
        """Name of the physics engine, as Brax asks for it."""
        return self.engine

    def make_mj_model(self, quadruped: Quadruped) -> mujoco.MjModel:
        """Return the model of `quadruped` that the engine steps: in MuJoCo C the full one."""
        if self.engine == "mujoco":
            return quadruped.make_full_model(self.stepping.dt)
        return self._make_training_model(quadruped)

    def _make_training_model(self, quadruped: Quadruped) -> mujoco.MjModel:
        config = self.config
        return quadruped.make_training_model(
            config.physics_dt,
            config.solver_iterations,
            config.line_search_iterations,
            config.contacts,
        )

    def to_engine(self, engine: EngineName) -> "QuadrupedEnv":
        """Return the same environment with its physics stepped by `engine`."""
        return self if engine == self.engine else QuadrupedEnv(self.quadruped, self.config, engine)

    def reset(self, rng: jax.Array, tile: jax.Array | None = None) -> State:
        """Return a fresh episode; `rng` is a JAX random key.

        It starts on tile `tile`, () int32, an index into `terrain.tiles`; None: on any of them.
        """
        config, place = self.config, self._sample_body(rng)
        body = self.get_body(place)
        physics, tile = self._sample_start(body.robot, rng, tile)
        randomization = self._sample_randomization(body.robot, jax.random.fold_in(rng, 1))
        command = None
        if config.command.active:
            grip = self._compute_grip(randomization)
            command = start_command(
                config.command, rng, config.control_dt, grip, body.command_scale
            )
        start = EnvState(
            physics,
            jnp.zeros(12),
            jnp.zeros((), jnp.int32),
            command,
            randomization,
            tile=tile,
            body=place,
        )
        if self.curriculum is not None:
            start = start._replace(travel=start_travel(physics.qpos))
        if self.has_strides:
            start = start._replace(strides=start_strides())
        zero = jnp.zeros(())
        terms = {name: zero for name, term in config.reward.items() if term.in_use}
        state = State(
            pipeline_state=start,
            obs=zero,
            reward=zero,
            done=zero,
            metrics=self._make_metrics(body.robot, zero, zero, zero, zero, zero, terms),
            info=_make_info(
                jnp.zeros((), jnp.int32), Effort(jnp.zeros(12), zero), jnp.zeros(4, bool)
            ),
        )
        return self.start_episode(state)

    def step(self, state: State, action: jax.Array) -> State:
        """Return the state one control step later, with `action` (12,) in [-1, 1].

        A state or action that is not finite ends its episode with reward 0. The pose before it
        stands in its place, so that nothing downstream ever sees it.
        """
        before: EnvState = state.pipeline_state
        body = self.get_body(before.body)
        model, physics, randomization, targets = self.apply_action(before, action)
        physics, effort = ENGINES[self.engine].step(model, self.stepping, physics, targets)
        sane, physics, effort, action = _replace_invalid(
            body.robot.home, before.qpos, physics, effort, action
        )
        after = before._replace(
            physics=physics,
            last_action=action,
            steps=before.steps + 1,
            command=self._advance_command(body, before, randomization),
            conditions=randomization,
        )
        after_state = self.evaluate_step(before, after, effort, sane)
        # As Brax's environments do, leave what wrappers keep there.
        return after_state.replace(
            info=state.info | after_state.info, metrics=state.metrics | after_state.metrics
        )

    def apply_action(
        self, before: EnvState, action: jax.Array
    ) -> tuple[Any, PhysicsState, EpisodeRandomization | None, jax.Array]:
        """Return what the engine steps in a control step from `before` with `action` (12,).

        The model, its first state, the randomization, and joint targets, (12,) or (substeps, 12),
        rad: they take effect late, and a push may come.
        """
        robot, physics, randomization = self.get_robot(before), before.physics, before.conditions
        model = robot.geometry if self._model is None else self._model
        target = self.config.action(robot, action, physics.qpos[7:])
        if randomization is None:
            return model, physics, None, target
        physics = apply_push(randomization, physics, before.steps, self.config.steps_per_push)
        randomization, targets = delay_targets(
            randomization, target, self.stepping.substeps, before.steps
        )
        if randomization.variation is not None:
            model = ENGINES[self.engine].apply_randomization(model, randomization.variation)
        return model, physics, randomization, targets

    def evaluate_step(
        self, before: EnvState, after: EnvState, effort: Effort, sane: jax.Array
    ) -> State:
        """Return the state after a control step, with its reward, its end and its observation.

        Numbers that are not `sane`, () bool, give no reward.
        """
        config, robot = self.config, self.get_robot(before)
        step = self._make_step(robot, before, after, effort, sane)
        # A fall, the time limit, the edge of the ground, or numbers that are not finite end it.
        term_robot, term_step = robot, step
        if config.unit_leg is not None:
            term_robot = resize_robot(robot, config.unit_leg)
            term_step = resize_step(robot, step, config.unit_leg)
        falls = find_falls(config.termination, term_robot, term_step)
        fell = jnp.any(falls) & sane
        term_step = term_step._replace(fell=fell)
        end = find_end(config, self.terrain, after, falls, sane)
        terms = {
            name: jnp.where(sane, value, 0.0)
            for name, value in compute_reward_terms(config.reward, term_robot, term_step).items()
        }
        if before.strides is not None:
            after = after._replace(strides=before.strides.advance(step))
        after = self.sensors.measure(robot, self._advance_travel(after, step))
        if config.critic:
            after = after._replace(contact=step.contact)
        return State(
            pipeline_state=after,
            obs=self.sensors.observe(robot, after),
            reward=compute_total_reward(config.reward, terms),
            done=(end > 0).astype(jnp.float32),
            metrics=self._make_metrics(
                robot,
                speed=step.commanded_speed if config.command.active else step.mean_velocity[0],
                fell=fell.astype(jnp.float32),
                nan=1.0 - sane.astype(jnp.float32),
                velocity_error=jnp.linalg.norm(step.velocity_error),
                standing=is_standing(robot, after.qpos).astype(jnp.float32),
                terms=terms,
            ),
            info=_make_info(end, effort, step.contact),
        )

    def start_episode(self, state: State, max_delay: int | None = None, **changes: Any) -> State:
        """Start an episode from `state` with `changes` of its `EnvState`, and observe it.

        Sensors may be late by `max_delay` control steps; None: by as many as the task samples.
        """
        start = state.pipeline_state._replace(**changes)
        robot = self.get_robot(start)
        start = self.sensors.start_history(robot, start, max_delay)
        return state.replace(pipeline_state=start, obs=self.sensors.observe(robot, start))

    def start_with_body(self, state: State, body: jax.Array) -> State:
        """Start an episode from `state` with the body at place `body`, () int32, of the bank.

        It is as near its home pose and touches the floor as `state` does, and its command is as
        large a share of what it may be. Its conditions are `state`'s.
        """
        start: EnvState = state.pipeline_state
        before, after = self.get_body(start.body), self.get_body(body)
        home = jnp.asarray(after.robot.home_joints, jnp.float32)
        offsets = start.qpos[7:] - before.robot.home_joints
        joints = jnp.clip(home + offsets, after.robot.lower, after.robot.upper)
        qpos = start.qpos.at[7:].set(joints)
        if self.config.reset.height is None:
            qpos = put_on_floor(after.robot.geometry, qpos, self.config.reset)
        changes: dict[str, Any] = {"body": body, "physics": start.physics._replace(qpos=qpos)}
        if start.command is not None:
            scale = after.command_scale / before.command_scale
            changes["command"] = start.command._replace(velocity=scale * start.command.velocity)
        if start.conditions is not None:
            targets = jnp.broadcast_to(home, start.conditions.targets.shape)
            changes["conditions"] = start.conditions._replace(targets=targets)
        return self.start_episode(state, **changes)

    def get_robot(self, state: EnvState) -> RobotConstants:
        """Return the constants of the robot in `state`."""
        return self.get_body(state.body).robot

    def _sample_body(self, rng: jax.Array) -> jax.Array | None:
        """Return the place of an episode's body in the bank."""
        if self.bank is None:
            return None
        return jax.random.randint(jax.random.fold_in(rng, 4), (), 0, len(self.bank))

    def _sample_start(
        self, robot: RobotConstants, rng: jax.Array, tile: jax.Array | None
    ) -> tuple[PhysicsState, jax.Array | None]:
        """Return a start, and the tile that it is on."""
        # Sampled on a flat floor, then put on the ground.
        level = replace(robot, geometry=robot.geometry._replace(ground=None))
        physics = sample_start(level, self.config.reset, rng)
        if self.terrain is None:
            return physics, None
        key_tile, key_place = jax.random.split(jax.random.fold_in(rng, 2))
        if tile is None:
            tile = jax.random.randint(key_tile, (), 0, len(self.terrain.tiles))
        return place_on_tile(robot.geometry, self.terrain, physics, tile, key_place), tile

    def _sample_randomization(
        self, robot: RobotConstants, key: jax.Array
    ) -> EpisodeRandomization | None:
        ranges = self.config.randomization
        if not ranges.enabled:
            return None
        return sample_randomization(ranges, robot, self.stepping, key, self.friction)

    def _compute_grip(self, randomization: EpisodeRandomization | None) -> ArrayLike:
        """Return the greatest acceleration () that friction with the floor can give, m/s^2."""
        if randomization is None or randomization.variation is None:
            return self.config.gravity * self.friction
        return self.config.gravity * randomization.variation.friction

    def _advance_command(
        self, body: BodyConstants, before: EnvState, randomization: EpisodeRandomization | None
    ) -> Any:
        """Return the `Command` of the next control step; None for a task without commands.

        The randomized friction of the floor bounds a new command.
        """
        if before.command is None:
            return None
        config, grip = self.config, self._compute_grip(randomization)
        steps = before.steps + 1
        return advance_command(
            config.command, before.command, steps, config.control_dt, grip, body.command_scale
        )

    def _make_step(
        self,
        robot: RobotConstants,
        before: EnvState,
        after: EnvState,
        effort: Effort,
        sane: jax.Array,
    ) -> Step:
        """Return the control step as terminations see it, before it is known whether it fell."""
        config, dt, qpos = self.config, self.config.control_dt, after.qpos
        start = jnp.where(sane, before.qpos, qpos)
        soles, lowest = fast.compute_lowest_points(robot.geometry, qpos)
        # MuJoCo's ground gives way: a foot that lands sinks in, up to 2 cm at a run, its shin too.
        radius = robot.geometry.contacts[0].radius
        legs = lowest[1:] - jnp.clip(soles[:, 2], -radius, 0.0)
        command = before.velocity_command
        if before.command is not None:
            speed = jnp.linalg.norm(qpos[:2] - start[:2]) / dt
            grip = self._compute_grip(before.conditions)
            command = compute_target_velocity(config.command, before.command, speed, grip)
        start_soles = fast.compute_lowest_points(robot.geometry, start)[0]
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
            start_soles=start_soles,
            soles=soles,
            start_contact=start_soles[:, 2] < CONTACT_GAP,
            contact=soles[:, 2] < CONTACT_GAP,
            lowest=jnp.stack([lowest[0], jnp.min(legs)]),
            ground=None if self.terrain is None else qpos[2] - compute_height(robot, qpos),
            strides=before.strides,
        )

    def _advance_travel(self, after: EnvState, step: Step) -> EnvState:
        if after.travel is None:
            return after
        assert self.curriculum is not None
        velocity, command = step.heading_velocity, step.command[:2]
        if not self.config.command.active:
            velocity, command = step.mean_velocity, jnp.array([self.curriculum.pace, 0.0])
        return after._replace(travel=after.travel.advance(velocity, command, step.dt))

    def _make_metrics(
        self,
        robot: RobotConstants,
        speed: jax.Array,
        fell: jax.Array,
        nan: jax.Array,
        velocity_error: jax.Array,
        standing: jax.Array,
        terms: dict[str, jax.Array],
    ) -> dict[str, jax.Array]:
        """Return the metrics that this task has: some only with commands, or with any start."""
        metrics = {"speed": speed, "fell": fell, "nan": nan}
        if self.config.command.active:
            metrics["velocity_error"] = velocity_error
        if self.config.reset.tumbled:
            metrics["standing"] = standing
        if self.bank is not None:
            figures = {name: metrics[name] for name in FIGURES_BY_CLASS if name in metrics}
            for body_class, share in find_classes(robot).items():
                metrics[f"count/bodies/{body_class}"] = share
                for name, value in figures.items():
                    metrics[f"count/{name}/{body_class}"] = share * value
        return metrics | {f"reward/{name}": value for name, value in terms.items()}

    def make_example_state(self, key: jax.Array | None = None) -> EnvState:
        """Return a state at rest in the home pose, with the command and conditions of `key`."""
        config = self.config
        key = jax.random.PRNGKey(0) if key is None else key
        home = jnp.asarray(self._level_robot.home, jnp.float32)
        command = None
        if config.command.active:
            command = start_command(config.command, key, config.control_dt)
        return EnvState(
            PhysicsState(home, jnp.zeros(18)),
            jnp.zeros(12),
            jnp.zeros((), jnp.int32),
            command,
            self._sample_randomization(self._level_robot, key),
            contact=jnp.zeros(4, bool),
            strides=start_strides() if self.has_strides else None,
        )


def apply_push(
    randomization: EpisodeRandomization, physics: PhysicsState, steps: jax.Array, period: int
) -> PhysicsState:
    """Return `physics` after the push of control step `steps`, if it has one: one per `period`."""
    forward, left = randomization.push * sample_push_signs(randomization, steps, period)
    push = rotate_about_z(compute_yaw(physics.qpos[3:7]), forward, left)
    return physics._replace(qvel=physics.qvel.at[:2].add(jnp.stack(push)))


def sample_push_signs(
    randomization: EpisodeRandomization, steps: jax.Array, period: int
) -> jax.Array:
    """Return the signs of a push forward and to the left (2,); 0 in a control step without one."""
    shares = jax.random.uniform(randomization.make_key(PUSH, steps // period), (3,))
    is_push = steps % period == jnp.floor(shares[2] * period).astype(jnp.int32)
    return jnp.where(is_push, jnp.where(shares[:2] < 0.5, -1.0, 1.0), 0.0)


def make_task_robot(
    quadruped: Quadruped, config: EnvConfig, field: Heightfield | None = None
) -> Quadruped:
    """Return the robot under the task's gravity, with the task's motors, on its ground."""
    spec, effort = quadruped.spec.copy(), quadruped.effort
    spec.option.gravity[2] = -config.gravity
    if config.motor.effort is not None:
        effort = np.full(12, config.motor.effort)
        for name, most in zip(quadruped.joints, effort, strict=True):
            # The models have a motor's limit twice, for its control and for its joint.
            spec.actuator(name).ctrlrange = spec.joint(name).actfrcrange = [-most, most]
    if field is not None and not has_field(spec):
        lay(spec, field)
    return replace(quadruped, effort=effort, spec=spec)


def _replace_invalid(
    home: np.ndarray, start: jax.Array, physics: PhysicsState, effort: Effort, action: jax.Array
) -> tuple[jax.Array, PhysicsState, Effort, jax.Array]:
    """Return True if all numbers are finite and no speed absurd, and the three, harmless if not.

    Then the robot is at rest where it was, at `start` (19,), or if that is no place either, at
    `home` (19,).
    """
    numbers = jnp.concatenate(
        [physics.qpos, physics.qvel, action, effort.torque, effort.energy[None]]
    )
    sane = jnp.all(jnp.isfinite(numbers)) & jnp.all(jnp.abs(physics.qvel) < MAX_SPEED)
    action = jnp.where(sane, action, 0.0)
    place = jnp.where(jnp.all(jnp.abs(start) < FARTHEST), start, home)
    at_rest = PhysicsState(place, jnp.zeros(18))
    physics = jax.tree.map(lambda x, safe: jnp.where(sane, x, safe), physics, at_rest)
    effort = jax.tree.map(lambda x: jnp.where(sane, x, 0.0), effort)
    return sane, physics, effort, action


def _make_info(end: jax.Array, effort: Effort, contact: jax.Array) -> dict[str, Any]:
    return {
        "end": end,  # index into `QuadrupedEnv.ends`
        "truncation": (end == TIME_LIMIT).astype(jnp.float32),
        "torque": effort.torque,
        "energy": effort.energy,
        "contact": contact,
    }
