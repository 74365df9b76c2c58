"""Feet of any shape, knees of any kind, hips of any zero: all from the legs' structure."""

from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import Quadruped, make_quadruped
from quadwalk.robot.report import UrdfError
from quadwalk.robot.scene import find_lowest_point
from quadwalk.robot.urdf import parse_urdf
from tests.robot import robots
from tests.robot.robots import ball_calf, check_stands, inertial, joint, link, plain_leg, shape


def made(calf, leg=plain_leg, folder: Path | None = None) -> Quadruped:
    """`robots.quadruped`, with meshes from a folder."""
    return make_quadruped(parse_urdf(robots.quadruped(calf, leg), "r.urdf", folder))


def stands(quadruped: Quadruped) -> None:
    """On its feet alone, and PD control keeps it up.

    A foot's sphere fits into the end of a calf whose edges reach further, but in training they end
    at its center or before it.
    """
    for model, deepest in (
        (quadruped.make_full_model(), 1 - np.sqrt(2)),  # a square edge at 45 degrees
        (quadruped.make_training_model(0.002, contacts="body"), 0),
    ):
        data = robots.make_data(model, quadruped.home)
        heights = {
            model.geom(geom).name: find_lowest_point(model, data, geom)
            for geom in range(model.ngeom)
            if model.geom_bodyid[geom] and model.geom_group[geom] == 3
        }
        feet = [heights.pop(foot) for foot in quadruped.feet]
        np.testing.assert_allclose(feet, 0, atol=1e-6)
        radius = model.geom(quadruped.feet[0]).size[0]
        assert min(heights.values()) >= deepest * radius, heights
    check_stands(quadruped, 3, 0.8)


def foot_link(name: str, geometry: str, kind: str = "collision") -> str:
    """A thin calf of .2 m, and a foot's link bolted to its end."""
    return (
        link(f"{name}3", inertial(0.5), shape('cylinder radius="0.005" length="0.18"', "0 0 -0.09"))
        + link(f"{name}_foot", inertial(0.01, "1e-5 1e-5 1e-5"), shape(geometry, kind=kind))
        + joint(f"{name}_bolt", f"{name}3", f"{name}_foot", xyz="0 0 -0.2", kind="fixed")
    )


def one_shape(name: str, geometry: str, rpy: str = "0 0 0") -> str:
    """A calf of .2 m that is all one shape."""
    return link(f"{name}3", inertial(0.5), shape(geometry, "0 0 -0.1", rpy=rpy))


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    """A ball of 3 cm that is centered 1 cm off, a wheel of 2 cm about y, and a spindly calf."""
    ball = trimesh.creation.icosphere(3, 0.03)
    ball.apply_translation([0.01, 0, 0])
    ball.export(tmp_path / "ball.stl")
    wheel = trimesh.creation.cylinder(0.02, 0.01, sections=64)
    wheel.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    wheel.export(tmp_path / "wheel.stl")
    trimesh.creation.box((0.02, 0.02, 0.2)).export(tmp_path / "calf.stl")
    return tmp_path


# What the calf is, the foot's radius and the height of its center below the calf's joint, m.
FEET = {
    "a ball's mesh": (partial(foot_link, geometry='mesh filename="ball.stl"'), 0.03, 0.2),
    "a wheel's mesh": (partial(foot_link, geometry='mesh filename="wheel.stl"'), 0.02, 0.2),
    "a box": (partial(foot_link, geometry='box size="0.03 0.03 0.03"'), 0.015, 0.2),
    "a flat box": (partial(foot_link, geometry='box size="0.05 0.05 0.02"'), 0.01, 0.2),
    "a cylinder": (partial(one_shape, geometry='cylinder radius="0.01" length="0.2"'), 0.01, 0.19),
    "a whole calf's mesh": (partial(one_shape, geometry='mesh filename="calf.stl"'), 0.01, 0.19),
    "only seen": (
        lambda name: link(
            f"{name}3", inertial(0.5), shape('sphere radius="0.02"', "0 0 -0.18", "visual")
        ),
        0.02,
        0.18,
    ),
    "only a frame": (
        lambda name: (
            link(f"{name}3", inertial(0.5))
            + link(f"{name}tip")
            + joint(f"{name}bolt", f"{name}3", f"{name}tip", xyz="0 0 -0.2", kind="fixed")
        ),
        0.016,
        0.2,
    ),
}


