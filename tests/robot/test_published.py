"""URDFs as their makers publish them: what every reader passes over is passed over, and said."""

import mujoco
import numpy as np
import pytest

from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.mjcf import convert, write_xml
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.legs import find_legs
from quadwalk.robot.urdf import parse_urdf, read_urdf
from tests.robot.robots import check_dynamics, inertial, joint, link, make_data, robot, shape

TEXT = ALIENGO_URDF.read_text()


def xml(text: str) -> str:
    """The MJCF of a quadruped's URDF."""
    urdf = parse_urdf(text)
    return write_xml(convert(urdf, find_legs(urdf.tree)).spec)


# What makers write beside URDF: the AlienGo's text, what it becomes, and the kind in the report.
EXTENSIONS = {
    "joint attribute": ('type="fixed"', 'type="fixed" dont_collapse="true"', "joint dont_collapse"),
    "limit attribute": ("effort=", 'command_effort="4" effort=', "limit command_effort"),
    "dynamics attribute": ("<dynamics ", '<dynamics D="1" ', "dynamics D"),
    "geometry name": ("<geometry>", '<geometry name="g">', "geometry name"),
    "element of a link": ("</link>", "<self_filter/></link>", "<self_filter> of a link"),
    "with elements": ("</link>", "<kinematic><a b='nan'/></kinematic></link>", "<kinematic> of a"),
    "a stray origin": ("</link>", '<origin xyz="1 2 3"/></link>', "<origin> of a link"),
    "a stray gravity": ("</link>", "<gravity>0</gravity></link>", "<gravity> of a link"),
    "collision's material": ("</collision>", "<material/></collision>", "<material> of a coll"),
    "second material": (
        '<material name="graphite"/></visual>',
        '<material name="graphite"/><material name="orange"/></visual>',
        "<material> of a visual beside another",
    ),
    "texture without a file": ("<color ", "<texture/><color ", "<texture> without a file"),
    "plugin": ("</robot>", "<transmission><joint name='x'/></transmission></robot>", "<transmis"),
}


@pytest.mark.parametrize("case", EXTENSIONS)
def test_extensions_change_nothing_and_are_reported_by_kind(case):
    text = " ".join(TEXT.split()).replace("> <", "><")
    old, new, kind = EXTENSIONS[case]
    assert old in text
    extended = text.replace(old, new)
    assert xml(extended) == xml(text)
    (line,) = [
        line for line in parse_urdf(extended).report.to_lines() if line.startswith("dropped")
    ]
    assert line.startswith(f"dropped: extensions of other tools: {kind}")
    assert line.endswith(f"({text.count(old)})")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("<inertial>", "<inertail>", "has a <inertail> in it; expected <inertial>"),
        ("<inertial>", "<Inertial>", "expected <inertial>"),
        ("<collision>", "<colision>", "expected <collision>"),
        ("<dynamics ", "<dynamic ", "expected <dynamics>"),
        ("lower=", "lowr=", "has attribute 'lowr'; expected lower"),
        ("damping=", "dampning=", "expected damping"),
        ("radius=", "radus=", "expected radius"),
        ("velocity=", "velcoiy=", "expected velocity"),
        ("xyz=", "xzy=", "expected xyz"),
        ("<axis ", "<axes ", "expected <axis>"),
        ('<joint name="imu_joint"', '<jiont name="imu_joint"', "expected <joint>"),
    ],
)
def test_a_name_that_is_nearly_one_that_is_missing_is_refused(old, new, says):
    assert old in TEXT
    text = TEXT.replace(old, new, 1)
    if old.startswith("<"):
        closing = old.replace("<", "</"), new.replace("<", "</")
        at = text.index(new)
        text = text[:at] + text[at:].replace(*closing, 1)
        if "jiont" in new:
            text = text[:at] + text[at:].replace("</joint>", "</jiont>", 1)
    with pytest.raises(UrdfError, match="line ") as raised:
        parse_urdf(text)
    assert says in str(raised.value)


def test_a_robot_without_a_name_has_its_files(tmp_path):
    file = tmp_path / "walker.urdf"
    file.write_text("<!-- <robot> -->" + TEXT.replace('<?xml version="1.0"?>', "").replace(
        '<robot name="aliengo"', "<robot"))  # fmt: skip
    urdf = read_urdf(file)
    assert urdf.robot.name == "walker"
    assert "assumed: the robot's name, for it has none: walker" in urdf.report.to_lines()
    assert parse_urdf(urdf.text, "copy.urdf").robot.name == "walker"  # a run's copy as well


