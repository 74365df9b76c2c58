"""How physics is laid out for XLA on a CPU: robots along the last axis, in batches of cache size.

Measured on two cores with `benchmarks/physics.py`; see there for what each of these gives.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

BATCH = 128  # robots side by side: what they hold at a time then stays in a core's cache
LANES = 8  # floats in a vector register


def robots_last(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let `vmap` run a function of one robot that takes arrays (..., robots) at once.

    `function` maps arrays with the robots along the last axis to such arrays. What is returned
    takes and gives one robot's, without that axis; under `jax.vmap`, batches of them are computed.
    """

    @jax.custom_batching.custom_vmap
    def of_one(*arguments: Any) -> Any:
        several = jax.tree.map(lambda x: jnp.asarray(x)[..., None], arguments)
        return jax.tree.map(lambda x: x[..., 0], function(*several))

    @of_one.def_vmap
    def of_many(size: int, batched: Any, *arguments: Any) -> Any:
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


def stage(running: Any, function: Callable[..., Any], *arguments: Any) -> Any:
    """function(*arguments), computed once and kept in memory.

    XLA fuses arithmetic by repeating what several results share, here a fivefold of it. It does
    not look into a conditional whose condition it cannot know: `running`, a scalar that is True.
    """
    traced = jax.jit(function)  # once, for its shapes and for itself
    shapes = jax.eval_shape(traced, *arguments)
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return jax.lax.cond(running, lambda: traced(*arguments), lambda: zeros)
