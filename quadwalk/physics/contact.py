"""Contacts with the ground and joint limits: the rows of MuJoCo's soft constraints.

The constraints are MuJoCo's (https://mujoco.readthedocs.io/en/stable/computation, "Constraint
model"): pyramidal friction cones, four edges to a contact, and one row for a joint beyond its
limit. Spheres alone touch the ground, of each kind one to a leg: feet, or also knees, the trunk's
corners and hips. A contact is moved by the trunk and its own leg's joints alone, so the Hessian has
the mass matrix's arrow shape.

Vectors are in world axes, points relative to the trunk's origin.
"""

from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from quadwalk.physics import vectors as v
from quadwalk.physics.rigid_body import LINKS, MassMatrix, Motion, Pose
from quadwalk.physics.vectors import Array, Vector

# One value for each constraint, arrays (4, robots): four edges of each kind of contact, three
# limits.
Rows: TypeAlias = tuple[Array, ...]
EDGES = 4


class SolverParams(NamedTuple):
    """Stiffness and impedance of a kind of constraint, (4,) over legs, from solref and solimp."""

    stiffness: Array  # of the reference acceleration, 1/s^2
    damping: Array  # of the reference acceleration, 1/s
    low: Array  # impedance where the constraint is just violated
    high: Array  # impedance from `width` on
    width: Array  # m or rad
    middle: Array
    power: Array
    # MuJoCo's estimate (invweight0), of translation at a contact or of a joint, 1/kg or 1/(kg m^2),
    # which follows from all masses, inertias and armatures of the robot.
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


class Row(NamedTuple):
    """One row of a contact's Jacobian: its product with a velocity is that in one direction.

    The velocity is that of the contact point, by the trunk and by the joints of its leg.
    """

    linear: Vector  # the trunk's linear velocity; this is the direction itself
    angular: Vector  # the trunk's angular velocity
    joints: tuple[Array, ...]  # the joints of its leg


class ContactPoint(NamedTuple):
    """The point in which one kind of sphere touches the ground, or is nearest to it."""

    place: Vector  # m
    columns: tuple[Vector, ...]  # velocity of that point by each of the leg's joints that move it
    friction: Array
    # Of ground that is not level, the contact's Jacobian: velocity along its normal and along its
    # tangents times friction. None: the normal is world z, the tangents y and -x.
    jacobian: tuple[Row, Row, Row] | None = None


class GroundBelow(NamedTuple):
    """The ground under one kind of sphere, over legs."""

    above: Array  # m, straight down, from the sphere to where it would touch the ground
    normal: Vector
    first: Vector  # tangent
    second: Vector  # tangent


class Constraints(NamedTuple):
    """The constraints at one state; an inactive constraint row has weight 0."""

    points: tuple[ContactPoint, ...]
    signs: Vector  # direction of each joint limit, +1 at the lower one
    reference: Rows  # MuJoCo's reference acceleration
    weight: Rows  # MuJoCo's D


def compute_impedance(
    params: SolverParams, inverse_inertia: Array, depth: Array
) -> tuple[Array, Array]:
    """Return impedance and weight of a constraint row violated by `depth` < 0, m or rad."""
    x = jnp.minimum(jnp.abs(depth) / params.width, 1.0)
    below = x**params.power / params.middle ** (params.power - 1)
    above = 1 - (1 - x) ** params.power / (1 - params.middle) ** (params.power - 1)
    share = jnp.where(x < params.middle, below, above)
    value = params.low + share * (params.high - params.low)
    return value, value / ((1 - value) * inverse_inertia)


def compute_centers(contact: Contact, pose: Pose) -> Vector:
    """Return the centers of one kind of sphere, m, from the trunk's origin, in world axes."""
    if contact.link is None:
        return v.apply(pose.trunk, contact.center)
    rotation, origin = pose.rotations[contact.link], pose.origins[contact.link]
    return v.add(origin, v.apply(rotation, contact.center))


def find_constraints(
    contacts: tuple[Contact, ...],
    limits: tuple[Limits, ...],
    pose: Pose,
    height: Array,
    angles: Vector,
    velocity: Motion,
    ground: tuple[GroundBelow, ...] | None = None,
) -> Constraints:
    """Return the constraints with the trunk's origin at `height` (robots,), m.

    `angles` are those of hip, thigh and calf joints, (4, robots) each, rad. `ground` is that under
    each kind of sphere; None: it is level, at height 0.
    """
    points: list[ContactPoint] = []
    signs: list[Array] = []
    reference: list[Array] = []
    weights: list[Array] = []
    for index, contact in enumerate(contacts):
        under = None if ground is None else ground[index]
        point, accelerations, weight = _constrain_contact(contact, pose, height, velocity, under)
        points.append(point)
        reference += accelerations
        weights += [weight] * EDGES
    for limit, angle, rate in zip(limits, angles, velocity.joints, strict=True):
        sign, acceleration, weight = _constrain_joint(limit, angle, rate)
        signs.append(sign)
        reference.append(acceleration)
        weights.append(weight)
    return Constraints(tuple(points), v.to_vector(signs), tuple(reference), tuple(weights))


