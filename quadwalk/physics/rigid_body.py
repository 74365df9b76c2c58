"""Rigid-body dynamics of a floating trunk with four legs of three hinges each.

The equations are those of MuJoCo (composite rigid bodies for the mass matrix, recursive
Newton-Euler for the bias forces: Featherstone 2008, Rigid Body Dynamics Algorithms), with what all
quadrupeds share taken for granted, so that four legs and thousands of robots are computed
side by side. An array is (4, robots) for a quantity of the legs, (robots,) for one of the trunk.

Everything is in world axes about the trunk's origin. A generalized vector is `Motion`: the trunk's
linear and angular part, then the joints'. MuJoCo's own has the angular part in trunk axes.
"""

import operator
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from quadwalk.physics import vectors as v
from quadwalk.physics.vectors import Array, Matrix, Vector

LINKS = 3  # of a leg: hip, thigh, calf

Inertia: TypeAlias = tuple[Array, ...]  # a symmetric 3x3 matrix: xx yy zz xy xz yz


class Link(NamedTuple):
    """Constants of one link of each leg, (4,) over legs; frames of the link and its parent."""

    offset: Vector  # of the link's origin from its parent's, parent frame, m
    axis: Vector  # of its joint, parent frame
    turn: tuple[Matrix, Matrix, Matrix]  # its rotation in the parent is [0] + cos [1] + sin [2]
    mass: Array  # kg
    center: Vector  # of mass, link frame, m
    inertia: Inertia  # about the center, link frame, kg m^2
    armature: Array  # kg m^2
    damping: Array  # N m s/rad


class Trunk(NamedTuple):
    """Constants of the trunk, scalars, in its frame, as a link's."""

    mass: Array
    center: Vector
    inertia: Inertia


class Motion(NamedTuple):
    """A velocity, acceleration or force of the whole robot."""

    linear: Vector  # of the trunk's origin, arrays (robots,)
    angular: Vector  # of the trunk, world axes
    joints: Vector  # hip, thigh, calf, arrays (4, robots)


class Pose(NamedTuple):
    """Rotations and positions in world axes, relative to the trunk's origin."""

    trunk: Matrix  # rotation
    rotations: tuple[Matrix, ...]  # of the links
    origins: tuple[Vector, ...]  # of the links: their joints are there
    axes: tuple[Vector, ...]  # unit vectors of the joints


class Composite(NamedTuple):
    """Mass, first and second moments of mass about the trunk's origin."""

    mass: Array
    moment: Vector  # mass * center
    inertia: Inertia


class MassMatrix(NamedTuple):
    """The symmetric joint-space inertia: an arrow, as legs only meet at the trunk."""

    base: tuple[tuple[Array, ...], ...]  # 6 x 6, arrays (robots,)
    cross: tuple[tuple[Array, ...], ...]  # a column of 6 for each joint, arrays (4, robots)
    legs: tuple[tuple[Array, ...], ...]  # 3 x 3, arrays (4, robots)

    def add_to_joints(self, values: Vector) -> "MassMatrix":
        """Return the matrix with `values` added to the diagonal of hip, thigh and calf joints."""
        legs = [list(row) for row in self.legs]
        for i, value in enumerate(values):
            legs[i][i] = legs[i][i] + value
        return self._replace(legs=tuple(map(tuple, legs)))


def compute_rotation(quat: tuple[Array, ...]) -> Matrix:
    """Return the rotation matrix of a quaternion wxyz, which need not have length 1."""
    w, x, y, z = quat
    n = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        (1 - n * (y * y + z * z), n * (x * y - w * z), n * (x * z + w * y)),
        (n * (x * y + w * z), 1 - n * (x * x + z * z), n * (y * z - w * x)),
        (n * (x * z - w * y), n * (y * z + w * x), 1 - n * (x * x + y * y)),
    )


