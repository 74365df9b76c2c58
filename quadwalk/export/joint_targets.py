"""An action map as numbers: joint targets = clip(offset + scale * action, lower, upper)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.robot_arrays import RobotArrays
from quadwalk.errors import UserError
from quadwalk.settings.terms import ActionMap

_SAMPLES = 1000
_TOLERANCE = 1e-5  # rad
_FAR = 1e3  # rad, or actions: beyond any limit


@dataclass(frozen=True)
class JointTargets:
    """Joint targets (12,), rad, as a clipped linear function of actions (12,)."""

    scale: np.ndarray  # (12,) rad per unit of action
    offset: np.ndarray  # (12,) rad
    lower: np.ndarray  # (12,) rad; -inf: no limit
    upper: np.ndarray  # (12,) rad; inf: no limit
    reach: np.ndarray | None  # (12,) rad, the farthest from the joints' angles; None: anywhere

    def __call__(self, action: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """Targets (..., 12), rad, of actions (..., 12) and joint angles (..., 12), rad."""
        target = np.clip(self.offset + self.scale * action, self.lower, self.upper)
        if self.reach is None:
            return target
        return np.clip(target, joints - self.reach, joints + self.reach)


def find_targets(action_map: ActionMap, robot: RobotArrays) -> JointTargets:
    """The numbers that `action_map` comes down to, measured and then checked on random actions.

    Raises `UserError` for a map that is no clipped linear function of the action: no file
    format for policies can state it.
    """

    def targets(action: jax.Array, joints: jax.Array) -> jax.Array:
        return action_map(robot, action, joints)

    middle, none = jnp.asarray(robot.home_joints, jnp.float32), jnp.zeros(12)
    # A map that only goes so far from the joints' angles arrives after some steps.
    for _ in range(100):
        middle = targets(none, middle)
    slope = np.asarray(jax.jacobian(targets)(none, middle))
    away = np.asarray(targets(none, middle + _FAR) - (middle + _FAR))
    reach = np.abs(away) if np.all(np.abs(away) < 0.5 * _FAR) else None
    rng, inf = np.random.default_rng(0), np.full(12, np.inf)
    action = rng.uniform(-1.0, 1.0, (_SAMPLES, 12)).astype(np.float32)
    joints = rng.uniform(robot.lower, robot.upper, (_SAMPLES, 12)).astype(np.float32)
    expected = jax.jit(jax.vmap(targets))(action, joints)
    for lower, upper in ((robot.lower, robot.upper), (-inf, inf)):
        found = JointTargets(np.diag(slope), np.asarray(middle), lower, upper, reach)
        if np.max(np.abs(found(action, joints) - expected)) < _TOLERANCE:
            return found
    name = action_map.function.__name__
    raise UserError(
        f"the action map {name} cannot be exported; expected joint targets that are "
        "clip(offset + scale * action), within the joints' limits or without any"
    )