def _constrain_contact(
    contact: Contact, pose: Pose, height: Array, velocity: Motion, under: GroundBelow | None
) -> tuple[ContactPoint, list[Array], Array]:
    """Return the point of a kind of contact, its edges' reference accelerations and weight."""
    gap, place = _find_point(contact, compute_centers(contact, pose), height, under)
    moving = 0 if contact.link is None else contact.link + 1
    columns = tuple(
        v.cross(axis, v.subtract(place, origin))
        for axis, origin in zip(pose.axes[:moving], pose.origins[:moving], strict=True)
    )
    point = ContactPoint(place, columns, contact.friction)
    if under is not None:
        point = point._replace(jacobian=_make_jacobian(point, under))
    params, mu = contact.params, contact.friction
    # The inverse inertia is that of an edge of MuJoCo's pyramid.
    edge_inertia = params.inverse_inertia * (1 + mu**2) * 2 * mu**2
    share, weight = compute_impedance(params, edge_inertia, gap)
    inside = gap < 0
    accelerations: list[Array] = [
        jnp.where(inside, -params.damping * rate - params.stiffness * share * gap, 0.0)
        for rate in project_on_edges(point, velocity)
    ]
    return point, accelerations, jnp.where(inside, weight, 0.0)


def _find_point(
    contact: Contact, center: Vector, height: Array, under: GroundBelow | None
) -> tuple[Array, Vector]:
    """Return the gap between spheres and ground, m, negative inside it, and the contact points."""
    radius = contact.radius
    if under is None:
        gap = height + center[2] - radius
        return gap, (center[0], center[1], center[2] - radius - 0.5 * gap)
    gap = under.above * under.normal[2]
    return gap, v.subtract(center, v.scale(radius + 0.5 * gap, under.normal))


def _make_jacobian(point: ContactPoint, under: GroundBelow) -> tuple[Row, Row, Row]:
    """Return the Jacobian of a contact with ground that is not level."""

    def make_row(axis: Vector) -> Row:
        return Row(axis, v.cross(point.place, axis), tuple(v.dot(axis, c) for c in point.columns))

    tangents = (v.scale(point.friction, tangent) for tangent in (under.first, under.second))
    first, second = map(make_row, tangents)
    return make_row(under.normal), first, second


def _constrain_joint(limit: Limits, angle: Array, rate: Array) -> tuple[Array, Array, Array]:
    """Return a joint limit's sign, reference acceleration and weight."""
    from_lower, from_upper = angle - limit.lower, limit.upper - angle
    gap = jnp.minimum(from_lower, from_upper)
    sign = jnp.where(from_lower < from_upper, 1.0, -1.0)
    params = limit.params
    share, weight = compute_impedance(params, params.inverse_inertia, gap)
    beyond = gap < 0
    acceleration = -params.damping * sign * rate - params.stiffness * share * gap
    return sign, jnp.where(beyond, acceleration, 0.0), jnp.where(beyond, weight, 0.0)


def project_on_edges(point: ContactPoint, motion: Motion) -> Rows:
    """Return the parts of `motion` along the edges of friction pyramids, at contact points.

    They are the products of the four rows of each point's Jacobian with `motion`: four arrays (4
    legs, robots).
    """
    if point.jacobian is not None:
        up, first, second = (_apply_row(row, motion) for row in point.jacobian)
        return up + first, up - first, up + second, up - second
    at_trunk = v.add(motion.linear, v.cross(motion.angular, point.place))
    by_joints = (v.scale(motion.joints[i], column) for i, column in enumerate(point.columns))
    x, y, z = v.add(at_trunk, *by_joints)
    x, y = point.friction * x, point.friction * y
    return z + y, z - y, z - x, z + x


def _apply_row(row: Row, motion: Motion) -> Array:
    """Return the product of one row of contacts' Jacobians with `motion`, (4 legs, robots)."""
    total = v.dot(row.linear, motion.linear) + v.dot(row.angular, motion.angular)
    return sum((a * b for a, b in zip(row.joints, motion.joints, strict=False)), start=total)


def apply_jacobian(constraints: Constraints, motion: Motion) -> Rows:
    """Return J motion, with J the Jacobian of all constraints: edges, then joint limits."""
    at_limits = (sign * rate for sign, rate in zip(constraints.signs, motion.joints, strict=True))
    at_floor = (row for point in constraints.points for row in project_on_edges(point, motion))
    return (*at_floor, *at_limits)


def apply_jacobian_transposed(constraints: Constraints, strength: Rows) -> Motion:
    """Return J^T strength, the force of all constraints."""
    forces, torques = [], []
    at_limits = zip(constraints.signs, strength[-LINKS:], strict=True)
    joints = [sign * limit for sign, limit in at_limits]
    for point, edges in zip(constraints.points, _split_by_contact(strength), strict=True):
        force, torque, joint_torques = _push(point, edges)
        forces.append(force)
        torques.append(torque)
        for i, joint_torque in enumerate(joint_torques):
            joints[i] = joint_torque + joints[i]
    return Motion(
        v.to_vector(v.sum_legs(x) for x in v.add(*forces)),
        v.to_vector(v.sum_legs(x) for x in v.add(*torques)),
        v.to_vector(joints),
    )


