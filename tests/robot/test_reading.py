"""URDFs as tools and makers write them: read as other readers do, or refused with one line."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.mjcf import Options, convert, write_xml
from quadwalk.robot.report import UrdfError
from quadwalk.robot.scene import find_lowest_point
from quadwalk.robot.structure.legs import find_legs
from quadwalk.robot.structure.tree import to_roll_pitch_yaw
from quadwalk.robot.urdf import parse_urdf, read_urdf
from tests.robot.robots import (
    LIMIT,
    check_dynamics,
    inertial,
    joint,
    link,
    make_data,
    replace_once,
    robot,
    shape,
)

TEXT = ALIENGO_URDF.read_text()
# A body, and another on a hinge of it.
DYNAMICS = '<dynamics damping="1" friction="2"/>'
ARM = robot(
    link("a", inertial(1, "1 1 1")),
    link("b", inertial(1, "1 1 1"), shape('box size="1 1 1"')),
    joint("j", "a", "b", extra=LIMIT + DYNAMICS),
)
BOMB = '<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>'
EXTERNAL = '<!DOCTYPE robot [<!ENTITY a SYSTEM "file:///etc/passwd">]>'
XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
EXTRA_LINK = link("extra") + "</robot>"
LOOP = (
    link("a")
    + link("b")
    + joint("ab", "a", "b", kind="fixed")
    + joint("ba", "b", "a", kind="fixed")
    + "</robot>"
)
BOX = '<box size="0.647 0.15 0.112"/>'
MOTOR = '<dynamics damping="0.22" friction="0.425" armature="0.009"/>'
ORIGIN = '<origin xyz="0 0 0" rpy="0 0 0"/><parent'
AXIS = '<axis xyz="0 0 1"/>'


def load(text: str | bytes) -> mujoco.MjSpec:
    """Read, check and convert a text to a model's spec."""
    urdf = parse_urdf(text, "robot.urdf")
    return convert(urdf, find_legs(urdf.tree)).spec


