"""How observations and actions look in the sagittal mirror, y -> -y.

A term's function says it: `@mirrors(VECTOR)`, or `@mirrors(SCALAR, LATERAL)` for one number after
another. A kind is a function of the robot's mirror and of the term's parameters.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np

from quadwalk.robot.mirror import Mirror, RobotMirror, join_mirrors, make_mirror

# None: with these parameters it has no mirror image.
Kind: TypeAlias = Callable[[RobotMirror, dict[str, Any]], Mirror | None]
F = TypeVar("F", bound=Callable[..., Any])


class Mirrors(NamedTuple):
    """How observations and actions of a task mirror."""

    observation: Mirror  # the policy's numbers with their history, then the value network's
    action: Mirror  # (12,)


def make_signs(*signs: float) -> Kind:
    """Return the kind of numbers that keep their places and change these signs."""
    return lambda robot, params: make_mirror(np.arange(len(signs)), signs)


def make_grid_mirror(rows: int, columns: int) -> Mirror:
    """Return the mirror of rows of points, each from the right to the left."""
    places = np.arange(rows * columns).reshape(rows, columns)[:, ::-1].ravel()
    return make_mirror(places, np.ones(rows * columns))


def _get_joints(robot: RobotMirror, params: dict[str, Any]) -> Mirror:
    return robot.joints


def _make_links(robot: RobotMirror, params: dict[str, Any]) -> Mirror:
    return make_mirror(robot.joints.source, np.ones(12))


def _get_feet(robot: RobotMirror, params: dict[str, Any]) -> Mirror:
    return robot.feet


SCALAR = make_signs(1)  # the same in the mirror
LATERAL = make_signs(-1)  # to the left, or a turn to the left
VECTOR = make_signs(1, -1, 1)  # a velocity, a direction
AXIAL = make_signs(-1, 1, -1)  # an angular velocity, a torque
JOINTS: Kind = _get_joints  # an angle, speed, torque or action of each joint (12,)
LINKS: Kind = _make_links  # a number without direction of each joint, or of the link it moves (12,)
FEET: Kind = _get_feet  # a number of each foot (4,)


def mirrors(*kinds: Kind) -> Callable[[F], F]:
    """Mark a term's function, as a decorator, with the kinds of its numbers, in order.

    A kind, such as `VECTOR`, says how numbers change when left and right are exchanged.
    """

    def mark(function: F) -> F:
        function.mirrored_as = kinds  # type: ignore[attr-defined]
        return function

    return mark


def find_mirror(
    function: Callable[..., Any], params: dict[str, Any] | None, robot: RobotMirror
) -> Mirror | None:
    """Return how the term's numbers mirror; None where it does not say, or they do not."""
    kinds = getattr(function, "mirrored_as", ())
    parts = [kind(robot, params or {}) for kind in kinds]
    if not parts or None in parts:
        return None
    return join_mirrors(*parts)


def repeat_for_history(frame: Mirror, history: np.ndarray) -> Mirror:
    """Return the mirror of a control step's numbers, then those that are observed again, by age.

    `history` (n,) is for how many earlier control steps each number is observed.
    """
    steps = []
    for ago in range(1 + max(history)):
        is_observed = history >= ago
        place = np.cumsum(is_observed) - 1
        steps.append(make_mirror(place[frame.source[is_observed]], frame.sign[is_observed]))
    return join_mirrors(*steps)
