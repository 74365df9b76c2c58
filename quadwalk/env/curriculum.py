"""A curriculum over the terrain: where the next episode of an environment starts.

As in legged_gym (Rudin et al. 2021, arXiv:2109.11978), each environment keeps to one kind of tile.
It moves to the next level when it gets more than half a tile away from its start. It moves back
when it covers less than half of the commanded distance. From the top it moves to any level of the
harder half; in legged_gym to any level at all, but easy ones are learned soon and not forgotten.
Where episodes are confined to their tiles, reaching the edge counts too.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from quadwalk.settings.environment import EnvConfig
from quadwalk.terrain.terrain import Terrain

EDGE = 0.3  # m: as close to a tile's edge counts as there, for that is looked at just before


class Travel(NamedTuple):
    """How far an episode has come."""

    start: jax.Array  # (2,) m, x and y of the trunk where it began
    steps: jax.Array  # () int32, control steps since then
    walked: jax.Array  # () m, along the velocity command, or along x where there is none
    commanded: jax.Array  # () m, by the velocity command, or at the curriculum's pace


def begin_travel(qpos: jax.Array) -> Travel:
    """Of an episode that begins at `qpos` (19,)."""
    zero = jnp.zeros(())
    return Travel(qpos[:2], jnp.zeros((), jnp.int32), zero, zero)


def travel_on(travel: Travel, velocity: jax.Array, command: jax.Array, dt: float) -> Travel:
    """`travel` after `dt` s more at mean `velocity` (2,), m/s, in the frame of `command` (2,)."""
    size = jnp.linalg.norm(command)
    along = jnp.dot(velocity, command) / jnp.maximum(size, 1e-6)
    return travel._replace(
        steps=travel.steps + 1,
        walked=travel.walked + along * dt,
        commanded=travel.commanded + size * dt,
    )


@dataclass(frozen=True)
class Curriculum:
    """Which tile an environment's episode is on; tiles are kind by kind, of each its levels."""

    kinds: tuple[str, ...]  # of each row of tiles
    levels: int
    tile: float  # m, its length
    episode_steps: int  # control steps in a full episode
    pace: float  # m/s, along x, of a task without commands: half a tile in a full episode
    # m, of the middles of all tiles (n, 2), where episodes are confined to them
    middles: tuple[tuple[float, float], ...] | None = None

    def first(self, environments: int, key: jax.Array) -> jax.Array:
        """Tiles (n,) int32 to begin with: all kinds in turn, of the easier half of their levels."""
        kind = jnp.arange(environments) % len(self.kinds)
        level = jax.random.randint(key, (environments,), 0, (self.levels + 1) // 2)
        return kind * self.levels + level

    def evenly(self, environments: int, key: jax.Array) -> jax.Array:
        """Tiles (n,) int32, each as likely as any other."""
        return jax.random.randint(key, (environments,), 0, len(self.kinds) * self.levels)

    def following(
        self, tile: jax.Array, travel: Travel, qpos: jax.Array, steps: jax.Array, key: jax.Array
    ) -> jax.Array:
        """The tile () int32 after an episode on `tile` that ends at `qpos` (19,), after `steps`.

        An episode that ends early by a fall is compared with the commanded distance of a full one.
        One whose commanded distance is less than a quarter of a tile says nothing.
        """
        away = jnp.linalg.norm(qpos[:2] - travel.start)
        planned = travel.steps + self.episode_steps - steps
        commanded = travel.commanded * planned / jnp.maximum(travel.steps, 1)
        up = away > self.tile / 2
        if self.middles is not None:
            place = qpos[:2] - jnp.asarray(self.middles, jnp.float32)[tile]
            up |= jnp.max(jnp.abs(place)) > self.tile / 2 - EDGE
        down = ~up & (commanded > self.tile / 4) & (travel.walked < commanded / 2)
        kind, level = tile // self.levels, tile % self.levels
        level = jnp.maximum(level + up.astype(jnp.int32) - down.astype(jnp.int32), 0)
        harder = jax.random.randint(key, (), self.levels // 2, self.levels)
        return kind * self.levels + jnp.where(level < self.levels, level, harder)

    def sums(self, tile: jax.Array) -> dict[str, jax.Array]:
        """Of environments on `tile` (n,), by kind: how many there are and the sum of their levels.

        Named "count/level/KIND" and "count/robots/KIND".
        """
        found = {}
        for kind in dict.fromkeys(self.kinds):
            rows = [index for index, own in enumerate(self.kinds) if own == kind]
            here = jnp.isin(tile // self.levels, jnp.array(rows))
            found[f"count/robots/{kind}"] = jnp.sum(here)
            found[f"count/level/{kind}"] = jnp.sum(jnp.where(here, tile % self.levels, 0))
        return found


def make_curriculum(config: EnvConfig, terrain: Terrain | None) -> Curriculum | None:
    """That of a task on `terrain`; None where it has none."""
    ground = config.ground
    if terrain is None or not ground.curriculum or ground.file is not None:
        return None
    length = ground.tile[0]
    pace = length / 2 / config.episode_seconds
    middles = tuple(tile.middle for tile in terrain.tiles) if ground.confined else None
    return Curriculum(ground.kinds, ground.levels, length, config.episode_steps, pace, middles)
