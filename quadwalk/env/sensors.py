"""Sensors: what policy and value network see of a state, with offsets, noise, delay and history.

What is measured and known in one control step is a frame. An `EnvState` keeps as many frames as
delay and history need, the newest first; see `EnvState.frames`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.observations import observe as observe_parts
from quadwalk.env.randomization import (
    latest_drawn,
    measured,
    reading,
    readings_needed,
    sensed,
)
from quadwalk.env.reflections import Mirrors, mirror_of, with_history
from quadwalk.env.robot_arrays import RobotArrays
from quadwalk.env.state import EnvState
from quadwalk.errors import UserError
from quadwalk.robot.mirror import Mirror, NotSymmetric, RobotMirror, join_mirrors
from quadwalk.settings.environment import EnvConfig
from quadwalk.settings.terms import Observation, Term

# Of parts of an observation, their numbers' names.
PartNames: TypeAlias = dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class Sensors:
    """The sensors of one task; pure functions of the robot's constants and an `EnvState`."""

    config: EnvConfig
    part_names: PartNames  # of what the policy sees, in one control step
    critic_part_names: PartNames  # of what the value network sees besides

    def start_history(
        self, robot: RobotArrays, start: EnvState, latest: int | None = None
    ) -> EnvState:
        """`start` with all its frames measured there; `latest`: see `QuadrupedEnv.begun`."""
        if latest is None:
            late = start.conditions is not None and start.conditions.sensor_delay is not None
            longest = latest_drawn(self.config.randomization)[1]
            latest = readings_needed(longest, self.config.control_dt) if late else 0
        kept = 1 + latest + max(part.history for part in self.config.observation.values())
        return start._replace(
            frames=jnp.tile(self._frame(robot, start), (kept, 1)) if kept > 1 else None,
            contact=jnp.zeros(4, bool) if self.config.critic else None,
        )

    def measure(self, robot: RobotArrays, state: EnvState) -> EnvState:
        """`state` with what is measured in it as the newest of its frames, if it keeps any."""
        frames = state.frames
        if frames is None:
            return state
        late = self._late(frames)
        rows = [self._frame(robot, state)[None], frames[:late]]
        if max(self.history):
            rows += [self._delayed(state)[None], frames[late + 1 : -1]]
        return state._replace(frames=jnp.concatenate(rows))

    def observe(self, robot: RobotArrays, state: EnvState) -> jax.Array:
        """What the policy sees, then what the value network sees besides, float32."""
        if state.frames is None:
            seen = [self._frame(robot, state)]
        else:
            seen, late = [self._delayed(state)], self._late(state.frames)
            for ago in range(1, 1 + max(self.history)):
                seen.append(state.frames[late + ago][np.flatnonzero(self.history >= ago)])
        if self.config.critic:
            seen.append(observe_parts(self.config.critic, robot, state))
        return jnp.concatenate(seen)

    def compute_truth(self, robot: RobotArrays, state: EnvState) -> jax.Array:
        """What the observation's first numbers (n,) are without delay, noise and offsets."""
        return observe_parts(self.config.observation, robot, state)

    def _frame(self, robot: RobotArrays, state: EnvState) -> jax.Array:
        """What is measured and known in one control step (n,), float32."""
        conditions = state.conditions
        if conditions is None:
            return self.compute_truth(robot, state)
        disturbed = state._replace(physics=measured(conditions, state.physics))
        return sensed(
            conditions, self.compute_truth(robot, disturbed), self.noise_scale, state.steps
        )

    def _delayed(self, state: EnvState) -> jax.Array:
        """Delayed sensor readings of this step, and what needs no sensor (n,)."""
        frames, conditions = state.frames, state.conditions
        assert frames is not None
        late = self._late(frames)
        if not late or conditions is None or conditions.sensor_delay is None:
            return frames[0]
        return jnp.where(self._sensors, reading(conditions, frames[: late + 1]), frames[0])

    def _late(self, frames: jax.Array) -> int:
        """By how many control steps sensors may be late where these are kept."""
        return len(frames) - 1 - int(max(self.history))

    def _of_parts(self, value: Callable[[Observation], Any]) -> np.ndarray:
        """`value` of the part that each number of a control step belongs to."""
        parts = self.config.observation
        return np.array(
            [value(parts[part]) for part, names in self.part_names.items() for _ in names]
        )

    @cached_property
    def history(self) -> np.ndarray:
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
    def names(self) -> tuple[str, ...]:
        """A name for each number that the policy sees; `gravity_x[-2]` is of two steps before."""
        names = np.array([name for own in self.part_names.values() for name in own])
        return tuple(
            f"{name}[-{ago}]" if ago else str(name)
            for ago in range(1 + max(self.history))
            for name in names[self.history >= ago]
        )

    @cached_property
    def critic_names(self) -> tuple[str, ...]:
        """A name for each number that the value network sees besides."""
        return tuple(name for own in self.critic_part_names.values() for name in own)

    def find_mirrors(self, robot: RobotMirror) -> Mirrors:
        """Return how observation and action mirror where the parts of the robot mirror so.

        Raises `NotSymmetric` where a term does not say it, `UserError` where one says it of
        another size.
        """
        config = self.config
        terms: list[tuple[str, Term, int]] = [("action", config.action, 12)]
        for group, parts, names in (
            ("observation", config.observation, self.part_names),
            ("critic", config.critic, self.critic_part_names),
        ):
            terms += [(f"{group} {name!r}", parts[name], len(own)) for name, own in names.items()]
        mirrors = list[Mirror]()
        for what, term, size in terms:
            mirror = mirror_of(term.function, term.params, robot) if size else join_mirrors()
            if mirror is None:
                raise NotSymmetric(
                    f"the {what} does not say how it mirrors; expected @mirrors on its function"
                )
            if len(mirror.source) != size:
                raise UserError(
                    f"the {what} has {size} numbers, and its function says how "
                    f"{len(mirror.source)} mirror; expected as many"
                )
            mirrors.append(mirror)
        action, observed = mirrors[0], mirrors[1 : 1 + len(config.observation)]
        critic = mirrors[1 + len(config.observation) :]
        return Mirrors(
            join_mirrors(with_history(join_mirrors(*observed), self.history), *critic), action
        )


def make_sensors(
    config: EnvConfig, robot: RobotArrays, joints: tuple[str, ...], example: Callable[[], EnvState]
) -> Sensors:
    """The sensors of a task; `joints` are their names, `example` gives a state for shapes."""
    state = jax.eval_shape(example)

    def names(parts: dict[str, Observation]) -> PartNames:
        sizes = {
            name: jax.eval_shape(partial(part.compute, f"observation {name!r}", robot), state).size
            for name, part in parts.items()
        }
        return {name: parts[name].name_numbers(name, size, joints) for name, size in sizes.items()}

    return Sensors(config, names(config.observation), names(config.critic))
