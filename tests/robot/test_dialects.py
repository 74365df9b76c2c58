"""URDFs as other tools write them: read as those tools do, or refused by what they would lose."""

import re

import mujoco
import numpy as np
import pinocchio
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from quadwalk.errors import UsageError
from quadwalk.robot.mjcf import Options, convert
from quadwalk.robot.quadruped import make_quadruped
from quadwalk.robot.report import UrdfError
from quadwalk.robot.scene import find_lowest_point
from quadwalk.robot.structure.tree import to_roll_pitch_yaw
from quadwalk.robot.urdf import parse_urdf, read_urdf
from tests.robot import robots
from tests.robot.robots import LIMIT, ball_calf, check_dynamics, inertial, joint, link, shape

DOG = robots.quadruped(ball_calf)
HEAD = link("head", inertial(0.3)) + joint("neck", "trunk", "head", xyz="0.25 0 0.1")
# A body, and another on a hinge of it: of this, `replaced` changes one thing.
ARM = robots.robot(
    link("a", inertial(1, "1 1 1")),
    link("b", inertial(1, "1 1 1"), shape('box size="1 1 1"')),
    joint("j", "a", "b", extra=LIMIT + '<dynamics damping="1" friction="2"/>'),
)


def with_parts(*parts: str, text: str = DOG) -> str:
    """Return a robot's text with more links and joints at its end."""
    return text.replace("</robot>", "".join(parts) + "</robot>")


def replaced(old: str, new: str, text: str = ARM) -> str:
    """Return `text` with the first `old` replaced."""
    assert old in text
    return text.replace(old, new, 1)


def read_dog(text: str, fix: tuple[str, ...] = (), **options):
    """Return the quadruped of a text, and what was said of it in one text."""
    dog = make_quadruped(parse_urdf(text, "r.urdf", fix=fix), Options(**options))
    # A run keeps this text, from which the same robot has to come.
    again = make_quadruped(parse_urdf(dog.urdf, "r.urdf", fix=fix), Options(**options))
    np.testing.assert_array_equal(again.home, dog.home)
    return dog, "\n".join(dog.notes)


def check_same_model(one: mujoco.MjModel, other: mujoco.MjModel) -> None:
    for name in ("body_pos", "body_quat", "body_mass", "jnt_range", "geom_pos", "geom_size"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


def test_a_rotations_angles_are_scipys_at_a_pitch_of_90_degrees_too():
    rng = np.random.default_rng(0)
    up = np.array([0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)])
    for quat in [*rng.normal(size=(50, 4)), up, -3 * up, up + 1e-9 * rng.normal(size=4)]:
        expected = Rotation.from_quat(quat).as_matrix()
        angles = to_roll_pitch_yaw(expected)
        matrix = Rotation.from_euler("xyz", angles).as_matrix()
        np.testing.assert_allclose(matrix, expected, atol=1e-12)


@pytest.mark.parametrize(
    "quat", ["0 0.70710678 0 0.70710678", "0.1 0.2 0.3 0.927361849549570", "0 0 2 -2"]
)
def test_quaternions_of_urdf_1_1_are_read_as_pinocchio_reads_them(quat):
    """In a joint, an inertia and a shape; its text is then URDF 1.0, for readers of that."""
    for place in range(3):
        text = ARM.replace('name="r"', 'name="r" version="1.1"')
        head, *tail = text.split(' rpy="0 0 0"')
        text = ' rpy="0 0 0"'.join([head, *tail[: place + 1]])
        rest = ' rpy="0 0 0"'.join(tail[place + 1 :])
        text = f'{text} quat_xyzw="{quat}"{rest}'
        urdf = parse_urdf(text)
        theirs = pinocchio.buildModelFromXML(text)
        ours = pinocchio.buildModelFromXML(urdf.text)
        assert "quat" not in urdf.text
        assert theirs.jointPlacements[1].isApprox(ours.jointPlacements[1], 1e-9)
        assert theirs.inertias[1].isApprox(ours.inertias[1], 1e-9)
        check_dynamics(urdf, convert(urdf).spec, states=3)


