"""The fast engine: MuJoCo's equations laid out for many quadrupeds at once.

Equations, solver's problem and integrator are MuJoCo's; see docs/physics.md.
"""

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from quadwalk.physics import motor
from quadwalk.physics import vectors as v
from quadwalk.physics.batching import batch_robots, materialize, opaque_true
from quadwalk.physics.contact import (
    Under,
    centers,
    find_constraints,
    look_under,
    triangles_under,
)
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
from quadwalk.physics.surface import Ground
from quadwalk.physics.vectors import Vector


def step(
    model: Model, stepping: Stepping, physics: PhysicsState, target: jax.Array
) -> tuple[PhysicsState, Effort]:
    """One control step; `target` (12,) or (substeps, 12), rad. To be vmapped over robots."""
    # Not constants, even where a caller has no JAX arrays.
    physics, target = jax.tree.map(jnp.asarray, (physics, target))

    def of_many(
        model: Model, physics: PhysicsState, target: jax.Array
    ) -> tuple[PhysicsState, Effort]:
        def advance(state: PhysicsState, torque: jax.Array) -> PhysicsState:
            iterations, line_search = stepping.iterations, stepping.line_search
            qacc = compute_acceleration(model, state, torque, iterations, line_search, stepping.dt)
            return integrate(state, qacc, stepping.dt)

        return motor.run_control_step(model.motor, stepping, physics, target, advance)

    shape: Any = partial(jax.ShapeDtypeStruct, dtype=physics.qpos.dtype)
    like = (PhysicsState(*(shape(x.shape) for x in physics)), Effort(shape((12,)), shape(())))
    return batch_robots(of_many, like)(model, physics, target)


def apply_randomization(model: Model, variation: RobotRandomization) -> Model:
    """The constants of one robot that differs by `variation` from that of `model`."""
    trunk, legs = model.trunk, variation.link_mass.reshape(4, LINKS)
    links = tuple(
        link._replace(
            mass=link.mass * legs[:, i],
            inertia=tuple(x * legs[:, i] for x in link.inertia),
            damping=link.damping * variation.damping,
            armature=link.armature * variation.armature,
        )
        for i, link in enumerate(model.links)
    )
    x, y, z = variation.trunk_center
    return model._replace(
        trunk=trunk._replace(
            mass=trunk.mass + variation.trunk_mass, center=v.add(trunk.center, (x, y, z))
        ),
        links=links,
        contacts=tuple(
            dataclasses.replace(contact, friction=jnp.broadcast_to(variation.friction, 4))
            for contact in model.contacts
        ),
        motor=randomize_motor(model.motor, variation),
    )


def compute_acceleration(
    model: Model,
    state: PhysicsState,
    torque: jax.Array,
    iterations: int,
    line_search: int,
    dt: float = 0.0,
) -> jax.Array:
    """Return MuJoCo's qacc (18, robots) with joint torques (12, robots), Nm; see `batch_robots`.

    With a time step `dt`, s, joint damping is implicit over it, as in MuJoCo's Euler integrator.
    """
    qpos, qvel = state.qpos, state.qvel
    trunk, links, gravity = model.trunk, model.links, model.gravity
    barrier = opaque_true(qpos[2, 0])  # heights beyond are not let into the next control step
    rotation = materialize(barrier, lambda quat: compute_rotation(tuple(quat)), qpos[3:7])
    angles = _by_link(qpos[7:])
    pose = materialize(barrier, lambda r, a: compute_pose(links, r, a), rotation, angles)
    bodies = materialize(barrier, lambda p: place_bodies(trunk, links, p), pose)
    velocity = _motion(pose, qvel)
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
            _by_link(torque), links, velocity.joints, bias.joints, strict=True
        )
    )
    force = Motion(v.scale(-1.0, bias.linear), v.scale(-1.0, bias.angular), joints)
    found = materialize(
        barrier,
        lambda *a: find_constraints(model.contacts, model.limits, *a),
        pose,
        qpos[2],
        angles,
        velocity,
        None if model.ground is None else _look_under(model, model.ground, barrier, pose, qpos),
    )
    solution = minimize_cost(mass, found, force, barrier, iterations, line_search)
    if dt > 0.0:
        solution = _damp_implicitly(links, mass, solution, dt, barrier)
    angular = v.apply_transposed(pose.trunk, solution.angular)
    legs = jnp.stack(solution.joints, axis=1).reshape(4 * LINKS, -1)
    return jnp.concatenate([jnp.stack([*solution.linear, *angular]), legs])


