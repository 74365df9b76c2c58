"""The curriculum: the tile after an episode, by hand and by legged_gym's rule."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from quadwalk.env.reset import Curriculum
from quadwalk.env.state import start_travel

LEVELS, TILE, STEPS, DT = 5, 8.0, 1000, 0.02
KINDS = ("flat", "rough", "flat")
LESSONS = Curriculum(KINDS, LEVELS, TILE, STEPS, pace=0.2)
KEYS = jax.random.split(jax.random.PRNGKey(0), 200)


def at(x: float, y: float) -> jax.Array:
    return jnp.zeros(19).at[:2].set(jnp.array([x, y]))


def traveled(velocity, command, steps):
    travel = start_travel(at(1.0, -2.0))
    for _ in range(steps):
        travel = travel.advance(jnp.asarray(velocity), jnp.asarray(command), DT)
    return travel


def following(tile, away, walked, commanded, steps=STEPS, step=STEPS):
    """Return the tiles after an episode of `steps`, now at step `step`, for 200 keys."""
    travel = start_travel(at(1.0, -2.0))._replace(
        steps=jnp.int32(steps), walked=jnp.float32(walked), commanded=jnp.float32(commanded)
    )
    next_of = jax.vmap(
        lambda key: LESSONS.sample_next_tile(
            jnp.int32(tile), travel, at(1.0 + away, -2.0), step, key
        )
    )
    return set(np.asarray(next_of(KEYS)).tolist())


def test_what_is_walked_counts_along_the_command():
    travel = traveled([0.3, 0.4], [0.0, 0.5], 50)
    assert float(travel.walked) == pytest.approx(0.4 * 50 * DT)
    assert float(travel.commanded) == pytest.approx(0.5 * 50 * DT)
    assert int(travel.steps) == 50
    assert travel.start.tolist() == [1.0, -2.0]
    assert float(traveled([0.3, 0.4], [0.0, 0.0], 5).walked) == 0.0


@pytest.mark.parametrize(
    ("away", "walked", "commanded", "change"),
    [
        (4.1, 0.0, 20.0, 1),  # more than half a tile away, whatever was told
        (3.9, 6.0, 11.9, 0),  # as much as half of what it was told, but not far
        (3.9, 5.9, 12.1, -1),
        (0.0, 0.0, 1.9, 0),  # told next to nothing
    ],
)
def test_levels_go_up_and_down_by_one_of_the_same_kind(away, walked, commanded, change):
    middle = 1 * LEVELS + 2
    assert following(middle, away, walked, commanded) == {middle + change}


def test_below_the_first_level_there_is_none_and_from_the_top_to_the_harder_half():
    assert following(2 * LEVELS, 0.0, 0.0, 10.0) == {2 * LEVELS}
    harder = set(range(LEVELS + LEVELS // 2, 2 * LEVELS))
    assert following(1 * LEVELS + LEVELS - 1, 5.0, 9.0, 9.0) == harder


def test_a_fall_counts_for_the_rest_of_the_episode():
    """Check a fall after 100 of 1000 steps.

    The robot has walked all of the 2 m commanded so far. A full episode commands 20 m, so that is a
    tenth.
    """
    middle = LEVELS + 2
    assert following(middle, 2.0, 2.0, 2.0, steps=100, step=100) == {middle - 1}
    # An episode that began at step 900 was planned to be as short as that.
    assert following(middle, 2.0, 2.0, 2.0, steps=100, step=1000) == {middle}
    assert following(middle, 0.0, 0.0, 0.0, steps=0, step=0) == {middle}


def test_one_that_came_to_the_edge_of_its_tile_goes_on():
    """Check that a robot at the edge of its tile goes up a level.

    It started half way there, and the time for its commands is not over.
    """
    confined = dataclasses.replace(LESSONS, middles=tuple((8.0 * k, 1.0) for k in range(15)))
    tile = LEVELS + 1  # its middle is at x = 48
    travel = start_travel(at(50.0, 1.0))._replace(
        steps=jnp.int32(200), walked=jnp.float32(1.8), commanded=jnp.float32(2.0)
    )
    for x, y, change in ((51.8, 1.0, 1), (51.6, 1.0, -1), (48.0, -2.8, 1)):
        next_tile = confined.sample_next_tile(jnp.int32(tile), travel, at(x, y), 200, KEYS[0])
        assert int(next_tile) == tile + change


def test_environments_begin_on_all_kinds_and_the_easier_levels():
    tiles = np.asarray(LESSONS.sample_first_tiles(600, jax.random.PRNGKey(1)))
    assert (tiles // LEVELS).tolist() == [k % 3 for k in range(600)]
    assert set(tiles % LEVELS) == {0, 1, 2}
    evenly = np.asarray(LESSONS.sample_tiles(600, jax.random.PRNGKey(1)))
    assert set(evenly) == set(range(3 * LEVELS))


def test_levels_are_summed_by_kind_whatever_row_it_is():
    tile = jnp.array([0, 3, LEVELS + 4, 2 * LEVELS + 2])
    sums = {name: int(value) for name, value in LESSONS.sum_levels(tile).items()}
    assert sums == {
        "count/robots/flat": 3,
        "count/level/flat": 5,
        "count/robots/rough": 1,
        "count/level/rough": 4,
    }
