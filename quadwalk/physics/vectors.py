"""Vectors and 3x3 matrices as tuples of their components, each an array over legs and robots.

XLA compiles arithmetic on such components to long loops over robots, with the processor's vector
instructions; arrays whose last axis is a vector's three components leave most of these idle.
"""

from collections.abc import Iterable
from typing import TypeAlias

import jax
import numpy as np

# (4, robots) of legs' quantities, (robots,) of the trunk's; of constants, NumPy's or a number.
Array: TypeAlias = jax.Array | np.ndarray | float
Vector: TypeAlias = tuple[Array, Array, Array]
Matrix: TypeAlias = tuple[Vector, Vector, Vector]  # rows


def to_vector(components: Iterable[Array]) -> Vector:
    """Return the vector of three components."""
    x, y, z = components
    return x, y, z


def add(*vectors: Vector) -> Vector:
    """Return the sum of vectors, added from left to right."""
    return to_vector(sum(parts[1:], start=parts[0]) for parts in zip(*vectors, strict=True))


def subtract(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scale(factor: Array, a: Vector) -> Vector:
    """Return factor * a."""
    return factor * a[0], factor * a[1], factor * a[2]


def dot(a: Vector, b: Vector) -> Array:
    """Return the inner product of a and b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def transpose(m: Matrix) -> Matrix:
    """Return the transposed matrix."""
    x, y, z = zip(*m, strict=True)
    return x, y, z


def apply(m: Matrix, a: Vector) -> Vector:
    """Return m a."""
    return dot(m[0], a), dot(m[1], a), dot(m[2], a)


def apply_transposed(m: Matrix, a: Vector) -> Vector:
    """Return m^T a."""
    return apply(transpose(m), a)


def multiply(a: Matrix, b: Matrix) -> Matrix:
    """Return the product a b."""
    columns = transpose(b)
    x, y, z = (to_vector(dot(row, column) for column in columns) for row in a)
    return x, y, z


def sum_legs(a: Array) -> Array:
    """Return the sum over the four legs, the first axis."""
    assert not isinstance(a, float)
    return a[0] + a[1] + a[2] + a[3]
