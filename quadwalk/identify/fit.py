"""Least squares: the joints' constants that explain a log best, and how sure they are."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from quadwalk.errors import UserError
from quadwalk.identify.joint_log import Log
from quadwalk.identify.stand import Joints, simulator
from quadwalk.physics.model import Model

SETTLE = 0.3  # s at the beginning that count for nothing: how the joints moved before is not known
DELAY = 0.005  # s, where the search for it begins
OF_URDF = ("armature", "friction", "damping")  # of each joint; the delay and the gains are of all
# In these the search takes steps; where the description has more, in that.
_UNITS = {
    "armature": 1e-3,
    "friction": 0.1,
    "damping": 0.05,
    "kp": 1.0,
    "kd": 0.1,
    "delay": 1e-3,
    "friction_speed": 0.02,
}
_SHIFT = 1e-4  # share by which a constant is changed to see what it does
_BLOCK = 0.5  # s: what is further apart errs independently


class Value(NamedTuple):
    """A constant of the joints numbered `joints`."""

    name: str  # a field of `Joints`
    joints: tuple[int, ...]
    described: float  # by the robot's description, or as the search began
    found: float
    interval: float  # half of the 95 % interval


@dataclass(frozen=True)
class Fit:
    """What was found, and the angles (n, 12), rad, at the log's times."""

    values: tuple[Value, ...]
    described: Joints
    before: np.ndarray  # by the description
    after: np.ndarray  # by what was found
    fitted: np.ndarray  # (n,) whether a time is one that was fitted
    held_out: np.ndarray  # (n,) whether it was held out


def fit_joints(
    model: Model,
    described: Joints,
    log: Log,
    names: Sequence[str],
    groups: Sequence[tuple[int, ...]],
    hold_out: float,
) -> Fit:
    """Fit the constants called `names`, armature, friction and damping for each group of joints.

    The last `hold_out` of the log is not fitted, and shows how well the fit predicts. `UserError`
    where the robot of the description, with these gains, is none that can be simulated.
    """
    whole = [tuple(range(12))]
    places = [(name, own) for name in names for own in (groups if name in OF_URDF else whole)]
    start = np.array([_mean(described, *place) for place in places])
    scale = np.maximum(start, [_UNITS[name] for name, _ in places])
    simulate = simulator(model, log)
    since = (log.time - log.time[0]) / (log.time[-1] - log.time[0])
    fitted = (log.time - log.time[0] > SETTLE) & (since <= 1.0 - hold_out)

    def candidates(x: np.ndarray) -> Joints:
        """Of `x` (m,), in units of `scale`, and of each of its neighbors."""
        values = (scale * np.vstack([x, x + _SHIFT * np.eye(len(x))])).T
        joints = {n: np.repeat(of[:, None], len(x) + 1, 1) for n, of in described._asdict().items()}
        for (name, group), own in zip(places, values, strict=True):
            joints[name][list(group)] = own
        return Joints(**joints)

    evaluate = _remembering(lambda x: simulate(candidates(x)))

    def residual(x: np.ndarray) -> np.ndarray:
        return (evaluate(x)[fitted, :, 0] - log.position[fitted]).ravel()

    def jacobian(x: np.ndarray) -> np.ndarray:
        angles = evaluate(x)[fitted]
        return ((angles[:, :, 1:] - angles[:, :, :1]) / _SHIFT).reshape(-1, len(x))

    begin = np.maximum(start / scale, 0.5)
    if not np.isfinite(residual(begin)).all():
        raise UserError(
            "the description's joints shake themselves; expected --kp and --kd as recorded"
        )
    best = least_squares(residual, begin, jacobian, bounds=(0.0, np.inf), xtol=1e-5, ftol=1e-7)
    block = ((log.time[fitted] - log.time[0]) // _BLOCK).astype(int)
    sure = scale * intervals(jacobian(best.x), residual(best.x), np.repeat(block, 12))
    found = zip(places, start, scale * best.x, sure, strict=True)
    return Fit(
        values=tuple(Value(*place, *map(float, numbers)) for place, *numbers in found),
        described=described,
        before=evaluate(start / scale)[:, :, 0],
        after=evaluate(best.x)[:, :, 0],
        fitted=fitted,
        held_out=since > 1.0 - hold_out,
    )


def intervals(jacobian: np.ndarray, residual: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Halves of the 95 % intervals (m,) of a least-squares solution.

    `jacobian` (n, m) and `residual` (n,); those of one `block` (n,) may err alike, as where the
    model is wrong: Liang and Zeger 1986, Longitudinal data analysis using generalized linear
    models.
    """
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    pull = jacobian * residual[:, None]
    blocks = np.array([pull[block == own].sum(axis=0) for own in np.unique(block)])
    spread = len(blocks) / (len(blocks) - 1) * blocks.T @ blocks
    return 1.96 * np.sqrt(np.diag(inverse @ spread @ inverse))


def _mean(joints: Joints, name: str, group: tuple[int, ...]) -> float:
    return float(np.mean(getattr(joints, name)[list(group)]))


def _remembering(function: Callable[[np.ndarray], np.ndarray]) -> Callable[..., np.ndarray]:
    """`function` that keeps its last result, which residual and Jacobian both need."""
    last: list[np.ndarray] = []

    def remembered(x: np.ndarray) -> np.ndarray:
        if not last or not np.array_equal(last[0], x):
            last[:] = [x.copy(), function(x)]
        return last[1]

    return remembered