# A text, and what the message must say.
TEXTS = [
    ("", "is empty"),
    (" \n ", "is empty"),
    ("hello", "not well-formed"),
    (b"\x00\xff\xfe\x01", "not well-formed"),
    (TEXT[: len(TEXT) // 2], "not well-formed"),
    (TEXT.replace("</robot>", ""), "not well-formed"),
    (TEXT + "<robot/>", "not well-formed"),
    (TEXT.replace("<robot", BOMB + "<robot").replace("orange", "&b;"), "DOCTYPE"),
    (TEXT.replace("<robot", EXTERNAL + "<robot"), "DOCTYPE"),
    (TEXT.replace('version="1.0"', 'version="7"').encode(), "not well-formed"),
    ('<mujoco model="x"/>', "<mujoco>; expected <robot>"),
    ('<robot name="x"/>', "no <link>"),
    (TEXT.replace('"FR_foot"', '"world"'), "'world' is not the root"),
    (robot('<link name="a"><mass value="1"/></link>'), "a <mass> in it; expected <inertial/mass>"),
    (ARM.replace(AXIS, "").replace(' type="rev', ' axis="0 0 1" type="rev'), "expected <axis>"),
    (f'<robot name="r" {XACRO}><xacro:include filename="leg.xacro"/></robot>', "run xacro"),
    (ARM.replace("<link", f'<xacro:leg {XACRO} name="FL"/><link', 1), "run xacro"),
    ('<robot name="r"><xacro:include filename="leg.xacro"/></robot>', "run xacro"),
]
# What becomes what in the AlienGo's text, and what the message must say.
CHANGES = [
    ("orange", "&who;", "not well-formed"),
    ('<link name="trunk"', "<link", "<link> has no 'name'"),
    ('<link name="trunk"', '<link name=" "', "empty 'name'"),
    ('<joint name="imu_joint"', "<joint", "<joint> has no 'name'"),
    ('<link name="FL_foot"', '<link name="FR_foot"', "'FR_foot' appears twice"),
    ('"FL_hip_joint"', '"FR_hip_joint"', "joint 'FR_hip_joint' appears twice"),
    ('<parent link="trunk"', '<parent link="tronk"', "parent 'tronk'"),
    ('<parent link="trunk"', '<parent link="tr&#10;onk&#13;"', "parent 'tr onk '"),
    ('<parent link="trunk"', f'<parent link="{"tronk" * 10_000}"', "parent 'tronk"),
    ('<child link="FR_hip"', '<child link="hip"', "child 'hip'"),
    ('<parent link="trunk"/>', "", "has no <parent>"),
    ("</robot>", joint("extra", "extra", "FR_hip") + EXTRA_LINK, "second parent"),
    ("</robot>", EXTRA_LINK, "2 links have no parent ('trunk', 'extra')"),
    ("</robot>", LOOP, "'a' is its own ancestor; expected a tree"),
    ('<child link="imu_link"/>', '<child link="trunk"/>', "to itself"),
    ('<mass value="11.644"/>', "<mass/>", "<mass> has no 'value'"),
    ('ixx="0.051944892"', "", "<inertia> has no 'ixx'"),
    ('<mass value="11.644"/>', "", "has no <mass>"),
    ('value="11.644"', 'value="heavy"', 'value="heavy"'),
    ('value="11.644"', 'value="1_1"', 'value="1_1"'),
    ('value="11.644"', 'value="11 644"', "expected one number"),
    ('xyz="0.2407 -0.051 0"', 'xyz="0.2407 -0.051"', "expected 3"),
    ('value="11.644"', 'value="nan"', 'value="nan"'),
    ('effort="35.278"', 'effort="inf"', 'effort="inf"'),
    ('value="11.644"', 'value="1e999"', "finite"),
    ('value="11.644"', 'value="1e12"', "at most"),
    ('value="11.644"', 'value="1e-320"', "0 or at least"),
    ("<dynamics d", '<safety_controller k_position="nan"/><dynamics d', 'k_position="nan"'),
    ('<axis xyz="1 0 0"', '<axis xyz="0 0 0"', "'FR_hip_joint': <axis>"),
    ('type="revolute"', 'type="hinge"', "of type 'hinge'"),
    ('lower="-1.2217304763960306"', 'lower="2"', "lower 2 and upper 1.22"),
    ('effort="35.278"', 'effort="-1"', 'effort="-1"'),
    ('damping="0.22"', 'damping="-1"', 'damping="-1"'),
    ('value="1.993"', 'value="-1.993"', "link 'FR_hip': <mass>"),
    ('value="1.993"', 'value="0"', "link 'FR_hip' moves (joint 'FR_hip_joint') and has no mass"),
    ('value="11.644"', 'value="0"', "link 'trunk'"),
    ('ixx="0.051944892"', 'ixx="-0.05"', "link 'trunk': <inertia>"),
    ('ixy="0.001703617"', 'ixy="0.2"', "expected positive"),
    ('ixx="0.051944892"', 'ixx="5"', "above the sum of the others"),
    (MOTOR, MOTOR + '<mimic joint="tail"/>', "follows joint 'tail'"),
    (MOTOR, MOTOR + '<mimic joint="FR_hip_joint"/>', "'FR_hip_joint' in a circle"),
    ('radius="0.046"', 'radius="-0.046"', 'radius="-0.046"'),
    ('size="0.647 0.15', 'size="0.647 -0.15', "<box>"),
    ('<cylinder radius="0.046"', '<cylinder radius="0"', "above 1e-09 m"),
    ('<axis xyz="1 0 0"/>', '<axis xyz="1 0 0"/><axis xyz="0 1 0"/>', "2 <axis>"),
    (BOX, BOX + '<sphere radius="1"/>', "holds 2 shapes"),
    (BOX, "", "holds 0 shapes"),
    (BOX, "<cone/>", "<cone>"),
    (BOX, "<capsule/>", "<capsule> has no 'radius'"),
    ('rgba="1.0 0.42 0.04 1"', 'rgba="1.0 0.42"', "expected 4 numbers"),
    ('name="graphite"', 'name="orange"', "a second color"),
    # Names that are nearly those of what is missing.
    ('<origin xyz="0.2407', '<orgin xyz="0.2407', "a <orgin> in it; expected <origin>"),
    ("<dynamics ", "<dynamic ", "expected <dynamics>"),
    ("<axis ", "<axes ", "expected <axis>"),
    ('<axis xyz="1 0 0"', '<axis xzy="1 0 0"', "attribute 'xzy'; expected xyz"),
    ("lower=", "lowr=", "attribute 'lowr'; expected lower"),
    ("damping=", "dampning=", "expected damping"),
    ("radius=", "radus=", "expected radius"),
    ("velocity=", "velcoiy=", "expected velocity"),
    ("</link>", "<colision/></link>", "expected <collision>"),
    ("</robot>", '<jiont name="j"/></robot>', "expected <joint>"),
]
# The same for `ARM`; None: it is read.
ARM_CHANGES = [
    # A rotation as a quaternion that is none.
    ('rpy="0 0 0"', 'quat_xyzw="0 0 0 1" rpy="0 0 1"', "has both rpy and quat_xyzw"),
    ('rpy="0 0 0"', 'quat_xyzw="0 0 0 0"', "quat_xyzw of length 0; expected a rotation"),
    ('rpy="0 0 0"', 'quat_xyzw="0 0 1"', "expected 4 numbers"),
    ('rpy="0 0 0"', 'quat_xyz="0 0 0 1"', "expected quat_xyzw"),
    # Physics in another place, where it would be lost.
    (DYNAMICS, "<dynamics><damping>1</damping></dynamics>", 'expected damping="..."'),
    (DYNAMICS, "<dynamics>1</dynamics>", "holds '1' as text; expected attributes: damping"),
    (DYNAMICS, '<damping value="1"/>', 'expected <dynamics damping="...">'),
    ('type="revolute"', 'type="revolute" armature="1"', 'expected <dynamics armature="...">'),
    (LIMIT, '<limit effort="20" velocity="10"><lower>-3</lower></limit>', 'lower="..."'),
    (LIMIT, '<limit effort="20" velocity="10" min="-3" max="3"/>', '<limit lower="...">'),
    (LIMIT, "<limit><Effort>20</Effort></limit>", 'expected effort="..."'),
    (AXIS + LIMIT, f'<axis xyz="0 0 1">{LIMIT}</axis>', "expected <limit>"),
    (AXIS, "<axis><xyz>0 0 1</xyz></axis>", "expected xyz"),
    (ORIGIN, "<origin>0 0 1</origin><parent", "as text"),
    (ORIGIN, "<origin><xyz>0</xyz></origin><parent", "xyz"),
    ('type="revolute"', 'type="revolute" axis="0 0 1"', None),
    ('type="revolute"', 'type="fixed" armature="1"', None),
    (AXIS, "", None),
    ('<link name="a">', '<link name="a" mass="1">', None),
    # Limits, xacro.
    ('lower="-3" upper="3"', 'lower="2"', "lower 2 and upper 0; expected lower below upper"),
    ('value="1"', 'value="${mass}"', "run xacro"),
    ("box size", 'mesh filename="$(find dog)/a.stl" size', "run xacro"),
]


def _list_refused() -> list[tuple[str | bytes, str]]:
    changes = [(replace_once(TEXT, old, new), says) for old, new, says in CHANGES]
    arms = [(replace_once(ARM, old, new), says) for old, new, says in ARM_CHANGES if says]
    return [*TEXTS, *changes, *arms]


@pytest.mark.parametrize(("text", "says"), _list_refused(), ids=lambda value: str(value)[-30:])
def test_what_is_no_robot_is_refused_with_one_line(text, says):
    with pytest.raises(UrdfError) as raised:
        load(text)
    message = str(raised.value)
    assert message.startswith("robot.urdf")
    assert says in message
    assert "expected" in message
    assert "\n" not in message
    assert len(message) <= 800


def test_a_default_in_another_place_is_no_loss():
    for old, new, says in ARM_CHANGES:
        if says is None:
            parse_urdf(replace_once(ARM, old, new))


def test_refuses_what_is_no_file(tmp_path: Path):
    for path, says in (
        (tmp_path, "is a folder; expected a URDF"),
        (tmp_path / "none.urdf", r"none\.urdf: cannot be read \(No such file"),
        (Path("a\0b"), "cannot be read"),
    ):
        with pytest.raises(UrdfError, match=says):
            read_urdf(path)
    if Path("/dev/zero").exists():
        with pytest.raises(UrdfError, match="larger than 16 MB"):
            read_urdf(Path("/dev/zero"))


def make_chain(length: int, kind: str, *body: str) -> str:
    """Return a robot of so many joints in a row, with links of `body` below a massive one."""
    links = [link("l0", inertial(1, "1 1 1")), *(link(f"l{i + 1}", *body) for i in range(length))]
    at = {"xyz": "0 0 1", "kind": kind, "extra": ""}
    return robot(*links, *(joint(f"j{i}", f"l{i}", f"l{i + 1}", **at) for i in range(length)))


def test_as_many_links_and_joints_as_are_allowed_convert_and_no_more():
    model = convert(parse_urdf(make_chain(1999, "fixed"))).spec.compile()
    assert model.nsite == 2000  # one per fused link, one for the IMU
    with pytest.raises(UrdfError, match="100000 links or joints; expected at most 2000"):
        load(make_chain(99_999, "fixed"))
    moving = inertial(1, "1 1 1")
    assert convert(parse_urdf(make_chain(500, "continuous", moving))).spec.compile().nv == 506
    with pytest.raises(UrdfError, match="501 joints that move; expected at most 500"):
        parse_urdf(make_chain(501, "continuous", moving))


# What makers write beside URDF: what becomes what in the AlienGo's text, and the kind reported.
EXTENSIONS = [
    ('type="fixed"', 'type="fixed" dont_collapse="true"', "joint dont_collapse"),
    ("effort=", 'command_effort="4" effort=', "limit command_effort"),
    ("<dynamics ", '<dynamics D="1" ', "dynamics D"),
    ("<geometry>", '<geometry name="g">', "geometry name"),
    ("</link>", "<self_filter/></link>", "<self_filter> of a link"),
    ("</link>", "<kinematic><a b='nan'/></kinematic></link>", "<kinematic> of a link"),
    ("</link>", '<origin xyz="1 2 3"/></link>', "<origin> of a link"),
    ("</link>", "<gravity>0</gravity></link>", "<gravity> of a link"),
    ("</collision>", "<material/></collision>", "<material> of a collision"),
    ("</visual>", '<material name="orange"/></visual>', "<material> of a visual beside another"),
    ("<color ", "<texture/><color ", "<texture> without a file"),
    ("</robot>", "<transmission><joint name='x'/></transmission></robot>", "<transmission>"),
]
# The same of other dialects, with the line of the report.
DIALECTS = [
    ("<robot", '<robot xmlns="http://a" xmlns:g="http://b"', "dropped: the namespace: http://a"),
    ("<?xml", "\n \t\n<?xml", "assumed: the XML declaration comes first"),
    ("<?xml", "\r\n \r\n<?xml", "assumed: the XML declaration comes first"),
    ("<?xml", "\ufeff\n<?xml", "assumed: the XML declaration comes first"),
    ('version="1.0"', 'version="0.0"', "assumed: XML 1.0, for the file says 0.0"),
    ('rpy="0 0 0"', 'rpy="1e-66 0 -5.8e-60"', ""),
]


@pytest.fixture(scope="module")
def plain_xml() -> str:
    urdf = parse_urdf(TEXT)
    return write_xml(convert(urdf, find_legs(urdf.tree)).spec)


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [(old, new, f"dropped: extensions of other tools: {kind} (") for old, new, kind in EXTENSIONS]
    + DIALECTS,
)
def test_what_other_tools_write_changes_nothing_and_is_reported(old, new, note, plain_xml):
    assert old in TEXT
    urdf = parse_urdf(TEXT.replace(old, new).encode())
    assert write_xml(convert(urdf, find_legs(urdf.tree)).spec) == plain_xml
    lines = "\n".join(urdf.report.to_lines())
    assert note in lines
    if note.endswith("("):
        assert f"{note}{TEXT.count(old)})" in lines


def test_namespaces_of_elements_are_dropped():
    text = re.sub(r"<(/?)(\w)", r"<\1u:\2", ARM).replace("<u:robot", '<u:robot xmlns:u="http://u"')
    urdf = parse_urdf(text)
    assert "dropped: the namespace: http://u" in urdf.report.to_lines()
    assert write_xml(convert(urdf).spec) == write_xml(convert(parse_urdf(ARM)).spec)
    assert parse_urdf(urdf.text).report.to_lines() == parse_urdf(ARM).report.to_lines()


def test_lines_are_counted_from_the_first_of_the_file():
    text = f'\n\n<?xml version="1.0"?>\n{ARM}'.replace('value="1"', 'value="?"', 1)
    with pytest.raises(UrdfError, match="line 4: link 'a'"):
        parse_urdf(text.encode())


def test_reads_what_the_file_says_in_any_encoding():
    text = TEXT.replace('name="aliengo"', 'name="Älien"').replace(
        '<?xml version="1.0"?>', '<?xml version="1.0" encoding="iso-8859-1"?>'
    )
    assert parse_urdf(text.encode("latin-1")).robot.name == "Älien"
    assert parse_urdf(text).robot.name == "Älien"  # text, whatever it declares


def test_a_robot_without_a_name_has_its_files(tmp_path):
    file = tmp_path / "walker.urdf"
    file.write_text(ARM.replace('<robot name="r"', "<!-- <robot> --><robot"))
    urdf = read_urdf(file)
    assert urdf.robot.name == "walker"
    assert "assumed: the robot's name, for it has none: walker" in urdf.report.to_lines()
    assert parse_urdf(urdf.text, "copy.urdf").robot.name == "walker"  # a run's copy as well


def test_an_axis_need_not_be_normalized_or_given():
    model = load(replace_once(TEXT, '<axis xyz="0 1 0"', '<axis xyz="0 7 0"')).compile()
    assert model.joint("FR_thigh_joint").axis == pytest.approx([0, 1, 0])
    model = load(replace_once(TEXT, '<axis xyz="1 0 0"/>', "")).compile()
    assert model.joint("FR_hip_joint").axis == pytest.approx([1, 0, 0])


def test_a_rotations_angles_are_scipys_at_a_pitch_of_90_degrees_too():
    rng = np.random.default_rng(0)
    up = np.array([0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)])
    for quat in [*rng.normal(size=(50, 4)), up, -3 * up, up + 1e-9 * rng.normal(size=4)]:
        expected = Rotation.from_quat(quat).as_matrix()
        matrix = Rotation.from_euler("xyz", to_roll_pitch_yaw(expected)).as_matrix()
        np.testing.assert_allclose(matrix, expected, atol=1e-12)


