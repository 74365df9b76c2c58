"""The fast engine: MuJoCo's equations laid out for many quadrupeds at once.

Equations, the solver's problem and the integrator are MuJoCo's; see docs/physics.md. Arrays have
robots last, unless said otherwise.
"""

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.physics import motor
from quadwalk.physics import vectors as v
from quadwalk.physics.batching import batch_robots, make_opaque_true, materialize
from quadwalk.physics.contact import GroundBelow, compute_centers, find_constraints
from quadwalk.physics.model import Model, RobotRandomization, randomize_motor
from quadwalk.physics.model import make_model as make_model
from quadwalk.physics.motor import Effort, PhysicsState, Stepping
from quadwalk.physics.rigid_body import (
    LINKS,
    Link,
    MassMatrix,
    Motion,
    Pose,
    compute_bias_force,
    compute_mass_matrix,
    compute_pose,
    compute_rotation,
    place_bodies,
)
from quadwalk.physics.solver import add_scaled, minimize_cost, solve
from quadwalk.physics.surface import Ground, Spot, compute_contact_frame
from quadwalk.physics.vectors import Array, Vector


def step(
    model: Model, stepping: Stepping, physics: PhysicsState, target: jax.Array
) -> tuple[PhysicsState, Effort]:
    """Advance one robot by a control step; see `Engine`."""
    # Not constants, even where a caller has no JAX arrays.
    physics, target = jax.tree.map(jnp.asarray, (physics, target))

    def step_batch(
        model: Model, physics: PhysicsState, target: jax.Array
    ) -> tuple[PhysicsState, Effort]:
        def advance(state: PhysicsState, torque: jax.Array) -> PhysicsState:
            iterations, line_search = stepping.iterations, stepping.line_search
            qacc = compute_acceleration(model, state, torque, iterations, line_search, stepping.dt)
            return integrate(state, qacc, stepping.dt)

        return motor.run_control_step(model.motor, stepping, physics, target, advance)

    shape: Any = partial(jax.ShapeDtypeStruct, dtype=physics.qpos.dtype)
    like = (PhysicsState(*(shape(x.shape) for x in physics)), Effort(shape((12,)), shape(())))
    return batch_robots(step_batch, like)(model, physics, target)


def apply_randomization(model: Model, randomization: RobotRandomization) -> Model:
    """Return the model of one robot, changed as `randomization` says; see `Engine`."""
    trunk, legs = model.trunk, randomization.link_mass.reshape(4, LINKS)
    links = tuple(
        link._replace(
            mass=link.mass * legs[:, i],
            inertia=tuple(x * legs[:, i] for x in link.inertia),
            damping=link.damping * randomization.damping,
            armature=link.armature * randomization.armature,
        )
        for i, link in enumerate(model.links)
    )
    center = v.add(trunk.center, v.to_vector(randomization.trunk_center))
    return model._replace(
        trunk=trunk._replace(mass=trunk.mass + randomization.trunk_mass, center=center),
        links=links,
        contacts=tuple(
            dataclasses.replace(contact, friction=jnp.broadcast_to(randomization.friction, 4))
            for contact in model.contacts
        ),
        motor=randomize_motor(model.motor, randomization),
    )


def compute_acceleration(
    model: Model,
    state: PhysicsState,
    torque: jax.Array,
    iterations: int,
    line_search: int,
    dt: float = 0.0,
) -> jax.Array:
    """Return MuJoCo's qacc (18, robots) with joint torques (12, robots), Nm.

    With a time step `dt`, s, joint damping is implicit over it, as in MuJoCo's Euler integrator.
    """
    qpos, qvel = state.qpos, state.qvel
    trunk, links, gravity = model.trunk, model.links, model.gravity
    barrier = make_opaque_true(qpos[2, 0])  # greater heights do not reach the next control step
    angles = _split_by_link(qpos[7:])
    pose = _materialize_pose(barrier, links, qpos, angles)
    bodies = materialize(barrier, lambda p: place_bodies(trunk, links, p), pose)
    velocity = _to_motion(pose, qvel)
    mass = materialize(barrier, lambda p, b: compute_mass_matrix(trunk, links, p, b), pose, bodies)
    bias = materialize(
        barrier,
        lambda p, b, u: compute_bias_force(trunk, links, p, b, u, gravity),
        pose,
        bodies,
        velocity,
    )
    joints = v.to_vector(
        t - link.damping * rate - b
        for t, link, rate, b in zip(
            _split_by_link(torque), links, velocity.joints, bias.joints, strict=True
        )
    )
    force = Motion(v.scale(-1.0, bias.linear), v.scale(-1.0, bias.angular), joints)
    ground = model.ground
    constraints = materialize(
        barrier,
        lambda *a: find_constraints(model.contacts, model.limits, *a),
        pose,
        qpos[2],
        angles,
        velocity,
        None if ground is None else _find_ground_below(model, ground, barrier, pose, qpos),
    )
    solution = minimize_cost(mass, constraints, force, barrier, iterations, line_search)
    if dt > 0.0:
        solution = _apply_damping(links, mass, solution, dt, barrier)
    angular = v.apply_transposed(pose.trunk, solution.angular)
    legs = jnp.stack(solution.joints, axis=1).reshape(4 * LINKS, -1)
    return jnp.concatenate([jnp.stack([*solution.linear, *angular]), legs])