def _damp_implicitly(
    links: tuple[Link, ...], mass: MassMatrix, motion: Motion, dt: float, barrier: jax.Array
) -> Motion:
    """Return (M + dt D)^-1 M a for an acceleration a, `motion`, with D the joints' damping.

    It is computed as a - (M + dt D)^-1 dt D a, which rounding errors harm least.
    """
    damping = [dt * link.damping for link in links]
    legs = [list(row) for row in mass.legs]
    for i, joint in enumerate(damping):
        legs[i][i] = legs[i][i] + joint
    damped = mass._replace(legs=tuple(map(tuple, legs)))
    nothing = jax.tree.map(jnp.zeros_like, motion.linear)
    joints = v.to_vector(d * a for d, a in zip(damping, motion.joints, strict=True))
    change = solve(damped, Motion(nothing, nothing, joints), barrier)
    return add_scaled(motion, -1.0, change)


def _look_under(
    model: Model, ground: Ground, barrier: jax.Array, pose: Pose, qpos: jax.Array
) -> tuple[Under, ...]:
    """The ground under all spheres."""
    x, y, height = qpos[:3]
    at = tuple(centers(contact, pose) for contact in model.contacts)
    # In two parts: XLA would read heights again wherever something that follows from them is used.
    found = materialize(
        barrier,
        lambda at, x, y: tuple(
            triangles_under(contact, surface, center, (x, y))
            for contact, surface, center in zip(model.contacts, ground.offsets, at, strict=True)
        ),
        at,
        x,
        y,
    )
    return materialize(
        barrier,
        lambda found, altitudes: tuple(
            look_under(surface, spot, around, altitude)
            for surface, (spot, around), altitude in zip(
                ground.offsets, found, altitudes, strict=True
            )
        ),
        found,
        tuple(height + center[2] for center in at),
    )


def integrate(state: PhysicsState, acceleration: jax.Array, dt: float) -> PhysicsState:
    """MuJoCo's semi-implicit Euler step, arrays with robots last."""
    qvel = state.qvel + dt * acceleration
    position = state.qpos[:3] + dt * qvel[:3]
    # The turn of dt * spin, as a quaternion, after the trunk's own.
    x, y, z = dt * qvel[3:6]
    angle = jnp.sqrt(x * x + y * y + z * z)
    share = 0.5 * jnp.sinc(angle / (2 * jnp.pi))
    cos = jnp.cos(0.5 * angle)
    x, y, z = share * x, share * y, share * z
    a, b, c, d = state.qpos[3:7]
    turned = (
        a * cos - b * x - c * y - d * z,
        a * x + b * cos + c * z - d * y,
        a * y - b * z + c * cos + d * x,
        a * z + b * y - c * x + d * cos,
    )
    quat = jnp.stack(turned)
    quat = quat / jnp.linalg.norm(quat, axis=0)
    qpos = jnp.concatenate([position, quat, state.qpos[7:] + dt * qvel[6:]])
    return PhysicsState(qpos, qvel)


