"""Programs with an environment's ground as an argument: as a constant, it compiles slowly."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import jax

from quadwalk.env.env import QuadrupedEnv
from quadwalk.physics.surface import Surface

# Of each environment its `heights`, once for all its programs.
_on_device: WeakKeyDictionary[QuadrupedEnv, tuple[jax.Array, ...]] = WeakKeyDictionary()


def jit(
    env: QuadrupedEnv, function: Callable[..., Any], donate: tuple[int, ...] = (), **options: Any
) -> Callable[..., Any]:
    """function(env, ...) compiled for this `env`, whose ground is an argument of the program.

    `function` is to use the `env` that it gets: the one given here has the ground as a constant.
    Its arguments number `donate`, after `env`, are donated; `options` are others of `jax.jit`.
    """

    @partial(jax.jit, donate_argnums=tuple(1 + number for number in donate), **options)
    def program(heights: tuple[jax.Array, ...], *arguments: Any) -> Any:
        return function(with_heights(env, heights), *arguments)

    if env not in _on_device:
        _on_device[env] = jax.device_put(heights(env))
    return partial(program, _on_device[env])


def heights(env: QuadrupedEnv) -> tuple[Any, ...]:
    """Of each surface that programs read, its grids (n,), m; none for a flat floor."""
    return tuple(surface.grids.reshape(-1) for surface in _surfaces(env))


def with_heights(env: QuadrupedEnv, heights: Sequence[jax.Array]) -> QuadrupedEnv:
    """The same environment, on ground of these `heights`, as the function of that name has them."""
    if not heights:
        return env
    pairs = zip(_surfaces(env), heights, strict=True)
    ground, *touched = (replace(surface, heights=own) for surface, own in pairs)
    own, left = copy.copy(env), iter(touched)
    own.geometry = env.geometry._replace(
        ground=ground,
        contacts=tuple(
            contact if contact.surface is None else replace(contact, surface=next(left))
            for contact in env.geometry.contacts
        ),
    )
    own.robot = replace(env.robot, ground=ground)
    own.sensors = replace(env.sensors, robot=own.robot)
    if env.model is env.geometry:
        own.model = own.geometry
    return own


def _surfaces(env: QuadrupedEnv) -> tuple[Surface, ...]:
    if env.terrain is None:
        return ()
    touched = (contact.surface for contact in env.geometry.contacts)
    return tuple(surface for surface in (env.geometry.ground, *touched) if surface is not None)
