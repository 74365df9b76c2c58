"""The robot that environments get: names, limits, the standing pose, and the two models."""

import dataclasses
import re

import mujoco
import numpy as np
import pytest

from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import Quadruped, load_quadruped, make_quadruped
from quadwalk.robot.scene import find_lowest_point
from quadwalk.robot.urdf import parse_urdf
from tests.robot import zoo
from tests.robot.robots import make_data, simulate_standing

TEXT = ALIENGO_URDF.read_text()
NO_MESHES = Options(meshes=False)
ALL = tuple(
    f"{kind}_{leg}" for kind in ("knee", "corner", "top", "hip") for leg in ("FR", "FL", "RR", "RL")
)
BODY = ALL[:8]


def test_aliengo_has_unitrees_figures(quadruped):
    model = quadruped.make_full_model()
    assert quadruped.name == "aliengo"
    assert quadruped.trunk == "trunk"
    assert quadruped.legs == ("FR", "FL", "RR", "RL")
    assert quadruped.feet == ("FR_foot", "FL_foot", "RR_foot", "RL_foot")
    parts = ("hip", "thigh", "calf")
    assert quadruped.joints[:3] == tuple(f"FR_{part}_joint" for part in parts)
    assert model.body_mass.sum() == pytest.approx(11.644 + 4 * (1.993 + 0.639 + 0.207 + 0.06))
    np.testing.assert_allclose(quadruped.effort, [35.278, 35.278, 44.4] * 4)
    np.testing.assert_allclose(quadruped.velocity, [20, 20, 15.89] * 4)
    np.testing.assert_allclose(np.degrees(quadruped.lower[:3]), [-70, -120, -159], atol=0.01)
    np.testing.assert_allclose(np.degrees(quadruped.upper[:3]), [70, 240, -37], atol=0.01)
    np.testing.assert_allclose(model.dof_armature[6:], [0.009, 0.015, 0.022] * 4)
    np.testing.assert_allclose(quadruped.friction, 0.425)
    assert model.nbody == 1 + 13
    assert model.nu == 12


def test_motors_have_rotors_where_the_file_gives_none():
    none = re.sub(r' armature="[^"]*"', "", TEXT)
    robot = make_quadruped(parse_urdf(none))
    # 23.24 kg that stand 0.3749 m high: 0.006 * 23.24 * 0.3749^2.
    np.testing.assert_allclose(robot.make_full_model().dof_armature[6:], 0.020, atol=1e-12)
    np.testing.assert_allclose(robot.make_training_model(0.004).dof_armature[6:], 0.020, atol=1e-12)
    (note,) = [note for note in robot.notes if "rotors" in note]
    assert note.startswith("assumed: rotors of 0.02 kg m^2 (armature): FR_hip_joint, ")
    # None at all is what a file can ask for.
    some = re.sub(r' armature="[^"]*"', ' armature="0"', TEXT, count=1)
    stated = make_quadruped(parse_urdf(some))
    assert (stated.make_full_model().dof_armature[6:] == 0).sum() == 1
    assert not any("rotors" in note for note in stated.notes)


def test_left_and_right_mirror_each_other(quadruped):
    model = quadruped.make_full_model()
    flip = np.array([1, -1, 1])
    for right, left in (("FR", "FL"), ("RR", "RL")):
        for part in ("hip", "thigh", "calf"):
            a, b = model.body(f"{right}_{part}"), model.body(f"{left}_{part}")
            np.testing.assert_allclose(a.pos * flip, b.pos, atol=1e-12)
            np.testing.assert_allclose(a.inertia, b.inertia, rtol=1e-9)
            if part != "calf":  # whose center of mass Unitree does not mirror, by 0.1 mm
                np.testing.assert_allclose(a.ipos * flip, b.ipos, atol=1e-12)


def test_home_stands_with_its_feet_just_on_the_floor(quadruped):
    # 2 * .25 m * cos .8 from hip to foot center, and the foot's radius below it.
    assert quadruped.home[2] == pytest.approx(0.5 * np.cos(0.8) + 0.0265)
    np.testing.assert_array_equal(quadruped.home[7:], [0, 0.8, -1.6] * 4)
    model = quadruped.make_full_model()
    data = make_data(model, model.key("home").qpos)
    heights = [find_lowest_point(model, data, model.geom(foot).id) for foot in quadruped.feet]
    np.testing.assert_allclose(heights, 0, atol=1e-12)
    assert all(contact.dist > -1e-12 for contact in data.contact)  # and nothing overlaps
    for leg, foot in zip(quadruped.legs, quadruped.feet, strict=True):
        under = data.xpos[model.body(f"{leg}_thigh").id] - data.site_xpos[model.site(foot).id]
        np.testing.assert_allclose(under[:2], 0, atol=1e-12)


