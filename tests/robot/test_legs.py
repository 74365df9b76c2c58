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
from quadwalk.robot.scene import find_lowest_point
from quadwalk.robot.urdf import parse_urdf
from tests.robot import robots
from tests.robot.robots import ball_calf, check_stands, inertial, joint, link, plain_leg, shape


def read_robot(calf, leg=plain_leg, folder: Path | None = None) -> Quadruped:
    """Return the robot of `robots.quadruped`, with meshes from a folder."""
    return make_quadruped(parse_urdf(robots.quadruped(calf, leg), "r.urdf", folder))


def check_stands_on_feet(quadruped: Quadruped) -> None:
    """Check that it stands on its feet alone, and PD control keeps it up.

    A foot's sphere fits into the end of a calf whose edges reach further. In training they end at
    its center or before it.
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


def make_foot_link(name: str, geometry: str, kind: str = "collision") -> str:
    """Return a thin calf of 0.2 m, and a foot's link bolted to its end."""
    return (
        link(f"{name}3", inertial(0.5), shape('cylinder radius="0.005" length="0.18"', "0 0 -0.09"))
        + link(f"{name}_foot", inertial(0.01, "1e-5 1e-5 1e-5"), shape(geometry, kind=kind))
        + joint(f"{name}_bolt", f"{name}3", f"{name}_foot", xyz="0 0 -0.2", kind="fixed")
    )


def make_calf(name: str, geometry: str, rpy: str = "0 0 0") -> str:
    """Return a calf of 0.2 m that is all one shape."""
    return link(f"{name}3", inertial(0.5), shape(geometry, "0 0 -0.1", rpy=rpy))


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    """Write three meshes; return their folder.

    A ball of 3 cm is 1 cm off its center. The others are a wheel of 2 cm about y and a spindly
    calf.
    """
    ball = trimesh.creation.icosphere(3, 0.03)
    ball.apply_translation([0.01, 0, 0])
    ball.export(tmp_path / "ball.stl")
    wheel = trimesh.creation.cylinder(0.02, 0.01, sections=64)
    wheel.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    wheel.export(tmp_path / "wheel.stl")
    trimesh.creation.box((0.02, 0.02, 0.2)).export(tmp_path / "calf.stl")
    return tmp_path


CAPSULE = 'capsule radius="0.02" length="0.16"'
TILTED_END = (-0.08 * np.sin(0.5), 0.1 + 0.08 * np.cos(0.5))
BALL = shape('sphere radius="0.02"', "0 0 -0.18", "visual")


def make_frame_calf(name: str) -> str:
    """Return a calf without shapes, with a frame at its end."""
    bolt = joint(f"{name}bolt", f"{name}3", f"{name}tip", xyz="0 0 -0.2", kind="fixed")
    return link(f"{name}3", inertial(0.5)) + link(f"{name}tip") + bolt


# The calf, the foot's radius and the x and z of its center from the calf's joint, m.
FEET = {
    "a ball's mesh": (lambda n: make_foot_link(n, 'mesh filename="ball.stl"'), 0.03, 0.01, 0.2),
    "a wheel's mesh": (lambda n: make_foot_link(n, 'mesh filename="wheel.stl"'), 0.02, 0, 0.2),
    "a box": (lambda n: make_foot_link(n, 'box size="0.03 0.03 0.03"'), 0.015, 0, 0.2),
    "a flat box": (lambda n: make_foot_link(n, 'box size="0.05 0.05 0.02"'), 0.01, 0, 0.2),
    "a cylinder": (lambda n: make_calf(n, 'cylinder radius="0.01" length="0.2"'), 0.01, 0, 0.19),
    "a capsule": (lambda n: make_calf(n, CAPSULE), 0.02, 0, 0.18),
    "a tilted capsule": (lambda n: make_calf(n, CAPSULE, "0 0.5 0"), 0.02, *TILTED_END),
    "a whole calf's mesh": (lambda n: make_calf(n, 'mesh filename="calf.stl"'), 0.01, 0, 0.19),
    "only seen": (lambda n: link(f"{n}3", inertial(0.5), BALL), 0.02, 0, 0.18),
    "only a frame": (make_frame_calf, 0.016, 0, 0.2),
}


@pytest.mark.parametrize("case", FEET)
def test_a_foot_of_any_shape_is_a_sphere_at_the_end_of_the_leg(meshes, case):
    calf, radius, x, reach = FEET[case]
    quadruped = read_robot(calf, folder=meshes)
    model = quadruped.make_full_model()
    for foot in quadruped.feet:
        assert model.geom(foot).type == mujoco.mjtGeom.mjGEOM_SPHERE
        assert model.geom(foot).size[0] == pytest.approx(radius, rel=0.03)
        np.testing.assert_allclose(model.geom(foot).pos, [x, 0, -reach], atol=2e-3)
        assert model.geom(foot).pos[1] == pytest.approx(0, abs=1e-6)
    (note,) = [note for note in quadruped.notes if "the feet are spheres of" in note]
    assert f"{model.geom(quadruped.feet[0]).size[0] * 1000:.3g} mm" in note
    check_stands_on_feet(quadruped)