@pytest.mark.parametrize(
    "quat", ["0 0.70710678 0 0.70710678", "0.1 0.2 0.3 0.927361849549570", "0 0 2 -2"]
)
def test_quaternions_of_urdf_1_1_are_read_as_pinocchio_reads_them(quat):
    """Check a joint, an inertia and a shape; the text is then URDF 1.0, for readers of that."""
    level = ' rpy="0 0 0"'
    parts = ARM.replace('name="r"', 'name="r" version="1.1"').split(level)
    for place in range(1, 4):
        before, after = level.join(parts[:place]), level.join(parts[place:])
        text = f'{before} quat_xyzw="{quat}"{after}'
        urdf = parse_urdf(text)
        pinocchio_model = pinocchio.buildModelFromXML(text)
        our_model = pinocchio.buildModelFromXML(urdf.text)
        assert "quat" not in urdf.text
        assert pinocchio_model.jointPlacements[1].isApprox(our_model.jointPlacements[1], 1e-9)
        assert pinocchio_model.inertias[1].isApprox(our_model.inertias[1], 1e-9)
        check_dynamics(urdf, convert(urdf).spec, states=3)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize(
    ("limit", "note"),
    [
        ("", "there are none"),
        ('<limit effort="3" velocity="4"/>', "there are none"),
        ('<limit lower="0" upper="0" effort="3" velocity="4"/>', "both are 0"),
        ('<limit lower="-1e16" upper="1e16" effort="3" velocity="4"/>', "they are beyond 1e9"),
    ],
)
def test_no_position_limits_are_unlimited(limit, note, kind):
    urdf = parse_urdf(ARM.replace(LIMIT, limit).replace("revolute", kind))
    assert not convert(urdf).spec.compile().joint("j").limited
    assert f"assumed: no position limits, for {note}: j" in urdf.report.to_lines()


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("limit", ['lower="-2"', 'upper="2"', 'upper="0.1"', 'lower="0"'])
def test_a_limit_that_is_left_out_is_0_as_in_pinocchio(limit, kind):
    text = replace_once(ARM, 'lower="-3" upper="3"', limit).replace("revolute", kind)
    urdf = parse_urdf(text)
    model = convert(urdf).spec.compile()
    pinocchio_model = pinocchio.buildModelFromXML(text)
    expected = [pinocchio_model.lowerPositionLimit[0], pinocchio_model.upperPositionLimit[0]]
    if expected == [0, 0]:  # what exporters write where none is set
        assert not model.joint("j").limited
    else:
        np.testing.assert_array_equal(model.joint("j").range, expected)
    assert any("limits of 0" in line for line in urdf.report.to_lines())


