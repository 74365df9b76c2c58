"""Mirror-symmetric layers (Su et al. 2024, arXiv:2403.17320).

In suitable coordinates, a `Basis`, a mirror image differs from its original only in signs: those of
the odd part are reversed, those of the even part stay. A layer that maps even to even and odd to
odd numbers is equivariant: a mirrored observation gives the mirrored action. That takes half the
arithmetic of a plain layer, and learns from fewer steps. The activation works on a layer's units
themselves, of which one half is the mirror image of the other.

One thing breaks the symmetry: `lead`, the bias of the odd part. A mirrored observation gives the
mirrored action, and the same value, with the lead's sign reversed. Without it no side could lead a
gallop: `run` then bounds, at 4.9 to 5.2 m/s instead of 5.5. It starts at random, for no gradient
says which side.
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.robot.mirror import Mirror, make_mirror

HALF = np.float32(np.sqrt(0.5))
# Names of a layer's kernel and bias: those of the even part, or of a plain layer; those of the odd
# part, which the layer of a value has not.
WEIGHTS = (("kernel", "bias"), ("negated", "lead"))

Parts = tuple[jax.Array, ...]  # (even, odd), or (all,) without a mirror


class Basis:
    """Orthonormal coordinates of vectors (n, ...) in which a mirror only changes signs.

    Two numbers that change places become their sum and their difference. Without a mirror the
    coordinates are the numbers themselves, as one part.
    """

    def __init__(self, size: int, mirror: Mirror | None = None) -> None:
        self.size, self.mirror = size, mirror
        unit = np.eye(size, dtype=np.float32)
        if mirror is None:
            self.matrices: tuple[np.ndarray, ...] = (unit,)
            return
        source, sign = np.asarray(mirror.source), np.asarray(mirror.sign, np.float32)
        image = np.zeros((size, size), np.float32)
        image[np.arange(size), source] = sign
        first = np.arange(size) <= source
        alone = np.arange(size) == source
        even = first & ~(alone & (sign < 0.0))
        odd = first & ~(alone & (sign > 0.0))
        scale = np.where(alone, np.float32(0.5), HALF)[:, None]
        self.matrices = ((scale * (unit + image))[even], (scale * (unit - image))[odd])

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of coordinates in each part."""
        return tuple(len(matrix) for matrix in self.matrices)

    def split(self, x: jax.Array) -> Parts:
        """Return the coordinates of `x` (n, ...)."""
        if self.mirror is None:
            return (x,)
        return tuple(_multiply_sparse(matrix, x) for matrix in self.matrices)

    def join(self, parts: Parts) -> jax.Array:
        """Return the vector (n, ...) with these coordinates."""
        if self.mirror is None:
            return parts[0]
        return _multiply_sparse(np.concatenate(self.matrices).T, jnp.concatenate(parts))


def _multiply_sparse(matrix: np.ndarray, x: jax.Array) -> jax.Array:
    """Return `matrix @ x` for a matrix with at most two nonzero entries in each row."""
    order = np.argsort(matrix == 0.0, axis=1, kind="stable")[:, :2]
    weights = np.take_along_axis(matrix, order, axis=1).reshape(-1, 2, *[1] * (x.ndim - 1))
    return weights[:, 0] * x[order[:, 0]] + weights[:, 1] * x[order[:, 1]]


def apply_activation(activation: Callable[[jax.Array], jax.Array], parts: Parts) -> Parts:
    """Return the parts (m, ...) of a layer's units after `activation`."""
    if len(parts) == 1:
        return (activation(parts[0]),)
    even, odd = (HALF * part for part in parts)
    left, right = activation(even + odd), activation(even - odd)
    return HALF * (left + right), HALF * (left - right)


def to_plain(params: Any, inputs: Basis, outputs: Basis) -> Any:
    """Return the weights of the plain network that computes the same as a symmetric one."""
    if inputs.mirror is None:
        return params
    plain = {}
    for name, layer, before, after in _iterate_layers(params, inputs, outputs):
        kernels = [layer[kernel] for kernel, _ in WEIGHTS if kernel in layer]
        biases = [layer[bias] for _, bias in WEIGHTS if bias in layer]
        plain[name] = {
            "kernel": sum(
                a.T @ kernel @ b
                for a, kernel, b in zip(before.matrices, kernels, after.matrices, strict=False)
            ),
            "bias": sum(bias @ b for bias, b in zip(biases, after.matrices, strict=False)),
        }
    return {"params": plain}


def to_symmetric(params: Any, inputs: Basis, outputs: Basis) -> Any:
    """Return the symmetric weights of which `to_plain` makes plain `params`.

    Weights that no symmetric network can have lose their asymmetric part.
    """
    if inputs.mirror is None:
        return params
    symmetric: dict[str, dict[str, Any]] = {}
    for name, layer, before, after in _iterate_layers(params, inputs, outputs):
        symmetric[name] = {}
        for (kernel, bias), a, b in zip(WEIGHTS, before.matrices, after.matrices, strict=True):
            if len(b):  # a value has no odd part
                symmetric[name][kernel] = a @ layer["kernel"] @ b.T
                symmetric[name][bias] = b @ layer["bias"]
    return {"params": symmetric}


def _iterate_layers(
    params: Any, inputs: Basis, outputs: Basis
) -> Iterator[tuple[str, Any, Basis, Basis]]:
    """Yield the name and the weights of each layer, and the bases of its inputs and outputs."""
    layers = params["params"]
    before = inputs
    for number in range(len(layers)):
        name = f"hidden_{number}"
        after = outputs
        if number + 1 < len(layers):
            half = sum(layers[name][k].shape[1] for k, _ in WEIGHTS if k in layers[name]) // 2
            swap = make_mirror(np.roll(np.arange(2 * half), half), np.ones(2 * half))
            after = Basis(2 * half, swap)
        yield name, layers[name], before, after
        before = after
