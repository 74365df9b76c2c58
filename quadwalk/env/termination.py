"""When an episode ends by a fall."""

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.config import TerminationConfig
from quadwalk.env.robot import RobotArrays

REASONS = ("tipped", "low", "touched")


def fall_reasons(
    robot: RobotArrays, config: TerminationConfig, qpos: jax.Array, lowest: jax.Array
) -> jax.Array:
    """Whether each of `REASONS` holds, (3,) bool.

    Tipped over; the trunk too low; a shape other than a foot on the floor. `qpos` (19,), `lowest`
    () m, of all shapes but the feet.
    """
    _, x, y, _ = qpos[3:7]
    upright = 1.0 - 2.0 * (x * x + y * y)  # cosine of the angle between trunk z and world z
    return jnp.stack(
        [
            upright < np.cos(config.tilt),
            qpos[2] < config.height * robot.home_height,
            lowest < config.clearance,
        ]
    )
