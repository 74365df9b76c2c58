"""Action maps, from actions in [-1, 1] to joint targets, and when these take effect.

To add a map, write such a function, in a file of your own or here, and name it in a task. One here
needs a name in `quadwalk/settings/registry.py`.
"""

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.reflections import JOINTS, mirrors
from quadwalk.env.state import JITTER, EpisodeRandomization, RobotConstants
from quadwalk.settings.terms import ActionMap


@mirrors(JOINTS)
def about_home(
    robot: RobotConstants, action: jax.Array, *, hip: float, thigh: float, calf: float
) -> jax.Array:
    """Targets (12,), rad, about the home pose and within the joints' limits.

    Action 1 moves a hip's target by `hip`, a thigh's by `thigh`, a calf's by `calf`, rad.
    """
    return _compute_targets(robot, action, np.tile([hip, thigh, calf], 4))


@mirrors(JOINTS)
def feet_alike(
    robot: RobotConstants, action: jax.Array, *, hip: float, thigh: float, calf: float
) -> jax.Array:
    """`about_home`, with a thigh's reach more by the calf's where the knee is ahead.

    Two legs whose knees point either way have their feet in the same place where the thighs' angles
    differ by the calf's. So one's foot goes wherever the other's does.
    """
    reach = np.tile([hip, thigh, calf], (4, 1))
    reach[robot.knees_ahead, 1] += calf
    return _compute_targets(robot, action, reach.ravel())


@mirrors(JOINTS)
def about_standard(
    robot: RobotConstants, action: jax.Array, *, hip: float, thigh: float, calf: float
) -> jax.Array:
    """`about_home` for standard joints: an action moves the feet of any robot alike.

    For the AlienGo, whose joints are standard, it is `about_home`.
    """
    offsets = robot.from_standard(np.tile([hip, thigh, calf], 4) * action)
    return jnp.clip(robot.home_joints + offsets, robot.lower, robot.upper)


def _compute_targets(robot: RobotConstants, action: jax.Array, reach: np.ndarray) -> jax.Array:
    return jnp.clip(robot.home_joints + reach * action, robot.lower, robot.upper)


ABOUT_STANDARD = ActionMap(about_standard, {"hip": 0.3, "thigh": 0.9, "calf": 0.9})
ABOUT_HOME = ActionMap(about_home, {"hip": 0.3, "thigh": 0.9, "calf": 0.9})


def delay_targets(
    randomization: EpisodeRandomization, target: jax.Array, substeps: int, steps: jax.Array
) -> tuple[EpisodeRandomization, jax.Array]:
    """Return `randomization` with `target` (12,), rad, as the newest, and the targets in effect.

    Those are (substeps, 12), one for each physics step of control step number `steps`.
    """
    targets = jnp.concatenate([target[None], randomization.targets[:-1]])
    jitter = jax.random.uniform(randomization.make_key(JITTER, steps))
    delay = jnp.floor(randomization.delay + jitter).astype(jnp.int32)
    # How many control steps ago: those that began within the last `delay` physics steps.
    late = delay - jnp.arange(substeps) + substeps - 1
    ago = jnp.minimum(jnp.maximum(late, 0) // substeps, len(targets) - 1)
    applied_targets = targets[ago] - randomization.encoder
    return randomization._replace(targets=targets), applied_targets