@pytest.mark.parametrize("case", FEET)
def test_a_foot_of_any_shape_is_a_sphere_at_the_end_of_the_leg(meshes, case):
    calf, radius, reach = FEET[case]
    quadruped = made(calf, folder=meshes)
    model = quadruped.make_full_model()
    for foot in quadruped.feet:
        assert model.geom(foot).type == mujoco.mjtGeom.mjGEOM_SPHERE
        assert model.geom(foot).size[0] == pytest.approx(radius, rel=0.03)
        x, y, z = model.geom(foot).pos
        assert z == pytest.approx(-reach, abs=2e-3)
        assert x == pytest.approx(0.01 if "ball" in case else 0, abs=2e-3)
        assert y == pytest.approx(0, abs=1e-6)
    (note,) = [note for note in quadruped.notes if "the feet are spheres of" in note]
    assert f"{model.geom(quadruped.feet[0]).size[0] * 1000:.3g} mm" in note
    stands(quadruped)


def test_a_foot_whose_mesh_is_missing_is_at_its_frame():
    text = robots.quadruped(partial(foot_link, geometry='mesh filename="none.stl"'))
    text = text.replace('length="0.18"', 'length="0.1"')
    quadruped = make_quadruped(parse_urdf(text), Options(meshes=False))
    # What is left of the calf reaches .14 m.
    assert quadruped.make_full_model().geom(quadruped.feet[0]).size[0] == pytest.approx(
        0.005, rel=0.05
    )


def test_a_sphere_at_the_knee_is_no_foot(meshes):
    def calf(name: str) -> str:
        knee = shape('sphere radius="0.03"') + "<collision>"
        return foot_link(name, 'mesh filename="ball.stl"').replace("<collision>", knee, 1)

    assert made(calf, folder=meshes).feet == ("b_foot", "a_foot", "d_foot", "c_foot")


def test_a_leg_that_ends_in_nothing_is_no_leg():
    with pytest.raises(UrdfError, match="'a3' and what is fixed to it have no shape and no frame"):
        made(lambda name: link(f"{name}3", inertial(1)))


def box_and_foot(quadruped: Quadruped) -> tuple[mujoco.MjModel, int, int]:
    """The training model, its first calf's box and that leg's foot."""
    model = quadruped.make_training_model(0.004)
    box, foot = model.geom("b3"), model.geom(quadruped.feet[0])
    assert box.type == mujoco.mjtGeom.mjGEOM_BOX
    return model, box.id, foot.id


def test_thin_calves_end_at_the_centers_of_their_feet():
    def calf(name: str) -> str:
        bar = shape('box size="0.006 0.008 0.2"', "0 0 -0.1")
        return link(f"{name}3", inertial(0.5), bar, shape('sphere radius="0.02"', "0 0 -0.19"))

    model, box, _ = box_and_foot(made(calf))
    np.testing.assert_allclose(model.geom_pos[box], [0, 0, -0.095], atol=1e-9)
    np.testing.assert_allclose(model.geom_size[box], [0.003, 0.004, 0.095], atol=1e-9)


def test_thick_calves_end_where_a_step_is_no_fall(meshes):
    """A calf of 2 cm on a foot of 1 cm leans by 60 degrees, with an edge below."""
    quadruped = made(FEET["a whole calf's mesh"][0], folder=meshes)
    model, box, foot = box_and_foot(quadruped)
    data = robots.make_data(model, quadruped.home)
    trunk, calf = (data.xmat[b].reshape(3, 3) for b in (1, model.geom_bodyid[box]))
    lean = Rotation.from_rotvec(np.radians(60) * np.array([1, 1, 0]) / np.sqrt(2)).as_matrix()
    mujoco.mju_mat2Quat(data.qpos[3:7], (lean @ calf.T @ trunk).ravel())
    mujoco.mj_kinematics(model, data)
    above = find_lowest_point(model, data, box) - find_lowest_point(model, data, foot)
    assert above == pytest.approx(0.005, abs=1e-6)
    assert np.ptp(data.geom_xpos[[box, foot], 2]) < 0.1  # and it is still most of the calf