@pytest.mark.parametrize(
    ("origin", "says"),
    [
        ('quat_xyzw="0 0 0 1" rpy="0 0 1"', "has both rpy and quat_xyzw"),
        ('quat_xyzw="0 0 0 0"', "quat_xyzw of length 0; expected a rotation"),
        ('quat_xyzw="0 0 1"', "expected 4 numbers"),
        ('quat_xyz="0 0 0 1"', "expected quat_xyzw"),
    ],
)
def test_a_quaternion_that_is_no_rotation_is_refused(origin, says):
    with pytest.raises(UrdfError, match=re.escape(says)):
        parse_urdf(replaced('rpy="0 0 0"', origin))


LIMITS = '<limit lower="-3" upper="3" effort="20" velocity="10"/>'
DYNAMICS = '<dynamics damping="1" friction="2"/>'


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (DYNAMICS, "<dynamics><damping>1</damping></dynamics>", 'expected damping="..."'),
        (DYNAMICS, "<dynamics>1</dynamics>", "holds '1' as text; expected attributes: damping"),
        (DYNAMICS, '<damping value="1"/>', 'expected <dynamics damping="...">'),
        ('type="revolute"', 'type="revolute" armature="1"', 'expected <dynamics armature="...">'),
        (LIMITS, '<limit effort="20" velocity="10"><lower>-3</lower></limit>', 'lower="..."'),
        (LIMITS, '<limit effort="20" velocity="10" min="-3" max="3"/>', '<limit lower="...">'),
        (LIMITS, "<limit><Effort>20</Effort></limit>", 'expected effort="..."'),
        ('<axis xyz="0 0 1"/>' + LIMITS, f'<axis xyz="0 0 1">{LIMITS}</axis>', "expected <limit>"),
        ('<axis xyz="0 0 1"/>', "<axis><xyz>0 0 1</xyz></axis>", "expected xyz"),
        ('<axis xyz="0 0 1"/>', "", None),
        ('type="revolute"', 'type="revolute" axis="0 0 1"', None),
        ('<origin xyz="0 0 0" rpy="0 0 0"/><parent', "<origin>0 0 1</origin><parent", "as text"),
        ('<origin xyz="0 0 0" rpy="0 0 0"/><parent', "<origin><xyz>0</xyz></origin><parent", "xyz"),
        ('<link name="a">', '<link name="a" mass="1">', None),
        ('type="revolute"', 'type="fixed" armature="1"', None),
    ],
)
def test_physics_in_another_place_is_refused_by_what_is_expected(old, new, says):
    text = replaced(old, new)
    if says is None:  # there as well, or no more than a default
        parse_urdf(text)
        return
    with pytest.raises(UrdfError, match=re.escape(says)):
        parse_urdf(text)


def test_an_axis_as_an_attribute_is_refused_where_there_is_none():
    text = replaced('<axis xyz="0 0 1"/>', "", replaced('"revolute"', '"revolute" axis="0 0 1"'))
    with pytest.raises(UrdfError, match="has attribute 'axis'; expected <axis>"):
        parse_urdf(text)
    massless = robots.robot('<link name="a"><mass value="1"/></link>')
    with pytest.raises(UrdfError, match="has a <mass> in it; expected <inertial/mass>"):
        parse_urdf(massless)


@pytest.mark.parametrize(
    "world",
    [
        link("world"),
        link("world", shape('box size="9 9 0.1"', kind="visual")),
        link("world", shape('box size="9 9 0.1"', "0 0 -0.05")),
    ],
)
def test_a_dog_that_a_joint_fixes_to_the_world_floats(world):
    place = joint("w", "world", "trunk", xyz="0 0 0.4", rpy="0 0.3 0", kind="fixed", extra="")
    dog, said = read_dog(with_parts(world, place))
    assert "the link 'world' and the joint that holds the robot there: w" in said
    assert dog.trunk == "trunk"
    assert "world" not in dog.urdf
    check_same_model(dog.make_full_model(), make_quadruped(parse_urdf(DOG)).make_full_model())


def test_an_arm_that_a_joint_fixes_to_the_world_stays_there():
    base = link("world") + joint("w", "world", "a", kind="fixed", extra="")
    urdf = parse_urdf(with_parts(base, text=ARM))
    assert convert(urdf).spec.compile().nv == 1


