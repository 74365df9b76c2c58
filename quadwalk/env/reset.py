"""Starts of episodes: the robot's state, and where on the terrain it is.

The curriculum over the terrain is that of legged_gym (Rudin et al. 2021, arXiv:2109.11978). Each
environment keeps to one kind of tile. It moves to the next level when it gets more than half a tile
away from its start. It moves back when it covers less than half of the commanded distance. From the
top it moves to any level of the harder half; in legged_gym to any level at all, but easy ones are
learned soon and not forgotten. Where episodes are confined to their tiles, reaching the edge counts
too.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from quadwalk.env.state import RobotConstants, Travel
from quadwalk.physics.fast import compute_lowest_points
from quadwalk.physics.model import Model
from quadwalk.physics.motor import PhysicsState
from quadwalk.physics.rotation import from_euler
from quadwalk.robot.quadruped import Quadruped
from quadwalk.robot.scene import find_lowest_point
from quadwalk.settings.environment import EnvConfig, ResetConfig
from quadwalk.terrain.terrain import Terrain

EDGE = 0.3  # m: this close to a tile's edge counts as there, since it is looked at just before


def sample_start(robot: RobotConstants, config: ResetConfig, key: jax.Array) -> PhysicsState:
    """Return a random start near the home pose or `config.pose`, on a flat floor at height 0.

    The lowest foot just touches the floor, or the trunk is at `config.height`. With
    `config.tumbled` the orientation is any, and the lowest part of the robot touches the floor.
    """
    shares = jax.random.uniform(key, (35,), minval=-1.0, maxval=1.0)
    pose, joints, velocity, speed = jnp.split(shares, [4, 16, 22])

    qpos = jnp.asarray(robot.home, jnp.float32)
    qpos = qpos.at[1].set(config.offset * pose[0])
    quat = from_euler(config.tilt * pose[1], config.tilt * pose[2], config.yaw * pose[3])
    if config.tumbled:
        quat = jax.random.normal(jax.random.fold_in(key, 3), (4,))  # none of `QuadrupedEnv.reset`'s
        quat = quat / jnp.linalg.norm(quat)
    qpos = qpos.at[3:7].set(quat)
    middle = robot.home_joints if config.pose is None else np.tile(config.pose, 4)
    angles = jnp.clip(middle + config.joints * joints, robot.lower, robot.upper)
    qpos = qpos.at[7:].set(angles)
    if config.height is None:
        qpos = put_on_floor(robot.geometry, qpos, config)
    else:
        qpos = qpos.at[2].set(config.height)

    qvel = jnp.zeros(18).at[:6].set(config.velocity * velocity)
    qvel = qvel.at[0].add(config.forward * (speed[12] + 1.0) / 2.0)
    qvel = qvel.at[6:].set(config.joint_velocity * speed[:12])
    return PhysicsState(qpos, qvel)


def compute_nominal_start(
    model: mujoco.MjModel, quadruped: Quadruped, config: ResetConfig
) -> np.ndarray:
    """Return qpos (19,) of a start without its random part.

    `model` is one of the quadruped. MuJoCo computes it, so that nothing has to be compiled.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    if config.pose is not None:
        data.qpos[7:] = np.clip(np.tile(config.pose, 4), quadruped.lower, quadruped.upper)
    mujoco.mj_kinematics(model, data)
    lowest = min(find_lowest_point(model, data, model.geom(name).id) for name in quadruped.feet)
    data.qpos[2] = data.qpos[2] - lowest if config.height is None else config.height
    return data.qpos.copy()


def place_on_tile(
    model: Model, terrain: Terrain, start: PhysicsState, tile: jax.Array, key: jax.Array
) -> PhysicsState:
    """Move a start from the flat floor to where episodes of tile `tile`, () int32, start.

    The robot's lowest part is as high above the ground as it was above the floor.
    """
    starts, spreads = (
        jnp.asarray([getattr(place, name) for place in terrain.tiles], jnp.float32)
        for name in ("start", "spread")
    )
    place = starts[tile] + spreads[tile] * jax.random.uniform(key, (2,), minval=-1.0, maxval=1.0)
    level = model._replace(ground=None)
    qpos = start.qpos.at[:2].add(place)
    rise = _compute_lowest(level, start.qpos) - _compute_lowest(model, qpos)
    return start._replace(qpos=qpos.at[2].add(rise))


def put_on_floor(model: Model, qpos: jax.Array, config: ResetConfig) -> jax.Array:
    """Return the pose (19,) at the height in which its lowest foot just touches the floor.

    With `config.tumbled` it is the lowest part of the robot.
    """
    return qpos.at[2].add(-_compute_lowest(model, qpos, feet=not config.tumbled))


def _compute_lowest(model: Model, qpos: jax.Array, feet: bool = False) -> jax.Array:
    """Return how far the robot's lowest part, or lowest foot, is above the ground, m."""
    soles, others = compute_lowest_points(model, qpos)
    lowest = jnp.min(soles[:, 2])
    return lowest if feet else jnp.minimum(lowest, jnp.min(others))


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

    def sample_first_tiles(self, environments: int, key: jax.Array) -> jax.Array:
        """Return the tile (n,) int32 on which each of n `environments` starts training.

        Kinds follow in turn; the level is drawn from the easier half.
        """
        kind = jnp.arange(environments) % len(self.kinds)
        level = jax.random.randint(key, (environments,), 0, (self.levels + 1) // 2)
        return kind * self.levels + level

    def sample_tiles(self, environments: int, key: jax.Array) -> jax.Array:
        """Return tiles (n,) int32, each as likely as any other."""
        return jax.random.randint(key, (environments,), 0, len(self.kinds) * self.levels)

    def sample_next_tile(
        self, tile: jax.Array, travel: Travel, qpos: jax.Array, steps: jax.Array, key: jax.Array
    ) -> jax.Array:
        """Return the tile () int32 after an episode on `tile` that ends at `qpos` after `steps`.

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

    def sum_levels(self, tile: jax.Array) -> dict[str, jax.Array]:
        """Return the number of environments on `tile` (n,) and the sum of their levels, by kind.

        Named "count/robots/KIND" and "count/level/KIND".
        """
        sums = {}
        for kind in dict.fromkeys(self.kinds):
            rows = [row for row, row_kind in enumerate(self.kinds) if row_kind == kind]
            is_kind = jnp.isin(tile // self.levels, jnp.array(rows))
            sums[f"count/robots/{kind}"] = jnp.sum(is_kind)
            sums[f"count/level/{kind}"] = jnp.sum(jnp.where(is_kind, tile % self.levels, 0))
        return sums


def make_curriculum(config: EnvConfig, terrain: Terrain | None) -> Curriculum | None:
    """Return the curriculum of a task on `terrain`; None where it has none."""
    ground = config.ground
    if terrain is None or not ground.curriculum or ground.file is not None:
        return None
    length = ground.tile[0]
    pace = length / 2 / config.episode_seconds
    middles = tuple(tile.middle for tile in terrain.tiles) if ground.confined else None
    return Curriculum(ground.kinds, ground.levels, length, config.episode_steps, pace, middles)