def test_knees_bend_backwards_where_they_may_over_a_foot_that_is_no_link_of_its_own():
    quadruped = made(ball_calf)
    assert max(robots.measure_knees(quadruped).values()) < -0.1
    assert quadruped.feet == ("b3_foot", "a3_foot", "d3_foot", "c3_foot")
    model = quadruped.make_full_model()
    assert model.site("b3_foot").pos == pytest.approx([0, 0, -0.2])
    assert model.geom("b3_foot").size[0] == 0.02
    # Thigh .3 m, calf .2 m: the foot is below the thigh joint, at cos(.8) of .5 m.
    data = robots.make_data(model, quadruped.home)
    down = data.site("b3_foot").xpos - data.body("b2").xpos
    np.testing.assert_allclose(down, [0, 0, -0.5 * np.cos(0.8)], atol=1e-4)


def bent_ahead(name: str, x: float, y: float) -> str:
    """A leg whose knee, if it is behind, can only bend ahead, as HyQ's."""
    knee = robots.LIMIT.replace('lower="-3"', 'lower="0.3"') if x < 0 else robots.LIMIT
    return plain_leg(name, x, y, knee=knee)


def turned_about(name: str, x: float, y: float) -> str:
    """A leg as ANYmal's, the hind ones the front ones turned about."""
    return plain_leg(name, x, y, thigh="0.06 0 0" if x > 0 else "-0.06 0 0")


@pytest.mark.parametrize("leg", [bent_ahead, turned_about])
def test_knees_bend_as_their_limits_say_and_else_inwards(leg):
    quadruped = made(ball_calf, leg)
    bent = robots.measure_knees(quadruped)
    assert max(bent["FL"], bent["FR"]) < -0.1
    assert min(bent["RL"], bent["RR"]) > 0.1
    stands(quadruped)


@pytest.mark.parametrize("angle", [0.4, -0.9])
def test_hips_turn_until_the_legs_are_upright(angle):
    quadruped = made(ball_calf, partial(plain_leg, hip_rpy=f"{angle} 0 0"))
    np.testing.assert_allclose(quadruped.home[7::3], -angle, atol=1e-4)
    stands(quadruped)


def test_motors_that_the_urdf_does_not_give():
    text = robots.quadruped(ball_calf).replace(robots.LIMIT, "")
    with pytest.raises(UrdfError, match=r"pass --robot\.effort NM --robot\.speed RAD") as raised:
        make_quadruped(parse_urdf(text))
    assert "no effort limit for 'bj1' and 'bj2' and 10 more, no speed limit" in str(raised.value)
    quadruped = make_quadruped(parse_urdf(text), Options(effort=30, speed=12))
    np.testing.assert_array_equal(quadruped.effort, 30)
    np.testing.assert_array_equal(quadruped.velocity, 12)
    np.testing.assert_array_equal(quadruped.make_full_model().actuator_ctrlrange, [[-30, 30]] * 12)
    np.testing.assert_array_equal(quadruped.upper, np.pi)
    given = make_quadruped(parse_urdf(robots.quadruped(ball_calf)), Options(effort=30, speed=12))
    np.testing.assert_array_equal(given.effort, 20)  # the URDF's own


def test_a_leg_with_a_link_without_mass_is_said():
    text = robots.quadruped(ball_calf).replace(
        link("a1", inertial(0.5), shape('box size="0.02 0.02 0.02"')), link("a1")
    )
    with pytest.raises(UrdfError, match="link 'a1' of leg FL has no mass"):
        make_quadruped(parse_urdf(text))
