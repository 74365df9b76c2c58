"""When an episode ends by a fall."""

import jax
import jax.numpy as jnp
import numpy as np
from mujoco import mjtGeom

from quadwalk.env.config import TerminationConfig
from quadwalk.env.robot import RobotArrays


def lowest_points(robot: RobotArrays, position: jax.Array, rotation: jax.Array) -> jax.Array:
    """Height (n,), m, of the lowest point of each shell shape.

    `position` (n, 3) and `rotation` (n, 3, 3) place the shapes in the world frame. Training lets
    only feet touch the floor, so this is how it knows that a knee or the trunk would have.
    """
    down = jnp.abs(rotation[:, 2, :])  # how far each of the shape's axes points up or down
    size = robot.shell_size
    kind = robot.shell_kind
    box = jnp.sum(down * size, axis=1)
    disc = jnp.sqrt(jnp.maximum(1.0 - jnp.square(down[:, 2]), 0.0))
    cylinder = size[:, 0] * disc + size[:, 1] * down[:, 2]
    capsule = size[:, 0] + size[:, 1] * down[:, 2]
    reach = jnp.where(kind == mjtGeom.mjGEOM_SPHERE, size[:, 0], 0.0)
    reach = jnp.where(kind == mjtGeom.mjGEOM_BOX, box, reach)
    reach = jnp.where(kind == mjtGeom.mjGEOM_CYLINDER, cylinder, reach)
    reach = jnp.where(kind == mjtGeom.mjGEOM_CAPSULE, capsule, reach)
    return position[:, 2] - reach


REASONS = ("tipped", "low", "touched")


def fall_reasons(
    robot: RobotArrays, config: TerminationConfig, qpos: jax.Array, lowest: jax.Array
) -> jax.Array:
    """Whether each of `REASONS` holds, (3,) bool.

    Tipped over; the trunk too low; a shape other than a foot on the floor. `qpos` (nq,), `lowest`
    (n,) from `lowest_points`.
    """
    _, x, y, _ = qpos[3:7]
    upright = 1.0 - 2.0 * (x * x + y * y)  # cosine of the angle between trunk z and world z
    return jnp.stack(
        [
            upright < np.cos(config.tilt),
            qpos[2] < config.height * robot.home_height,
            jnp.min(lowest, initial=jnp.inf) < config.clearance,
        ]
    )
