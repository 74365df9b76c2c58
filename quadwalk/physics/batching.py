"""How physics is laid out for XLA on a CPU: robots along the last axis, in batches of cache size.

Measured on two cores with `benchmarks/physics.py`; see there for what each of these gives.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

BATCH = 128  # robots side by side: what they hold at a time then stays in a core's cache
LANES = 8  # floats in a vector register


class Shared:
    """Base of pytrees whose arrays are the same for all robots and have no axis of robots."""


def batch_robots(function: Callable[..., Any], like: Any) -> Callable[..., Any]:
    """Let `vmap` run a function of one robot that takes arrays (..., robots) at once.

    `function` maps pytrees of arrays with the robots along the last axis to such pytrees. What is
    returned takes and gives one robot's, without that axis; under `jax.vmap`, batches of them are
    computed. `like` is a pytree of the shapes and types of what one robot gives: with it, the
    function is traced for the batch alone, not for one robot as well.

    Leaves of the arguments that are constants (`is_constant`) get a last axis of length 1. The
    compiled program folds them: zeros vanish from it. What is `Shared` is handed on as it is.
    """

    shapes, expected = jax.tree.flatten(like)

    def of_any(*arguments: Any) -> Any:
        leaves, structure = jax.tree.flatten(arguments, is_leaf=lambda x: isinstance(x, Shared))
        shared, parts = jax.tree.flatten([x for x in leaves if isinstance(x, Shared)])
        fixed = [isinstance(leaf, Shared) or is_constant(leaf) for leaf in leaves]
        varying = [leaf for leaf, is_fixed in zip(leaves, fixed, strict=True) if not is_fixed]

        def of_several(*arrays: jax.Array) -> list[Any]:
            rest = iter(arrays[: len(varying)])
            common = iter(jax.tree.unflatten(parts, arrays[len(varying) :]))
            inputs = []
            for leaf, is_fixed in zip(leaves, fixed, strict=True):
                if isinstance(leaf, Shared):
                    inputs.append(next(common))
                else:
                    inputs.append(append_axis(leaf) if is_fixed else next(rest))
            found = function(*jax.tree.unflatten(structure, inputs))
            own: Any = jax.tree.structure(found)
            if own != expected:
                raise TypeError(f"a function gives {own}; expected {expected}")
            return jax.tree.leaves(found)

        found = _robots.bind(
            *varying, *shared, function=of_several, shared=len(shared), shapes=tuple(shapes)
        )
        return jax.tree.unflatten(expected, found)

    return of_any


def is_constant(leaf: Any) -> bool:
    """Whether a leaf is the same for all robots: NumPy's or a number. JAX's may be one for each.

    Randomization turns constants into variables, since it computes them with JAX. `TypeError` for
    any other leaf.
    """
    if isinstance(leaf, jax.Array):
        return False
    if isinstance(leaf, np.ndarray | np.generic | int | float):
        return True
    raise TypeError(f"a leaf is a {type(leaf).__name__}; expected an array or a number")


def append_axis(constant: Any) -> Any:
    """A constant array with a last axis of length 1, for the robots; a number as it is."""
    return np.reshape(constant, (*np.shape(constant), 1)) if np.ndim(constant) else constant


def _of_one(
    *arguments: Any, function: Callable[..., list[Any]], shared: int, **_: Any
) -> list[Any]:
    arrays = [jnp.asarray(x) for x in arguments]
    varying = len(arrays) - shared
    return [
        x[..., 0] for x in function(*(x[..., None] for x in arrays[:varying]), *arrays[varying:])
    ]


def _of_many(
    arguments: Sequence[Any],
    axes: Sequence[int | None],
    *,
    function: Callable[..., list[Any]],
    shared: int,
    **_: Any,
) -> tuple[list[Any], list[int]]:
    """What a batch gives, its axis first; `axes` are the batch's in `arguments`."""
    varying = len(arguments) - shared
    common = arguments[varying:]
    assert all(axis is None for axis in axes[varying:])
    arguments, axes = arguments[:varying], axes[:varying]
    size = next(x.shape[axis] for x, axis in zip(arguments, axes, strict=True) if axis is not None)
    # An accelerator is to be filled at once.
    number = -(-size // BATCH) if jax.default_backend() == "cpu" else 1
    length = size if number == 1 else -(-size // (number * LANES)) * LANES

    def arrange(x: jax.Array, axis: int | None) -> jax.Array:
        x = jnp.broadcast_to(x, (size, *x.shape)) if axis is None else jnp.moveaxis(x, axis, 0)
        x = jnp.pad(x, [(0, number * length - size)] + [(0, 0)] * (x.ndim - 1), mode="edge")
        return jnp.moveaxis(x.reshape(number, length, *x.shape[1:]), 1, -1)

    def restore(x: jax.Array) -> jax.Array:
        x = jnp.moveaxis(x, -1, 1)
        return x.reshape(number * length, *x.shape[2:])[:size]

    batches = [arrange(x, axis) for x, axis in zip(arguments, axes, strict=True)]
    out = [restore(x) for x in jax.lax.map(lambda batch: function(*batch, *common), batches)]
    return out, [0] * len(out)


def _tangents(
    primals: Sequence[Any], tangents: Sequence[Any], **how: Any
) -> tuple[list[Any], list[Any]]:
    """Forward derivatives: those of one robot, for `vmap` to batch as it does."""
    tangents = [ad.instantiate_zeros(tangent) for tangent in tangents]
    return jax.jvp(partial(_of_one, **how), tuple(primals), tuple(tangents))


# `jax.custom_batching.custom_vmap` would trace a function for one robot, to know its shapes, and
# then for the batch: seconds of every start.
_robots = Primitive("batch_robots")
_robots.multiple_results = True
_robots.def_impl(lambda *arguments, **how: jax.jit(partial(_of_one, **how))(*arguments))
_robots.def_abstract_eval(
    lambda *_, shapes, **__: [ShapedArray(each.shape, each.dtype) for each in shapes]
)
mlir.register_lowering(_robots, mlir.lower_fun(_of_one, multiple_results=True))
batching.primitive_batchers[_robots] = _of_many
ad.primitive_jvps[_robots] = _tangents


def opaque_true(number: jax.Array) -> jax.Array:
    """True, though XLA cannot know it: `number`, of a sound state, is far below 1e30, or NaN."""
    return ~(number > 1e30)


def materialize(barrier: Any, function: Callable[..., Any], *arguments: Any) -> Any:
    """function(*arguments), computed once and kept in memory.

    XLA fuses arithmetic by repeating what several results share, here a fivefold of it. It does
    not look into a conditional whose condition it cannot know: `barrier`, from `opaque_true`.
    """
    traced = jax.jit(function)  # once, for its shapes and for itself
    shapes = jax.eval_shape(traced, *arguments)
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return jax.lax.cond(barrier, lambda: traced(*arguments), lambda: zeros)
