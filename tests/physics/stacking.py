"""Models of several robots as one that `jax.vmap` maps over."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np


def stack_models(models: Sequence[Any]) -> tuple[list[np.ndarray], Callable[[Sequence[Any]], Any]]:
    """What differs between models of one structure, any engine's; and how to make one of it.

    Returns the leaves that differ, with the models along axis 0, and a function that takes one
    robot's of these, as within `jax.vmap`, and returns its model: all other leaves are the first's.
    """
    # On the host: MJX ties its arrays to one device, and the robots may be on several.
    rows = [
        list(map(np.asarray, leaves)) for leaves in zip(*map(jax.tree.leaves, models), strict=True)
    ]
    differ = [not all(np.array_equal(row[0], leaf) for leaf in row) for row in rows]
    leaves, structure = jax.tree.flatten(models[0])

    def assemble(given: Sequence[Any]) -> Any:
        rest = iter(given)
        chosen = [next(rest) if own else leaf for own, leaf in zip(differ, leaves, strict=True)]
        return jax.tree.unflatten(structure, chosen)

    return [np.stack(row) for row, own in zip(rows, differ, strict=True) if own], assemble
