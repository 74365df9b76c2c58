"""Least squares: the joints' constants that explain a log best, and how sure they are."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.optimize import least_squares

from quadwalk.errors import UserError
from quadwalk.identify.log import find_pieces
from quadwalk.identify.log_files import Log
from quadwalk.identify.simulation import Joints, make_simulator
from quadwalk.physics.model import Model

# s at the beginning of each piece that count for nothing: how the joints moved before is unknown.
SETTLE = 0.3
# A fit that leaves more of a joint's motion, as a share of its rms, shows nothing.
MOST_UNEXPLAINED = 0.5
DELAY = 0.005  # s, where the search for it begins
OF_URDF = ("armature", "friction", "damping")  # of each joint; the delay and the gains are of all
# Of single joints. Encoders that the controller shares have the first alone; where angles shift
# after they are controlled, as in a driver or a log, both are equal.
OFFSETS = ("offset", "target_offset")
# The search's units; that of a constant of which the description has more is the description's.
_UNITS = {
    "armature": 1e-3,
    "friction": 0.1,
    "damping": 0.05,
    "kp": 1.0,
    "kd": 0.1,
    "delay": 1e-3,
    "friction_speed": 0.02,
    "offset": 0.01,
    "target_offset": 0.01,
}
_SHIFT = 1e-4  # share by which a constant is changed to see what it does
_BLOCK = 0.5  # s: what is further apart errs independently


class Value(NamedTuple):
    """A constant of the joints numbered `joints`, as fitted."""

    name: str  # a field of `Joints`
    joints: tuple[int, ...]
    described: float  # by the robot's description, or as the search began
    estimate: float
    interval: float  # half of the 95 % interval


@dataclass(frozen=True)
class Fit:
    """The fitted constants, and the angles (n, 12), rad, at the log's times."""

    values: tuple[Value, ...]
    described: Joints
    before: np.ndarray  # by the description
    after: np.ndarray  # by the fit
    fitted: np.ndarray  # (n,) True for the times that were fitted
    held_out: np.ndarray  # (n,) True for those that were held out
    unexplained: np.ndarray  # (12,) share of each joint's motion that the fit leaves, as rms

    @property
    def explains(self) -> bool:
        """True if the fit leaves little of each joint's motion, `MOST_UNEXPLAINED` at most."""
        return bool(self.unexplained.max() <= MOST_UNEXPLAINED)


