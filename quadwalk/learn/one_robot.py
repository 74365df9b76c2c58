"""A policy of many bodies as one of a single robot, which observes in meters, seconds and radians.

What `EnvConfig.unit_leg` does to an observation is linear. So the first layer takes it over, and
the description of the body, which one robot keeps, becomes a part of that layer's bias.
"""

from dataclasses import replace
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.brax import NestedMeanStd
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.observations import body
from quadwalk.env.state import EnvState
from quadwalk.learn.statistics import compute_scale
from quadwalk.physics.motor import PhysicsState
from quadwalk.settings.environment import BodiesConfig, EnvConfig

Group = Literal["observation", "critic"]
_STATES = 512  # random states that observations are compared in
_TOLERANCE = 1e-3  # of an observation, relative to the largest in these states
_NOTHING = 1e-5  # a factor below this is a rounding error


class Translation(NamedTuple):
    """What a network of many bodies observes, as functions of what one of a single robot does."""

    matrix: np.ndarray  # (m, n)
    constant: np.ndarray  # (m,): the former are matrix @ the latter + constant
    fits: np.ndarray  # (m,) bool: False for numbers that are no such function


def make_one_robot_config(config: EnvConfig) -> EnvConfig:
    """Return the same task for one robot, without the description of its body."""
    observation = {n: part for n, part in config.observation.items() if part.function is not body}
    return replace(config, observation=observation, unit_leg=None, bodies=BodiesConfig())


def translate_actions(many: QuadrupedEnv, one: QuadrupedEnv) -> np.ndarray:
    """Return the matrix (12, 12) from actions of `one` to those of `many` with the same targets.

    It holds within the joints' limits.
    """
    no_limit = np.full(12, np.inf)
    robot = replace(many.robot, lower=-no_limit, upper=no_limit)
    home = jnp.asarray(robot.home_joints, jnp.float32)

    def measure(env: QuadrupedEnv) -> np.ndarray:
        return np.asarray(jax.jacobian(lambda x: env.config.action(robot, x, home))(jnp.zeros(12)))

    reach: np.ndarray = np.linalg.solve(measure(many), measure(one))
    return reach


def translate_observations(many: QuadrupedEnv, one: QuadrupedEnv, group: Group) -> Translation:
    """Return how `many`, a task for many bodies, observes its robot, by what `one` observes.

    Both have the same robot. All numbers of a control step are fitted in random states.
    """
    actions = translate_actions(many, one)
    states = _sample_states(many)
    values = _observe(many, group, states._replace(last_action=states.last_action @ actions.T))
    inputs = _observe(one, group, states)
    inputs = np.hstack([inputs, np.ones((_STATES, 1))])
    factors = np.linalg.lstsq(inputs, values, rcond=None)[0].T
    off = np.abs(inputs @ factors.T - values).max(axis=0)
    fits = off <= _TOLERANCE * np.maximum(np.abs(values).max(axis=0), 1.0)
    factors[np.abs(factors) < _NOTHING] = 0.0
    rows, ages = _locate_numbers(many, group)
    columns, one_ages = _locate_numbers(one, group)
    same_age = ages[:, None] == one_ages
    return Translation(
        matrix=factors[np.ix_(rows, columns)] * same_age,
        constant=factors[rows, -1],
        fits=fits[rows],
    )


def join_translations(first: Translation, second: Translation) -> Translation:
    """Return the translation of observations one after another."""
    zeros = np.zeros((len(first.matrix), second.matrix.shape[1]))
    below = np.zeros((len(second.matrix), first.matrix.shape[1]))
    return Translation(
        np.block([[first.matrix, zeros], [below, second.matrix]]),
        np.concatenate([first.constant, second.constant]),
        np.concatenate([first.fits, second.fits]),
    )


def to_one_robot(
    params: Any, statistics: NestedMeanStd, translation: Translation
) -> tuple[Any, NestedMeanStd]:
    """Return weights and statistics of a plain network that observes what one robot does.

    Numbers that do not fit count as their means.
    """
    matrix, constant, fits = translation
    mean, scale = np.asarray(statistics.mean, float), np.asarray(compute_scale(statistics), float)
    matrix = matrix * fits[:, None]
    inverse = np.linalg.pinv(matrix)
    one_statistics = NestedMeanStd(
        jnp.float32(inverse @ (mean - constant)),
        jnp.float32(np.linalg.norm(inverse * scale, axis=1)),
    )
    one_mean = np.asarray(one_statistics.mean, float)
    one_scale = np.asarray(compute_scale(one_statistics), float)
    rest = np.where(fits, matrix @ one_mean + constant - mean, 0.0)
    layers = {name: dict(layer) for name, layer in params["params"].items()}
    first = layers["hidden_0"]
    kernel = np.asarray(first["kernel"], float) / scale[:, None]
    first["kernel"] = jnp.float32(one_scale[:, None] * (matrix.T @ kernel))
    first["bias"] = jnp.float32(np.asarray(first["bias"], float) + rest @ kernel)
    return {"params": layers}, one_statistics


def change_actions(params: Any, actions: np.ndarray) -> Any:
    """Return a plain policy whose small actions are `actions` (12, 12) times those of `params`."""
    layers = dict(params["params"])
    last = f"hidden_{len(layers) - 1}"
    layers[last] = {
        name: jnp.concatenate([means @ jnp.float32(actions.T), spreads], axis=-1)
        for name, weights in layers[last].items()
        for means, spreads in [jnp.split(jnp.asarray(weights), 2, axis=-1)]
    }
    return {"params": layers}


def _sample_states(env: QuadrupedEnv) -> EnvState:
    """Return states (n, ...) of `env`, in which every number that is observed varies."""
    rng = np.random.default_rng(0)

    def sample(*shape: int) -> jax.Array:
        return jnp.asarray(rng.standard_normal((_STATES, *shape)), jnp.float32)

    keys = jax.random.split(jax.random.PRNGKey(0), _STATES)
    states: EnvState = jax.jit(jax.vmap(env.make_example_state))(keys)
    quat = sample(4)
    quat /= jnp.linalg.norm(quat, axis=1, keepdims=True)
    physics = PhysicsState(jnp.hstack([sample(3), quat, sample(12)]), sample(18))
    changes: dict[str, Any] = {"physics": physics, "last_action": sample(12)}
    if states.command is not None:
        changes["command"] = states.command._replace(velocity=sample(3))
    changes["contact"] = sample(4) > 0.0
    return states._replace(**changes)


def _observe(env: QuadrupedEnv, group: Group, states: EnvState) -> np.ndarray:
    """Return all numbers of the group in a control step, without noise: (states, n)."""
    parts = getattr(env.config, group)
    observe = jax.jit(jax.vmap(lambda state: env.sensors.compute(parts, env.robot, state)))
    return np.asarray(observe(states), float)


def _locate_numbers(env: QuadrupedEnv, group: Group) -> tuple[list[int], np.ndarray]:
    """Return for each number of a network's input its place in a control step, and its age."""
    sensors = env.sensors
    parts, names = sensors.part_names, sensors.names
    if group == "critic":
        parts, names = sensors.critic_part_names, sensors.critic_names
    places = {name: place for place, name in enumerate(n for part in parts.values() for n in part)}
    splits = [name.partition("[") for name in names]
    return [places[name] for name, _, _ in splits], np.array([age for _, _, age in splits])
