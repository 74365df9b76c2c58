"""Episodes on ground that is not level: where they start, what is above ground, where they end."""

import dataclasses
from functools import partial
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from quadwalk.env import terminations
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.observations import height, height_scan, scan_ahead
from quadwalk.env.terminations import is_off_ground
from quadwalk.errors import UsageError
from quadwalk.physics.fast import compute_lowest_points
from quadwalk.physics.rotation import compute_yaw
from quadwalk.settings.terms import Observation
from quadwalk.tasks import rough, sprint
from quadwalk.terrain.terrain import FLAT

KINDS = ("stairs_up", "blocks", "slope_down")
SCAN = {"length": 0.4, "width": 0.2, "spacing": 0.1, "reach": 0.5}
EPISODES = 24


@pytest.fixture(scope="module")
def hilly(quadruped) -> QuadrupedEnv:
    ground = dataclasses.replace(
        FLAT,
        kinds=KINDS,
        levels=2,
        difficulty=(0.5, 1.0),
        tile=(6.0, 6.0),
        border=2.0,
        curriculum=True,
    )
    scan = Observation(height_scan, SCAN, noise=0.05)
    config = dataclasses.replace(
        sprint.TASK.env, ground=ground, observation={"scan": scan, "height": Observation(height)}
    )
    return QuadrupedEnv(quadruped, config)


@pytest.fixture(scope="module")
def starts(hilly):
    return jax.jit(jax.vmap(hilly.reset))(jax.random.split(jax.random.PRNGKey(0), EPISODES))


@pytest.fixture(scope="module")
def hilly_step(hilly):
    return jax.jit(jax.vmap(hilly.step))


def test_episodes_start_on_the_ground_of_tiles_drawn_at_random(hilly, starts):
    state = starts.pipeline_state
    qpos, tiles = np.asarray(state.qpos), np.asarray(state.tile)
    assert len(set(tiles)) > 3
    assert len(np.unique(qpos[:, :2], axis=0)) == EPISODES
    for place, tile in zip(qpos[:, :2], tiles, strict=True):
        start, spread = hilly.terrain.tiles[tile].start, hilly.terrain.tiles[tile].spread
        offset = sprint.TASK.env.reset.offset * np.array([0, 1])
        assert np.all(np.abs(place - start) <= spread + offset + 1e-5)
    soles, others = jax.vmap(lambda q: compute_lowest_points(hilly.model, q))(state.qpos)
    lowest = np.minimum(np.min(soles[:, :, 2], axis=1), np.min(others, axis=1))
    np.testing.assert_allclose(lowest, 0.0, atol=1e-4)


def test_an_episode_starts_on_the_tile_that_is_asked_for(hilly):
    keys = jax.random.split(jax.random.PRNGKey(1), 6)
    states = jax.jit(jax.vmap(hilly.reset))(keys, jnp.arange(6))
    np.testing.assert_array_equal(states.pipeline_state.tile, np.arange(6))
    middles = np.array([tile.middle for tile in hilly.terrain.tiles])
    assert np.abs(np.asarray(states.pipeline_state.qpos[:, :2]) - middles).max() < 0.6


def test_the_scan_and_the_height_are_those_of_the_field(hilly, starts):
    qpos = np.asarray(starts.pipeline_state.qpos)
    names = hilly.sensors.names
    assert len(names) == 15 + 1
    for q, observation in zip(qpos, np.asarray(starts.obs), strict=True):
        heading = float(compute_yaw(jnp.asarray(q[3:7])))
        ahead, left = np.meshgrid(np.arange(-2, 3) / 10, np.arange(-1, 2) / 10, indexing="ij")
        turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        points = q[:2] + np.stack([ahead.ravel(), left.ravel()], axis=1) @ turn.T
        below = q[2] - hilly.robot.home_height - hilly.terrain.field.compute_height(points)
        np.testing.assert_allclose(observation[:15], np.clip(below, -0.5, 0.5), atol=2e-4)
        assert observation[15] == pytest.approx(
            q[2] - hilly.terrain.field.compute_height(q[:2]), abs=1e-4
        )


def test_falls_are_told_by_heights_above_ground_and_leaving_the_field_is_none(
    hilly, hilly_step, starts
):
    idle = jnp.zeros((EPISODES, 12))
    state = starts.pipeline_state
    assert not np.any(hilly_step(starts, idle).done)  # though trunks are 1.5 m under 0 in hollows
    physics = state.physics

    def place_at(qpos):
        return starts.replace(pipeline_state=state._replace(physics=physics._replace(qpos=qpos)))

    sunk = hilly_step(place_at(physics.qpos.at[:, 2].add(-0.25)), idle)
    assert np.all(np.asarray(sunk.info["end"]) >= 2)
    away = physics.qpos.at[:, 0].set(hilly.terrain.field.size[0] / 2 - 0.5).at[:, 2].set(0.4)
    left = hilly_step(place_at(away), idle)
    assert np.all(np.asarray(left.info["end"]) == 1)
    assert np.all(np.asarray(left.info["truncation"]) == 1.0)