class Parameters:
    """The constants to fit as numbers x (m,), in units of `scale` (m,), each of some joints.

    Legs on a stand move independently, so that the constants of single joints of one kind can
    change in one simulation, each in its own leg.
    """

    def __init__(
        self, described: Joints, names: Sequence[str], groups: Sequence[tuple[int, ...]]
    ) -> None:
        joints = range(12)
        groups_of = dict.fromkeys(OF_URDF, groups)
        groups_of |= {name: [(joint,) for joint in joints] for name in OFFSETS}
        self.places = [
            (name, group) for name in names for group in groups_of.get(name, [tuple(joints)])
        ]
        self._described = described
        self.start = np.array([_compute_mean(described, *place) for place in self.places])
        self.scale = np.maximum(self.start, [_UNITS[name] for name, _ in self.places])
        self.lower = np.array([-np.inf if name in OFFSETS else 0.0 for name, _ in self.places])
        # Constants of single joints of one kind share a column, one number for each such set.
        kinds = [(name, group if len(group) > 1 else group[0] % 3) for name, group in self.places]
        columns = {kind: column for column, kind in enumerate(dict.fromkeys(kinds), start=1)}
        self._column = np.array([columns[kind] for kind in kinds])
        # (m, 12) True for the joints of the legs whose constant it is.
        legs = [{joint // 3 for joint in group} for _, group in self.places]
        self._moves = np.array([[joint // 3 in group for joint in joints] for group in legs])

    def make_candidates(self, x: np.ndarray) -> Joints:
        """Return candidates for the joints: one with constants `x`, others with some changed.

        `compute_jacobian` takes the angles that they cause.
        """
        values = np.repeat((self.scale * x)[:, None], self._column.max() + 1, axis=1)
        values[np.arange(len(x)), self._column] += _SHIFT * self.scale
        joints = {
            name: np.repeat(value[:, None], values.shape[1], axis=1)
            for name, value in self._described._asdict().items()
        }
        for (name, group), value in zip(self.places, values, strict=True):
            joints[name][list(group)] = value
        return Joints(**joints)

    def compute_jacobian(self, angles: np.ndarray) -> np.ndarray:
        """Return the derivatives (n, 12, m) by x of the joints' angles.

        `angles` (n, 12, candidates) are those of the candidates of `make_candidates`.
        """
        change = (angles[:, :, self._column] - angles[:, :, :1]) / _SHIFT
        return change * self._moves.T


def fit_joints(
    model: Model,
    described: Joints,
    log: Log,
    names: Sequence[str],
    groups: Sequence[tuple[int, ...]],
    hold_out: float,
) -> Fit:
    """Fit the constants called `names` to the log by least squares.

    Armature, friction and damping are those of each group of joints, offsets of single joints. The
    last `hold_out` of the log is not fitted, and shows how well the fit predicts. Raise `UserError`
    where the robot of the description, with these gains, is none that can be simulated.
    """
    parameters = Parameters(described, names, groups)
    start, scale = parameters.start, parameters.scale
    simulate = make_simulator(model, log)
    is_last = np.arange(len(log.time)) >= (1.0 - hold_out) * len(log.time)
    settled = _find_settled(log)
    fitted, held_out = settled & ~is_last, settled & is_last
    evaluate = _remember_last(lambda x: simulate(parameters.make_candidates(x)))

    def compute_residual(x: np.ndarray) -> np.ndarray:
        return (evaluate(x)[fitted, :, 0] - log.position[fitted]).ravel()

    def compute_jacobian(x: np.ndarray) -> np.ndarray:
        return parameters.compute_jacobian(evaluate(x)[fitted]).reshape(-1, len(x))

    begin = np.maximum(start / scale, np.where(parameters.lower < 0, start / scale, 0.5))
    if not np.isfinite(compute_residual(begin)).all():
        raise UserError(
            "the description's joints shake themselves; expected --kp and --kd as recorded"
        )
    best = least_squares(
        compute_residual,
        begin,
        compute_jacobian,
        bounds=(parameters.lower, np.inf),
        xtol=1e-5,
        ftol=1e-7,
    ).x
    block = ((log.time[fitted] - log.time[0]) // _BLOCK).astype(int)
    interval = scale * compute_intervals(
        compute_jacobian(best), compute_residual(best), np.repeat(block, 12)
    )
    numbers = np.stack([start, scale * best, interval], axis=1).tolist()
    after = evaluate(best)[:, :, 0]
    rms = np.sqrt(np.mean((after - log.position)[settled] ** 2, axis=0))
    return Fit(
        values=tuple(
            Value(*place, *row) for place, row in zip(parameters.places, numbers, strict=True)
        ),
        described=described,
        before=evaluate(start / scale)[:, :, 0],
        after=after,
        fitted=fitted,
        held_out=held_out,
        unexplained=rms / log.position[settled].std(axis=0),
    )


def _find_settled(log: Log) -> np.ndarray:
    """Return True (n,) for the times at least `SETTLE` s after the beginning of their piece.

    A piece is a part of the log between gaps.
    """
    pieces = [log.time[piece] for piece in find_pieces(log.time)]
    return np.concatenate([time - time[0] > SETTLE for time in pieces])


def compute_intervals(jacobian: np.ndarray, residual: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return halves of the 95 % intervals (m,) of a least-squares solution, by the jackknife.

    `jacobian` is (n, m), `residual` (n,). Rows of one `block` (n,) may err alike, as where the
    model is wrong: the intervals come from the changes when each block is left out.
    """
    information = jacobian.T @ jacobian
    rows = [block == number for number in np.unique(block)]
    changes = [
        np.linalg.pinv(information - jacobian[row].T @ jacobian[row], hermitian=True)
        @ (jacobian[row].T @ residual[row])
        for row in rows
    ]
    count = len(rows)
    deviation = np.sqrt((count - 1) / count * np.sum(np.square(changes), axis=0))
    return stats.t.ppf(0.975, count - 1) * deviation


def _compute_mean(joints: Joints, name: str, group: tuple[int, ...]) -> float:
    """Return the mean of constant `name` over the joints of `group`."""
    return float(np.mean(getattr(joints, name)[list(group)]))


def _remember_last(function: Callable[[np.ndarray], np.ndarray]) -> Callable[..., np.ndarray]:
    """Return `function` with a memory of its last result: residual and Jacobian need it."""
    last: list[np.ndarray] = []

    def call(x: np.ndarray) -> np.ndarray:
        if not last or not np.array_equal(last[0], x):
            last[:] = [x.copy(), function(x)]
        return last[1]

    return call
