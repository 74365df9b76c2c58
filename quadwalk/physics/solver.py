"""Newton's method for MuJoCo's convex problem: the acceleration under soft constraints.

The problem is that of Todorov 2014, "Convex and analytically-invertible dynamics with contacts and
constraints". Only the trunk and its own leg's joints move a contact, so the Hessian has the mass
matrix's arrow shape. It is factored in a tenth of the operations of a dense one.
"""

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from quadwalk.physics import vectors as v
from quadwalk.physics.batching import materialize
from quadwalk.physics.contact import (
    Constraints,
    Rows,
    apply_jacobian,
    apply_jacobian_transposed,
    compute_hessian,
)
from quadwalk.physics.rigid_body import LINKS, MassMatrix, Motion
from quadwalk.physics.vectors import Array

Table: TypeAlias = list[list[Array]]
Factor: TypeAlias = Table  # rows of a lower triangle, with the diagonal inverted


class NewtonState(NamedTuple):
    """The iterate of Newton's method, and what follows from it."""

    acceleration: Motion
    residual: Motion  # mass acceleration - force
    off: Rows  # the constraints' accelerations less their reference accelerations


def minimize_cost(
    mass: MassMatrix,
    constraints: Constraints,
    force: Motion,
    barrier: jax.Array,
    iterations: int,
    line_search: int,
) -> Motion:
    """Return the acceleration that minimizes MuJoCo's cost; see `materialize` for `barrier`.

    `force` is the sum of all forces except those of constraints. Each iteration takes a Newton step
    and searches along it for the root of the cost's slope. That is piecewise linear; the search has
    `line_search` evaluations.

    The search begins at rest. The last step's acceleration is a worse start: feet that slide switch
    between the edges of their friction pyramids from step to step (benchmarks/accuracy.py).
    """

    def iterate(state: NewtonState, _: None) -> tuple[NewtonState, None]:
        x, residual, off = state
        active = tuple(
            jnp.where(o < 0, w, 0.0) for o, w in zip(off, constraints.weight, strict=True)
        )
        pull = apply_jacobian_transposed(
            constraints, tuple(-w * o for w, o in zip(active, off, strict=True))
        )
        downhill = add_scaled(pull, -1.0, residual)
        matrix = materialize(barrier, compute_hessian, mass, constraints, active)
        step = solve(matrix, downhill, barrier)
        inertial = materialize(barrier, multiply, mass, step)
        slope, bend = compute_inner_product(step, residual), compute_inner_product(step, inertial)
        along = apply_jacobian(constraints, step)
        scaled = [w * a for w, a in zip(constraints.weight, along, strict=True)]

        def evaluate(alpha: Array) -> tuple[Array, Array]:
            first: Array = 0.0
            second: Array = 0.0
            for o, a, s in zip(off, along, scaled, strict=True):
                at = o + alpha * a
                active = jnp.where(at < 0, s, 0.0)
                first = first + active * at
                second = second + active * a
            return slope + alpha * bend + v.sum_legs(first), bend + v.sum_legs(second)

        def narrow(_: int, bracket: tuple[Array, ...]) -> tuple[Array, ...]:
            alpha, low, high = bracket
            first, second = materialize(barrier, evaluate, alpha)
            low = jnp.where(first < 0, alpha, low)
            high = jnp.where(first < 0, high, alpha)
            guess = alpha - first / second
            inside = (guess >= low) & (guess <= high)
            return jnp.where(inside, guess, 0.5 * (low + high)), low, high

        bracket = (jnp.ones_like(slope), jnp.zeros_like(slope), jnp.full_like(slope, 1e10))
        alpha, _, _ = jax.lax.fori_loop(0, line_search, narrow, bracket)
        after = NewtonState(
            add_scaled(x, alpha, step),
            add_scaled(residual, alpha, inertial),
            tuple(o + alpha * a for o, a in zip(off, along, strict=True)),
        )
        return after, None

    start = NewtonState(
        jax.tree.map(jnp.zeros_like, force),
        jax.tree.map(jnp.negative, force),
        tuple(map(jnp.negative, constraints.reference)),
    )
    return jax.lax.scan(iterate, start, None, length=iterations)[0].acceleration


