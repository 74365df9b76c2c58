"""Contacts with the floor and joint limits: MuJoCo's soft constraints, by Newton's method.

The convex problem is MuJoCo's (https://mujoco.readthedocs.io/en/stable/computation, "Constraint
model"): pyramidal friction cones, four edges to a contact, and one row for a joint beyond its
limit. What touches the floor are spheres, of each kind one to a leg: feet, or also knees and the
trunk's corners. The trunk and its own leg's joints alone move one, so the Hessian has the mass
matrix's arrow shape and is factored in a tenth of the operations of a dense one.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from quadwalk.physics import vectors as v
from quadwalk.physics.batching import stage
from quadwalk.physics.rigid_body import LINKS, MassMatrix, Motion, Pose
from quadwalk.physics.vectors import Vector

# Of the constraints, arrays (4, robots): four edges of each kind of contact, three limits.
Rows = tuple[Any, ...]
EDGES = 4


class Softness(NamedTuple):
    """How a kind of constraint yields, arrays (4, 1): MuJoCo's solref and solimp, digested."""

    stiffness: Any  # of the reference acceleration, 1/s^2
    damping: Any  # the same, 1/s
    low: Any  # impedance where the constraint is just met
    high: Any  # impedance from `width` on
    width: Any  # m or rad
    middle: Any
    power: Any
    inverse_inertia: Any  # MuJoCo's estimate of a constraint row's, 1/kg or 1/(kg m^2)


class Contact(NamedTuple):
    """Constants of one kind of sphere that may touch the floor, arrays (4, 1)."""

    link: int | None  # that carries it; None: the trunk
    centre: Vector  # of the sphere, in that link's frame, m
    radius: Any  # m
    friction: Any
    softness: Softness


class Limits(NamedTuple):
    """Constants of hip, thigh or calf joints' position limits, arrays (4, 1)."""

    lower: Any  # rad, -inf for none
    upper: Any
    softness: Softness


class Touch(NamedTuple):
    """Where one kind of sphere touches the floor, or is nearest to it."""

    point: Vector  # relative to the trunk's origin, m
    columns: tuple[Vector, ...]  # velocity of that point by each of the leg's joints that move it
    friction: Any


class Constraints(NamedTuple):
    """The constraints at one state; a row that is not in force has weight 0."""

    touches: tuple[Touch, ...]
    signs: Vector  # direction of each joint limit, +1 at the lower one
    reference: Rows  # acceleration that the constraint asks for
    weight: Rows  # MuJoCo's D


def impedance(soft: Softness, depth: Any) -> tuple[Any, Any]:
    """Impedance and weight at constraint violation `depth` < 0."""
    x = jnp.minimum(jnp.abs(depth) / soft.width, 1.0)
    below = x**soft.power / soft.middle ** (soft.power - 1)
    above = 1 - (1 - x) ** soft.power / (1 - soft.middle) ** (soft.power - 1)
    share = jnp.where(x < soft.middle, below, above)
    value = soft.low + share * (soft.high - soft.low)
    return value, value / ((1 - value) * soft.inverse_inertia)


def centres(contact: Contact, pose: Pose) -> Vector:
    """Where the spheres are, relative to the trunk's origin, m."""
    if contact.link is None:
        return v.apply(pose.trunk, contact.centre)
    rotation, origin = pose.rotations[contact.link], pose.origins[contact.link]
    return v.add(origin, v.apply(rotation, contact.centre))