def test_legs_that_lead_from_the_world_are_refused_in_words():
    two = joint("w", "world", "trunk", kind="fixed", extra="")
    two += link("post") + joint("v", "world", "post", kind="fixed", extra="")
    with pytest.raises(UrdfError, match="the legs' joints lead from link 'world', the ground"):
        make_quadruped(parse_urdf(with_parts(link("world"), two)))


MARK = shape('sphere radius="0.01"', kind="visual")


@pytest.mark.parametrize(
    "parts",
    [(), (MARK,), (MARK, shape('mesh filename="no.stl"', kind="visual")), (inertial(0),)],
)
def test_a_footprint_from_which_the_trunk_floats_is_dropped(parts):
    floats = joint("f", "footprint", "trunk", xyz="0 0 0.4", kind="floating", extra="")
    dog, said = read_dog(with_parts(link("footprint", *parts), floats))
    assert "dropped: the ground's link and its floating joint: footprint" in said
    check_same_model(dog.make_full_model(), make_quadruped(parse_urdf(DOG)).make_full_model())


@pytest.mark.parametrize("part", [inertial(1), shape('box size="1 1 1"')])
def test_what_could_weigh_or_touch_is_no_footprint(part):
    floats = joint("f", "footprint", "trunk", kind="floating", extra="")
    with pytest.raises(UrdfError, match="a quadruped has four of three joints each"):
        make_quadruped(parse_urdf(with_parts(link("footprint", part), floats)))


@pytest.mark.parametrize(
    "text",
    [
        DOG.replace("<robot", '<robot xmlns="http://drake.mit.edu"'),
        re.sub(r"<(/?)(\w)", r"<\1u:\2", DOG).replace("<u:robot", '<u:robot xmlns:u="http://u"'),
        with_parts(
            "<g:gazebo/>",
            text=DOG.replace("<robot", '<robot xmlns="http://a" xmlns:g="http://gazebosim.org"'),
        ),
    ],
)
def test_a_namespace_is_dropped(text):
    dog, said = read_dog(text)
    assert "dropped: the namespace: http" in said
    check_same_model(dog.make_full_model(), make_quadruped(parse_urdf(DOG)).make_full_model())


XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'


@pytest.mark.parametrize(
    "text",
    [
        f'<robot name="r" {XACRO}><xacro:include filename="leg.xacro"/></robot>',
        ARM.replace("<link", f'<xacro:leg {XACRO} name="FL"/><link', 1),
        '<robot name="r"><xacro:include filename="leg.xacro"/></robot>',
        replaced('value="1"', 'value="${mass}"'),
        replaced("box size", 'mesh filename="$(find dog)/a.stl" size'),
    ],
)
def test_xacro_is_to_be_expanded(text):
    with pytest.raises(UrdfError, match=r"r\.urdf: is not expanded: run xacro"):
        parse_urdf(text, "r.urdf")


@pytest.mark.parametrize("blank", ["\n", " \t\n\n", "\r\n \r\n", "\ufeff\n"])
def test_blank_space_may_stand_before_the_declaration(blank):
    text = f'{blank}<?xml version="1.0"?>\n{ARM}'
    urdf = parse_urdf(text.encode())
    assert any("XML declaration" in line for line in urdf.report.to_lines())
    assert pinocchio.buildModelFromXML(text).nv == 1
    line = text.replace("\r\n", "\n").count("\n") + 1
    with pytest.raises(UrdfError, match=f"line {line}: link 'a'"):
        parse_urdf(text.replace('value="1"', 'value="?"', 1).encode())


@pytest.mark.parametrize(
    ("limit", "kind"),
    [
        ('lower="-2"', "revolute"),
        ('upper="2"', "revolute"),
        ('upper="0.1"', "prismatic"),
        ('lower="0"', "revolute"),
    ],
)
def test_a_limit_that_is_left_out_is_0_as_in_pinocchio(limit, kind):
    text = replaced('lower="-3" upper="3"', limit).replace("revolute", kind)
    urdf = parse_urdf(text)
    model = convert(urdf).spec.compile()
    theirs = pinocchio.buildModelFromXML(text)
    expected = [theirs.lowerPositionLimit[0], theirs.upperPositionLimit[0]]
    if expected == [0, 0]:  # what exporters write where none is set
        assert not model.joint("j").limited
    else:
        np.testing.assert_array_equal(model.joint("j").range, expected)
    assert any("limits of 0" in line for line in urdf.report.to_lines())