def converted(text: str) -> tuple[mujoco.MjModel, list[str]]:
    """The model, compiled of its XML, and the lines of the report."""
    conversion = convert(parse_urdf(text))
    return mujoco.MjModel.from_xml_string(write_xml(conversion.spec)), conversion.report.to_lines()


def arm(limit: str, kind: str = "revolute") -> str:
    body = link("a", inertial(1))
    return robot(link("world"), body, joint("j", "world", "a", kind=kind, extra=limit))


@pytest.mark.parametrize(
    ("limit", "says"),
    [
        ("", "there are none"),
        ('<limit effort="3" velocity="4"/>', "there are none"),
        ('<limit lower="0" upper="0" effort="3" velocity="4"/>', "both are 0"),
        ('<limit lower="-1e16" upper="1e16" effort="3" velocity="4"/>', "they are beyond 1e9"),
    ],
)
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_no_position_limits_are_unlimited(limit, says, kind):
    model, lines = converted(arm(limit, kind))
    assert not model.jnt_limited[0]
    assert f"assumed: no position limits, for {says}: j" in lines


def test_one_limit_beyond_all_bounds_leaves_the_other():
    model, _ = converted(arm('<limit lower="-1e16" upper="0.5" effort="3" velocity="4"/>'))
    assert model.jnt_limited[0]
    np.testing.assert_array_equal(model.jnt_range[0], [-1e9, 0.5])


def test_effort_and_speed_beyond_all_bounds_are_unlimited():
    model, lines = converted(arm('<limit lower="-1" upper="1" effort="1e12" velocity="1e10"/>'))
    assert not model.jnt_actfrclimited[0]
    assert not model.actuator_ctrllimited[0]
    assert "assumed: any effort, for the limit is beyond 1e9: j" in lines
    assert "assumed: any velocity, for the limit is beyond 1e9: j" in lines


def follower(kind: str = "revolute", own: str = "revolute") -> str:
    limit = '<limit lower="-1" upper="1" effort="9" velocity="1"/>'
    mimic = '<mimic joint="lead" multiplier="2" offset="0.3"/>'
    return robot(
        link("world"), link("a", inertial(1)), link("b", inertial(1)),
        joint("lead", "world", "a", kind=kind),
        joint("follow", "world", "b", kind=own, extra=limit + mimic),
    )  # fmt: skip


def test_a_joint_that_follows_another():
    model, _ = converted(follower())
    assert model.nu == 1
    np.testing.assert_array_equal(model.key("home").qpos, [0, 0.3])
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    while data.time < 2:
        data.ctrl = 5 * (0.3 - data.qpos[0]) - 5 * data.qvel[0]
        mujoco.mj_step(model, data)
    assert data.qpos[0] > 0.1
    assert data.qpos[1] == pytest.approx(0.3 + 2 * data.qpos[0], abs=1e-3)


def test_what_follows_a_fixed_joint_is_held():
    model, lines = converted(follower(kind="fixed"))
    assert (model.nv, model.nu) == (1, 0)
    data = make_data(model, [0.1])
    while data.time < 2:
        mujoco.mj_step(model, data)
    assert data.qpos[0] == pytest.approx(0.3, abs=1e-3)
    assert model.key("home").qpos[0] == 0.3
    assert "assumed: held still, for they follow a fixed joint: follow" in lines


def test_a_fixed_joint_follows_nothing():
    model, lines = converted(follower(own="fixed"))
    assert (model.nv, model.neq) == (1, 0)
    assert "dropped: <mimic> of fixed joints: follow" in lines


def ball_joint(middle: str = "", base: str = "") -> str:
    """An arm whose shoulder is three hinges and a slide, over links without mass."""
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
    urdf = parse_urdf(ball_joint(base=base))
    conversion = convert(urdf)
    model = conversion.spec.compile()
    assert (model.body("upper").jntnum[0], model.nbody) == (4, 4)
    check_dynamics(urdf, conversion.spec)
    fused = "fused: joints over links without mass: j1 with upper, j2 with upper, j3 with upper"
    assert fused in conversion.report.to_lines()


def test_a_link_without_mass_that_could_touch_something_is_refused():
    with pytest.raises(UrdfError, match=r"'m2' moves \(joint 'j2'\) and has no mass"):
        parse_urdf(ball_joint(shape('sphere radius="0.1"')))


def test_numbers_of_an_origin_that_are_nothing_are_0():
    text = arm("").replace('rpy="0 0 0"', 'rpy="1e-66 0 -5.8e-60"')
    assert write_xml(convert(parse_urdf(text)).spec) == write_xml(convert(parse_urdf(arm(""))).spec)