def find_constraints(
    contacts: tuple[Contact, ...],
    limits: tuple[Limits, ...],
    pose: Pose,
    height: Any,
    angles: Vector,
    velocity: Motion,
) -> Constraints:
    """The constraints with the trunk's origin at `height` (robots,), m."""
    touches: list[Touch] = []
    reference: list[Any] = []
    weights: list[Any] = []
    for contact in contacts:
        centre = centres(contact, pose)
        gap = height + centre[2] - contact.radius
        point = (centre[0], centre[1], centre[2] - contact.radius - 0.5 * gap)
        moving = 0 if contact.link is None else contact.link + 1
        columns = tuple(
            v.cross(axis, v.subtract(point, origin))
            for axis, origin in zip(pose.axes[:moving], pose.origins[:moving], strict=True)
        )
        touch = Touch(point, columns, contact.friction)
        soft = contact.softness
        share, weight = impedance(soft, gap)
        touching = gap < 0
        reference += [
            jnp.where(touching, -soft.damping * rate - soft.stiffness * share * gap, 0.0)
            for rate in along_edges(touch, velocity)
        ]
        weights += [jnp.where(touching, weight, 0.0)] * EDGES
        touches.append(touch)
    signs: list[Any] = []
    for limit, angle, rate in zip(limits, angles, velocity.joints, strict=True):
        from_lower, from_upper = angle - limit.lower, limit.upper - angle
        gap = jnp.minimum(from_lower, from_upper)
        sign = jnp.where(from_lower < from_upper, 1.0, -1.0)
        soft = limit.softness
        share, weight = impedance(soft, gap)
        beyond = gap < 0
        asked = -soft.damping * sign * rate - soft.stiffness * share * gap
        signs.append(sign)
        reference.append(jnp.where(beyond, asked, 0.0))
        weights.append(jnp.where(beyond, weight, 0.0))
    x, y, z = signs
    return Constraints(tuple(touches), (x, y, z), tuple(reference), tuple(weights))


def along_edges(touch: Touch, motion: Motion) -> Rows:
    """`motion` at the points of contact, along the four edges of the friction pyramids."""
    at_trunk = v.add(motion.linear, v.cross(motion.angular, touch.point))
    by_joints = (v.scale(motion.joints[i], column) for i, column in enumerate(touch.columns))
    x, y, z = v.add(at_trunk, *by_joints)
    x, y = touch.friction * x, touch.friction * y
    return z + y, z - y, z - x, z + x


def rows(found: Constraints, motion: Motion) -> Rows:
    """J motion."""
    at_limits = (sign * rate for sign, rate in zip(found.signs, motion.joints, strict=True))
    at_floor = (row for touch in found.touches for row in along_edges(touch, motion))
    return (*at_floor, *at_limits)


def by_touch(values: Rows) -> list[Rows]:
    """Of values for all rows, the four edges of each kind of contact."""
    return [values[i : i + EDGES] for i in range(0, len(values) - LINKS, EDGES)]


def force_of(found: Constraints, strength: Rows) -> Motion:
    """J^T strength."""
    pushes: list[Vector] = [
        (touch.friction * (d - c), touch.friction * (a - b), a + b + c + d)
        for touch, (a, b, c, d) in zip(found.touches, by_touch(strength), strict=True)
    ]
    turns = [v.cross(t.point, push) for t, push in zip(found.touches, pushes, strict=True)]
    joints = [sign * limit for sign, limit in zip(found.signs, strength[-LINKS:], strict=True)]
    for touch, push in zip(found.touches, pushes, strict=True):
        for i, column in enumerate(touch.columns):
            joints[i] = v.dot(column, push) + joints[i]
    return Motion(
        tuple(v.legs_sum(x) for x in v.add(*pushes)),  # type: ignore[arg-type]
        tuple(v.legs_sum(x) for x in v.add(*turns)),  # type: ignore[arg-type]
        tuple(joints),  # type: ignore[arg-type]
    )


def hessian(mass: MassMatrix, found: Constraints, weight: Rows) -> MassMatrix:
    """M + J^T diag(weight) J."""
    matrix = mass
    for touch, at_edges in zip(found.touches, by_touch(weight), strict=True):
        matrix = stiffened(matrix, touch, at_edges)
    legs = [list(row) for row in matrix.legs]
    for i, at_limit in enumerate(weight[-LINKS:]):
        legs[i][i] = legs[i][i] + at_limit
    return matrix._replace(legs=tuple(map(tuple, legs)))