def test_a_lower_limit_above_0_needs_an_upper_one():
    with pytest.raises(UrdfError, match="lower 2 and upper 0; expected lower below upper"):
        parse_urdf(replaced('lower="-3" upper="3"', 'lower="2"'))


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
        urdf = parse_urdf(robots.robot(shared, link("a", inertial(1), visual.format(used))))
        model = convert(urdf).spec.compile()
        np.testing.assert_allclose(model.mat("paint").rgba, expected, atol=1e-6)
        changed = rgba != " ".join(map(str, expected))
        assert any("colors of" in line for line in urdf.report.to_lines()) == changed


@pytest.mark.parametrize("missing", ['effort="20"', 'velocity="10"', 'effort="20" velocity="10"'])
def test_a_limit_without_effort_or_speed_leaves_them_to_flags(missing):
    text = DOG.replace(missing, "")
    flags = {"effort": "--robot.effort NM", "velocity": "--robot.speed RAD_PER_S"}
    flags = [flag for name, flag in flags.items() if name in missing]
    with pytest.raises(UrdfError, match=f"or pass {' '.join(flags)}$"):
        make_quadruped(parse_urdf(text))
    dog, said = read_dog(text, effort=12.0, speed=7.0)
    assert "for <limit> has none" in said
    assert set(dog.effort) == {12.0 if "effort" in missing else 20.0}
    assert set(dog.velocity) == {7.0 if "velocity" in missing else 10.0}


def test_capsules_are_mujocos_own():
    """Its own reader of URDF is the independent one."""
    text = robots.robot(
        link("a", inertial(1), shape('capsule radius="0.1" length="1"', "1 2 3", rpy="0.3 0.2 1"))
    )
    theirs = mujoco.MjModel.from_xml_string(text)
    model = convert(parse_urdf(text)).spec.compile()
    ours = model.geom("a").id
    assert model.geom_type[ours] == theirs.geom_type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE
    for name in ("geom_size", "geom_pos", "geom_quat"):
        np.testing.assert_allclose(
            getattr(model, name)[ours], getattr(theirs, name)[0], atol=1e-12, err_msg=name
        )
    # It stands on the lowest point of its surface: a center's height less the radius.
    data = robots.make_data(model, model.key("home").qpos)
    ends = data.geom("a").xpos[2] + 0.5 * data.geom("a").xmat[8] * np.array([-1, 1])
    assert find_lowest_point(model, data, ours) == pytest.approx(ends.min() - 0.1)
    assert find_lowest_point(model, data, ours) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("rpy", ["0 0 0", "0 0.5 0", "0 -0.8 0"])
def test_the_foot_of_a_calf_that_is_a_capsule_is_its_end(rpy):
    calf = shape('capsule radius="0.02" length="0.16"', "0 0 -0.1", rpy=rpy)
    dog, _ = read_dog(robots.quadruped(lambda name: link(f"{name}3", inertial(0.5), calf)))
    model = dog.make_training_model(0.002)
    turn = Rotation.from_euler("xyz", [float(angle) for angle in rpy.split()])
    for foot in dog.feet:
        assert model.geom(foot).size[0] == pytest.approx(0.02, rel=0.05)
        end = turn.apply([0, 0, -0.08]) - np.array([0, 0, 0.1])
        np.testing.assert_allclose(model.geom(foot).pos, end, atol=2e-3)
    robots.check_stands(dog, 2, 0.8)


ANKLES = [
    link(f"{leg}4", inertial(0.1)) + joint(f"{leg}wheel", f"{leg}3", f"{leg}4", xyz="0 0 -0.2")
    for leg in "abcd"
]
GRIPPER = link("finger", inertial(0.1)) + joint(
    "grip", "head", "finger", kind="prismatic", extra=LIMIT + '<mimic joint="neck"/>'
)


