"""When an episode ends by a fall."""

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.physics.robot_arrays import RobotArrays
from quadwalk.physics.rotation import euler
from quadwalk.task.config import TerminationConfig

REASONS = ("tipped", "low", "touched")


def fall_reasons(
    robot: RobotArrays, config: TerminationConfig, qpos: jax.Array, lowest: jax.Array
) -> jax.Array:
    """Whether each of `REASONS` holds, (3,) bool.

    Tipped over; the trunk too low; a shape other than a foot on the floor. `qpos` (19,), `lowest`
    () m, of all shapes but the feet.
    """
    tipped = low = touched = jnp.zeros((), bool)
    if config.tilt is not None:
        _, x, y, _ = qpos[3:7]
        upright = 1.0 - 2.0 * (x * x + y * y)  # cosine of the angle between trunk z and world z
        tipped |= upright < np.cos(config.tilt)
    if config.roll_pitch is not None:
        tipped |= jnp.max(jnp.abs(euler(qpos[3:7])[:2])) > config.roll_pitch
    if config.height is not None:
        low |= qpos[2] < config.height * robot.home_height
    if config.base_height is not None:
        low |= qpos[2] < config.base_height
    if config.clearance is not None:
        touched |= lowest < config.clearance
    return jnp.stack([tipped, low, touched])