def compute_lowest_points(model: Model, qpos: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The feet's soles (4, 3), m, and how far the lowest of all else (5,) is above the ground, m.

    That is of the trunk, then of each leg but its foot. Soles have x and y in the world, z above
    the ground straight below. To be vmapped over robots; `qpos` is (19,).

    Not all shapes touch the ground in training, so this is how it knows that one would have. Of
    other shapes over ground that is not level, ends and corners are looked at.
    """

    def of_many(model: Model, qpos: jax.Array) -> tuple[jax.Array, jax.Array]:
        barrier = opaque_true(qpos[2, 0])
        rotation = materialize(barrier, lambda quat: compute_rotation(tuple(quat)), qpos[3:7])
        angles = _by_link(qpos[7:])
        pose = materialize(barrier, lambda r, a: compute_pose(model.links, r, a), rotation, angles)
        if model.ground is not None:
            return _lowest_points_over(model, model.ground, barrier, pose, qpos)
        feet, height = model.contacts[0], qpos[2]
        x, y, z = centers(feet, pose)
        trunk, legs = jnp.full_like(height, jnp.inf), jnp.full_like(z, jnp.inf)
        for shell in model.shells:
            if shell.link is None:
                trunk = jnp.minimum(trunk, shell.bottom(pose.trunk[2]))
            else:
                bottom = shell.bottom(pose.rotations[shell.link][2])
                legs = jnp.minimum(legs, pose.origins[shell.link][2] + bottom)
        soles = jnp.stack([x, y, z - feet.radius], axis=1) + qpos[:3]
        return soles, height + jnp.concatenate([trunk[None], legs])

    qpos = jnp.asarray(qpos)
    shape = partial(jax.ShapeDtypeStruct, dtype=qpos.dtype)
    return batch_robots(of_many, (shape((4, 3)), shape((5,))))(model, qpos)


def compute_leg_points(model: Model, joints: jax.Array) -> jax.Array:
    """Centers of the spheres that thighs and calves have (n, 4, 3), m, in the trunk's frame.

    The feet first, then knees if they may touch the floor. To be vmapped; `joints` (12,) in rad.
    """
    spheres = [contact for contact in model.contacts if contact.link]

    def of_many(model: Model, joints: jax.Array) -> jax.Array:
        one, zero = jnp.ones_like(joints[0]), jnp.zeros_like(joints[0])
        upright = compute_rotation((one, zero, zero, zero))
        pose = compute_pose(model.links, upright, _by_link(joints))
        return jnp.stack([jnp.stack(centers(c, pose), axis=1) for c in model.contacts if c.link])

    joints = jnp.asarray(joints)
    shape = jax.ShapeDtypeStruct((len(spheres), 4, 3), joints.dtype)
    return batch_robots(of_many, shape)(model, joints)


def _lowest_points_over(
    model: Model, ground: Ground, barrier: jax.Array, pose: Pose, qpos: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """`compute_lowest_points` over ground that is not level."""
    x, y, height = qpos[:3]
    along, across, _ = centers(model.contacts[0], pose)
    under = _look_under(model, ground, barrier, pose, qpos)[0]
    trunk, legs = jnp.full_like(height, jnp.inf), jnp.full_like(along, jnp.inf)
    for shell in model.shells:
        rotation = pose.trunk if shell.link is None else pose.rotations[shell.link]
        for there, point in shell.low_points(rotation[2]):
            place = v.apply(rotation, point)
            if shell.link is not None:
                place = v.add(place, pose.origins[shell.link])
            level = ground.surface.at(x + place[0], y + place[1])[0]
            gap = jnp.where(there, height + place[2] - level, jnp.inf)
            if shell.link is None:
                trunk = jnp.minimum(trunk, gap)
            else:
                legs = jnp.minimum(legs, gap)
    soles = jnp.stack([x + along, y + across, jnp.asarray(under.above)], axis=1)
    return soles, jnp.concatenate([trunk[None], legs])


def _by_link(joints: jax.Array) -> Vector:
    """(12, robots) as hip, thigh and calf joints, (4, robots) each."""
    legs = joints.reshape(4, LINKS, -1)
    return legs[:, 0], legs[:, 1], legs[:, 2]


def _motion(pose: Pose, values: jax.Array) -> Motion:
    """MuJoCo's velocity or acceleration (18, robots); its angular part is in trunk axes."""
    angular = v.to_vector(values[3:6])
    return Motion(v.to_vector(values[:3]), v.apply(pose.trunk, angular), _by_link(values[6:]))
