"""Tiles and the field they make: sizes, seams, seeds, files and their errors."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from quadwalk.errors import UsageError, UserError
from quadwalk.terrain.cli import main
from quadwalk.terrain.terrain import FLAT, make_sizes, make_terrain, measure_leg
from quadwalk.terrain.tiles import KINDS, OF_LEG, Patch

LEG = 0.5
EVERY = dataclasses.replace(FLAT, kinds=tuple(KINDS))
SMALL = dataclasses.replace(EVERY, levels=2, border=1.0)
CELL = 0.05
PATCH = Patch(CELL * np.arange(-80, 81), CELL * np.arange(-80, 81), CELL)
SIZES = make_sizes(FLAT, LEG)


def make_tile(kind: str, difficulty: float = 1.0, seed: int = 0) -> np.ndarray:
    return KINDS[kind](PATCH, SIZES, difficulty, np.random.default_rng(seed))


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(sorted(KINDS)), st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_a_tile_is_bounded_by_its_difficulty_and_level_where_robots_start(kind, difficulty, seed):
    heights = make_tile(kind, difficulty, seed)
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
    along = make_tile("slope_up")[80, 92:]  # ahead of the middle
    np.testing.assert_allclose(np.diff(along), CELL * np.tan(np.radians(25)))
    np.testing.assert_allclose(make_tile("slope_down")[80, 92:], -along)
    stairs = make_tile("stairs_up")[80, 80:]
    risers = np.flatnonzero(np.diff(stairs))
    np.testing.assert_allclose(np.diff(stairs)[risers], 0.15)
    np.testing.assert_allclose(CELL * np.diff(risers), 0.3)
    assert len(risers) == 11
    np.testing.assert_allclose(make_tile("stairs_down")[80, 80:], -stairs)
    ditch = make_tile("ditches")[80, 80:]
    assert set(ditch) == {0.0, -0.3}
    assert np.abs(make_tile("rough")).max() > 0.07
    assert np.ptp(make_tile("waves")) > 0.15
    blocks = make_tile("blocks")
    assert 0.13 < blocks.max() <= 0.15
    assert 0.3 < np.mean(blocks > 0) < 0.7
    course = make_tile("course")
    assert 0.05 < course.max() <= 0.15
    assert course.min() == -0.3


def test_sizes_grow_with_the_leg_unless_given(quadruped):
    assert measure_leg(quadruped.make_full_model(), quadruped.feet[0]) == pytest.approx(0.5)
    assert make_sizes(FLAT, 1.0) == OF_LEG
    assert make_sizes(FLAT, 0.2).step == pytest.approx(0.06)
    given_sizes = dataclasses.replace(FLAT, step=0.1, tread=0.4, block=0.2, roughness=0.03)
    sizes = make_sizes(given_sizes, 0.2)
    assert (sizes.step, sizes.tread, sizes.block, sizes.roughness) == (0.1, 0.4, 0.2, 0.03)
    assert sizes.slope == OF_LEG.slope


def test_the_same_seed_makes_the_same_ground_and_another_another():
    first, again = (make_terrain(SMALL, LEG).field for _ in range(2))
    np.testing.assert_array_equal(first.heights, again.heights)
    other = make_terrain(SMALL.make_unseen(), LEG)
    for kind in ("rough", "waves", "blocks", "course"):
        place = other.find_tile(kind, 1)
        x, y = (np.arange(-size / 2, size / 2, CELL) for size in place.size)
        grid = np.stack(np.meshgrid(x, y), axis=-1) + place.middle
        assert np.abs(other.field.compute_height(grid) - first.compute_height(grid)).max() > 0.05


def test_tiles_lie_where_the_terrain_says():
    terrain = make_terrain(SMALL, LEG)
    assert len(terrain.tiles) == len(KINDS) * 2
    assert terrain.field.heights.dtype == np.float32
    assert terrain.field.size == pytest.approx((18.0, 2.0 + 8.0 * len(KINDS)))
    for level, depth in ((0, 0.0), (1, -3.5 * np.tan(np.radians(25)))):
        place = terrain.find_tile("slope_up", level)
        assert place.difficulty == level
        height = terrain.field.compute_height(np.array(place.middle))
        assert height == pytest.approx(depth, abs=1e-5)
        assert place.start == place.middle
    course = terrain.find_tile("course", 1)
    assert course.start[0] == pytest.approx(course.middle[0] - 3.5)  # at its near end
    start = course.start + np.array([[-0.2, 0.0], [0.2, 0.0]])
    np.testing.assert_array_equal(terrain.field.compute_height(start), 0.0)


def test_a_field_is_read_from_a_file(tmp_path):
    heights = np.random.default_rng(0).uniform(-1, 1, (30, 40))
    np.save(tmp_path / "field.npy", heights)
    terrain = make_terrain(dataclasses.replace(FLAT, file=tmp_path / "field.npy"), LEG)
    np.testing.assert_allclose(terrain.field.heights, heights, atol=1e-7)
    assert terrain.field.size == pytest.approx((39 * CELL, 29 * CELL))
    assert terrain.find_tile("file", 0).start == (0.0, 0.0)
    for bits, kind in ((8, np.uint8), (16, np.uint16)):
        white = 2**bits - 1
        pixels = np.random.default_rng(1).integers(0, white, (20, 25)).astype(kind)
        Image.fromarray(pixels).save(tmp_path / "field.png")
        config = dataclasses.replace(FLAT, file=tmp_path / "field.png", white=0.3)
        terrain = make_terrain(config, LEG)
        np.testing.assert_allclose(terrain.field.heights[::-1], 0.3 * pixels / white, atol=1e-6)


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


def test_a_tile_or_field_that_cannot_be_is_one_clear_line():
    with pytest.raises(
        UsageError, match="no tile 'rough' of level 2; it has: flat 0, flat 1, slope"
    ):
        make_terrain(SMALL, LEG).find_tile("rough", 2)
    with pytest.raises(UsageError, match="expected fewer tiles, smaller ones"):
        make_terrain(dataclasses.replace(EVERY, tile=(800.0, 800.0)), LEG)


def test_the_command_draws_every_kind_with_the_robot_on_it(tmp_path):
    out = str(tmp_path / "ground.png")
    main(["-o", out, "--kinds", "stairs_up", "flat", "--levels", "2"])
    pixels = np.asarray(Image.open(tmp_path / "ground.png").convert("RGB")).astype(int)
    assert pixels.shape == (2 * 320 + 4, 2 * 480 + 4, 3)
    (_, stairs), (_, flat) = (
        np.split(row[:, :960], 2, axis=1) for row in (pixels[:320], pixels[324:])
    )
    edges = []
    for picture in (stairs, flat):  # the robot is orange
        assert (picture[..., 0] - picture[..., 2] > 100).mean() > 0.003
        edges.append((np.abs(np.diff(picture.sum(axis=2), axis=0)) > 100).mean())
    assert edges[0] > 1.5 * edges[1]  # stairs have edges that a level floor has not


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--levels 0", r"^--levels is 0; expected 1 to"),
        ("--levels many", r"^bad value for --levels; expected INT"),
        ("--kinds sea", r"^--kinds: no terrain 'sea'; expected some of: "),
    ],
)
def test_the_command_names_the_flag_that_was_given(tmp_path, flags, message):
    with pytest.raises(UsageError, match=message):
        main(["-o", str(tmp_path / "a.png"), *flags.split()])