def test_pd_holds_the_home_pose_and_softer_pd_nearly(quadruped):
    poses = simulate_standing(quadruped, 10, kp=300, kd=8)
    assert np.abs(poses[:, :2]).max() < 0.02
    assert np.abs(poses[:, 2] - quadruped.home[2]).max() < 0.02
    assert poses[:, 3].min() > np.cos(np.radians(2) / 2)
    check_stands_on_soft_legs(quadruped)


def check_stands_on_soft_legs(quadruped: Quadruped) -> None:
    """Check that with gains of training the legs give way, and then it stands still, upright."""
    poses = simulate_standing(quadruped, 5, kp=80, kd=2)
    settled = poses[len(poses) // 2 :]
    assert np.abs(settled[:, :2] - settled[0, :2]).max() < 0.02
    assert settled[-1, 2] > 0.8 * quadruped.home[2]
    assert settled[:, 3].min() > np.cos(np.radians(10) / 2)


def check_trainable(quadruped: Quadruped, contacts="feet", names: tuple[str, ...] = ()) -> None:
    """Check that MJX takes the training model, where only feet, `names` and floor can touch."""
    mjx = pytest.importorskip("mujoco.mjx")
    model = quadruped.make_training_model(0.004, contacts=contacts)
    assert mjx.put_model(model).nv == 18
    touching = {
        frozenset((model.geom(a).name, model.geom(b).name))
        for a in range(model.ngeom)
        for b in range(a)
        if model.geom_contype[a] & model.geom_conaffinity[b]
        or model.geom_contype[b] & model.geom_conaffinity[a]
    }
    assert touching == {frozenset(("floor", name)) for name in (*quadruped.feet, *names)}


def test_mjx_takes_the_training_model(quadruped):
    check_trainable(quadruped)
    check_trainable(quadruped, "knees", BODY[:4])
    check_trainable(quadruped, "body", BODY)
    check_trainable(quadruped, "all", ALL)


def test_other_quadrupeds_stand_and_train(reference_urdf):
    quadruped = load_quadruped(reference_urdf)
    check_stands_on_soft_legs(quadruped)
    check_trainable(quadruped)
    check_trainable(quadruped, "body", BODY)
    model = quadruped.make_training_model(0.004, contacts="body")
    for leg, foot in zip(quadruped.legs, quadruped.feet, strict=True):
        # Unitree's thighs are bars whose thickness is a little less than the feet's.
        assert 0.8 < model.geom(f"knee_{leg}").size[0] / model.geom(foot).size[0] <= 1


def test_spheres_are_where_the_shapes_meet_the_floor(quadruped):
    model = quadruped.make_training_model(0.004, contacts="all")
    pose = np.array([0, 0, 1.0, 1, 0, 0, 0])
    level = [0.0, np.pi / 2, -np.pi / 2] * 4  # thighs; calves upright
    data = make_data(model, np.r_[pose, level])
    for leg in quadruped.legs:
        x, y = (1 if leg[0] == "F" else -1), (1 if leg[1] == "L" else -1)
        knee, thigh = (model.geom(name).id for name in (f"knee_{leg}", f"{leg}_thigh"))
        np.testing.assert_allclose(
            data.geom_xpos[knee], [x * 0.2407 - 0.25, y * (0.051 + 0.0868), 1.0], atol=1e-9
        )
        np.testing.assert_allclose(
            find_lowest_point(model, data, knee), find_lowest_point(model, data, thigh), atol=1e-9
        )
        for kind, z in (("corner", -0.056), ("top", 0.056)):
            corner = model.geom(f"{kind}_{leg}")
            half = np.array([x * 0.3235, y * 0.075, z])
            np.testing.assert_allclose(corner.pos + np.sign(half) * corner.size[0], half)
            assert corner.bodyid == model.body("trunk").id
        assert model.geom_bodyid[knee] == model.body(f"{leg}_thigh").id
        hip, motor = model.geom(f"hip_{leg}"), model.geom(f"{leg}_hip")
        assert hip.bodyid == motor.bodyid == model.body(f"{leg}_hip").id
        np.testing.assert_allclose(hip.size[0], motor.size[0])  # a cylinder across, on its axis
        np.testing.assert_allclose(
            data.geom_xpos[hip.id], [x * 0.2407, y * (0.051 + 0.0868), 1.0], atol=1e-9
        )


def test_a_link_may_have_the_name_of_a_knee():
    quadruped = make_quadruped(parse_urdf(TEXT.replace('"FL_thigh"', '"knee_FR"')))
    assert quadruped.make_training_model(0.004, contacts="body").geom("knee_FR").size[0] == 0.0215


def test_a_trunk_without_shapes_has_its_corners_at_the_hips():
    trunk = re.search(r'<link name="trunk">.*?</link>', TEXT, re.DOTALL)[0]
    bare = re.sub(r"<collision>.*?</collision>", "", trunk, flags=re.DOTALL)
    quadruped = make_quadruped(parse_urdf(TEXT.replace(trunk, bare)))
    model = quadruped.make_training_model(0.004, contacts="body")
    corner = model.geom("corner_FR")
    outwards = np.array([1, -1, -1]) * corner.size[0]
    np.testing.assert_allclose(corner.pos + outwards, [0.2407, -0.051, 0], atol=1e-12)


def test_a_hip_without_shapes_is_as_thick_as_the_foot(quadruped):
    shaped = r'(<link name="FR_hip">.*?)<collision>.*?</collision>'
    bare = make_quadruped(parse_urdf(re.sub(shaped, r"\1", TEXT, flags=re.DOTALL)))
    model = bare.make_training_model(0.004, contacts="all")
    assert model.geom("hip_FR").size[0] == model.geom(quadruped.feet[0]).size[0]
    assert model.geom("hip_FL").size[0] > model.geom(quadruped.feet[0]).size[0]


@zoo.repeat_for(zoo.QUADRUPEDS)
def test_mjx_takes_the_zoos_training_models(urdf):
    check_trainable(load_quadruped(urdf, NO_MESHES))


def test_both_models_are_of_one_robot(quadruped):
    full, training = quadruped.make_full_model(), quadruped.make_training_model(0.002)
    assert (full.nbody, full.njnt, full.nu) == (training.nbody, training.njnt, training.nu)
    for kind, count in (("body", full.nbody), ("joint", full.njnt), ("actuator", full.nu)):
        for i in range(count):
            assert getattr(full, kind)(i).name == getattr(training, kind)(i).name
    same = (
        "body_mass body_inertia body_ipos body_iquat jnt_range jnt_actfrcrange dof_armature "
        "dof_damping actuator_ctrlrange"
    )
    for name in same.split():
        np.testing.assert_array_equal(getattr(full, name), getattr(training, name))
    collision = [full.geom(i).name for i in range(full.ngeom) if full.geom(i).name]
    assert collision == [training.geom(i).name for i in range(training.ngeom)]
    assert len(collision) == 1 + 1 + 4 * 4
    assert training.nsensor == 0
    assert training.nlight == 0
    assert not training.dof_frictionloss.any()
    assert not full.dof_frictionloss.any()
    np.testing.assert_array_equal(
        quadruped.make_full_model(frictionloss=True).dof_frictionloss[6:], quadruped.friction
    )
    for model, iterations in ((training, (1, 5)), (full, (100, 50))):
        assert model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
        assert (model.opt.iterations, model.opt.ls_iterations) == iterations


def test_a_model_without_visuals_has_the_meshes_of_collisions_alone(quadruped):
    spec = quadruped.spec.copy()
    corners = [0, 0, 0, 0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1]
    for kind in ("visual", "collision"):
        spec.add_mesh(name=kind, uservert=corners)
        spec.body(quadruped.trunk).add_geom(
            spec.find_default(kind), type=mujoco.mjtGeom.mjGEOM_MESH, meshname=kind
        )
    robot = dataclasses.replace(quadruped, spec=spec)
    models = [robot.make_full_model(visuals=visuals) for visuals in (True, False)]
    names = [[model.mesh(i).name for i in range(model.nmesh)] for model in models]
    assert names == [["visual", "collision"], ["collision"]]


def test_qpos_qvel_and_ctrl_are_in_the_order_of_the_joints(quadruped):
    model = quadruped.make_training_model(0.002)
    for i, name in enumerate(quadruped.joints):
        joint = model.joint(name)
        assert (joint.qposadr[0], joint.dofadr[0]) == (7 + i, 6 + i)
        assert model.actuator(i).name == name
        assert model.actuator(i).trnid[0] == joint.id


def test_legs_are_found_by_place_whatever_their_names_and_order():
    # Legs in another order of the file, under other names.
    swapped = TEXT.replace('"FR_', '"zz_').replace('"RL_', '"aa_')
    quadruped = make_quadruped(parse_urdf(swapped))
    assert quadruped.legs == ("FR", "FL", "RR", "RL")
    assert quadruped.joints[0] == "zz_hip_joint"  # the one that stands ahead on the right
    model = quadruped.make_full_model()
    assert model.joint("zz_hip_joint").qposadr[0] == 7
    assert model.body("zz_hip").pos == pytest.approx([0.2407, -0.051, 0])


def test_a_continuous_thigh_and_a_reversed_axis():
    text = TEXT.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>')
    calf = 'lower="{}" upper="{}"'
    text = text.replace(
        calf.format("-2.775073510670984", "-0.6457718232379019"),
        calf.format("0.6457718232379019", "2.775073510670984"),
    )
    text = text.replace('<limit lower="-2.0944" upper="4.1888"', "<limit")
    text = re.sub(r'(_thigh_joint" type=)"revolute"', r'\1"continuous"', text)
    quadruped = make_quadruped(parse_urdf(text))
    np.testing.assert_array_equal(quadruped.home[7:], [0, -0.8, 1.6] * 4)
    np.testing.assert_allclose(quadruped.lower[:3], [-1.22173, -np.pi, 0.64577], atol=1e-5)
    assert quadruped.home[2] == pytest.approx(0.5 * np.cos(0.8) + 0.0265)