def compute_pose(links: tuple[Link, ...], trunk: Matrix, angles: Vector) -> Pose:
    """Return the pose of all links, for a rotation of the trunk and joint angles.

    `angles` are those of hips, thighs and calves, (4, robots) each, rad.
    """
    rotation, origin = trunk, None
    rotations, origins, axes = [], [], []
    for link, angle in zip(links, angles, strict=True):
        cos, sin = jnp.cos(angle), jnp.sin(angle)
        fixed, with_cos, with_sin = link.turn
        x, y, z = (
            v.to_vector(fixed[i][j] + cos * with_cos[i][j] + sin * with_sin[i][j] for j in range(3))
            for i in range(3)
        )
        step = v.apply(rotation, link.offset)
        origin = step if origin is None else v.add(origin, step)
        axes.append(v.apply(rotation, link.axis))
        rotation = v.multiply(rotation, (x, y, z))
        rotations.append(rotation)
        origins.append(origin)
    return Pose(trunk, tuple(rotations), tuple(origins), tuple(axes))


def rotate_inertia(rotation: Matrix, inertia: Inertia) -> Inertia:
    """Return R I R^T, of a rotation R and an inertia I."""
    xx, yy, zz, xy, xz, yz = inertia
    half = v.multiply(rotation, ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    return tuple(v.dot(half[i], rotation[j]) for i, j in pairs)


def make_composite(mass: Array, center: Vector, inertia: Inertia) -> Composite:
    """Return mass and moments of one body about the trunk's origin.

    `center`, m, is its center of mass relative to the trunk's origin; `inertia` is about that
    center.
    """
    moment = v.scale(mass, center)
    (x, y, z), (mx, my, mz) = center, moment
    shift = (y * my + z * mz, x * mx + z * mz, x * mx + y * my, -x * my, -x * mz, -y * mz)
    return Composite(mass, moment, tuple(a + b for a, b in zip(inertia, shift, strict=True)))


def apply_inertia(inertia: Inertia, a: Vector) -> Vector:
    """Return I a."""
    xx, yy, zz, xy, xz, yz = inertia
    return v.apply(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)), a)


class Bodies(NamedTuple):
    """Centers of mass and inertias in world axes; centers are relative to the trunk's origin."""

    centers: tuple[Vector, ...]  # links
    inertias: tuple[Inertia, ...]  # links, about their centers
    trunk_center: Vector
    trunk_inertia: Inertia


def place_bodies(trunk: Trunk, links: tuple[Link, ...], pose: Pose) -> Bodies:
    """Return centers of mass and inertias at a pose."""
    return Bodies(
        tuple(
            v.add(origin, v.apply(rotation, link.center))
            for link, rotation, origin in zip(links, pose.rotations, pose.origins, strict=True)
        ),
        tuple(map(rotate_inertia, pose.rotations, [link.inertia for link in links])),
        v.apply(pose.trunk, trunk.center),
        rotate_inertia(pose.trunk, trunk.inertia),
    )


def compute_mass_matrix(
    trunk: Trunk, links: tuple[Link, ...], pose: Pose, bodies: Bodies
) -> MassMatrix:
    """Return the joint-space inertia of trunk and legs, by the composite-rigid-body algorithm.

    The diagonal of the joints includes their armature.
    """
    below: Composite | None = None
    columns: list[tuple[Array, ...]] = []  # hip, thigh, calf: force then torque on the trunk
    legs: list[list[Array]] = [[0.0] * LINKS for _ in range(LINKS)]
    for i in reversed(range(LINKS)):
        link = links[i]
        body = make_composite(link.mass, bodies.centers[i], bodies.inertias[i])
        below = body if below is None else jax.tree.map(operator.add, body, below)
        axis, origin = pose.axes[i], pose.origins[i]
        # Turning at unit speed about the joint, as motion of the trunk's origin.
        sweep = v.cross(origin, axis)
        force = v.add(v.scale(below.mass, sweep), v.cross(axis, below.moment))
        torque = v.add(apply_inertia(below.inertia, axis), v.cross(below.moment, sweep))
        columns.insert(0, force + torque)
        for j in range(i + 1):
            outer, at = pose.axes[j], pose.origins[j]
            legs[i][j] = legs[j][i] = v.dot(outer, v.subtract(torque, v.cross(at, force)))
        legs[i][i] = legs[i][i] + link.armature
    assert below is not None
    robot = jax.tree.map(
        operator.add,
        make_composite(trunk.mass, bodies.trunk_center, bodies.trunk_inertia),
        jax.tree.map(v.sum_legs, below),
    )
    mass, (x, y, z), (xx, yy, zz, xy, xz, yz) = robot
    o = jnp.zeros_like(x)
    mass = mass + o
    base = (
        (mass, o, o, o, z, -y),
        (o, mass, o, -z, o, x),
        (o, o, mass, y, -x, o),
        (o, -z, y, xx, xy, xz),
        (z, o, -x, xy, yy, yz),
        (-y, x, o, xz, yz, zz),
    )
    return MassMatrix(base, tuple(columns), tuple(tuple(row) for row in legs))