def test_a_foot_whose_mesh_is_missing_is_at_its_frame():
    text = robots.quadruped(partial(make_foot_link, geometry='mesh filename="none.stl"'))
    text = text.replace('length="0.18"', 'length="0.1"')
    quadruped = make_quadruped(parse_urdf(text), Options(meshes=False))
    # What is left of the calf reaches .14 m.
    assert quadruped.make_full_model().geom(quadruped.feet[0]).size[0] == pytest.approx(
        0.005, rel=0.05
    )


def test_a_sphere_at_the_knee_is_no_foot(meshes):
    def calf(name: str) -> str:
        knee = shape('sphere radius="0.03"') + "<collision>"
        return make_foot_link(name, 'mesh filename="ball.stl"').replace("<collision>", knee, 1)

    assert read_robot(calf, folder=meshes).feet == ("b_foot", "a_foot", "d_foot", "c_foot")


def find_box_and_foot(quadruped: Quadruped) -> tuple[mujoco.MjModel, int, int]:
    """Return the training model, its first calf's box and that leg's foot."""
    model = quadruped.make_training_model(0.004)
    box, foot = model.geom("b3"), model.geom(quadruped.feet[0])
    assert box.type == mujoco.mjtGeom.mjGEOM_BOX
    return model, box.id, foot.id


def test_thin_calves_end_at_the_centers_of_their_feet():
    def calf(name: str) -> str:
        bar = shape('box size="0.006 0.008 0.2"', "0 0 -0.1")
        return link(f"{name}3", inertial(0.5), bar, shape('sphere radius="0.02"', "0 0 -0.19"))

    model, box, _ = find_box_and_foot(read_robot(calf))
    np.testing.assert_allclose(model.geom_pos[box], [0, 0, -0.095], atol=1e-9)
    np.testing.assert_allclose(model.geom_size[box], [0.003, 0.004, 0.095], atol=1e-9)


def test_thick_calves_end_where_a_step_is_no_fall(meshes):
    """Check a calf of 2 cm on a foot of 1 cm, at 60 degrees with an edge below."""
    quadruped = read_robot(FEET["a whole calf's mesh"][0], folder=meshes)
    model, box, foot = find_box_and_foot(quadruped)
    data = robots.make_data(model, quadruped.home)
    trunk, calf = (data.xmat[b].reshape(3, 3) for b in (1, model.geom_bodyid[box]))
    lean = Rotation.from_rotvec(np.radians(60) * np.array([1, 1, 0]) / np.sqrt(2)).as_matrix()
    mujoco.mju_mat2Quat(data.qpos[3:7], (lean @ calf.T @ trunk).ravel())
    mujoco.mj_kinematics(model, data)
    above = find_lowest_point(model, data, box) - find_lowest_point(model, data, foot)
    assert above == pytest.approx(0.005, abs=1e-6)
    assert np.ptp(data.geom_xpos[[box, foot], 2]) < 0.1  # and it is still most of the calf


def test_knees_bend_backwards_where_they_may_over_a_foot_that_is_no_link_of_its_own():
    quadruped = read_robot(ball_calf)
    assert max(robots.measure_knees(quadruped).values()) < -0.1
    assert quadruped.feet == ("b3_foot", "a3_foot", "d3_foot", "c3_foot")
    model = quadruped.make_full_model()
    assert model.site("b3_foot").pos == pytest.approx([0, 0, -0.2])
    assert model.geom("b3_foot").size[0] == 0.02
    # Thigh .3 m, calf .2 m: the foot is below the thigh joint, at cos(.8) of .5 m.
    data = robots.make_data(model, quadruped.home)
    down = data.site("b3_foot").xpos - data.body("b2").xpos
    np.testing.assert_allclose(down, [0, 0, -0.5 * np.cos(0.8)], atol=1e-4)


def make_bent_leg(name: str, x: float, y: float) -> str:
    """Return a leg whose knee, if it is behind, can only bend ahead, as HyQ's."""
    knee = robots.LIMIT.replace('lower="-3"', 'lower="0.3"') if x < 0 else robots.LIMIT
    return plain_leg(name, x, y, knee=knee)


def make_turned_leg(name: str, x: float, y: float) -> str:
    """Return a leg as ANYmal's: the hind ones are the front ones turned about."""
    return plain_leg(name, x, y, thigh="0.06 0 0" if x > 0 else "-0.06 0 0")


@pytest.mark.parametrize("leg", [make_bent_leg, make_turned_leg])
def test_knees_bend_as_their_limits_say_and_else_inwards(leg):
    quadruped = read_robot(ball_calf, leg)
    bent = robots.measure_knees(quadruped)
    assert max(bent["FL"], bent["FR"]) < -0.1
    assert min(bent["RL"], bent["RR"]) > 0.1
    check_stands_on_feet(quadruped)


@pytest.mark.parametrize("angle", [0.4, -0.9])
def test_hips_turn_until_the_legs_are_upright(angle):
    quadruped = read_robot(ball_calf, partial(plain_leg, hip_rpy=f"{angle} 0 0"))
    np.testing.assert_allclose(quadruped.home[7::3], -angle, atol=1e-4)
    check_stands_on_feet(quadruped)
