"""Robots on windows of a field, against MuJoCo on the whole of it."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from quadwalk.physics.model import RobotRandomization
from quadwalk.physics.mujoco_c import Stepper, randomize_model
from quadwalk.terrain.heightfield import lay, make_field
from quadwalk.terrain.windows import STRIDE, measure_reach
from tests.physics.reference import measure_heights, place_robot


@pytest.fixture(scope="module")
def stepper(quadruped):
    x, y = 0.05 * np.arange(275), 0.05 * np.arange(175)[:, None]
    heights = 0.05 * np.sin(2.3 * x + 1.1 * y) + 0.05 * np.sin(1.7 * y - 0.6 * x) - 0.5
    field = make_field(heights, 0.05)
    spec = quadruped.spec.copy()
    lay(spec, field)
    robot = replace(quadruped, spec=spec)
    return Stepper(robot.make_full_model(), robot)


def make_variations(count: int) -> RobotRandomization:
    """Return robots that differ in friction and in the load on their trunk."""
    rng = np.random.default_rng(1)
    same = dict.fromkeys(RobotRandomization._fields, np.ones(count))
    changed = {
        "friction": rng.uniform(0.3, 1.0, count),
        "trunk_mass": rng.uniform(-1.0, 5.0, count),
        "trunk_center": rng.uniform(-0.05, 0.05, (count, 3)),
        "link_mass": np.ones((count, 12)),
    }
    return RobotRandomization(**same | changed)


def sample_places(stepper, count: int) -> np.ndarray:
    """Return places (n, 2), m, anywhere on the field, half of them just where windows meet."""
    rng = np.random.default_rng(2)
    half = stepper.model.hfield_size[0, :2]
    points = rng.uniform(-half, half, (count, 2))
    edges = STRIDE * (0.5 + rng.integers(0, 6, count // 2)) - half[0]
    points[: count // 2, 0] = edges + rng.uniform(-0.01, 0.01, count // 2)
    return points


def test_around_a_robot_the_ground_is_that_of_the_field(stepper):
    """Measure heights by MuJoCo's rays."""
    rng, most = np.random.default_rng(3), measure_reach(stepper.model)
    half = stepper.model.hfield_size[0, :2]
    where = sample_places(stepper, 40)
    models, origins = stepper.find_models(make_variations(40), where)
    assert len({tuple(origin) for origin in origins}) > 10
    points = np.clip(where[:, None] + rng.uniform(-most, most, (40, 20, 2)) / 2**0.5, -half, half)

    for model, origin, near in zip(models, origins, points, strict=True):
        inside = near * (1 - 1e-9)
        expected = measure_heights(stepper.model, inside)
        np.testing.assert_allclose(measure_heights(model, inside - origin), expected, atol=1e-9)


def test_robots_step_as_on_the_whole_field(quadruped, stepper):
    """Check agreement to the last digits, but for some robots that touch the ground.

    How deep MuJoCo finds a shape in several of a field's prisms hangs on these digits. The same
    happens to a robot that is moved by 1e-14 m on one field.
    """
    count, rng = 200, np.random.default_rng(4)
    states, rows = np.zeros((count, 38)), make_variations(count)
    states[:, 1:20] = quadruped.home
    states[:, 1:3] = 0.8 * sample_places(stepper, count)
    states[:, 3] -= rng.uniform(0.42, 0.5, count)  # from just above to up to the knees
    states[:, 8:20] += rng.uniform(-0.3, 0.3, (count, 12))
    states[:, 20:] = rng.uniform(-3, 3, (count, 18))
    torque = rng.uniform(-10, 10, (count, 12))
    models, origins = stepper.find_models(rows, states[:, 1:3])
    shift = np.pad(origins, [(0, 0), (1, 35)])
    states_after = (stepper.step(states - shift, torque, models) + shift)[:, 1:]
    expected, touching = np.zeros((count, 37)), np.zeros(count)
    for k in range(count):
        model = randomize_model(stepper.model, RobotRandomization(*(x[k] for x in rows)))
        data = mujoco.MjData(model)
        data.qpos, data.qvel, data.qfrc_applied[6:] = states[k, 1:20], states[k, 20:], torque[k]
        mujoco.mj_step(model, data)
        expected[k], touching[k] = [*data.qpos, *data.qvel], data.ncon
    same = np.abs(states_after - expected).max(axis=1) < 1e-9
    assert same[touching > 0].mean() > 0.4  # none, were they elsewhere
    assert (touching > 0).mean() > 0.3
    assert np.all(same[touching == 0])
    np.testing.assert_allclose(states_after[:, :19], expected[:, :19], atol=0.05)


def test_a_model_is_kept_while_its_robot_is_there(stepper):
    rows, places = make_variations(3), np.array([[0.0, 0.0], [3.0, 1.0], [-5.0, 2.0]])
    first, _ = stepper.find_models(rows, places)
    again, _ = stepper.find_models(rows, places + 0.01)
    assert all(a is b for a, b in zip(first, again, strict=True))
    distant_models, _ = stepper.find_models(rows, places + np.array([2.0, 0.0]))
    assert not any(a is b for a in first for b in distant_models)
    for a, b in zip(first, distant_models, strict=True):
        np.testing.assert_array_equal(a.body_mass, b.body_mass)
        assert np.any(a.hfield_data != b.hfield_data)
    alone, _ = stepper.find_models(RobotRandomization(*(x[:1] for x in rows)), places[:1])
    assert len(stepper._models) == len(alone) == 1


def test_robots_alike_share_a_model_where_they_are_on_the_same_ground(stepper):
    rows = RobotRandomization(*(np.repeat(x, 3, axis=0) for x in make_variations(1)))
    models, _ = stepper.find_models(rows, np.array([[0.0, 0.0], [0.1, 0.0], [4.0, 0.0]]))
    assert models[0] is models[1]
    assert models[0] is not models[2]


def test_a_model_of_ones_own_is_small(quadruped, stepper):
    flat = Stepper(quadruped.make_full_model(), quadruped)
    for steps in (stepper, flat):
        (model,), origins = steps.find_models(make_variations(1), np.array([[3.0, 1.0]]))
        assert mujoco.mj_sizeModel(model) < 0.1 * mujoco.mj_sizeModel(steps.model)
    assert not origins.any()


def test_no_part_of_a_robot_is_farther_than_its_reach(quadruped):
    model = quadruped.make_full_model()
    most, farthest = measure_reach(model), 0.0
    rng = np.random.default_rng(3)
    low, high = quadruped.lower, quadruped.upper
    for joints in [*rng.uniform(low, high, (200, 12)), [0.0] * 12]:
        data = place_robot(model, np.r_[quadruped.home[:7], joints])
        for foot in quadruped.feet:
            geom = data.geom(foot)
            away = np.linalg.norm(geom.xpos - data.qpos[:3]) + model.geom(foot).size[0]
            farthest = max(farthest, away)
    assert farthest < most < 1.5 * farthest