def compute_cholesky(a: Sequence[Sequence[Array]], n: int) -> Factor:
    """Return the lower Cholesky factor of an n x n matrix of arrays."""
    low: Factor = [[0.0] * (i + 1) for i in range(n)]
    for j in range(n):
        pivot = a[j][j]
        for k in range(j):
            pivot = pivot - low[j][k] * low[j][k]
        low[j][j] = jax.lax.rsqrt(pivot)
        for i in range(j + 1, n):
            entry = a[i][j]
            for k in range(j):
                entry = entry - low[i][k] * low[j][k]
            low[i][j] = entry * low[j][j]
    return low


def solve_lower(low: Factor, b: list[Array]) -> list[Array]:
    """Return y of L y = b."""
    y: list[Array] = []
    for i, entry in enumerate(b):
        for k in range(i):
            entry = entry - low[i][k] * y[k]
        y.append(entry * low[i][i])
    return y


def solve_upper(low: Factor, y: list[Array]) -> list[Array]:
    """Return x of L^T x = y."""
    n = len(y)
    x: list[Array] = [0.0] * n
    for i in reversed(range(n)):
        entry = y[i]
        for k in range(i + 1, n):
            entry = entry - low[k][i] * x[k]
        x[i] = entry * low[i][i]
    return x


def solve(matrix: MassMatrix, force: Motion, barrier: jax.Array) -> Motion:
    """Return matrix^-1 force: eliminate the legs first, then solve for the trunk."""
    low = materialize(barrier, lambda legs: compute_cholesky(legs, LINKS), matrix.legs)

    def eliminate(low: Factor, matrix: MassMatrix, force: Motion) -> tuple[Table, list[Array]]:
        # L^-1 times the coupling to the trunk's 6 directions, [i][k], and L^-1 times the force.
        coupling = [solve_lower(low, [matrix.cross[k][i] for k in range(LINKS)]) for i in range(6)]
        return coupling, solve_lower(low, list(force.joints))

    coupling, reduced = materialize(barrier, eliminate, low, matrix, force)

    def reduce(
        coupling: Table, reduced: list[Array], matrix: MassMatrix, force: Motion
    ) -> tuple[Table, list[Array]]:
        base = [
            [
                matrix.base[i][j]
                - v.sum_legs(sum(coupling[i][k] * coupling[j][k] for k in range(LINKS)))
                for j in range(i + 1)
            ]
            for i in range(6)
        ]
        right = [
            f - v.sum_legs(sum(coupling[i][k] * reduced[k] for k in range(LINKS)))
            for i, f in enumerate((*force.linear, *force.angular))
        ]
        return base, right

    base, right = materialize(barrier, reduce, coupling, reduced, matrix, force)
    top = materialize(barrier, lambda base: compute_cholesky(base, 6), base)
    trunk = materialize(
        barrier, lambda top, right: solve_upper(top, solve_lower(top, right)), top, right
    )
    left = [reduced[k] - sum(coupling[i][k] * trunk[i] for i in range(6)) for k in range(LINKS)]
    x, y, z = solve_upper(low, left)
    return Motion((trunk[0], trunk[1], trunk[2]), (trunk[3], trunk[4], trunk[5]), (x, y, z))


def multiply(matrix: MassMatrix, motion: Motion) -> Motion:
    """Return the product matrix motion."""
    trunk = (*motion.linear, *motion.angular)
    base = [
        sum(matrix.base[i][j] * trunk[j] for j in range(6))
        + v.sum_legs(sum(matrix.cross[k][i] * motion.joints[k] for k in range(LINKS)))
        for i in range(6)
    ]
    joints = (
        sum(matrix.cross[k][i] * trunk[i] for i in range(6))
        + sum(matrix.legs[k][j] * motion.joints[j] for j in range(LINKS))
        for k in range(LINKS)
    )
    return Motion((base[0], base[1], base[2]), (base[3], base[4], base[5]), v.to_vector(joints))


def compute_inner_product(a: Motion, b: Motion) -> Array:
    """Return the inner product of two motions, (robots,): the sum over trunk and all joints."""
    trunk = v.dot(a.linear, b.linear) + v.dot(a.angular, b.angular)
    return trunk + v.sum_legs(v.dot(a.joints, b.joints))


def add_scaled(a: Motion, factor: Array, b: Motion) -> Motion:
    """Return a + factor * b."""
    return jax.tree.map(lambda x, y: x + factor * y, a, b)
