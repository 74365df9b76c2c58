"""Bodies for one policy, by MuJoCo's figures of the models that are made of them."""

import dataclasses

import mujoco
import numpy as np
import pytest

from quadwalk.robot import bodies as robot_bodies
from quadwalk.robot.bodies import (
    HEAVIEST,
    HELD_OUT,
    KNEES,
    LIGHTEST,
    RANGES,
    Body,
    is_held_out,
    make_body,
    sample_bodies,
)
from quadwalk.robot.scene import find_lowest_point
from tests.physics.reference import place_robot

# Unitree's figures of the AlienGo, from assets/aliengo.urdf, without units by hand: 23.24 kg, legs
# of 0.25 m and 0.25 m, so that m g L is 114 Nm and sqrt(L / g) 0.2258 s.
TORQUE, TIME = 23.24 * 9.81 * 0.5, (0.5 / 9.81) ** 0.5
ALIENGO = Body(
    leg=0.5,
    density=23.24 / 0.125,
    height=float(np.cos(0.8)),
    thigh=0.5,
    length=0.4814 / 0.5,
    width=0.102 / 0.5,
    offset=0.0868 / 0.5,
    foot=0.0265 / 0.5,
    knee=0.043 / 2 / 0.5,
    legs=11.6 / 23.24,
    hips=1.993 / 2.899,
    calf=0.267 / 2.899,
    ahead=0.008811 / 0.5,
    above=0.000273 / 0.5,
    spread_ahead=1.0,
    spread_aside=1.0,
    effort=35.278 / TORQUE,
    hip_effort=1.0,
    calf_effort=44.4 / 35.278,
    speed=20.0 * TIME,
    hip_speed=1.0,
    calf_speed=15.89 / 20.0,
    rotor=0.009 / (23.24 * 0.25),
    friction=0.425 / TORQUE,
    damping=0.22 / TORQUE / TIME,
    aside=1.2217,
    straight=0.6458,
)
AHEAD = dataclasses.replace(ALIENGO, front_knees=True, hind_knees=True)


def test_the_same_seed_gives_the_same_bodies_and_many_begin_with_few():
    few, many, others = (list(sample_bodies(n, seed)) for n, seed in ((4, 3), (9, 3), (4, 4)))
    assert few == many[:4]
    assert not set(few) & set(others)


def test_bodies_span_the_ranges_and_all_kinds_of_knees():
    bodies = list(sample_bodies(400, 0))
    for name, (low, high) in RANGES.items():
        values = np.array([getattr(body, name) for body in bodies])
        assert low <= values.min() <= values.max() <= high
        assert np.ptp(values) > 0.8 * (high - low), name
    masses = np.array([body.mass for body in bodies])
    assert LIGHTEST < masses.min() < 4.0
    assert 75.0 < masses.max() < HEAVIEST
    assert {(body.front_knees, body.hind_knees) for body in bodies} == set(KNEES)


@pytest.mark.parametrize("held_out", HELD_OUT.values(), ids=HELD_OUT)
def test_a_body_like_a_held_out_robot_is_drawn_anew(held_out, monkeypatch):
    leg, mass, thigh, length, width = held_out
    like = dataclasses.replace(
        ALIENGO, leg=leg, density=mass / leg**3, thigh=thigh, length=length, width=width
    )
    near = dataclasses.replace(like, length=1.02 * length, width=0.98 * width)
    bodies = iter([near, ALIENGO, AHEAD])
    assert is_held_out(like)
    assert not is_held_out(dataclasses.replace(like, length=1.04 * length))
    monkeypatch.setattr(robot_bodies, "_sample_body", lambda rng: next(bodies))
    monkeypatch.setattr(robot_bodies, "HELD_OUT", {"only": held_out})
    expected = AHEAD if is_held_out(ALIENGO) else ALIENGO
    assert list(sample_bodies(1, 0)) == [expected]


def test_the_alien_go_of_its_figures_is_the_alien_go(quadruped):
    body = make_body(ALIENGO)
    body_model, file_model = (robot.make_full_model(visuals=False) for robot in (body, quadruped))
    link_mass = [0, 1, 2, 3, 4]  # world, trunk and the first leg
    np.testing.assert_allclose(
        body_model.body_mass[link_mass], file_model.body_mass[link_mass], rtol=0.02
    )
    np.testing.assert_allclose(body_model.body_pos[1:], file_model.body_pos[1:], atol=1e-3)
    # Its left and right links differ in the file, by a thousandth of mass and inertia.
    moments = (np.sort(model.body_inertia[1:], axis=1) for model in (body_model, file_model))
    np.testing.assert_allclose(*moments, rtol=0.04, atol=2e-5)
    np.testing.assert_allclose(body_model.jnt_range[1:], file_model.jnt_range[1:], atol=0.01)
    knees = [i for i in range(body_model.ngeom) if not body_model.geom(i).name]
    assert len(knees) == 4
    sizes = np.delete(body_model.geom_size, knees, axis=0)
    np.testing.assert_allclose(sizes, file_model.geom_size, atol=1e-4)
    np.testing.assert_allclose(body.effort[:3], quadruped.effort[:3], rtol=1e-3)
    np.testing.assert_allclose(body.velocity[:3], quadruped.velocity[:3], rtol=1e-3)
    np.testing.assert_allclose(body.home[[2, 8, 9]], quadruped.home[[2, 8, 9]], atol=0.02)


