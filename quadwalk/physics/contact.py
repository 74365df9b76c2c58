"""Contacts with the ground and joint limits: the rows of MuJoCo's soft constraints.

The constraints are MuJoCo's (https://mujoco.readthedocs.io/en/stable/computation, "Constraint
model"): pyramidal friction cones, four edges to a contact, and one row for a joint beyond its
limit. What touches the floor are spheres, of each kind one to a leg: feet, or also knees, the
trunk's corners and hips. A contact is moved by the trunk and its own leg's joints alone, so the
Hessian has the mass matrix's arrow shape.
"""

from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.physics import vectors as v
from quadwalk.physics.rigid_body import LINKS, MassMatrix, Motion, Pose
from quadwalk.physics.surface import Spot, Surface, compute_contact_frame
from quadwalk.physics.vectors import Array, Vector

# Of the constraints, arrays (4, robots): four edges of each kind of contact, three limits.
Rows: TypeAlias = tuple[Array, ...]
EDGES = 4


class SolverParams(NamedTuple):
    """How a kind of constraint yields, (4,) over legs: precomputed from solref and solimp."""

    stiffness: Array  # of the reference acceleration, 1/s^2
    damping: Array  # the same, 1/s
    low: Array  # impedance where the constraint is just met
    high: Array  # impedance from `width` on
    width: Array  # m or rad
    middle: Array
    power: Array
    # MuJoCo's estimate (invweight0), of translation at a contact or of a joint, 1/kg or 1/(kg m^2).
    # It derives it from all masses, inertias and armatures of the robot.
    inverse_inertia: Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Contact:
    """Constants of one kind of sphere that may touch the floor, (4,) over legs."""

    link: int | None = field(metadata={"static": True})  # that carries it; None: the trunk
    center: Vector  # of the sphere, in that link's frame, m
    radius: Array  # m
    friction: Array
    params: SolverParams
    # (4,) each leg's grid in the offset surface of ground that is not level
    grids: tuple[int, ...] = field(default=(), metadata={"static": True})


class Limits(NamedTuple):
    """Constants of hip, thigh or calf joints' position limits, (4,) over legs."""

    lower: Array  # rad, -inf for none
    upper: Array
    params: SolverParams


class ContactPoint(NamedTuple):
    """Where one kind of sphere touches the floor, or is nearest to it."""

    point: Vector  # relative to the trunk's origin, m
    columns: tuple[Vector, ...]  # velocity of that point by each of the leg's joints that move it
    friction: Array
    # Of ground that is not level, the contact's Jacobian: velocity along its normal and along its
    # tangents times friction. None: the normal is world z, the tangents y and -x.
    jacobian: "tuple[Row, Row, Row] | None" = None


class Row(NamedTuple):
    """Velocity in one direction of a contact by each of what moves it."""

    linear: Vector  # by the trunk's, that is: the direction
    angular: Vector
    joints: tuple[Array, ...]


class Under(NamedTuple):
    """What is under one kind of sphere, over legs."""

    above: Array  # m, how far, straight down, the sphere is from touching the ground
    normal: Vector
    first: Vector  # tangent
    second: Vector


class Constraints(NamedTuple):
    """The constraints at one state; an inactive constraint row has weight 0."""

    points: tuple[ContactPoint, ...]
    signs: Vector  # direction of each joint limit, +1 at the lower one
    reference: Rows  # acceleration that the constraint asks for
    weight: Rows  # MuJoCo's D


def impedance(params: SolverParams, inverse_inertia: Array, depth: Array) -> tuple[Array, Array]:
    """A row's impedance and weight at constraint violation `depth` < 0."""
    x = jnp.minimum(jnp.abs(depth) / params.width, 1.0)
    below = x**params.power / params.middle ** (params.power - 1)
    above = 1 - (1 - x) ** params.power / (1 - params.middle) ** (params.power - 1)
    share = jnp.where(x < params.middle, below, above)
    value = params.low + share * (params.high - params.low)
    return value, value / ((1 - value) * inverse_inertia)


def centers(contact: Contact, pose: Pose) -> Vector:
    """Where the spheres are, relative to the trunk's origin, m."""
    if contact.link is None:
        return v.apply(pose.trunk, contact.center)
    rotation, origin = pose.rotations[contact.link], pose.origins[contact.link]
    return v.add(origin, v.apply(rotation, contact.center))


def triangles_under(
    contact: Contact, surface: Surface, center: Vector, place: tuple[Array, Array]
) -> tuple[Spot, Vector]:
    """Where spheres are over the offset surface that they may touch, and its heights around there.

    `center` is theirs from the trunk's origin, which is at `place` along world x and y, m.
    """
    which = np.reshape(contact.grids, (4, 1)) if any(contact.grids) else 0
    spot = surface.locate(place[0] + center[0], place[1] + center[1], which)
    return spot, surface.read(spot)


def look_under(surface: Surface, spot: Spot, heights: Vector, altitude: Array) -> Under:
    """What is under spheres whose centers are at `altitude`, m, over such triangles."""
    level, along, across = surface.interpolate(spot, heights)
    return Under(altitude - level, *compute_contact_frame(along, across))


