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


def compute_gravity_direction(quat: jax.Array) -> jax.Array:
    """Direction of gravity (3,), a unit vector, in the frame that `quat` (4,) turns."""
    return rotate_inverse(quat, jnp.array([0.0, 0.0, -1.0]))


def multiply(a: jax.Array, b: jax.Array) -> jax.Array:
    """The quaternion (4,) of turning by `b` and then, in the world, by `a`."""
    w, u = a[0] * b[0] - jnp.dot(a[1:], b[1:]), jnp.cross(a[1:], b[1:])
    return jnp.concatenate([w[None], a[0] * b[1:] + b[0] * a[1:] + u])


def compute_yaw(quat: jax.Array) -> jax.Array:
    """Heading of the body's x axis about world z, rad in (-pi, pi]."""
    w, x, y, z = quat
    return jnp.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def euler(quat: jax.Array) -> jax.Array:
    """Roll, pitch and yaw (3,), rad, of which `quat` (4,) is Rz(yaw) Ry(pitch) Rx(roll).

    Those of PyBullet's getEulerFromQuaternion: pitch from -pi/2 to pi/2; within 0.26 degrees of
    either end, where only roll and yaw together are determined, roll 0 and a yaw within +-2 pi.
    """
    w, x, y, z = quat
    sine = 2.0 * (w * y - x * z)
    general = jnp.stack(
        [
            jnp.arctan2(2.0 * (y * z + w * x), w * w - x * x - y * y + z * z),
            jnp.arcsin(jnp.clip(sine, -1.0, 1.0)),
            jnp.arctan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z),
        ]
    )
    up = jnp.sign(sine)
    vertical = jnp.stack([0.0 * w, up * (jnp.pi / 2), 2.0 * jnp.arctan2(-up * x, up * y)])
    return jnp.where(jnp.abs(sine) < 0.99999, general, vertical)


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
