"""Rotations by unit quaternions, wxyz, as MuJoCo orders them, of one robot.

A quaternion `quat` (4,) turns the body frame into the world frame.
"""

import jax
import jax.numpy as jnp


def rotate(quat: jax.Array, vector: jax.Array) -> jax.Array:
    """Return `vector` (3,), of the body frame, in the world frame, by `quat` (4,), wxyz."""
    w, u = quat[0], quat[1:]
    return vector + 2.0 * jnp.cross(u, jnp.cross(u, vector) + w * vector)


def rotate_inverse(quat: jax.Array, vector: jax.Array) -> jax.Array:
    """Return `vector` (3,), of the world frame, in the body frame."""
    return rotate(quat * jnp.array([1.0, -1.0, -1.0, -1.0]), vector)


def compute_gravity_direction(quat: jax.Array) -> jax.Array:
    """Return the direction of gravity, a unit vector (3,), in the body frame."""
    return rotate_inverse(quat, jnp.array([0.0, 0.0, -1.0]))


def multiply(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return the quaternion (4,) that turns by `b` and then, in the world, by `a`."""
    w, u = a[0] * b[0] - jnp.dot(a[1:], b[1:]), jnp.cross(a[1:], b[1:])
    return jnp.concatenate([w[None], a[0] * b[1:] + b[0] * a[1:] + u])


def compute_yaw(quat: jax.Array) -> jax.Array:
    """Return the heading of the body's x axis about world z, rad in (-pi, pi]."""
    w, x, y, z = quat
    return jnp.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def rotate_about_z(angle: jax.Array, x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the components in the world of vectors `x`, `y` (...) of a frame at `angle`, rad."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return cos * x - sin * y, sin * x + cos * y


def rotate_back_about_z(
    angle: jax.Array, x: jax.Array, y: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the components in a frame at `angle`, rad, of vectors `x`, `y` (...) of the world."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return cos * x + sin * y, cos * y - sin * x


def from_euler(roll: jax.Array, pitch: jax.Array, yaw: jax.Array) -> jax.Array:
    """Return the quaternion (4,) of Rz(yaw) Ry(pitch) Rx(roll), angles in rad."""
    cr, sr = jnp.cos(roll / 2), jnp.sin(roll / 2)
    cp, sp = jnp.cos(pitch / 2), jnp.sin(pitch / 2)
    cy, sy = jnp.cos(yaw / 2), jnp.sin(yaw / 2)
    return jnp.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
