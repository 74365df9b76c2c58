"""Sensors: what policy and value network observe, with offsets, noise, delay and history.

A frame is what is measured in one control step, and what is known without a sensor. An `EnvState`
keeps as many frames as delay and history need, the newest first; see `EnvState.frames`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from quadwalk.env.observations import compute_observation
from quadwalk.env.randomization import compute_longest_latencies, count_readings
from quadwalk.env.reflections import Mirrors, find_mirror, repeat_for_history
from quadwalk.env.similarity import resize_robot, resize_state
from quadwalk.env.state import NOISE, EnvState, EpisodeRandomization, RobotConstants
from quadwalk.errors import UserError
from quadwalk.physics.motor import PhysicsState
from quadwalk.physics.rotation import multiply, rotate_inverse
from quadwalk.robot.mirror import Mirror, NotSymmetric, RobotMirror, join_mirrors
from quadwalk.settings.environment import EnvConfig
from quadwalk.settings.terms import Observation, Term

# For parts of an observation, the names of their numbers.
PartNames: TypeAlias = dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class Sensors:
    """The sensors of a task; pure functions of the robot's constants and an `EnvState`."""

    config: EnvConfig
    part_names: PartNames  # of what the policy observes, in one control step
    critic_part_names: PartNames  # of what the value network observes besides

    def start_history(
        self, robot: RobotConstants, start: EnvState, max_delay: int | None = None
    ) -> EnvState:
        """Return `start` with frames as if the robot had always been in that state.

        There are as many frames as the policy's history and sensors up to `max_delay` control
        steps late need; None: the longest delay that the task's randomization samples.
        """
        if max_delay is None:
            late = start.conditions is not None and start.conditions.sensor_delay is not None
            longest = compute_longest_latencies(self.config.randomization)[1]
            max_delay = count_readings(longest, self.config.control_dt) if late else 0
        count = 1 + max_delay + max(part.history for part in self.config.observation.values())
        return start._replace(
            frames=jnp.tile(self._measure_frame(robot, start), (count, 1)) if count > 1 else None,
            contact=jnp.zeros(4, bool) if self.config.critic else None,
        )

    def measure(self, robot: RobotConstants, state: EnvState) -> EnvState:
        """Return `state` with a new measurement as the newest of its frames, if it keeps any."""
        frames = state.frames
        if frames is None:
            return state
        late = self._get_max_delay(frames)
        rows = [self._measure_frame(robot, state)[None], frames[:late]]
        if max(self.history):
            rows += [self._delay_frame(state)[None], frames[late + 1 : -1]]
        return state._replace(frames=jnp.concatenate(rows))

    def observe(self, robot: RobotConstants, state: EnvState) -> jax.Array:
        """Return the policy's observation, then what the value network observes besides, (n,)."""
        if state.frames is None:
            parts = [self._measure_frame(robot, state)]
        else:
            parts, late = [self._delay_frame(state)], self._get_max_delay(state.frames)
            for ago in range(1, 1 + max(self.history)):
                parts.append(state.frames[late + ago][np.flatnonzero(self.history >= ago)])
        if self.config.critic:
            parts.append(self.compute(self.config.critic, robot, state))
        return jnp.concatenate(parts)

    def compute_truth(self, robot: RobotConstants, state: EnvState) -> jax.Array:
        """Return the policy's observation of this step without delay, noise and offsets, (n,)."""
        return self.compute(self.config.observation, robot, state)

    def compute(
        self, parts: dict[str, Observation], robot: RobotConstants, state: EnvState
    ) -> jax.Array:
        """Return these observations (n,) without noise, at the size of `EnvConfig.unit_leg`."""
        leg = self.config.unit_leg
        if leg is not None:
            robot, state = resize_robot(robot, leg), resize_state(robot, state, leg)
        return compute_observation(parts, robot, state)

    def _measure_frame(self, robot: RobotConstants, state: EnvState) -> jax.Array:
        """Return what the policy observes of this step (n,), with offsets and noise, not late."""
        randomization = state.conditions
        if randomization is None:
            return self.compute_truth(robot, state)
        state = state._replace(physics=add_offsets(randomization, state.physics))
        truth = self.compute_truth(robot, state)
        return add_noise(randomization, truth, self.noise_scale, state.steps)

    def _delay_frame(self, state: EnvState) -> jax.Array:
        """Return the delayed sensor readings of this step, and what needs no sensor (n,)."""
        frames, randomization = state.frames, state.conditions
        assert frames is not None
        late = self._get_max_delay(frames)
        if not late or randomization is None or randomization.sensor_delay is None:
            return frames[0]
        readings = delay_reading(randomization.sensor_delay, frames[: late + 1])
        return jnp.where(self._is_sensor, readings, frames[0])

    def _get_max_delay(self, frames: jax.Array) -> int:
        """Return by how many control steps sensors may be late where these frames are kept."""
        return len(frames) - 1 - int(max(self.history))

    def _repeat_for_numbers(self, value: Callable[[Observation], Any]) -> np.ndarray:
        """Return the `value` of its part for each number of a control step."""
        parts = self.config.observation
        return np.array(
            [value(parts[part]) for part, names in self.part_names.items() for _ in names]
        )

    @cached_property
    def history(self) -> np.ndarray:
        """(n,) how many earlier control steps the policy observes of each number."""
        return self._repeat_for_numbers(lambda part: part.history)

    @cached_property
    def _is_sensor(self) -> np.ndarray:
        return self._repeat_for_numbers(lambda part: part.sensor)

    @cached_property
    def noise_scale(self) -> np.ndarray:
        """(n,) standard deviation of each number of a control step at noise level 1."""
        return self._repeat_for_numbers(lambda part: part.noise).astype(np.float32)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """A name for each number that the policy observes; `gravity_x[-2]` is two steps old."""
        names = np.array([name for part in self.part_names.values() for name in part])
        return tuple(
            f"{name}[-{ago}]" if ago else str(name)
            for ago in range(1 + max(self.history))
            for name in names[self.history >= ago]
        )

    @cached_property
    def critic_names(self) -> tuple[str, ...]:
        """A name for each number that only the value network observes, after those of `names`."""
        return tuple(name for part in self.critic_part_names.values() for name in part)

    def find_mirrors(self, robot: RobotMirror) -> Mirrors:
        """Return how observation and action mirror where the parts of the robot mirror so.

        Raises `NotSymmetric` where a term does not say it, `UserError` where one says it of
        another size.
        """
        config = self.config
        action = _find_mirror("action", config.action, 12, robot)
        observation, critic = (
            join_mirrors(
                *(
                    _find_mirror(f"{group} {name!r}", parts[name], len(labels), robot)
                    for name, labels in names.items()
                )
            )
            for group, parts, names in (
                ("observation", config.observation, self.part_names),
                ("critic", config.critic, self.critic_part_names),
            )
        )
        observation = repeat_for_history(observation, self.history)
        return Mirrors(join_mirrors(observation, critic), action)


