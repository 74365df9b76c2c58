"""Tiles and the field they make: sizes, seams, seeds, files, and what is wrong with them."""

import dataclasses
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from quadwalk.errors import UsageError, UserError
from quadwalk.terrain.cli import main
from quadwalk.terrain.terrain import FLAT, leg_length, make_terrain, sizes_of
from quadwalk.terrain.tiles import KINDS, OF_LEG, Patch, make_tile

LEG = 0.5
EVERY = dataclasses.replace(FLAT, kinds=tuple(KINDS))
SMALL = dataclasses.replace(EVERY, levels=2, border=1.0)
CELL = 0.05
PATCH = Patch(CELL * np.arange(-80, 81), CELL * np.arange(-80, 81), CELL)
SIZES = sizes_of(FLAT, LEG)


def tile(kind: str, difficulty: float = 1.0, seed: int = 0) -> np.ndarray:
    return make_tile(kind, PATCH, SIZES, difficulty, np.random.default_rng(seed))


def test_every_kind_and_level_is_made_in_under_a_second():
    began = time.process_time()
    terrain = make_terrain(EVERY, LEG)
    assert time.process_time() - began < 1.0
    assert len(terrain.tiles) == len(KINDS) * 10
    assert terrain.field.heights.dtype == np.float32
    assert terrain.field.size == pytest.approx((88.0, 88.0))


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(sorted(KINDS)), st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_a_tile_is_bounded_by_its_difficulty_and_level_where_robots_start(kind, difficulty, seed):
    heights = tile(kind, difficulty, seed)
    assert np.all(np.isfinite(heights))
    if difficulty == 0.0:
        assert not heights.any()
    bounds = {
        "rough": 0.08,
        "waves": 0.08,
        "blocks": 0.15,
        "ditches": 0.3,
        "course": 0.3,
        "flat": 0,
    }
    assert np.abs(heights).max() <= difficulty * bounds.get(kind, 3.6) + 1e-9
    if kind not in ("rough", "waves", "course"):
        assert np.ptp(heights[72:89, 72:89]) < 1e-9  # 80 cm around the middle
    if kind.startswith(("slope", "stairs")) or kind in ("flat", "ditches"):
        edge = np.concatenate([heights[0], heights[-1], heights[:, 0], heights[:, -1]])
        np.testing.assert_allclose(edge, 0.0, atol=1e-9)


def test_at_difficulty_1_tiles_have_the_sizes_of_a_leg_of_half_a_meter():
    along = tile("slope_up")[80, 92:]  # ahead of the middle
    np.testing.assert_allclose(np.diff(along), CELL * np.tan(np.radians(25)))
    np.testing.assert_allclose(tile("slope_down")[80, 92:], -along)
    stairs = tile("stairs_up")[80, 80:]
    risers = np.flatnonzero(np.diff(stairs))
    np.testing.assert_allclose(np.diff(stairs)[risers], 0.15)
    np.testing.assert_allclose(CELL * np.diff(risers), 0.3)
    assert len(risers) == 11
    np.testing.assert_allclose(tile("stairs_down")[80, 80:], -stairs)
    ditch = tile("ditches")[80, 80:]
    assert set(ditch) == {0.0, -0.3}
    assert np.abs(tile("rough")).max() > 0.07
    assert np.ptp(tile("waves")) > 0.15
    blocks = tile("blocks")
    assert 0.13 < blocks.max() <= 0.15
    assert 0.3 < np.mean(blocks > 0) < 0.7
    course = tile("course")
    assert 0.05 < course.max() <= 0.15
    assert course.min() == -0.3


def test_sizes_grow_with_the_leg_unless_given(quadruped):
    assert leg_length(quadruped.make_full_model(), quadruped.feet[0]) == pytest.approx(0.5)
    assert sizes_of(FLAT, 1.0) == OF_LEG
    assert sizes_of(FLAT, 0.2).step == pytest.approx(0.06)
    given_sizes = dataclasses.replace(FLAT, step=0.1, tread=0.4, block=0.2, roughness=0.03)
    found = sizes_of(given_sizes, 0.2)
    assert (found.step, found.tread, found.block, found.roughness) == (0.1, 0.4, 0.2, 0.03)
    assert found.slope == OF_LEG.slope


def test_the_same_seed_makes_the_same_ground_and_another_another():
    first, again = (make_terrain(SMALL, LEG).field for _ in range(2))
    np.testing.assert_array_equal(first.heights, again.heights)
    other = make_terrain(SMALL.unseen(), LEG)
    for kind in ("rough", "waves", "blocks", "course"):
        place = other.tile(kind, 1)
        x, y = (np.arange(-size / 2, size / 2, CELL) for size in place.size)
        grid = np.stack(np.meshgrid(x, y), axis=-1) + place.middle
        assert np.abs(other.field.height_at(grid) - first.height_at(grid)).max() > 0.05


def test_tiles_lie_where_the_terrain_says():
    terrain = make_terrain(SMALL, LEG)
    for level, depth in ((0, 0.0), (1, -3.5 * np.tan(np.radians(25)))):
        place = terrain.tile("slope_up", level)
        assert place.difficulty == level
        assert terrain.field.height_at(np.array(place.middle)) == pytest.approx(depth, abs=1e-5)
        assert place.start == place.middle
    course = terrain.tile("course", 1)
    assert course.start[0] == pytest.approx(course.middle[0] - 3.5)  # at its near end
    start = course.start + np.array([[-0.2, 0.0], [0.2, 0.0]])
    np.testing.assert_array_equal(terrain.field.height_at(start), 0.0)