def _push(point: ContactPoint, edges: Rows) -> tuple[Vector, Vector, list[Array]]:
    """Return force, torque about the trunk's origin and joint torques that push along `edges`.

    `edges` are four forces, one along each edge of the friction pyramids of one kind of sphere.
    """
    a, b, c, d = edges
    if point.jacobian is None:
        mu = point.friction
        force = mu * (d - c), mu * (a - b), a + b + c + d
        torque = v.cross(point.place, force)
        return force, torque, [v.dot(column, force) for column in point.columns]
    along = a + b + c + d, a - b, c - d  # the normal and the tangents
    first, second, third = point.jacobian
    force = v.apply_transposed((first.linear, second.linear, third.linear), along)
    torque = v.apply_transposed((first.angular, second.angular, third.angular), along)
    columns = zip(first.joints, second.joints, third.joints, strict=True)
    return force, torque, [v.dot(column, along) for column in columns]


def _split_by_contact(values: Rows) -> list[Rows]:
    """Return the rows of each kind of sphere, four edges each, without the joint limits."""
    return [values[i : i + EDGES] for i in range(0, len(values) - LINKS, EDGES)]


def compute_hessian(mass: MassMatrix, constraints: Constraints, weight: Rows) -> MassMatrix:
    """Return M + J^T diag(weight) J."""
    matrix = mass
    for point, edges in zip(constraints.points, _split_by_contact(weight), strict=True):
        if point.jacobian is None:
            matrix = _add_stiffness(matrix, point, edges)
        else:
            matrix = _add_stiffness_along(matrix, point.jacobian, edges)
    return matrix.add_to_joints(v.to_vector(weight[-LINKS:]))


def _add_stiffness(matrix: MassMatrix, point: ContactPoint, weight: Rows) -> MassMatrix:
    """Return `matrix` + J^T diag(weight) J of one kind of contact with level ground."""
    a, b, c, d = weight
    mu = point.friction
    xx, yy, zz = mu * mu * (c + d), mu * mu * (a + b), a + b + c + d
    xz, yz = mu * (d - c), mu * (a - b)

    def resist(u: Vector) -> Vector:
        return xx * u[0] + xz * u[2], yy * u[1] + yz * u[2], xz * u[0] + yz * u[1] + zz * u[2]

    px, py, pz = point.place
    o = jnp.zeros_like(px)
    units = ((o + 1.0, o, o), (o, o + 1.0, o), (o, o, o + 1.0))
    turns = ((o, -pz, py), (pz, o, -px), (-py, px, o))  # axis x point
    trunk = [resist(u) for u in (*units, *turns)]
    columns = [force + v.cross(point.place, force) for force in trunk]
    base = tuple(
        tuple(matrix.base[i][j] + v.sum_legs(columns[j][i]) for j in range(6)) for i in range(6)
    )
    cross, legs = list(matrix.cross), [list(row) for row in matrix.legs]
    for j, force in enumerate(resist(column) for column in point.columns):
        coupling = force + v.cross(point.place, force)
        cross[j] = tuple(m + x for m, x in zip(cross[j], coupling, strict=True))
        for i, column in enumerate(point.columns):
            legs[i][j] = legs[i][j] + v.dot(column, force)
    return MassMatrix(base, tuple(cross), tuple(map(tuple, legs)))


def _add_stiffness_along(
    matrix: MassMatrix, jacobian: tuple[Row, Row, Row], weight: Rows
) -> MassMatrix:
    """Return `matrix` + J^T diag(weight) J of one kind of contact with ground of any slope."""
    a, b, c, d = weight
    # J^T diag(weight) J in the contact's own frame: normal, first and second tangent.
    pairs = ((a + b + c + d, a - b, c - d), (a - b, a + b, 0.0), (c - d, 0.0, c + d))
    first, second, third = ((*row.linear, *row.angular, *row.joints) for row in jacobian)
    columns = [v.to_vector(entries) for entries in zip(first, second, third, strict=True)]
    weighted = [v.apply(pairs, column) for column in columns]

    def compute_entry(i: int, j: int) -> Array:
        return v.dot(columns[i], weighted[j])

    base = tuple(
        tuple(matrix.base[i][j] + v.sum_legs(compute_entry(max(i, j), min(i, j))) for j in range(6))
        for i in range(6)
    )
    cross, legs = list(matrix.cross), [list(row) for row in matrix.legs]
    moving = range(len(columns) - 6)
    for j in moving:
        cross[j] = tuple(m + compute_entry(i, 6 + j) for i, m in enumerate(cross[j]))
        for i in moving:
            legs[i][j] = legs[i][j] + compute_entry(6 + max(i, j), 6 + min(i, j))
    return MassMatrix(base, tuple(cross), tuple(map(tuple, legs)))
