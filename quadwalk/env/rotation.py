"""Rotations by unit quaternions, wxyz, as MuJoCo orders them."""

import jax
import jax.numpy as jnp


def rotate(quat: jax.Array, vector: jax.Array) -> jax.Array:
    """`vector` (3,), given in the body frame of `quat` (4,), in the world frame."""
    w, u = quat[0], quat[1:]
    return vector + 2.0 * jnp.cross(u, jnp.cross(u, vector) + w * vector)


def rotate_inverse(quat: jax.Array, vector: jax.Array) -> jax.Array:
    """`vector` (3,), given in the world frame, in the body frame of `quat` (4,)."""
    return rotate(quat * jnp.array([1.0, -1.0, -1.0, -1.0]), vector)


def yaw(quat: jax.Array) -> jax.Array:
    """Heading of the body's x axis about world z, rad in (-pi, pi]."""
    w, x, y, z = quat
    return jnp.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def from_euler(roll: jax.Array, pitch: jax.Array, yaw: jax.Array) -> jax.Array:
    """Quaternion (4,) of Rz(yaw) Ry(pitch) Rx(roll), angles in rad."""
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