def test_a_field_of_ones_own(tmp_path):
    heights = np.random.default_rng(0).uniform(-1, 1, (30, 40))
    np.save(tmp_path / "own.npy", heights)
    own = dataclasses.replace(FLAT, file=tmp_path / "own.npy")
    found = make_terrain(own, LEG)
    np.testing.assert_allclose(found.field.heights, heights, atol=1e-7)
    assert found.field.size == pytest.approx((39 * CELL, 29 * CELL))
    assert found.tile("file", 0).start == (0.0, 0.0)
    for bits, kind in ((8, np.uint8), (16, np.uint16)):
        white = 2**bits - 1
        pixels = np.random.default_rng(1).integers(0, white, (20, 25)).astype(kind)
        Image.fromarray(pixels).save(tmp_path / "own.png")
        config = dataclasses.replace(FLAT, file=tmp_path / "own.png", white=0.3)
        found = make_terrain(config, LEG)
        np.testing.assert_allclose(found.field.heights[::-1], 0.3 * pixels / white, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.npy", None, "No such file"),
        ("none.png", None, "No such file"),
        ("ground.txt", b"0 1 2", "expected a gray PNG, or an .npy"),
        ("text.npy", b"0 1 2", "cannot be read; expected a gray PNG, or an .npy"),
        ("text.png", b"0 1 2", "cannot be read; expected a gray PNG"),
        ("empty.npy", b"", "cannot be read"),
        ("names.npy", np.array([["a", "b"]]), "array of numbers"),
        ("line.npy", np.zeros(5), "two dimensions"),
        ("narrow.npy", np.zeros((1, 5)), "two dimensions"),
        ("hole.npy", np.full((5, 5), np.nan), "not finite"),
    ],
)
def test_a_wrong_file_is_one_clear_line(tmp_path, name, content, message):
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    elif content is not None:
        np.save(tmp_path / name, content)
    with pytest.raises(UserError, match=message) as caught:
        make_terrain(dataclasses.replace(FLAT, file=tmp_path / name), LEG)
    assert name in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kinds": ("flat", "lava")}, "no terrain 'lava'; expected some of: flat, slope_up"),
        (
            {"difficulty": (0.5, 1.5)},
            r"difficulty is \(0.5, 1.5\); expected 2 numbers, each 0 to 1",
        ),
        ({"difficulty": (0.5, 0.2)}, "the lower first"),
        ({"levels": 0}, "levels is 0; expected 1 to 1000"),
        ({"seed": -1}, "seed is -1; expected 0 or more"),
        ({"tile": (8.0, 0.1)}, "expected length and width of 10 cells or more"),
        ({"cell": 0.0}, "cell is 0.0; expected 0.005 to 1 m"),
        ({"border": -1.0}, "border is -1.0"),
        ({"step": 0.0}, "step is 0.0; expected more than 0 m"),
    ],
)
def test_wrong_settings_are_one_clear_line(changes, message):
    with pytest.raises(UsageError, match=message):
        dataclasses.replace(FLAT, **changes)


def test_what_there_is_not_is_one_clear_line():
    terrain = make_terrain(SMALL, LEG)
    with pytest.raises(UsageError, match="no tile 'lava'; it has: flat, slope_up"):
        terrain.tile("lava", 0)
    with pytest.raises(UsageError, match="no tile 'rough' of level 2; expected 0 to 1"):
        terrain.tile("rough", 2)
    with pytest.raises(UsageError, match=r"difficulty of terrain 'rough' is 1.5; expected 0 to 1"):
        tile("rough", 1.5)
    with pytest.raises(UsageError, match="no terrain 'lava'; expected one of"):
        tile("lava")
    vast = dataclasses.replace(EVERY, tile=(800.0, 800.0))
    with pytest.raises(UsageError, match="expected fewer tiles, smaller ones"):
        make_terrain(vast, LEG)


def test_the_command_draws_every_kind_it_is_asked_for_with_the_robot_on_it(tmp_path):
    command = [sys.executable, "-m", "quadwalk", "terrain", "-o", str(tmp_path / "ground.png")]
    subprocess.run([*command, "--kinds", "stairs_up", "flat", "--levels", "2"], check=True)
    pixels = np.asarray(Image.open(tmp_path / "ground.png").convert("RGB")).astype(int)
    assert pixels.shape == (2 * 320 + 4, 2 * 480 + 4, 3)
    (_, stairs), (_, flat) = (
        np.split(row[:, :960], 2, axis=1) for row in (pixels[:320], pixels[324:])
    )
    for picture in (stairs, flat):  # the robot is orange
        assert (picture[..., 0] - picture[..., 2] > 100).mean() > 0.003
    # Stairs have edges that a level floor has not.
    edges = [(np.abs(np.diff(each.sum(axis=2), axis=0)) > 100).mean() for each in (stairs, flat)]
    assert edges[0] > 1.5 * edges[1]


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("--levels 0", r"^--levels is 0; expected 1 to"),
        ("--levels many", r"^bad value for --levels; expected INT"),
        ("--kinds sea", r"^--kinds: no terrain 'sea'; expected some of: "),
    ],
)
def test_the_command_names_the_flag_that_was_given(tmp_path, flags, said):
    with pytest.raises(UsageError, match=said):
        main(["-o", str(tmp_path / "a.png"), *flags.split()])
