"""A bank of robots, of which each episode takes one: the numbers in which they differ, as rows."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.state import RobotConstants


class BodyConstants(NamedTuple):
    """The robot of one episode, and what its commands are like."""

    robot: RobotConstants
    # (3,) factors of a command's velocities and yaw rate; None: the task's are for this robot
    command_scale: Any = None


# kg, between light and medium bodies, and between these and heavy ones.
LIGHT, HEAVY = 10.0, 35.0
# Metrics that are counted by class, where a task has them.
FIGURES_BY_CLASS = ("fell", "velocity_error", "standing")


def find_classes(robot: RobotConstants) -> dict[str, jax.Array]:
    """Return which classes of bodies a robot is in, () float32 each, for metrics by class."""
    mass, ahead = jnp.asarray(robot.mass), jnp.any(jnp.asarray(robot.knees_ahead))
    classes = {
        "light": mass < LIGHT,
        "medium": (mass >= LIGHT) & (mass < HEAVY),
        "heavy": mass >= HEAVY,
        "knees_behind": ~ahead,
        "knees_ahead": ahead,
    }
    return {name: value.astype(jnp.float32) for name, value in classes.items()}


@dataclass(frozen=True, eq=False)
class Bank:
    """Bodies of one structure; what all have in common is constant in compiled programs."""

    rows: np.ndarray  # (bodies, n) float32, the numbers that differ
    like: tuple[Any, ...]  # the leaves of the first body
    places: tuple[int, ...]  # of the leaves that differ
    structure: Any

    def __len__(self) -> int:
        return len(self.rows)

    def read_body(self, row: jax.Array) -> BodyConstants:
        """Return the body whose numbers are `row`, one of `rows`."""
        leaves, start = list(self.like), 0
        for place in self.places:
            like = self.like[place]
            numbers = row[start : start + like.size].reshape(like.shape)
            leaves[place] = numbers > 0.5 if like.dtype == bool else numbers
            start += like.size
        body: BodyConstants = jax.tree.unflatten(self.structure, leaves)
        return body


def make_bank(bodies: Sequence[BodyConstants]) -> Bank:
    """Return the bank of `bodies`, which have as many links, shapes and limits as the first."""
    structure = jax.tree.structure(bodies[0])
    columns = [
        [np.asarray(leaf) for leaf in column]
        for column in zip(*map(jax.tree.leaves, bodies), strict=True)
    ]
    places = [i for i, column in enumerate(columns) if np.any(np.stack(column) != column[0])]
    rows = [np.concatenate([columns[i][n].ravel() for i in places]) for n in range(len(bodies))]
    like = jax.tree.leaves(bodies[0])
    for place in places:
        like[place] = columns[place][0]
    return Bank(np.stack(rows).astype(np.float32), tuple(like), tuple(places), structure)
