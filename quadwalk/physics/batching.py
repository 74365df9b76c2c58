"""How physics is laid out for XLA on a CPU: robots along the last axis, in batches of cache size.

Measured on two cores with `benchmarks/physics.py`; see there for what each of these gives.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

BATCH = 128  # robots side by side: what they hold at a time then stays in a core's cache
LANES = 8  # floats in a vector register

Tree = TypeVar("Tree")


def robots_last(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let `vmap` run a function of one robot that takes arrays (..., robots) at once.

    `function` maps pytrees of arrays with the robots along the last axis to such pytrees. What is
    returned takes and gives one robot's, without that axis; under `jax.vmap`, batches of them are
    computed.

    Leaves of the arguments that are no JAX arrays but NumPy's or numbers are the same for all
    robots. They get a last axis of length 1 and are constants of the compiled program, which folds
    them: zeros vanish from it.
    """

    def of_any(*arguments: Any) -> Any:
        places = [isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(arguments)]
        varying, assemble = _split(arguments, places)
        return _batched(lambda *arrays: function(*assemble(arrays, column)))(*varying)

    return of_any


def column(constant: Any) -> Any:
    """A constant array with a last axis of length 1, for the robots; a number as it is."""
    return np.reshape(constant, (*np.shape(constant), 1)) if np.ndim(constant) else constant


def _batched(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` of arrays (..., robots) as one of a single robot's, to be vmapped."""

    @jax.custom_batching.custom_vmap
    def of_one(*arguments: jax.Array) -> Any:
        several = [x[..., None] for x in arguments]
        return jax.tree.map(lambda x: x[..., 0], function(*several))

    @of_one.def_vmap
    def of_many(size: int, batched: Any, *arguments: jax.Array) -> Any:
        # An accelerator is to be filled at once.
        number = -(-size // BATCH) if jax.default_backend() == "cpu" else 1
        length = size if number == 1 else -(-size // (number * LANES)) * LANES

        def arrange(x: jax.Array, is_batched: bool) -> jax.Array:
            if not is_batched:
                x = jnp.broadcast_to(x, (size, *x.shape))
            x = jnp.pad(x, [(0, number * length - size)] + [(0, 0)] * (x.ndim - 1), mode="edge")
            return jnp.moveaxis(x.reshape(number, length, *x.shape[1:]), 1, -1)

        def restore(x: jax.Array) -> jax.Array:
            x = jnp.moveaxis(x, -1, 1)
            return x.reshape(number * length, *x.shape[2:])[:size]

        batches = jax.tree.map(arrange, tuple(arguments), tuple(batched))
        out = jax.tree.map(restore, jax.lax.map(lambda batch: function(*batch), batches))
        return out, jax.tree.map(lambda _: True, out)

    return of_one


def _split(tree: Tree, places: Sequence[bool]) -> tuple[list[Any], Callable[..., Tree]]:
    """The leaves of a pytree at `places`, and the function that puts it together again.

    That takes these leaves, or others in their place, and optionally a function for the rest.
    """
    leaves, structure = jax.tree.flatten(tree)

    def assemble(given: Sequence[Any], change: Callable[[Any], Any] = lambda leaf: leaf) -> Tree:
        rest = iter(given)
        pairs = zip(places, leaves, strict=True)
        return jax.tree.unflatten(
            structure, [next(rest) if place else change(leaf) for place, leaf in pairs]
        )

    return list(itertools.compress(leaves, places)), assemble


def materialize(running: Any, function: Callable[..., Any], *arguments: Any) -> Any:
    """function(*arguments), computed once and kept in memory.

    XLA fuses arithmetic by repeating what several results share, here a fivefold of it. It does
    not look into a conditional whose condition it cannot know: `running`, a scalar that is True.
    """
    traced = jax.jit(function)  # once, for its shapes and for itself
    shapes = jax.eval_shape(traced, *arguments)
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return jax.lax.cond(running, lambda: traced(*arguments), lambda: zeros)
