"""The layout of physics for XLA on a CPU: robots along the last axis, in batches of cache size.

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
    """Return a function of one robot that `jax.vmap` runs with the robots along the last axis.

    `function` maps pytrees of arrays (..., robots) to such pytrees; the result takes and gives
    arrays without that axis. `like` is a pytree of one robot's output, of shapes and types: with it
    `function` is traced for the batch alone, not for one robot as well.

    Leaves of the arguments that are constants (`is_constant`) get a last axis of length 1. The
    compiled program folds them: zeros vanish from it. `Shared` pytrees are passed on as they are.
    """

    shapes, structure = jax.tree.flatten(like)

    def run_one(*arguments: Any) -> Any:
        leaves, inputs = jax.tree.flatten(arguments, is_leaf=lambda x: isinstance(x, Shared))
        shared, shared_structure = jax.tree.flatten([x for x in leaves if isinstance(x, Shared)])
        fixed = [isinstance(leaf, Shared) or is_constant(leaf) for leaf in leaves]
        varying = [leaf for leaf, is_fixed in zip(leaves, fixed, strict=True) if not is_fixed]

        def run_batch(*arrays: jax.Array) -> list[Any]:
            arrays_left = iter(arrays[: len(varying)])
            shared_left = iter(jax.tree.unflatten(shared_structure, arrays[len(varying) :]))
            columns = []
            for leaf, is_fixed in zip(leaves, fixed, strict=True):
                if isinstance(leaf, Shared):
                    columns.append(next(shared_left))
                else:
                    columns.append(append_axis(leaf) if is_fixed else next(arrays_left))
            output = function(*jax.tree.unflatten(inputs, columns))
            output_structure: Any = jax.tree.structure(output)
            if output_structure != structure:
                raise TypeError(f"a function gives {output_structure}; expected {structure}")
            return jax.tree.leaves(output)

        output = _robots.bind(
            *varying, *shared, function=run_batch, shared=len(shared), shapes=tuple(shapes)
        )
        return jax.tree.unflatten(structure, output)

    return run_one


def is_constant(leaf: Any) -> bool:
    """Return True if a leaf is the same for all robots: NumPy's or a number.

    JAX's arrays may differ: randomization computes variables from constants with JAX. Raises
    `TypeError` for anything else.
    """
    if isinstance(leaf, jax.Array):
        return False
    if isinstance(leaf, np.ndarray | np.generic | int | float):
        return True
    raise TypeError(f"a leaf is a {type(leaf).__name__}; expected an array or a number")


def append_axis(constant: Any) -> Any:
    """Return a constant array with a last axis of length 1, for the robots; a number as it is."""
    return np.reshape(constant, (*np.shape(constant), 1)) if np.ndim(constant) else constant


def _run_one(
    *arguments: Any, function: Callable[..., list[Any]], shared: int, **_: Any
) -> list[Any]:
    """Return the output of `function` for one robot: a batch of one, whose axis is then dropped.

    The last `shared` of the arguments are the same for all robots.
    """
    arrays = [jnp.asarray(x) for x in arguments]
    varying = len(arrays) - shared
    batch = (x[..., None] for x in arrays[:varying])
    return [x[..., 0] for x in function(*batch, *arrays[varying:])]


def _run_batches(
    arguments: Sequence[Any],
    axes: Sequence[int | None],
    *,
    function: Callable[..., list[Any]],
    shared: int,
    **_: Any,
) -> tuple[list[Any], list[int]]:
    """Return the outputs of `function` for a batch of any size, and their batch axes.

    It is cut into batches of cache size. `axes` are the batch axes of `arguments`, None for an
    argument that is the same for all robots; the last `shared` of the arguments all are.
    """
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


def _differentiate(
    primals: Sequence[Any], tangents: Sequence[Any], **how: Any
) -> tuple[list[Any], list[Any]]:
    """Return one robot's output and its forward derivative, for `vmap` to batch as it does."""
    tangents = [ad.instantiate_zeros(tangent) for tangent in tangents]
    return jax.jvp(partial(_run_one, **how), tuple(primals), tuple(tangents))


# `jax.custom_batching.custom_vmap` would trace a function for one robot, to know its shapes, and
# then for the batch: seconds of every start.
_robots = Primitive("batch_robots")
_robots.multiple_results = True
_robots.def_impl(lambda *arguments, **how: jax.jit(partial(_run_one, **how))(*arguments))
_robots.def_abstract_eval(
    lambda *_, shapes, **__: [ShapedArray(shape.shape, shape.dtype) for shape in shapes]
)
mlir.register_lowering(_robots, mlir.lower_fun(_run_one, multiple_results=True))
batching.primitive_batchers[_robots] = _run_batches
ad.primitive_jvps[_robots] = _differentiate


def make_opaque_true(number: jax.Array) -> jax.Array:
    """Return True in a way that XLA cannot know.

    `number`, of a sound state, is far below 1e30, or NaN.
    """
    return ~(number > 1e30)


def materialize(barrier: Any, function: Callable[..., Any], *arguments: Any) -> Any:
    """Return function(*arguments), computed once and kept in memory.

    XLA fuses arithmetic by repeating what several results share, here a fivefold of it. It does not
    look into a conditional whose condition it cannot know: `barrier`, of `make_opaque_true`.
    """
    traced = jax.jit(function)  # once, for its shapes and for itself
    shapes = jax.eval_shape(traced, *arguments)
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return jax.lax.cond(barrier, lambda: traced(*arguments), lambda: zeros)
