"""The converted robot has the dynamics that Pinocchio computes from the same URDF."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.pinocchio_oracle import Pinocchio
from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.mjcf import convert, write_xml
from quadwalk.robot.structure.legs import find_legs
from quadwalk.robot.urdf import parse_urdf, read_urdf
from tests.robot.robots import check_dynamics, inertial, joint, link, robot


def check(file: Path) -> None:
    urdf = read_urdf(file)
    legs = find_legs(urdf.tree)
    spec = convert(urdf, legs).spec
    check_dynamics(urdf, spec, {f"position of {leg.foot_name}" for leg in legs})


def test_aliengo():
    check(ALIENGO_URDF)


def test_reference_quadrupeds(reference_urdf):
    check(reference_urdf)


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


@pytest.mark.parametrize("kind", ["prismatic", "planar", "floating"])
@pytest.mark.parametrize("afloat", [False, True])
def test_an_arm(kind, afloat):
    text = ARM.replace('name="rail" type="prismatic"', f'name="rail" type="{kind}"')
    if kind == "planar":  # Pinocchio takes the plane across z, whatever the axis.
        text = text.replace('<axis xyz="1 2 3"/>', '<axis xyz="0 0 2"/>')
    urdf = parse_urdf(set_afloat(text) if afloat else text)
    spec = convert(urdf).spec
    model = spec.compile()
    assert model.nv == {"prismatic": 2, "planar": 4, "floating": 7}[kind] + 6 * afloat
    assert model.nbody == 3 + afloat
    motors = [model.actuator(i).name for i in range(model.nu)]
    assert motors == ["rail"] * (kind == "prismatic") + ["turn"]
    check_dynamics(urdf, spec, {"position of tool"})


def test_a_plane_is_across_its_axis():
    ends = link("world"), link("puck", inertial(2, "0.1 0.2 0.15", "0.1 0.2 0.3"))
    at = {"xyz": "0 1 2", "rpy": "0.1 0.2 0.3"}
    planar = robot(*ends, joint("j", "world", "puck", "0 3 0", **at, kind="planar", extra=""))
    # z turns onto y about -x by a quarter: x stays, y becomes -z.
    chain = robot(
        *ends, link("a"), link("b"),
        joint("j_x", "world", "a", "1 0 0", **at, kind="prismatic"),
        joint("j_y", "a", "b", "0 0 -1", kind="prismatic"),
        joint("j_turn", "b", "puck", "0 1 0", kind="continuous", extra=""),
    )  # fmt: skip
    errors = Pinocchio(SimpleNamespace(text=chain), convert(parse_urdf(planar)).spec.compile())
    assert max(errors.compute_errors(50).values()) < 1e-10


def test_a_floating_joint_from_the_ground_is_the_floating_base():
    text = ALIENGO_URDF.read_text()
    base = joint("base", "world", parse_urdf(text).tree.root, kind="floating", extra="")
    urdf = parse_urdf(text.replace("</robot>", link("world") + base + "</robot>"))
    expected = write_xml(convert(parse_urdf(text), find_legs(parse_urdf(text).tree)).spec)
    assert write_xml(convert(urdf, find_legs(urdf.tree)).spec) == expected
    assert "dropped: the ground's link and its floating joint: world" in urdf.report.to_lines()