def stiffened(matrix: MassMatrix, touch: Touch, weight: Rows) -> MassMatrix:
    """`matrix` + J^T diag(weight) J of one kind of contact."""
    a, b, c, d = weight
    mu = touch.friction
    xx, yy, zz = mu * mu * (c + d), mu * mu * (a + b), a + b + c + d
    xz, yz = mu * (d - c), mu * (a - b)

    def stiff(u: Vector) -> Vector:
        return xx * u[0] + xz * u[2], yy * u[1] + yz * u[2], xz * u[0] + yz * u[1] + zz * u[2]

    px, py, pz = touch.point
    o = jnp.zeros_like(px)
    units = ((o + 1.0, o, o), (o, o + 1.0, o), (o, o, o + 1.0))
    turns = ((o, -pz, py), (pz, o, -px), (-py, px, o))  # axis x point
    trunk = [stiff(u) for u in (*units, *turns)]
    columns = [force + v.cross(touch.point, force) for force in trunk]
    base = tuple(
        tuple(matrix.base[i][j] + v.legs_sum(columns[j][i]) for j in range(6)) for i in range(6)
    )
    cross, legs = list(matrix.cross), [list(row) for row in matrix.legs]
    for j, force in enumerate(stiff(column) for column in touch.columns):
        crossed = force + v.cross(touch.point, force)
        cross[j] = tuple(m + x for m, x in zip(cross[j], crossed, strict=True))
        for i, column in enumerate(touch.columns):
            legs[i][j] = legs[i][j] + v.dot(column, force)
    return MassMatrix(base, tuple(cross), tuple(map(tuple, legs)))


def cholesky(a: Any, n: int) -> list[list[Any]]:
    """The rows of the lower factor of an n x n matrix of arrays, with the diagonal inverted."""
    low: list[list[Any]] = [[None] * (i + 1) for i in range(n)]
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


def forward(low: list[list[Any]], b: list[Any]) -> list[Any]:
    """Solve L y = b."""
    y: list[Any] = []
    for i, entry in enumerate(b):
        for k in range(i):
            entry = entry - low[i][k] * y[k]
        y.append(entry * low[i][i])
    return y


def backward(low: list[list[Any]], y: list[Any]) -> list[Any]:
    """Solve L^T x = y."""
    n = len(y)
    x: list[Any] = [None] * n
    for i in reversed(range(n)):
        entry = y[i]
        for k in range(i + 1, n):
            entry = entry - low[k][i] * x[k]
        x[i] = entry * low[i][i]
    return x


def solve(matrix: MassMatrix, force: Motion, running: Any) -> Motion:
    """matrix^-1 force: the legs are eliminated first, then the trunk is solved for."""
    low = stage(running, lambda legs: cholesky(legs, LINKS), matrix.legs)

    def eliminate(low: Any, matrix: MassMatrix, force: Motion) -> Any:
        # Of each leg, L^-1 of the coupling to the trunk's 6 directions, [i][k], and of the force.
        coupling = [forward(low, [matrix.cross[k][i] for k in range(LINKS)]) for i in range(6)]
        return coupling, forward(low, list(force.joints))

    coupling, reduced = stage(running, eliminate, low, matrix, force)

    def remain(coupling: Any, reduced: Any, matrix: MassMatrix, force: Motion) -> Any:
        base = [
            [
                matrix.base[i][j]
                - v.legs_sum(sum(coupling[i][k] * coupling[j][k] for k in range(LINKS)))
                for j in range(i + 1)
            ]
            for i in range(6)
        ]
        right = [
            f - v.legs_sum(sum(coupling[i][k] * reduced[k] for k in range(LINKS)))
            for i, f in enumerate((*force.linear, *force.angular))
        ]
        return base, right

    base, right = stage(running, remain, coupling, reduced, matrix, force)
    top = stage(running, lambda base: cholesky(base, 6), base)
    trunk = stage(running, lambda top, right: backward(top, forward(top, right)), top, right)
    left = [reduced[k] - sum(coupling[i][k] * trunk[i] for i in range(6)) for k in range(LINKS)]
    x, y, z = backward(low, left)
    return Motion((trunk[0], trunk[1], trunk[2]), (trunk[3], trunk[4], trunk[5]), (x, y, z))


