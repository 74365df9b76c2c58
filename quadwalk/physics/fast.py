"""Physics steps as training takes them: MuJoCo's equations, laid out for many quadrupeds.

The equations, the solver's problem and the integrator are those of `physics`, which lets MJX step
the same model; tests hold each against the other and against MuJoCo C.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from quadwalk.physics import vectors as v
from quadwalk.physics.batching import robots_last, stage
from quadwalk.physics.contact import centres, find_constraints, newton
from quadwalk.physics.mjx_engine import Effort, Physics, control_step
from quadwalk.physics.model import Legged
from quadwalk.physics.rigid_body import (
    LINKS,
    Motion,
    Pose,
    bias_force,
    mass_matrix,
    place_bodies,
    pose_of,
    rotation_of,
)
from quadwalk.physics.robot_arrays import RobotArrays
from quadwalk.physics.vectors import Vector


def simulate(
    legged: Legged, robot: RobotArrays, config: Any, physics: Physics, target: jax.Array
) -> tuple[Physics, Effort]:
    """One control step; `target` (12,) rad. To be vmapped over robots."""
    columns = dataclasses.replace(
        robot,
        effort=robot.effort[:, None],
        velocity=robot.velocity[:, None],
        friction=robot.friction[:, None],
    )
    iterations = config.solver_iterations, config.line_search_iterations

    def advance(state: Physics, torque: jax.Array, friction: jax.Array) -> Physics:
        found = acceleration(legged, state, torque + friction, *iterations)
        return integrate(state, found, config.physics_dt)

    def of_many(physics: Physics, target: jax.Array) -> tuple[Physics, Effort]:
        return control_step(columns, config, physics, target, advance)

    return robots_last(of_many)(physics, target)


def acceleration(
    legged: Legged, state: Physics, torque: jax.Array, iterations: int, line_search: int
) -> jax.Array:
    """MuJoCo's qacc (18, robots) with joint torques (12, robots), arrays with robots last."""
    qpos, qvel, warmstart = state
    # Always so: states beyond are not let into the next control step.
    running = ~(qpos[2, 0] > 1e30)
    rotation = stage(running, lambda quat: rotation_of(tuple(quat)), qpos[3:7])
    angles = _by_link(qpos[7:])
    pose = stage(running, lambda r, a: pose_of(legged.links, r, a), rotation, angles)
    bodies = stage(running, lambda p: place_bodies(legged.trunk, legged.links, p), pose)
    velocity = _motion(pose, qvel)
    mass = stage(running, lambda p, b: mass_matrix(legged.trunk, legged.links, p, b), pose, bodies)
    bias = stage(
        running,
        lambda p, b, u: bias_force(legged.trunk, legged.links, p, b, u, legged.gravity),
        pose,
        bodies,
        velocity,
    )
    joints = tuple(
        t - link.damping * rate - b
        for t, link, rate, b in zip(
            _by_link(torque), legged.links, velocity.joints, bias.joints, strict=True
        )
    )
    force = Motion(v.scale(-1.0, bias.linear), v.scale(-1.0, bias.angular), joints)  # type: ignore[arg-type]
    found = stage(
        running,
        lambda *a: find_constraints(legged.contacts, legged.limits, *a),
        pose,
        qpos[2],
        angles,
        velocity,
    )
    solution = newton(
        mass, found, force, _motion(pose, warmstart), running, iterations, line_search
    )
    angular = v.apply_transposed(pose.trunk, solution.angular)
    legs = jnp.stack(solution.joints, axis=1).reshape(4 * LINKS, -1)
    return jnp.concatenate([jnp.stack([*solution.linear, *angular]), legs])


def integrate(state: Physics, acceleration: jax.Array, dt: float) -> Physics:
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
    return Physics(qpos, qvel, acceleration)


def heights(legged: Legged, qpos: jax.Array) -> tuple[jax.Array, jax.Array]:
    """How far the feet (4,) and the lowest point of all other shapes () are above the floor, m.

    `qpos` (19,). To be vmapped over robots. Not all shapes touch the floor in training, so this is
    how it knows that one would have.
    """

    def of_many(qpos: jax.Array) -> tuple[jax.Array, jax.Array]:
        pose = pose_of(legged.links, rotation_of(tuple(qpos[3:7])), _by_link(qpos[7:]))
        height = qpos[2]
        feet = legged.contacts[0]
        soles = height + centres(feet, pose)[2] - feet.radius
        lowest = jnp.full_like(height, jnp.inf)
        for shell in legged.shells:
            if shell.link is None:
                rotation, origin = pose.trunk, jnp.zeros_like(height)
            else:
                rotation, origin = pose.rotations[shell.link], pose.origins[shell.link][2]
            bottom = origin + shell.bottom(rotation[2])
            lowest = jnp.minimum(lowest, jnp.min(jnp.atleast_2d(bottom), axis=0))
        return soles, height + lowest

    return robots_last(of_many)(qpos)


def soles(legged: Legged, qpos: jax.Array) -> jax.Array:
    """The lowest points (4, 3) of the feet in the world, m. `qpos` (19,); to be vmapped."""

    def of_many(qpos: jax.Array) -> jax.Array:
        pose = pose_of(legged.links, rotation_of(tuple(qpos[3:7])), _by_link(qpos[7:]))
        feet = legged.contacts[0]
        x, y, z = centres(feet, pose)
        return jnp.stack([x, y, z - feet.radius], axis=1) + qpos[:3]

    return robots_last(of_many)(qpos)


def _by_link(joints: jax.Array) -> Vector:
    """(12, robots) as hip, thigh and calf joints, (4, robots) each."""
    legs = joints.reshape(4, LINKS, -1)
    return legs[:, 0], legs[:, 1], legs[:, 2]


def _motion(pose: Pose, values: jax.Array) -> Motion:
    """MuJoCo's velocity or acceleration (18, robots); its angular part is in trunk axes."""
    angular: Any = tuple(values[3:6])
    return Motion(tuple(values[:3]), v.apply(pose.trunk, angular), _by_link(values[6:]))  # type: ignore[arg-type]