def find_constraints(
    contacts: tuple[Contact, ...],
    limits: tuple[Limits, ...],
    pose: Pose,
    height: Array,
    angles: Vector,
    velocity: Motion,
    ground: tuple[Under, ...] | None = None,
) -> Constraints:
    """The constraints with the trunk's origin at `height` (robots,), m.

    `ground` is what is under each kind of sphere, where it is not level.
    """
    points: list[ContactPoint] = []
    reference: list[Array] = []
    weights: list[Array] = []
    for index, contact in enumerate(contacts):
        center = centers(contact, pose)
        under = None if ground is None else ground[index]
        gap, point = touching(contact, center, height, under)
        moving = 0 if contact.link is None else contact.link + 1
        columns = tuple(
            v.cross(axis, v.subtract(point, origin))
            for axis, origin in zip(pose.axes[:moving], pose.origins[:moving], strict=True)
        )
        nearest = ContactPoint(point, columns, contact.friction)
        if under is not None:
            nearest = nearest._replace(jacobian=jacobian(nearest, under))
        params, mu = contact.params, contact.friction
        # Of an edge of MuJoCo's pyramid.
        share, weight = impedance(params, params.inverse_inertia * (1 + mu**2) * 2 * mu**2, gap)
        inside = gap < 0
        reference += [
            jnp.where(inside, -params.damping * rate - params.stiffness * share * gap, 0.0)
            for rate in along_edges(nearest, velocity)
        ]
        weights += [jnp.where(inside, weight, 0.0)] * EDGES
        points.append(nearest)
    signs: list[Array] = []
    for limit, angle, rate in zip(limits, angles, velocity.joints, strict=True):
        from_lower, from_upper = angle - limit.lower, limit.upper - angle
        gap = jnp.minimum(from_lower, from_upper)
        sign = jnp.where(from_lower < from_upper, 1.0, -1.0)
        params = limit.params
        share, weight = impedance(params, params.inverse_inertia, gap)
        beyond = gap < 0
        asked = -params.damping * sign * rate - params.stiffness * share * gap
        signs.append(sign)
        reference.append(jnp.where(beyond, asked, 0.0))
        weights.append(jnp.where(beyond, weight, 0.0))
    return Constraints(tuple(points), v.to_vector(signs), tuple(reference), tuple(weights))


def touching(
    contact: Contact, center: Vector, height: Array, under: Under | None
) -> tuple[Array, Vector]:
    """How far spheres at `center` are above the ground, m, and the contact's point."""
    radius = contact.radius
    if under is None:
        gap = height + center[2] - radius
        return gap, (center[0], center[1], center[2] - radius - 0.5 * gap)
    gap = under.above * under.normal[2]
    return gap, v.subtract(center, v.scale(radius + 0.5 * gap, under.normal))


def jacobian(at: ContactPoint, under: Under) -> tuple[Row, Row, Row]:
    """Of a contact with ground that is not level."""

    def row(axis: Vector) -> Row:
        return Row(axis, v.cross(at.point, axis), tuple(v.dot(axis, c) for c in at.columns))

    tangents = (v.scale(at.friction, tangent) for tangent in (under.first, under.second))
    first, second = map(row, tangents)
    return row(under.normal), first, second


def along_edges(at: ContactPoint, motion: Motion) -> Rows:
    """`motion` at the points of contact, along the four edges of the friction pyramids."""
    if at.jacobian is not None:
        up, first, second = (along_row(row, motion) for row in at.jacobian)
        return up + first, up - first, up + second, up - second
    at_trunk = v.add(motion.linear, v.cross(motion.angular, at.point))
    by_joints = (v.scale(motion.joints[i], column) for i, column in enumerate(at.columns))
    x, y, z = v.add(at_trunk, *by_joints)
    x, y = at.friction * x, at.friction * y
    return z + y, z - y, z - x, z + x


def along_row(row: Row, motion: Motion) -> Array:
    """`motion` in one direction of a contact."""
    total = v.dot(row.linear, motion.linear) + v.dot(row.angular, motion.angular)
    return sum((a * b for a, b in zip(row.joints, motion.joints, strict=False)), start=total)


def rows(found: Constraints, motion: Motion) -> Rows:
    """J motion."""
    at_limits = (sign * rate for sign, rate in zip(found.signs, motion.joints, strict=True))
    at_floor = (row for at in found.points for row in along_edges(at, motion))
    return (*at_floor, *at_limits)


def by_contact(values: Rows) -> list[Rows]:
    """Of values for all rows, the four edges of each kind of contact."""
    return [values[i : i + EDGES] for i in range(0, len(values) - LINKS, EDGES)]


