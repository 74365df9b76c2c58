"""The converted robot has the dynamics that Pinocchio computes from the same URDF."""

from pathlib import Path
from types import SimpleNamespace

import mujoco
import pytest

from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.mjcf import Options, convert, write_xml
from quadwalk.robot.structure.legs import find_legs
from quadwalk.robot.urdf import Urdf, parse_urdf, read_urdf
from tests.robot import zoo

STATES = 50


def check(pinocchio, file: Path, meshes: bool = True) -> None:
    """Compare masses, frames, mass matrix, bias and inverse dynamics, in memory and as XML."""
    urdf = read_urdf(file)
    legs = find_legs(urdf.tree, urdf.source)
    spec = convert(urdf, legs, Options(meshes=meshes)).spec
    check_spec(pinocchio, urdf, spec, {f"position of {leg.foot_name}" for leg in legs})


def check_spec(pinocchio, urdf: Urdf, spec: mujoco.MjSpec, compared: set[str]) -> None:
    """The same with the spec at hand; `compared` must be among what was."""
    in_memory = pinocchio(urdf, spec.compile()).errors(STATES)
    assert compared <= in_memory.keys()
    assert max(in_memory.values()) < 1e-10, in_memory
    from_xml = mujoco.MjModel.from_xml_string(write_xml(spec))
    through_xml = pinocchio(urdf, from_xml).errors(STATES)
    assert max(through_xml.values()) < 1e-5, through_xml


def test_aliengo(pinocchio):
    check(pinocchio, ALIENGO_URDF)


def test_reference_quadrupeds(pinocchio, reference_urdf):
    check(pinocchio, reference_urdf)


@zoo.each(zoo.QUADRUPEDS)
def test_quadrupeds_of_the_zoo(pinocchio, urdf):
    check(pinocchio, urdf, meshes=False)


def inertial(mass: float, moments: str, xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    ixx, iyy, izz = moments.split()
    return (
        f'<inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="{mass}"/><inertia ixx="{ixx}" '
        f'ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/></inertial>'
    )


# A fixed base, a slide, a slanted axis, fused links on both sides of a joint, a fused point mass,
# a thin plate (whose largest moment is the sum of the others), and links without mass.
ARM = f"""<robot name="arm"><link name="world"/><link name="base"/>
<link name="slide">{inertial(2, "0.1 0.2 0.15", "0.1 0 0", "0.3 -0.2 0.1")}</link>
<link name="bracket">{inertial(0.5, "0 0 0", "0.05 0.02 0")}</link>
<link name="plate">{inertial(0.3, "0.01 0.02 0.03", "0 0 0.4", "0.5 0.6 0.7")}</link>
<link name="tool"/>
<joint name="weld" type="fixed"><origin xyz="1 2 3" rpy="0 0.4 0"/><parent link="world"/>
  <child link="base"/></joint>
<joint name="rail" type="prismatic"><origin xyz="0 0 1" rpy="1 2 3"/><parent link="base"/>
  <child link="slide"/><axis xyz="1 2 3"/><limit lower="-1" upper="1" effort="5" velocity="1"/>
</joint>
<joint name="bolt" type="fixed"><origin xyz="0 0.1 0" rpy="0 0 1"/><parent link="slide"/>
  <child link="bracket"/></joint>
<joint name="turn" type="continuous"><origin xyz="0.2 0 0" rpy="0 1 0"/><parent link="bracket"/>
  <child link="plate"/><axis xyz="0 1 1"/></joint>
<joint name="tip" type="fixed"><origin xyz="0 0 0.8"/><parent link="plate"/><child link="tool"/>
</joint></robot>"""


def set_afloat(arm: str) -> str:
    """`ARM` with a base that has mass, and no ground."""
    base = f'<link name="base">{inertial(3, "0.1 0.1 0.1")}</link>'
    return arm.replace('"world"', '"root"').replace('<link name="base"/>', base)


def test_an_arm_on_a_fixed_base(pinocchio):
    urdf = parse_urdf(ARM)
    spec = convert(urdf).spec
    model = spec.compile()
    assert (model.nv, model.nbody) == (2, 3)
    check_spec(pinocchio, urdf, spec, {"position of tool"})


def test_an_arm_afloat(pinocchio):
    urdf = parse_urdf(set_afloat(ARM))
    errors = pinocchio(urdf, convert(urdf).spec.compile()).errors(STATES)
    assert max(errors.values()) < 1e-10, errors


@pytest.mark.parametrize("kind", ["planar", "floating"])
@pytest.mark.parametrize("afloat", [False, True])
def test_a_joint_of_several_directions(pinocchio, kind, afloat):
    text = ARM.replace('name="rail" type="prismatic"', f'name="rail" type="{kind}"')
    # Pinocchio takes the plane across z, whatever the axis.
    text = text.replace('<axis xyz="1 2 3"/>', '<axis xyz="0 0 2"/>')
    if afloat:
        text = set_afloat(text)
    urdf = parse_urdf(text)
    spec = convert(urdf).spec
    model = spec.compile()
    assert model.nv == {"planar": 4, "floating": 7}[kind] + 6 * afloat
    assert [model.actuator(i).name for i in range(model.nu)] == ["turn"]
    check_spec(pinocchio, urdf, spec, {"position of tool"})


def test_a_plane_is_across_its_axis(pinocchio):
    body = f"<link name='puck'>{inertial(2, '0.1 0.2 0.15', '0.1 0.2 0.3')}</link>"
    frame = '<origin xyz="0 1 2" rpy="0.1 0.2 0.3"/><parent link="world"/>'
    planar = (
        f'<robot name="r"><link name="world"/>{body}<joint name="j" type="planar">{frame}'
        '<child link="puck"/><axis xyz="0 3 0"/></joint></robot>'
    )
    # z turns onto y about -x by a quarter: x stays, y becomes -z.
    limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
    chain = (
        f'<robot name="r"><link name="world"/><link name="a"/><link name="b"/>{body}'
        f'<joint name="j_x" type="prismatic">{frame}<child link="a"/><axis xyz="1 0 0"/>{limit}'
        '</joint><joint name="j_y" type="prismatic"><parent link="a"/><child link="b"/>'
        f'<axis xyz="0 0 -1"/>{limit}</joint><joint name="j_turn" type="continuous">'
        '<parent link="b"/><child link="puck"/><axis xyz="0 1 0"/></joint></robot>'
    )
    spec = convert(parse_urdf(planar)).spec
    errors = pinocchio(SimpleNamespace(text=chain), spec.compile()).errors(STATES)
    assert max(errors.values()) < 1e-10, errors


def test_a_floating_joint_from_the_ground_is_the_floating_base():
    text = ALIENGO_URDF.read_text()
    ground = (
        '<link name="world"/><joint name="base" type="floating"><parent link="world"/>'
        f'<child link="{parse_urdf(text).tree.root}"/></joint></robot>'
    )
    urdf = parse_urdf(text.replace("</robot>", ground))
    expected = write_xml(convert(parse_urdf(text), find_legs(parse_urdf(text).tree, "")).spec)
    assert write_xml(convert(urdf, find_legs(urdf.tree, "")).spec) == expected
    assert "dropped: the ground's link and its floating joint: world" in urdf.report.lines()