@pytest.mark.parametrize(
    ("parts", "flag"),
    [
        ([HEAD], "neck"),
        ([HEAD.replace('"neck"', '"the neck"')], "'the neck'"),
        ([HEAD, GRIPPER], "neck grip"),
        (ANKLES, "awheel bwheel cwheel dwheel"),
        ([HEAD.replace("revolute", "continuous").replace(LIMIT, "")], "neck"),
    ],
)
def test_a_joint_that_is_no_legs_is_fixed_by_the_flag_that_the_line_names(parts, flag):
    text = with_parts(*parts)
    with pytest.raises(UrdfError, match=f"or pass --robot.fix {flag}$"):
        make_quadruped(parse_urdf(text))
    names = ("the neck",) if "'" in flag else tuple(flag.split())
    dog, said = read_dog(text, fix=names)
    assert "fixed at 0, as a flag says: " + names[0] in said
    # As if the file had it so.
    fixed = text
    for name in names:
        fixed = re.sub(f'(<joint name="{name}" type=)"\\w+"(.*?)<axis.*?</joint>',
                       r'\1"fixed"\2</joint>', fixed)  # fmt: skip
    check_same_model(dog.make_full_model(), make_quadruped(parse_urdf(fixed)).make_full_model())
    assert dog.make_full_model().nv == 18


def test_patterns_fix_several_joints_and_one_that_names_none_is_refused():
    dog, said = read_dog(with_parts(*ANKLES), fix=("*wheel",))
    assert "awheel, bwheel, cwheel, dwheel" in said
    assert len(dog.joints) == 12
    with pytest.raises(UsageError, match=r"--robot\.fix tail: names no joint; there are aj1, "):
        parse_urdf(DOG, fix=("tail",))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize(("limits", "position"), [((0.5, 3), 0.5), ((-3, -0.2), -0.2)])
def test_a_joint_whose_limits_leave_out_0_is_fixed_at_the_nearest(kind, limits, position):
    """As MuJoCo has it where the joint is there, and is at that position."""
    lower, upper = limits
    extra = f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>'
    turned = {"axis": "1 2 -2", "xyz": "0.1 0.2 0.3", "rpy": "0.3 -0.7 2", "kind": kind}
    moving = joint("j", "a", "b", extra=extra, **turned)
    text = robots.robot(link("a", inertial(1)), link("b", inertial(1)), moving)
    model = convert(parse_urdf(text)).spec.compile()
    data = robots.make_data(model, np.array([0, 0, 0, 1, 0, 0, 0, position]))
    fixed = parse_urdf(text, fix=("j",))
    assert f"fixed at {position:g}, as a flag says: j" in "\n".join(fixed.report.to_lines())
    placement = fixed.tree.placement["b"]
    np.testing.assert_allclose(placement[:3, 3], data.body("b").xpos, atol=1e-12)
    np.testing.assert_allclose(placement[:3, :3].ravel(), data.body("b").xmat, atol=1e-12)


@pytest.fixture
def box(tmp_path):
    """A folder `dog` with a URDF's place and meshes of 20 x 40 x 60 cm, visual and collision."""
    for kind, scale in (("visual", 1), ("collision", 2)):
        folder = tmp_path / "dog" / "meshes" / kind
        folder.mkdir(parents=True)
        trimesh.creation.box(np.array([0.2, 0.4, 0.6]) * scale).export(folder / "box.stl")
    return tmp_path / "dog"


def mesh_robot(name: str, extension: str = "") -> str:
    return robots.robot(
        extension, link("a", inertial(1), shape(f'mesh filename="{name}"', kind="visual"))
    )


def sizes(text: str, folder, *mesh_folders) -> tuple[list[float], str]:
    """Return the sides of the only mesh, m, none if it is left out, and the report."""
    options = Options(mesh_folders=mesh_folders)
    conversion = convert(parse_urdf(text, "r.urdf", folder), options=options)
    model = conversion.spec.compile()
    vertices = model.mesh_vert.astype(float)
    sides = np.sort(np.ptp(vertices, axis=0)).round(5).tolist() if model.nmesh else []
    return sides, "\n".join(conversion.report.to_lines())