def _materialize_pose(
    barrier: jax.Array, links: tuple[Link, ...], qpos: jax.Array, angles: Vector
) -> Pose:
    """Return the pose at `qpos` (19, robots) and joint `angles`, computed by `materialize`."""
    rotation = materialize(barrier, lambda quat: compute_rotation(tuple(quat)), qpos[3:7])
    pose: Pose = materialize(barrier, lambda r, a: compute_pose(links, r, a), rotation, angles)
    return pose


def _apply_damping(
    links: tuple[Link, ...], mass: MassMatrix, motion: Motion, dt: float, barrier: jax.Array
) -> Motion:
    """Return the acceleration that is left of `motion`, an acceleration, by implicit joint damping.

    It is (M + dt D)^-1 M a, with a that acceleration and D the joints' damping. Computed is a - (M
    + dt D)^-1 dt D a, which rounding errors harm least.
    """
    damping = v.to_vector(dt * link.damping for link in links)
    zeros = jax.tree.map(jnp.zeros_like, motion.linear)
    joints = v.to_vector(d * a for d, a in zip(damping, motion.joints, strict=True))
    change = solve(mass.add_to_joints(damping), Motion(zeros, zeros, joints), barrier)
    return add_scaled(motion, -1.0, change)


def _find_ground_below(
    model: Model, ground: Ground, barrier: jax.Array, pose: Pose, qpos: jax.Array
) -> tuple[GroundBelow, ...]:
    """Return the ground below each kind of sphere, where it is not level."""

    def read(centers: tuple[Vector, ...], x: Array, y: Array) -> list[tuple[Spot, Vector]]:
        triangles = []
        for contact, surface, center in zip(model.contacts, ground.offsets, centers, strict=True):
            which = np.reshape(contact.grids, (4, 1)) if any(contact.grids) else 0
            spot = surface.locate(x + center[0], y + center[1], which)
            triangles.append((spot, surface.read(spot)))
        return triangles

    def interpolate(
        triangles: list[tuple[Spot, Vector]], altitudes: tuple[Array, ...]
    ) -> tuple[GroundBelow, ...]:
        below = []
        for surface, (spot, heights), altitude in zip(
            ground.offsets, triangles, altitudes, strict=True
        ):
            level, along, across = surface.interpolate(spot, heights)
            below.append(GroundBelow(altitude - level, *compute_contact_frame(along, across)))
        return tuple(below)

    x, y, height = qpos[:3]
    centers = tuple(compute_centers(contact, pose) for contact in model.contacts)
    # In two parts: XLA would read heights again wherever something that follows from them is used.
    triangles = materialize(barrier, read, centers, x, y)
    altitudes = tuple(height + center[2] for center in centers)
    ground_below: tuple[GroundBelow, ...] = materialize(barrier, interpolate, triangles, altitudes)
    return ground_below


def integrate(state: PhysicsState, acceleration: jax.Array, dt: float) -> PhysicsState:
    """Return the state after MuJoCo's semi-implicit Euler step of `dt`, s.

    `acceleration` is qacc (18, robots). The quaternion is turned exactly.
    """
    qvel = state.qvel + dt * acceleration
    position = state.qpos[:3] + dt * qvel[:3]
    # The turn by dt * angular velocity, as a quaternion, after the trunk's own.
    x, y, z = dt * qvel[3:6]
    angle = jnp.sqrt(x * x + y * y + z * z)
    share = 0.5 * jnp.sinc(angle / (2 * jnp.pi))
    cos = jnp.cos(0.5 * angle)
    x, y, z = share * x, share * y, share * z
    a, b, c, d = state.qpos[3:7]
    parts = (
        a * cos - b * x - c * y - d * z,
        a * x + b * cos + c * z - d * y,
        a * y - b * z + c * cos + d * x,
        a * z + b * y - c * x + d * cos,
    )
    quat = jnp.stack(parts)
    quat = quat / jnp.linalg.norm(quat, axis=0)
    qpos = jnp.concatenate([position, quat, state.qpos[7:] + dt * qvel[6:]])
    return PhysicsState(qpos, qvel)


