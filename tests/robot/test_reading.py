"""A URDF that is not valid is refused with one line: file, element, and what is expected."""

import re
import time
from pathlib import Path

import mujoco
import pytest

from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.mjcf import Options, convert
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.legs import find_legs
from quadwalk.robot.urdf import parse_urdf, read_urdf
from tests.robot.robots import inertial, joint, link, robot

TEXT = ALIENGO_URDF.read_text()
TRUNK_INERTIA = 'ixx="0.051944892"'
BOMB = '<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>'
EXTERNAL = '<!DOCTYPE robot [<!ENTITY a SYSTEM "file:///etc/passwd">]>'


def changed(old: str, new: str) -> str:
    """AlienGo's URDF with the first `old` replaced."""
    assert old in TEXT
    return TEXT.replace(old, new, 1)


def load(text: str | bytes) -> mujoco.MjSpec:
    """All that stands between a text and a model: reading, checking, converting."""
    urdf = parse_urdf(text, "robot.urdf")
    return convert(urdf, find_legs(urdf.tree)).spec


EXTRA_LINK = link("extra") + "</robot>"
BOX = '<box size="0.647 0.15 0.112"/>'
MIMIC = '<dynamics damping="0.22" friction="0.425" armature="0.009"/>'

# What is wrong; the text, or what in the AlienGo's becomes what; and what the message must name.
BAD = {
    "empty": ("", "is empty"),
    "blank": (" \n ", "is empty"),
    "not XML": ("hello", "not well-formed"),
    "binary": (b"\x00\xff\xfe\x01", "not well-formed"),
    "truncated": (TEXT[: len(TEXT) // 2], "not well-formed"),
    "unclosed": (TEXT.replace("</robot>", ""), "not well-formed"),
    "two documents": (TEXT + "<robot/>", "not well-formed"),
    "entity bomb": (TEXT.replace("<robot", BOMB + "<robot").replace("orange", "&b;"), "DOCTYPE"),
    "external entity": (TEXT.replace("<robot", EXTERNAL + "<robot"), "DOCTYPE"),
    "undefined entity": ("orange", "&who;", "not well-formed"),
    "wrong root": ('<mujoco model="x"/>', "<mujoco>; expected <robot>"),
    "no links": ('<robot name="x"/>', "no <link>"),
    "no link name": ('<link name="trunk"', "<link", "<link> has no 'name'"),
    "empty link name": ('<link name="trunk"', '<link name=" "', "empty 'name'"),
    "no joint name": ('<joint name="imu_joint"', "<joint", "<joint> has no 'name'"),
    "duplicate link": ('<link name="FL_foot"', '<link name="FR_foot"', "'FR_foot' app"),
    "duplicate joint": ('"FL_hip_joint"', '"FR_hip_joint"', "joint 'FR_hip_joint' appears twice"),
    "unknown parent": ('<parent link="trunk"', '<parent link="tronk"', "parent 'tronk'"),
    "unknown child": ('<child link="FR_hip"', '<child link="hip"', "child 'hip'"),
    "no parent": ('<parent link="trunk"/>', "", "has no <parent>"),
    "two parents": ("</robot>", joint("extra", "extra", "FR_hip") + EXTRA_LINK, "second parent"),
    "two roots": ("</robot>", EXTRA_LINK, "2 links have no parent ('trunk', 'extra')"),
    "cycle": ('<child link="imu_link"/>', '<child link="trunk"/>', "expected"),
    "joint to itself": (
        'trunk"/>\n    <child link="imu_link"/>', 'imu_link"/>\n    <child link="imu_link"/>',
        "joint 'imu_joint' joins link 'imu_link' to itself",
    ),
    "missing value": ('<mass value="11.644"/>', "<mass/>", "<mass> has no 'value'"),
    "missing moment": (TRUNK_INERTIA, "", "<inertia> has no 'ixx'"),
    "missing inertia": (changed("<mass", "<!--").replace("<inertia ", "--><!-- ", 1)
                        .replace("/>\n    </inertial>", "-->\n    </inertial>", 1), "has no <"),
    "not a number": ('value="11.644"', 'value="heavy"', 'value="heavy"'),
    "python number": ('value="11.644"', 'value="1_1"', 'value="1_1"'),
    "two numbers": ('value="11.644"', 'value="11 644"', "expected one number"),
    "short vector": ('xyz="0.2407 -0.051 0"', 'xyz="0.2407 -0.051"', "expected 3"),
    "NaN mass": ('value="11.644"', 'value="nan"', 'value="nan"'),
    "infinite effort": ('effort="35.278"', 'effort="inf"', 'effort="inf"'),
    "overflow": ('value="11.644"', 'value="1e999"', "finite"),
    "enormous": ('value="11.644"', 'value="1e12"', "at most"),
    "NaN in an extension": (
        "<dynamics d", '<safety_controller k_position="nan"/><dynamics d', 'k_position="nan"',
    ),
    "zero axis": ('<axis xyz="1 0 0"', '<axis xyz="0 0 0"', "'FR_hip_joint': <axis>"),
    "unknown type": ('type="revolute"', 'type="hinge"', "of type 'hinge'"),
    "reversed": ('lower="-1.2217304763960306"', 'lower="2"', "lower 2 and upper 1.22"),
    "negative effort": ('effort="35.278"', 'effort="-1"', 'effort="-1"'),
    "negative mass": ('value="1.993"', 'value="-1.993"', "link 'FR_hip': <mass>"),
    "zero mass": ('value="1.993"', 'value="0"', "link 'FR_hip' moves"),
    "massless trunk": ('value="11.644"', 'value="0"', "link 'trunk'"),
    "negative moment": (TRUNK_INERTIA, 'ixx="-0.05"', "link 'trunk': <inertia>"),
    "not definite": ('ixy="0.001703617"', 'ixy="0.2"', "expected positive"),
    "triangle": (TRUNK_INERTIA, 'ixx="5"', "above the sum of the others"),
    "no inertial": (
        re.sub(r'(<link name="FR_thigh">\s*)<inertial>.*?</inertial>', r"\1", TEXT, flags=re.S),
        "link 'FR_thigh' moves (joint 'FR_thigh_joint')",
    ),
    "mimic of none": (MIMIC, MIMIC + '<mimic joint="tail"/>', "follows joint 'tail'"),
    "mimic of itself": (MIMIC, MIMIC + '<mimic joint="FR_hip_joint"/>', "'FR_hip_joint' in a cir"),
    "negative radius": ('radius="0.046"', 'radius="-0.046"', 'radius="-0.046"'),
    "negative size": ('size="0.647 0.15', 'size="0.647 -0.15', "<box>"),
    "zero size": ('<cylinder radius="0.046"', '<cylinder radius="0"', "above 1e-09 m"),
    "denormal": ('value="11.644"', 'value="1e-320"', "0 or at least"),
    "negative damping": ('damping="0.22"', 'damping="-1"', 'damping="-1"'),
    "misspelt attribute": ('<axis xyz="1 0 0"', '<axis xzy="1 0 0"', "attribute 'xzy'"),
    "misspelt element": ('<origin xyz="0.2407', '<orgin xyz="0.2407', "has a <orgin> in it"),
    "twice": ('<axis xyz="1 0 0"/>', '<axis xyz="1 0 0"/><axis xyz="0 1 0"/>', "2 <axis>"),
    "two shapes": (BOX, BOX + '<sphere radius="1"/>', "holds 2 shapes"),
    "no shape": (BOX, "", "holds 0 shapes"),
    "unknown shape": (BOX, "<cone/>", "<cone>"),
    "empty capsule": (BOX, "<capsule/>", "<capsule> has no 'radius'"),
    "bad color": ('rgba="1.0 0.42 0.04 1"', 'rgba="1.0 0.42"', "expected 4 numbers"),
    "second color": ('name="graphite"', 'name="orange"', "a second color"),
    "link named world": (TEXT.replace('"FR_foot"', '"world"'), "'world' is not the root"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_refuses(case):
    *text, named = BAD[case]
    with pytest.raises(UrdfError) as raised:
        load(changed(*text) if len(text) == 2 else text[0])
    message = str(raised.value)
    assert message.startswith("robot.urdf")
    assert named in message
    assert "expected" in message
    assert "\n" not in message


def test_a_name_with_line_breaks_or_without_end_makes_one_line():
    for name in ("tr&#10;onk&#13;", "tronk" * 10_000):
        with pytest.raises(UrdfError, match="parent") as raised:
            load(changed('<parent link="trunk"', f'<parent link="{name}"'))
        assert len(str(raised.value).splitlines()) == 1
        assert len(str(raised.value)) <= 800


def test_a_cycle_beside_the_root_is_named():
    loop = joint("ab", "a", "b", kind="fixed") + joint("ba", "b", "a", kind="fixed")
    loop = link("a") + link("b") + loop + "</robot>"
    with pytest.raises(UrdfError, match="'a' is its own ancestor; expected a tree"):
        load(TEXT.replace("</robot>", loop))


def test_refuses_what_is_no_file(tmp_path: Path):
    with pytest.raises(UrdfError, match=r"is a folder; expected a URDF"):
        read_urdf(tmp_path)
    with pytest.raises(UrdfError, match=r"none\.urdf: cannot be read \(No such file"):
        read_urdf(tmp_path / "none.urdf")
    with pytest.raises(UrdfError, match="cannot be read"):
        read_urdf(Path("a\0b"))
    if Path("/dev/zero").exists():
        with pytest.raises(UrdfError, match="larger than 16 MB"):
            read_urdf(Path("/dev/zero"))


def chain(length: int, kind: str, *body: str) -> str:
    """A robot of so many joints in a row, whose links are of `body`, the first one massive."""
    links = [link("l0", inertial(1, "1 1 1")), *(link(f"l{i + 1}", *body) for i in range(length))]
    at = {"xyz": "0 0 1", "kind": kind, "extra": ""}
    return robot(*links, *(joint(f"j{i}", f"l{i}", f"l{i + 1}", **at) for i in range(length)))


def test_refuses_100_000_links_in_bounded_time():
    text, start = chain(99_999, "fixed"), time.process_time()
    with pytest.raises(UrdfError, match="100000 links or joints; expected at most 2000"):
        load(text)
    assert time.process_time() - start < 5


def test_as_many_links_and_joints_as_are_allowed_convert():
    model = convert(parse_urdf(chain(1999, "fixed"))).spec.compile()
    assert model.nsite == 2000  # one per fused link, one for the IMU
    moving = inertial(1, "1 1 1")
    assert convert(parse_urdf(chain(500, "continuous", moving))).spec.compile().nv == 506
    with pytest.raises(UrdfError, match="501 joints that move; expected at most 500"):
        parse_urdf(chain(501, "continuous", moving))


def test_pybullets_xml_version_is_taken_for_1_0():
    urdf = parse_urdf(changed('version="1.0"', 'version="0.0"').encode())
    assert urdf.report.to_lines() == ["assumed: XML 1.0, for the file says 0.0"]
    with pytest.raises(UrdfError, match="not well-formed"):
        parse_urdf(changed('version="1.0"', 'version="7"').encode())


def test_reads_what_the_file_says_in_any_encoding():
    text = TEXT.replace('name="aliengo"', 'name="Älien"').replace(
        '<?xml version="1.0"?>', '<?xml version="1.0" encoding="iso-8859-1"?>'
    )
    assert parse_urdf(text.encode("latin-1")).robot.name == "Älien"
    assert parse_urdf(text).robot.name == "Älien"  # text, whatever it declares


def test_an_axis_need_not_be_normalized_or_given():
    model = load(changed('<axis xyz="0 1 0"', '<axis xyz="0 7 0"')).compile()
    assert model.joint("FR_thigh_joint").axis == pytest.approx([0, 1, 0])
    model = load(changed('<axis xyz="1 0 0"/>', "")).compile()
    assert model.joint("FR_hip_joint").axis == pytest.approx([1, 0, 0])


def test_a_base_without_mass_cannot_float():
    with pytest.raises(UrdfError, match="'a' is to float and has no mass"):
        convert(parse_urdf(robot(link("a"))), options=Options(floating=True))
