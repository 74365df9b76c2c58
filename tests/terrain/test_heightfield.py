"""Heights between nodes and a field as a model's floor, by MuJoCo's own rays."""

import mujoco
import numpy as np
import pytest

from quadwalk.terrain.heightfield import lay, make_field, read_field
from tests.physics.reference import measure_heights


def lay_field(quadruped, field) -> mujoco.MjModel:
    spec = quadruped.spec.copy()
    lay(spec, field)
    return spec.compile()


@pytest.mark.parametrize("seed", range(5))
def test_heights_are_those_that_mujocos_rays_meet(quadruped, seed):
    rng = np.random.default_rng(seed)
    field = make_field(rng.uniform(-2, 1, rng.integers(2, 30, 2)), 0.05)
    model = lay_field(quadruped, field)
    length, width = field.size
    points = rng.uniform(-0.499, 0.499, (200, 2)) * [length, width]
    ray_heights = measure_heights(model, points)
    np.testing.assert_allclose(field.compute_height(points), ray_heights, atol=1e-5)


@pytest.mark.parametrize("low", [-0.3, 0.0, 0.2])
def test_a_model_has_the_fields_numbers_and_the_planes_friction(quadruped, low):
    heights = np.random.default_rng(0).uniform(low, low + 0.5, (20, 30))
    field = make_field(heights, 0.05)
    model = lay_field(quadruped, field)
    model_field = read_field(model)
    np.testing.assert_allclose(model_field.heights, heights, atol=1e-6)
    assert model_field.cell == pytest.approx(0.05)
    assert model_field.origin == pytest.approx(field.origin)
    plane = quadruped.make_full_model()
    assert read_field(plane) is None
    for name in ("friction", "solref", "solimp", "contype", "conaffinity"):
        field_value, plane_value = (getattr(m.geom("floor"), name) for m in (model, plane))
        np.testing.assert_array_equal(field_value, plane_value)


def test_level_ground_is_a_field_too(quadruped):
    field = read_field(lay_field(quadruped, make_field(np.full((5, 5), 0.3), 0.05)))
    np.testing.assert_allclose(field.heights, 0.3, atol=1e-6)


def test_beyond_an_edge_the_ground_goes_on_level():
    field = make_field(np.random.default_rng(0).uniform(0, 1, (5, 5)), 0.05)
    assert field.compute_height(np.array([9.0, 9.0])) == field.heights[-1, -1]
    assert field.compute_height(np.array([-9.0, 0.0])) == field.heights[2, 0]
