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
    """How what a task's networks read and write mirrors."""

    observation: Mirror  # the policy's numbers with their history, then the value network's
    action: Mirror  # (12,)


def signs(*sign: float) -> Kind:
    """Numbers that keep their places and change these signs."""
    return lambda robot, params: make_mirror(np.arange(len(sign)), sign)


def grid(rows: int, row: int) -> Mirror:
    """Of rows from the right to the left, each of `row` numbers."""
    places = np.arange(rows * row).reshape(rows, row)[:, ::-1].ravel()
    return make_mirror(places, np.ones(rows * row))


SCALAR = signs(1)  # the same in the mirror
LATERAL = signs(-1)  # to the left, or a turn to the left
VECTOR = signs(1, -1, 1)  # a velocity, a direction
AXIAL = signs(-1, 1, -1)  # an angular velocity, a torque


def JOINTS(robot: RobotMirror, params: dict[str, Any]) -> Mirror:
    """An angle, speed, torque or action of each joint (12,)."""
    return robot.joints


def LINKS(robot: RobotMirror, params: dict[str, Any]) -> Mirror:
    """A factor or another number without direction of each joint or the link it moves (12,)."""
    return make_mirror(robot.joints.source, np.ones(12))


def FEET(robot: RobotMirror, params: dict[str, Any]) -> Mirror:
    """A number of each foot (4,)."""
    return robot.feet


def mirrors(*kinds: Kind) -> Callable[[F], F]:
    """Say of a term's function that its numbers are of these kinds, one after another."""

    def says(function: F) -> F:
        function.mirrored_as = kinds  # type: ignore[attr-defined]
        return function

    return says


def mirror_of(
    function: Callable[..., Any], params: dict[str, Any] | None, robot: RobotMirror
) -> Mirror | None:
    """How the term's numbers mirror; None where it does not say, or they do not."""
    kinds = getattr(function, "mirrored_as", None)
    own = [kind(robot, params or {}) for kind in kinds or ()]
    known = [part for part in own if part is not None]
    return join_mirrors(*known) if kinds and len(known) == len(own) else None


def with_history(frame: Mirror, history: np.ndarray) -> Mirror:
    """The numbers of a control step, then those that are also seen of one step before, and so on.

    `history` (n,) is of how many earlier steps each is seen.
    """
    steps = []
    for ago in range(1 + max(history)):
        kept = history >= ago
        place = np.cumsum(kept) - 1
        steps.append(make_mirror(place[frame.source[kept]], frame.sign[kept]))
    return join_mirrors(*steps)