def test_how_far_an_episode_has_come_is_counted(hilly, hilly_step, starts):
    travel = starts.pipeline_state.travel
    start = starts.pipeline_state.qpos[:, :2]
    np.testing.assert_array_equal(travel.start, start)
    actions = jnp.zeros((EPISODES, 12)).at[0].set(jnp.nan)  # which ends it where it is
    after = hilly_step(starts, actions).pipeline_state
    np.testing.assert_array_equal(after.qpos[0], starts.pipeline_state.qpos[0])
    ahead = np.asarray(after.qpos[:, 0] - start[:, 0])  # of a task without commands, along x
    np.testing.assert_allclose(after.travel.walked, ahead, atol=1e-6)
    pace = 6.0 / 2 / hilly.config.episode_seconds
    np.testing.assert_allclose(after.travel.commanded, pace * hilly.config.control_dt, rtol=1e-5)


def test_an_episode_can_be_confined_to_its_tile(hilly, starts):
    ground = dataclasses.replace(hilly.config.ground, confined=True)
    confined = QuadrupedEnv(hilly.quadruped, dataclasses.replace(hilly.config, ground=ground))
    state = starts.pipeline_state
    middles = np.array([hilly.terrain.tiles[tile].middle for tile in state.tile])

    def outside(env, offset):
        qpos = state.qpos.at[:, :2].set(middles + offset)
        new_state = state._replace(physics=state.physics._replace(qpos=qpos))
        return np.asarray(jax.vmap(partial(is_off_ground, env.config, env.terrain))(new_state))

    assert not outside(confined, [2.9, -2.9]).any()
    assert outside(confined, [3.1, 0.0]).all()
    assert outside(confined, [0.0, -3.1]).all()
    assert not outside(hilly, [3.1, 0.0]).any()  # its neighbor, or level ground


def test_the_ground_may_be_an_argument_of_a_program(hilly, starts):
    """Check that the ground is an argument of a program that gets the environment.

    It stays a constant of a program that holds the environment.
    """
    mesh, split = jax.sharding.Mesh(jax.devices(), "robots"), jax.P("robots")

    def reset(env, keys):
        over_devices = jax.shard_map(
            jax.vmap(env.reset), mesh=mesh, in_specs=split, out_specs=split, check_vma=False
        )
        return over_devices(keys)

    keys = jax.random.split(jax.random.PRNGKey(0), EPISODES)
    np.testing.assert_allclose(jax.jit(reset)(hilly, keys).obs, starts.obs, atol=1e-6)
    single = jax.jit(QuadrupedEnv.reset)(hilly, keys[0])
    np.testing.assert_allclose(single.obs, starts.obs[0], atol=1e-6)
    assert count_constants(reset, hilly, keys) < 100_000
    assert count_constants(lambda keys: reset(hilly, keys), keys) > 500_000


def count_constants(function: Any, *arguments: Any) -> int:
    """Return the bytes of the constants that are part of a program."""
    traced = jax.jit(function).trace(*arguments).jaxpr
    return sum(np.asarray(constant).nbytes for constant in traced.consts)


def test_the_blind_leave_the_scan_to_the_value_network():
    seeing, blind = (
        rough.TASK.env,
        dataclasses.replace(rough.TASK.env, blind=True).effective,
    )
    assert list(blind.observation) == [name for name in seeing.observation if name != "height_scan"]
    assert blind.critic["height_scan"] == seeing.observation["height_scan"]
    assert seeing.effective is seeing
    assert blind.effective is blind
    with pytest.raises(UsageError, match=r"env\.blind.*height_scan"):
        dataclasses.replace(sprint.TASK.env, blind=True)


def test_knees_may_touch_where_only_the_trunk_may_not():
    step = SimpleNamespace(lowest=jnp.array([0.02, -0.01]))
    assert terminations.touched(None, step, clearance=0.0)
    assert not terminations.trunk_touched(None, step, clearance=0.0)
    assert terminations.trunk_touched(None, step, clearance=0.03)


def test_a_scan_ahead_is_the_same_ground_further_on(hilly, starts):
    state = jax.tree.map(lambda x: x[0], starts.pipeline_state)
    about = height_scan(hilly.robot, state, length=1.0, width=0.2, spacing=0.1, reach=9.0)
    ahead = scan_ahead(hilly.robot, state, first=0.1, last=0.5, width=0.2, spacing=0.1, reach=9.0)
    np.testing.assert_allclose(ahead, about.reshape(11, 3)[6:].ravel(), atol=1e-5)


def test_other_engines_have_the_same_ground(hilly):
    there = hilly.to_engine("mujoco")
    np.testing.assert_array_equal(there.terrain.field.heights, hilly.terrain.field.heights)
    floor = there.make_mj_model(there.quadruped).geom("floor")
    assert floor.type[0] == hilly.mj_model.geom("floor").type[0] == 1  # a heightfield


def test_a_scan_of_a_flat_floor_is_level(env):
    qpos = jnp.asarray(env.robot.home).at[2].add(0.07)
    state = env.make_example_state()
    state = state._replace(physics=state.physics._replace(qpos=qpos))
    np.testing.assert_allclose(height_scan(env.robot, state, **SCAN), 0.07, atol=1e-6)