@pytest.mark.parametrize("body", [ALIENGO, AHEAD, *sample_bodies(4, 5)], ids=range(6))
def test_a_body_has_its_figures_and_stands_on_its_feet(body):
    robot = make_body(body)
    model = robot.make_full_model()
    data = place_robot(model, robot.home)
    feet = [model.geom(name).id for name in robot.feet]
    hips, thighs, knees = (data.xanchor[1 + i :: 3] for i in range(3))
    mass = model.body_subtreemass[0]
    thigh = np.linalg.norm(knees - thighs, axis=1)
    leg = thigh + np.linalg.norm(data.geom_xpos[feet] - knees, axis=1)
    assert mass == pytest.approx(body.mass, rel=1e-9)
    np.testing.assert_allclose(leg, body.leg, rtol=1e-9)
    np.testing.assert_allclose(thigh / leg, body.thigh, rtol=1e-9)
    np.testing.assert_allclose((hips[0] - hips[2])[0], body.length * body.leg, rtol=1e-9)
    np.testing.assert_allclose((hips[1] - hips[0])[1], body.width * body.leg, rtol=1e-9)
    np.testing.assert_allclose(np.abs(thighs - hips)[:, 1], body.offset * body.leg, rtol=1e-9)
    assert model.body_mass[1] / mass == pytest.approx(1.0 - body.legs, rel=1e-9)
    # The feet are below the thighs' joints, at the height of the figures, and on the floor.
    np.testing.assert_allclose(data.geom_xpos[feet][:, :2], thighs[:, :2], atol=1e-9)
    np.testing.assert_allclose(thighs[:, 2] - data.geom_xpos[feet, 2], body.height * body.leg)
    spheres = [i for i in range(model.ngeom) if not model.geom(i).name]
    np.testing.assert_allclose(data.geom_xpos[spheres], knees, atol=1e-9)
    np.testing.assert_allclose(model.geom_size[spheres, 0], body.knee * body.leg)
    lowest = [find_lowest_point(model, data, foot) for foot in feet]
    np.testing.assert_allclose(lowest, 0.0, atol=1e-9)
    ahead = knees[:, 0] > thighs[:, 0]
    assert ahead.tolist() == [body.front_knees] * 2 + [body.hind_knees] * 2
    torque = body.mass * 9.81 * body.leg
    np.testing.assert_allclose(robot.effort[1::3], body.effort * torque)
    np.testing.assert_allclose(model.actuator_ctrlrange[:, 1], robot.effort)
    speeds = robot.velocity * np.sqrt(body.leg / 9.81)
    np.testing.assert_allclose(speeds[2::3], body.speed * body.calf_speed)
    assert np.all((robot.home[7:] > robot.lower) & (robot.home[7:] < robot.upper))


@pytest.mark.parametrize("body", list(sample_bodies(3, 6)), ids=range(3))
def test_left_and_right_are_exact_mirror_images(body):
    robot = make_body(body)
    model = robot.make_full_model()
    data = place_robot(model, robot.home)
    flip = np.diag([1.0, -1.0, 1.0])
    right, left = (model.jnt_bodyid[1:].reshape(4, 3)[side::2].ravel() for side in (0, 1))
    frames = data.ximat.reshape(-1, 3, 3)
    inertia = frames * model.body_inertia[:, None] @ frames.transpose(0, 2, 1)
    np.testing.assert_allclose(data.xipos[right], data.xipos[left] @ flip, atol=1e-12)
    np.testing.assert_allclose(inertia[right], flip @ inertia[left] @ flip, atol=1e-12)
    np.testing.assert_allclose(inertia[1], flip @ inertia[1] @ flip, atol=1e-12)
    assert data.xipos[1, 1] == pytest.approx(0.0, abs=1e-12)
    # A body of mass has moments that obey the triangle's inequality.
    assert np.all(model.body_inertia[1:].sum(axis=1) > 2 * model.body_inertia[1:].max(axis=1))


def test_a_trunk_of_twice_the_mass_and_length_has_eight_times_the_inertia():
    longer = dataclasses.replace(ALIENGO, length=2 * ALIENGO.length, density=2 * ALIENGO.density)
    one, other = (make_body(body).make_full_model() for body in (ALIENGO, longer))

    def moments(model: mujoco.MjModel) -> np.ndarray:
        full = np.zeros(9)
        mujoco.mju_quat2Mat(full, model.body_iquat[1])
        turn = full.reshape(3, 3)
        return np.diag(turn @ np.diag(model.body_inertia[1]) @ turn.T)

    # Of xx, yy and zz, half the sum less xx is the moment of mass along x.
    along = [moments(model).sum() / 2 - moments(model)[0] for model in (one, other)]
    assert along[1] == pytest.approx(8.0 * along[0])
    assert moments(other)[0] == pytest.approx(2.0 * moments(one)[0])