def test_limits_beyond_all_bounds_are_unlimited():
    limit = '<limit lower="-1e16" upper="0.5" effort="1e12" velocity="1e10"/>'
    urdf = parse_urdf(ARM.replace(LIMIT, limit))
    model = convert(urdf).spec.compile()
    np.testing.assert_array_equal(model.joint("j").range, [-1e9, 0.5])
    assert not model.jnt_actfrclimited.any()
    assert not model.actuator_ctrllimited.any()
    for name in ("effort", "velocity"):
        assert f"assumed: any {name}, for the limit is beyond 1e9: j" in urdf.report.to_lines()
    # Where the text is written anew, for another reason, it can be read again.
    again = parse_urdf(parse_urdf(ARM.replace(LIMIT, limit).replace(' name="r"', "")).text)
    assert again.robot.joints[0].limit.velocity == np.inf


@pytest.mark.parametrize(
    ("rgba", "expected"),
    [
        ("255 51 0 1", [1, 0.2, 0, 1]),
        ("255 51 0 255", [1, 0.2, 0, 1]),
        ("0.2 0.4 0.6", [0.2, 0.4, 0.6, 1]),
        ("1.01 -0.1 0.5 1", [1, 0, 0.5, 1]),
        ("0.1 0.2 0.3 0.4", [0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_colors_are_brought_into_range(rgba, expected):
    material = f'<material name="paint"><color rgba="{rgba}"/></material>'
    visual = '<visual><geometry><box size="1 1 1"/></geometry>{}</visual>'
    for shared, used in ((material, '<material name="paint"/>'), ("", material)):
        urdf = parse_urdf(robot(shared, link("a", inertial(1), visual.format(used))))
        model = convert(urdf).spec.compile()
        np.testing.assert_allclose(model.mat("paint").rgba, expected, atol=1e-6)
        changed = rgba != " ".join(map(str, expected))
        assert any("colors of" in line for line in urdf.report.to_lines()) == changed


def test_capsules_are_mujocos_own():
    """Compare with MuJoCo's own reader of URDF, which is the independent one."""
    capsule = shape('capsule radius="0.1" length="1"', "1 2 3", rpy="0.3 0.2 1")
    text = robot(link("a", inertial(1), capsule))
    mujoco_model = mujoco.MjModel.from_xml_string(text)
    model = convert(parse_urdf(text)).spec.compile()
    geom = model.geom("a").id
    assert model.geom_type[geom] == mujoco_model.geom_type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE
    for name in ("geom_size", "geom_pos", "geom_quat"):
        np.testing.assert_allclose(
            getattr(model, name)[geom], getattr(mujoco_model, name)[0], atol=1e-12, err_msg=name
        )
    # It stands on the lowest point of its surface: a center's height less the radius.
    data = make_data(model, model.key("home").qpos)
    ends = data.geom("a").xpos[2] + 0.5 * data.geom("a").xmat[8] * np.array([-1, 1])
    assert find_lowest_point(model, data, geom) == pytest.approx(ends.min() - 0.1)
    assert find_lowest_point(model, data, geom) == pytest.approx(0, abs=1e-9)


def test_a_base_without_mass_cannot_float():
    with pytest.raises(UrdfError, match="'a' is to float and has no mass"):
        convert(parse_urdf(robot(link("a"))), options=Options(floating=True))
