"""The converted robot has the dynamics that Pinocchio computes from the same URDF."""

from pathlib import Path
from types import SimpleNamespace

import mujoco
import pytest

from benchmarks.pinocchio_oracle import Pinocchio
from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.mjcf import convert, write_xml
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.legs import find_legs
from quadwalk.robot.urdf import parse_urdf, read_urdf
from tests.robot.robots import check_dynamics, inertial, joint, link, robot, shape


def test_quadrupeds(reference_urdf):
    check_quadruped(reference_urdf)


def test_aliengo():
    check_quadruped(ALIENGO_URDF)


def check_quadruped(file: Path) -> None:
    """Assert that a converted quadruped has the dynamics of its URDF, feet included."""
    urdf = read_urdf(file)
    legs = find_legs(urdf.tree)
    check_dynamics(urdf, convert(urdf, legs).spec, {f"position of {leg.foot_name}" for leg in legs})


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
    """Give `ARM` a base that has mass, and no ground."""
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


def make_follower(kind: str = "revolute", follower: str = "revolute") -> str:
    """Return an arm with a joint `follow` at 0.3 plus twice joint `lead`."""
    limit = '<limit lower="-1" upper="1" effort="9" velocity="1"/>'
    mimic = '<mimic joint="lead" multiplier="2" offset="0.3"/>'
    return robot(
        link("world"), link("a", inertial(1)), link("b", inertial(1)),
        joint("lead", "world", "a", kind=kind),
        joint("follow", "world", "b", kind=follower, extra=limit + mimic),
    )  # fmt: skip


def test_a_joint_follows_another_or_is_held_by_one_that_is_fixed():
    for kind, leader in (("revolute", 0.1), ("fixed", 0.0)):
        conversion = convert(parse_urdf(make_follower(kind)))
        model = mujoco.MjModel.from_xml_string(write_xml(conversion.spec))
        assert model.nu == model.nv - 1 == (kind == "revolute")
        assert model.key("home").qpos[-1] == 0.3
        model.opt.gravity[:] = 0
        data = mujoco.MjData(model)
        while data.time < 2:
            if model.nu:
                data.ctrl = 5 * (0.3 - data.qpos[0]) - 5 * data.qvel[0]
            mujoco.mj_step(model, data)
        angle = data.joint("lead").qpos[0] if model.nu else 0.0
        assert angle >= leader
        assert data.joint("follow").qpos[0] == pytest.approx(0.3 + 2 * angle, abs=1e-3)
    note = "assumed: held still, for they follow a fixed joint: follow"
    assert note in conversion.report.to_lines()


def test_a_fixed_joint_follows_nothing():
    conversion = convert(parse_urdf(make_follower(follower="fixed")))
    model = conversion.spec.compile()
    assert (model.nv, model.neq) == (1, 0)
    assert "dropped: <mimic> of fixed joints: follow" in conversion.report.to_lines()


def make_ball_joint(middle: str = "", base: str = "") -> str:
    """Return an arm whose shoulder is three hinges and a slide, over links without mass."""
    return robot(
        link("base", base), link("m1"), link("m2", middle), link("m3"), link("frame"),
        link("upper", inertial(2, "0.1 0.2 0.15", "0.1 0.2 0.3", "0.1 0.2 0.3")),
        link("tip", inertial(1, "0.01 0.02 0.015", "0.3 0 0")),
        joint("j1", "base", "m1", "1 2 3", "0.1 0.2 0.3", "0.3 0.2 0.1"),
        joint("j2", "m1", "m2", "0 1 1", "0.4 0 0.1", "1 0 0.5"),
        joint("bolt", "m2", "frame", xyz="0 0.1 0", rpy="0 0.7 0", kind="fixed"),
        joint("j3", "frame", "m3", "1 0 0", "0 0 0.2", kind="prismatic"),
        joint("j4", "m3", "upper", "0 0 1", "0 0 0", "0 1 0", kind="continuous", extra=""),
        joint("j5", "upper", "tip", "0 1 0", "0.5 0 0"),
    )  # fmt: skip


@pytest.mark.parametrize("base", ["", inertial(3, "0.1 0.1 0.1")])
def test_joints_over_links_without_mass_are_those_of_one_body(base):
    urdf = parse_urdf(make_ball_joint(base=base))
    conversion = convert(urdf)
    model = conversion.spec.compile()
    assert (model.body("upper").jntnum[0], model.nbody) == (4, 4)
    check_dynamics(urdf, conversion.spec)
    fused = "fused: joints over links without mass: j1 with upper, j2 with upper, j3 with upper"
    assert fused in conversion.report.to_lines()


def test_a_link_without_mass_that_could_touch_something_is_refused():
    with pytest.raises(UrdfError, match=r"'m2' moves \(joint 'j2'\) and has no mass"):
        parse_urdf(make_ball_joint(shape('sphere radius="0.1"')))