def compute_bias_force(
    trunk: Trunk,
    links: tuple[Link, ...],
    pose: Pose,
    bodies: Bodies,
    velocity: Motion,
    gravity: Vector,
) -> Motion:
    """Return the force at which no coordinate accelerates, by recursive Newton-Euler.

    It balances Coriolis, centrifugal and gravitational forces; `gravity` is in m/s^2.
    """
    spin = velocity.angular
    forces = _compute_link_forces(links, pose, bodies, velocity, gravity)
    joints: list[Array] = []
    force, torque = forces[-1]
    for i in reversed(range(LINKS)):
        if i < LINKS - 1:
            force, torque = v.add(force, forces[i][0]), v.add(torque, forces[i][1])
        about = v.subtract(torque, v.cross(pose.origins[i], force))
        joints.insert(0, v.dot(pose.axes[i], about))
    center, inertia = bodies.trunk_center, bodies.trunk_inertia
    trunk_force = v.scale(trunk.mass, v.subtract(v.cross(spin, v.cross(spin, center)), gravity))
    trunk_torque = v.add(v.cross(spin, apply_inertia(inertia, spin)), v.cross(center, trunk_force))
    return Motion(
        v.add(trunk_force, v.to_vector(v.sum_legs(x) for x in force)),
        v.add(trunk_torque, v.to_vector(v.sum_legs(x) for x in torque)),
        v.to_vector(joints),
    )


def _compute_link_forces(
    links: tuple[Link, ...], pose: Pose, bodies: Bodies, velocity: Motion, gravity: Vector
) -> list[tuple[Vector, Vector]]:
    """Return the force on each link, and the torque about the trunk's origin.

    Velocities and accelerations go down the leg, from the trunk, whose acceleration is 0.
    """
    spin = velocity.angular
    spin_rate: Vector | None = None
    parent: Vector | None = None
    acceleration: Vector | None = None  # of the joint's place
    forces: list[tuple[Vector, Vector]] = []
    for i, link in enumerate(links):
        origin, axis = pose.origins[i], pose.axes[i]
        arm = origin if parent is None else v.subtract(origin, parent)
        centripetal = v.cross(spin, v.cross(spin, arm))
        if spin_rate is None or acceleration is None:
            acceleration = centripetal
        else:
            acceleration = v.add(acceleration, v.cross(spin_rate, arm), centripetal)
        rate = v.scale(velocity.joints[i], axis)
        change = v.cross(spin, rate)
        spin_rate = change if spin_rate is None else v.add(spin_rate, change)
        spin, parent = v.add(spin, rate), origin
        center, inertia = bodies.centers[i], bodies.inertias[i]
        arm = v.subtract(center, origin)
        centripetal = v.cross(spin, v.cross(spin, arm))
        of_center = v.add(acceleration, v.cross(spin_rate, arm), centripetal)
        force = v.scale(link.mass, v.subtract(of_center, gravity))
        gyroscopic = v.cross(spin, apply_inertia(inertia, spin))
        torque = v.add(apply_inertia(inertia, spin_rate), gyroscopic)
        forces.append((force, v.add(torque, v.cross(center, force))))
    return forces