def product(matrix: MassMatrix, motion: Motion) -> Motion:
    """matrix motion."""
    trunk = (*motion.linear, *motion.angular)
    base = [
        sum(matrix.base[i][j] * trunk[j] for j in range(6))
        + v.legs_sum(sum(matrix.cross[k][i] * motion.joints[k] for k in range(LINKS)))
        for i in range(6)
    ]
    joints = tuple(
        sum(matrix.cross[k][i] * trunk[i] for i in range(6))
        + sum(matrix.legs[k][j] * motion.joints[j] for j in range(LINKS))
        for k in range(LINKS)
    )
    return Motion((base[0], base[1], base[2]), (base[3], base[4], base[5]), joints)  # type: ignore[arg-type]


def inner(a: Motion, b: Motion) -> Any:
    """a . b, (robots,)."""
    trunk = v.dot(a.linear, b.linear) + v.dot(a.angular, b.angular)
    return trunk + v.legs_sum(v.dot(a.joints, b.joints))


def combined(a: Motion, factor: Any, b: Motion) -> Motion:
    """a + factor * b."""
    return jax.tree.map(lambda x, y: x + factor * y, a, b)


def newton(
    mass: MassMatrix,
    found: Constraints,
    force: Motion,
    start: Motion,
    running: Any,
    iterations: int,
    line_search: int,
) -> Motion:
    """The acceleration that minimises MuJoCo's cost, from acceleration `start`; see `stage`.

    `force` is all but the constraints'. Each iteration takes a Newton step and then searches along
    it for the root of the cost's slope, which is piecewise linear: `line_search` evaluations.
    """

    def iterate(x: Motion, _: None) -> tuple[Motion, None]:
        off = [a - r for a, r in zip(rows(found, x), found.reference, strict=True)]
        active = tuple(jnp.where(o < 0, w, 0.0) for o, w in zip(off, found.weight, strict=True))
        pull = force_of(found, tuple(-w * o for w, o in zip(active, off, strict=True)))
        residual = combined(product(mass, x), -1.0, force)
        gradient = combined(residual, -1.0, pull)
        matrix = stage(running, hessian, mass, found, active)
        step = solve(matrix, jax.tree.map(jnp.negative, gradient), running)
        slope, bend = inner(step, residual), inner(step, product(mass, step))
        along = rows(found, step)
        scaled = [w * a for w, a in zip(found.weight, along, strict=True)]

        def evaluate(alpha: Any) -> tuple[Any, Any]:
            first: Any = 0.0
            second: Any = 0.0
            for o, a, s in zip(off, along, scaled, strict=True):
                at = o + alpha * a
                in_force = jnp.where(at < 0, s, 0.0)
                first = first + in_force * at
                second = second + in_force * a
            return slope + alpha * bend + v.legs_sum(first), bend + v.legs_sum(second)

        def narrow(_: int, bracket: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
            alpha, low, high = bracket
            first, second = stage(running, evaluate, alpha)
            low = jnp.where(first < 0, alpha, low)
            high = jnp.where(first < 0, high, alpha)
            guess = alpha - first / second
            inside = (guess >= low) & (guess <= high)
            return jnp.where(inside, guess, 0.5 * (low + high)), low, high

        start = (jnp.ones_like(slope), jnp.zeros_like(slope), jnp.full_like(slope, 1e10))
        alpha, _, _ = jax.lax.fori_loop(0, line_search, narrow, start)
        return combined(x, alpha, step), None

    return jax.lax.scan(iterate, start, None, length=iterations)[0]