@pytest.mark.parametrize(
    "name",
    [
        "/opt/nowhere/meshes/visual/box.stl",
        "/opt/nowhere/box.stl",
        "file:///home/me/dog/visual/box.stl",
        r"C:\Users\me\dog\meshes\visual\box.stl",
        "package://nowhere/visual/box.stl",
        "../../elsewhere/box.stl",
        "http://example.org/dog/visual/box.stl",
    ],
)
def test_a_mesh_of_another_machine_is_looked_for_by_its_name_or_left_out(box, tmp_path, name):
    text = mesh_robot(name)
    (tmp_path / "away").mkdir()
    gone, said = sizes(text, tmp_path / "away")
    assert gone == []
    assert f"dropped: visual meshes that were not found: {name}" in said
    found, said = sizes(text, tmp_path / "away", box / "meshes" / "visual")
    assert found == [0.2, 0.4, 0.6]
    assert "assumed: visual meshes found by the ends of their names: box.stl" in said


def test_the_longer_end_of_a_meshs_name_counts(box):
    for kind, first in (("visual", 0.2), ("collision", 0.4)):
        text = mesh_robot(f"/opt/nowhere/meshes/{kind}/box.stl")
        for folder in (box, box / "meshes"):
            assert sizes(text, None, folder)[0][0] == first


def test_a_file_that_lies_outside_is_refused_still(box, tmp_path):
    secret = tmp_path / "secret.stl"
    secret.write_bytes((box / "meshes" / "visual" / "box.stl").read_bytes())
    with pytest.raises(UrdfError, match=r"lies outside .*, or pass --robot\.mesh-dirs"):
        sizes(mesh_robot(str(secret)), box)


@pytest.mark.parametrize(
    ("compiler", "name"),
    [
        ('meshdir="meshes/visual"', "box.stl"),
        (
            'meshdir="meshes/visual/" balanceinertia="true" strippath="true"',
            "package://d/m/box.stl",
        ),
        ('meshdir="meshes" strippath="false"', "visual/box.stl"),
        ('meshdir="./meshes/visual"', "/opt/nowhere/box.stl"),
    ],
)
def test_meshes_are_where_mujocos_extension_says(box, tmp_path, compiler, name):
    text = mesh_robot(name, f"<mujoco><compiler {compiler}/><option/></mujoco>")
    found, said = sizes(text, box)
    assert found == [0.2, 0.4, 0.6]
    assert "<option> of a mujoco (1)" in said
    # A run's copy of the URDF has the original's folder among those of meshes.
    assert sizes(text, tmp_path, box)[0] == [0.2, 0.4, 0.6]
    # Written anew, for another reason, the text still says so.
    text = text.replace("<robot name", '<robot xmlns="http://drake.mit.edu" name')
    assert sizes(parse_urdf(text).text, box)[0] == [0.2, 0.4, 0.6]


@pytest.mark.parametrize("place", ["..", "/etc", "x" * 5000])
def test_mujocos_extension_leads_to_no_other_folder(box, tmp_path, place):
    (tmp_path / "box.stl").write_bytes((box / "meshes" / "visual" / "box.stl").read_bytes())
    text = mesh_robot("box.stl", f'<mujoco><compiler meshdir="{place}"/></mujoco>')
    assert sizes(text, box)[0] == []


def test_ply_is_read_and_glb_is_not_called_broken(box):
    mesh = trimesh.creation.box((0.2, 0.4, 0.6))
    for kind in ("ply", "glb"):
        mesh.export(box / f"a.{kind}")
    assert sizes(mesh_robot("a.ply"), box)[0] == [0.2, 0.4, 0.6]
    gone, said = sizes(mesh_robot("a.glb"), box)
    assert gone == []
    assert "dropped: visual meshes that are not read: a.glb is of kind '.glb'; expected" in said


def test_a_limit_beyond_1e9_is_written_so_that_it_can_be_read_again(tmp_path):
    text = DOG.replace('<robot name="r"', "<robot").replace('velocity="10"', 'velocity="1e10"')
    (tmp_path / "dog.urdf").write_text(text)
    urdf = read_urdf(tmp_path / "dog.urdf")
    assert parse_urdf(urdf.text).robot.joints[0].limit.velocity == np.inf