def compute_lowest_points(model: Model, qpos: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the feet's soles (4, 3), m, and the gaps of all other shapes to the ground (5,), m.

    A function of one robot, to be vmapped; `qpos` is (19,). Soles have x and y in the world, z
    above the ground straight below. The gaps are those of the lowest points of the trunk, then of
    each leg without its foot.

    Not all shapes touch the ground in training: by the gaps it is seen that one would have. Over
    ground that is not level, the gaps are those of the shapes' ends and corners.
    """

    def run_batch(model: Model, qpos: jax.Array) -> tuple[jax.Array, jax.Array]:
        barrier = make_opaque_true(qpos[2, 0])
        pose = _materialize_pose(barrier, model.links, qpos, _split_by_link(qpos[7:]))
        if model.ground is not None:
            return _compute_lowest_points_over(model, model.ground, barrier, pose, qpos)
        feet, height = model.contacts[0], qpos[2]
        x, y, z = compute_centers(feet, pose)
        trunk, legs = jnp.full_like(height, jnp.inf), jnp.full_like(z, jnp.inf)
        for shell in model.shells:
            if shell.link is None:
                trunk = jnp.minimum(trunk, shell.compute_bottom(pose.trunk[2]))
            else:
                bottom = shell.compute_bottom(pose.rotations[shell.link][2])
                legs = jnp.minimum(legs, pose.origins[shell.link][2] + bottom)
        soles = jnp.stack([x, y, z - feet.radius], axis=1) + qpos[:3]
        return soles, height + jnp.concatenate([trunk[None], legs])

    qpos = jnp.asarray(qpos)
    shape = partial(jax.ShapeDtypeStruct, dtype=qpos.dtype)
    return batch_robots(run_batch, (shape((4, 3)), shape((5,))))(model, qpos)


def _compute_lowest_points_over(
    model: Model, ground: Ground, barrier: jax.Array, pose: Pose, qpos: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return soles and gaps as `compute_lowest_points` does, over ground that is not level."""
    x, y, height = qpos[:3]
    along, across, _ = compute_centers(model.contacts[0], pose)
    feet = _find_ground_below(model, ground, barrier, pose, qpos)[0]
    trunk, legs = jnp.full_like(height, jnp.inf), jnp.full_like(along, jnp.inf)
    for shell in model.shells:
        rotation = pose.trunk if shell.link is None else pose.rotations[shell.link]
        for exists, point in shell.find_low_points(rotation[2]):
            place = v.apply(rotation, point)
            if shell.link is not None:
                place = v.add(place, pose.origins[shell.link])
            level = ground.surface.measure(x + place[0], y + place[1])[0]
            gap = jnp.where(exists, height + place[2] - level, jnp.inf)
            if shell.link is None:
                trunk = jnp.minimum(trunk, gap)
            else:
                legs = jnp.minimum(legs, gap)
    soles = jnp.stack([x + along, y + across, jnp.asarray(feet.above)], axis=1)
    return soles, jnp.concatenate([trunk[None], legs])


def compute_leg_points(model: Model, joints: jax.Array) -> jax.Array:
    """Return the centers of the spheres of thighs and calves (n, 4, 3), m, in the trunk's frame.

    A function of one robot, to be vmapped; `joints` is (12,), rad. The feet come first, then knees
    if they may touch the ground.
    """
    spheres = [contact for contact in model.contacts if contact.link]

    def run_batch(model: Model, joints: jax.Array) -> jax.Array:
        one, zero = jnp.ones_like(joints[0]), jnp.zeros_like(joints[0])
        upright = compute_rotation((one, zero, zero, zero))
        pose = compute_pose(model.links, upright, _split_by_link(joints))
        centers = [compute_centers(c, pose) for c in model.contacts if c.link]
        return jnp.stack([jnp.stack(center, axis=1) for center in centers])

    joints = jnp.asarray(joints)
    shape = jax.ShapeDtypeStruct((len(spheres), 4, 3), joints.dtype)
    return batch_robots(run_batch, shape)(model, joints)


def _split_by_link(joints: jax.Array) -> Vector:
    """Split values of all joints (12, robots) into hips, thighs and calves, (4, robots) each."""
    legs = joints.reshape(4, LINKS, -1)
    return legs[:, 0], legs[:, 1], legs[:, 2]


def _to_motion(pose: Pose, values: jax.Array) -> Motion:
    """Return MuJoCo's velocity or acceleration (18, robots), angular in trunk axes, as `Motion`."""
    angular = v.to_vector(values[3:6])
    joints = _split_by_link(values[6:])
    return Motion(v.to_vector(values[:3]), v.apply(pose.trunk, angular), joints)