def make_sensors(
    config: EnvConfig, robot: RobotConstants, joints: tuple[str, ...], example: EnvState
) -> Sensors:
    """Return the sensors of a task; `joints` are their names, `example` has a state's shapes."""

    def make_names(parts: dict[str, Observation]) -> PartNames:
        names = {}
        for name, part in parts.items():
            compute = partial(part.compute, f"observation {name!r}", robot)
            size = jax.eval_shape(compute, example).size
            names[name] = part.name_numbers(name, size, joints)
        return names

    return Sensors(config, make_names(config.observation), make_names(config.critic))


def add_offsets(randomization: EpisodeRandomization, physics: PhysicsState) -> PhysicsState:
    """Return the state with encoder offsets and IMU tilt."""
    half = jnp.concatenate([jnp.ones(1), 0.5 * randomization.tilt])
    half /= jnp.linalg.norm(half)
    quat = multiply(physics.qpos[3:7], half)
    qpos = physics.qpos.at[3:7].set(quat).at[7:].add(randomization.encoder)
    qvel = physics.qvel.at[3:6].set(rotate_inverse(half, physics.qvel[3:6]))
    return physics._replace(qpos=qpos, qvel=qvel)


def add_noise(
    randomization: EpisodeRandomization, readings: jax.Array, scale: ArrayLike, steps: jax.Array
) -> jax.Array:
    """Return `readings` (n,) with the noise of control step `steps`, `scale` (n,) at level 1."""
    noise = jax.random.normal(randomization.make_key(NOISE, steps), readings.shape)
    return readings + randomization.noise * scale * noise


def delay_reading(delay: jax.Array, frames: jax.Array) -> jax.Array:
    """Return the reading (n,) of `delay` () control steps ago, below m - 1.

    It is interpolated between two of the `frames` (m, n), which are newest first.
    """
    floor = jnp.floor(delay)
    share = delay - floor
    first = jnp.minimum(floor.astype(jnp.int32), len(frames) - 2)
    return (1.0 - share) * frames[first] + share * frames[first + 1]


def _find_mirror(what: str, term: Term, size: int, robot: RobotMirror) -> Mirror:
    if not size:
        return join_mirrors()
    mirror = find_mirror(term.function, term.params, robot)
    if mirror is None:
        raise NotSymmetric(
            f"the {what} does not say how it mirrors; expected @mirrors on its function"
        )
    if len(mirror.source) != size:
        raise UserError(
            f"the {what} has {size} numbers, and its function says how "
            f"{len(mirror.source)} mirror; expected as many"
        )
    return mirror