def force_of(found: Constraints, strength: Rows) -> Motion:
    """J^T strength."""
    at_contacts = list(zip(found.points, by_contact(strength), strict=True))
    pushes = [push(at, along) for at, along in at_contacts]
    turns = [
        v.cross(at.point, force) if at.jacobian is None else turn(at.jacobian, along)
        for (at, along), force in zip(at_contacts, pushes, strict=True)
    ]
    joints = [sign * limit for sign, limit in zip(found.signs, strength[-LINKS:], strict=True)]
    for (at, along), force in zip(at_contacts, pushes, strict=True):
        for i, column in enumerate(at.columns):
            if at.jacobian is None:
                joints[i] = v.dot(column, force) + joints[i]
            else:
                by = v.to_vector(row.joints[i] for row in at.jacobian)
                joints[i] = v.dot(by, combined(along)) + joints[i]
    return Motion(
        v.to_vector(v.sum_legs(x) for x in v.add(*pushes)),
        v.to_vector(v.sum_legs(x) for x in v.add(*turns)),
        v.to_vector(joints),
    )


def combined(along: Rows) -> Vector:
    """Of values along a contact's edges those along its normal and tangents."""
    a, b, c, d = along
    return a + b + c + d, a - b, c - d


def push(at: ContactPoint, along: Rows) -> Vector:
    """The force, in the world, of one kind of contact from those along its edges."""
    if at.jacobian is not None:
        first, second, third = (row.linear for row in at.jacobian)
        return v.apply_transposed((first, second, third), combined(along))
    a, b, c, d = along
    return at.friction * (d - c), at.friction * (a - b), a + b + c + d


def turn(jacobian: tuple[Row, Row, Row], along: Rows) -> Vector:
    """The torque about the trunk's origin of one kind of contact from forces along its edges."""
    first, second, third = (row.angular for row in jacobian)
    return v.apply_transposed((first, second, third), combined(along))


def hessian(mass: MassMatrix, found: Constraints, weight: Rows) -> MassMatrix:
    """M + J^T diag(weight) J."""
    matrix = mass
    for at, at_edges in zip(found.points, by_contact(weight), strict=True):
        matrix = stiffened(matrix, at, at_edges)
    legs = [list(row) for row in matrix.legs]
    for i, at_limit in enumerate(weight[-LINKS:]):
        legs[i][i] = legs[i][i] + at_limit
    return matrix._replace(legs=tuple(map(tuple, legs)))


def stiffened(matrix: MassMatrix, at: ContactPoint, weight: Rows) -> MassMatrix:
    """`matrix` + J^T diag(weight) J of one kind of contact."""
    if at.jacobian is not None:
        return stiffened_along(matrix, at.jacobian, weight)
    a, b, c, d = weight
    mu = at.friction
    xx, yy, zz = mu * mu * (c + d), mu * mu * (a + b), a + b + c + d
    xz, yz = mu * (d - c), mu * (a - b)

    def stiff(u: Vector) -> Vector:
        return xx * u[0] + xz * u[2], yy * u[1] + yz * u[2], xz * u[0] + yz * u[1] + zz * u[2]

    px, py, pz = at.point
    o = jnp.zeros_like(px)
    units = ((o + 1.0, o, o), (o, o + 1.0, o), (o, o, o + 1.0))
    turns = ((o, -pz, py), (pz, o, -px), (-py, px, o))  # axis x point
    trunk = [stiff(u) for u in (*units, *turns)]
    columns = [force + v.cross(at.point, force) for force in trunk]
    base = tuple(
        tuple(matrix.base[i][j] + v.sum_legs(columns[j][i]) for j in range(6)) for i in range(6)
    )
    cross, legs = list(matrix.cross), [list(row) for row in matrix.legs]
    for j, force in enumerate(stiff(column) for column in at.columns):
        crossed = force + v.cross(at.point, force)
        cross[j] = tuple(m + x for m, x in zip(cross[j], crossed, strict=True))
        for i, column in enumerate(at.columns):
            legs[i][j] = legs[i][j] + v.dot(column, force)
    return MassMatrix(base, tuple(cross), tuple(map(tuple, legs)))


def stiffened_along(matrix: MassMatrix, jacobian: tuple[Row, Row, Row], weight: Rows) -> MassMatrix:
    """`stiffened` for ground that is not level."""
    a, b, c, d = weight
    # In the contact's frame: what normal and tangents do to each other.
    pairs = ((a + b + c + d, a - b, c - d), (a - b, a + b, 0.0), (c - d, 0.0, c + d))
    first, second, third = ((*row.linear, *row.angular, *row.joints) for row in jacobian)
    columns = [v.to_vector(entries) for entries in zip(first, second, third, strict=True)]
    weighted = [v.apply(pairs, column) for column in columns]

    def entry(i: int, j: int) -> Array:
        return v.dot(columns[i], weighted[j])

    base = tuple(
        tuple(matrix.base[i][j] + v.sum_legs(entry(max(i, j), min(i, j))) for j in range(6))
        for i in range(6)
    )
    number = len(columns) - 6
    cross, legs = list(matrix.cross), [list(row) for row in matrix.legs]
    for j in range(number):
        cross[j] = tuple(m + entry(i, 6 + j) for i, m in enumerate(cross[j]))
        for i in range(number):
            legs[i][j] = legs[i][j] + entry(6 + max(i, j), 6 + min(i, j))
    return MassMatrix(base, tuple(cross), tuple(map(tuple, legs)))
