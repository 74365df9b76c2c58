"""Quadrupeds that can be trained, robots that cannot, and what is beside the legs."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from quadwalk.errors import UsageError
from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.cli import main
from quadwalk.robot.mjcf import Options, convert
from quadwalk.robot.quadruped import Quadruped, make_quadruped
from quadwalk.robot.report import UrdfError
from quadwalk.robot.urdf import parse_urdf
from tests.robot import robots
from tests.robot.robots import (
    LIMIT,
    Walker,
    ball_calf,
    inertial,
    joint,
    link,
    make_data,
    replace_once,
    shape,
)

DOG = robots.quadruped(ball_calf)
ALIENGO = ALIENGO_URDF.read_text()
HEAD = link("head", inertial(0.3)) + joint("neck", "trunk", "head", xyz="0.25 0 0.1")
GRIPPER = link("finger", inertial(0.1)) + joint(
    "grip", "head", "finger", kind="prismatic", extra=LIMIT + '<mimic joint="neck"/>'
)
WHEELS = "".join(
    link(f"{leg}4", inertial(0.1)) + joint(f"{leg}wheel", f"{leg}3", f"{leg}4", xyz="0 0 -0.2")
    for leg in "abcd"
)
FLOATS = joint("f", "footprint", "trunk", xyz="0 0 0.4", kind="floating", extra="")
MARK = shape('sphere radius="0.01"', kind="visual")
SMALL = Walker(size=0.3, mass=0.02)  # legs of 12 cm, 0.24 kg


def extend(text: str, *parts: str) -> str:
    """Return a robot's text with more links and joints at its end."""
    return text.replace("</robot>", "".join(parts) + "</robot>")


def read_dog(text: str, fix: tuple[str, ...] = (), **options) -> tuple[Quadruped, str]:
    """Return the quadruped of a text, and its notes as one text."""
    dog = make_quadruped(parse_urdf(text, "r.urdf", fix=fix), Options(**options))
    # A run keeps this text, from which the same robot has to come.
    again = make_quadruped(parse_urdf(dog.urdf, "r.urdf", fix=fix), Options(**options))
    np.testing.assert_array_equal(again.home, dog.home)
    return dog, "\n".join(dog.notes)


def check_same_model(dog: Quadruped, text: str) -> None:
    """Assert that a robot has the model of the one that `text` describes."""
    model, expected = (robot.make_full_model() for robot in (dog, read_dog(text)[0]))
    for name in ("body_pos", "body_quat", "body_mass", "jnt_range", "geom_pos", "geom_size"):
        np.testing.assert_array_equal(getattr(model, name), getattr(expected, name), name)


WORLD = link("world") + joint("w", "world", "trunk", kind="fixed", extra="")
POST = link("post") + joint("v", "world", "post", kind="fixed", extra="")
HIP = shape('box size="0.02 0.02 0.02"')
CALF = '<joint name="FR_calf_joint" type="revolute"'
# A text, and what the message must say.
REFUSED = [
    *(
        (replace_once(ALIENGO, old, new), says)
        for old, new, says in (
            (CALF, CALF.replace("revolute", "fixed"), "FR_hip_joint (2), FL_hip_joint (3)"),
            (CALF, CALF.replace("revolute", "planar"), "'FR_calf_joint' of a leg is planar"),
            ('xyz="-0.2407 0.051 0"', 'xyz="0.2407 0.051 0"', "one ahead and one behind"),
            ('effort="44.4"', 'effort="0"', "no effort limit for 'FR_calf_joint'; expected <limit"),
            ('velocity="15.89"', 'velocity="1e10"', "or pass --robot.speed RAD_PER_S"),
        )
    ),
    (extend(DOG, WORLD, POST), "the legs' joints lead from link 'world', the ground"),
    # What could weigh or touch is no footprint.
    (extend(DOG, link("footprint", inertial(1)), FLOATS), "a quadruped has four of three joints"),
    (extend(DOG, link("footprint", HIP), FLOATS), "a quadruped has four of three joints each"),
    (DOG.replace(link("a1", inertial(0.5), HIP), link("a1")), "link 'a1' of leg FL has no mass"),
    (robots.quadruped(lambda name: link(f"{name}3", inertial(1))), "no shape and no frame"),
]


@pytest.mark.parametrize(("text", "says"), REFUSED, ids=[says[:30] for _, says in REFUSED])
def test_what_is_no_quadruped_is_refused_in_words(text, says):
    with pytest.raises(UrdfError, match=re.escape(says)):
        make_quadruped(parse_urdf(text))


@pytest.mark.parametrize(
    ("walker", "reason"),
    [
        (Walker(hip=(-46, 46)), "joint 'FR_hip_joint' has limits of -46 and 46 rad; .*degrees"),
        (Walker(calf=(-150, -35)), "joint 'FR_calf_joint' .*2 pi.*degrees"),
        (Walker(thigh=(-10, 90)), "joint 'FR_thigh_joint' .*degrees"),
        (Walker(thigh=(-1, 7)), "joint 'FR_thigh_joint' has limits of -1 and 7 rad"),
        (Walker(size=1000), "legs are 400 m long; expected 0.01 to 2.5 m .*millimeters"),
        (replace(SMALL, size=300), "legs are 120 m long; .*millimeters"),
        (Walker(size=100), "legs are 40 m long; .*centimeters"),
        (Walker(size=1 / 0.0254), "legs are 15.* m long; .*inches"),
        (Walker(size=1e-3), "legs are 0.0004 m long; .*1e.03 times too short"),
        (Walker(mass=1000), "masses add up to 12000 kg, .* grams"),
        (replace(SMALL, mass=20), "masses add up to 240 kg, .* grams"),
        (Walker(mass=1e-3), "masses add up to 0.012 kg, .* tonnes"),
        (Walker(size=1000, mass=1000), "legs are 400 m long; .*millimeters"),
    ],
)
def test_units_of_no_quadruped_are_refused_with_the_likely_one(walker, reason):
    with pytest.raises(UrdfError, match=f"^dog.urdf: {reason}") as raised:
        make_quadruped(parse_urdf(walker.to_text(), "dog.urdf"))
    assert "expected" in str(raised.value)


@pytest.mark.parametrize(
    "walker",
    [
        SMALL,
        Walker(size=2.5, mass=15),  # legs of 1 m, 180 kg
        Walker(mass=0.3),
        Walker(mass=4),
        Walker(hip=(-9.42, 9.42), thigh=(-10, 10)),  # as ANYmal and Solo12 have them: none
        Walker(hip=(-math.tau, math.tau), thigh=(-1, 6.28)),
    ],
)
def test_quadrupeds_of_all_sizes_are_read(walker):
    quadruped = make_quadruped(parse_urdf(walker.to_text()))
    assert quadruped.trunk == "trunk"
    assert "wider than the robot" not in "\n".join(quadruped.notes)


def test_an_inertia_in_another_unit_is_said():
    notes = make_quadruped(parse_urdf(Walker(inertia=1e6).to_text())).notes
    (note,) = [note for note in notes if "wider than the robot" in note]
    assert ": trunk 100 m, " in note  # the square root of 1.5 * 0.04e6 kg m^2 / 6 kg


def test_the_command_says_why_it_does_not_train(tmp_path, capsys):
    file = tmp_path / "dog.urdf"
    file.write_text(Walker(size=1000).to_text())
    main([str(file), "-o", str(tmp_path / "dog.xml")])
    assert "trains as a quadruped: no: legs are 400 m long" in capsys.readouterr().err


@pytest.mark.parametrize(
    "world",
    [
        link("world"),
        link("world", shape('box size="9 9 0.1"', kind="visual")),
        link("world", shape('box size="9 9 0.1"', "0 0 -0.05")),
    ],
)
def test_a_dog_that_a_joint_fixes_to_the_world_floats_and_an_arm_stays(world):
    place = joint("w", "world", "trunk", xyz="0 0 0.4", rpy="0 0.3 0", kind="fixed", extra="")
    dog, notes = read_dog(extend(DOG, world, place))
    assert "the link 'world' and the joint that holds the robot there: w" in notes
    assert dog.trunk == "trunk"
    assert "world" not in dog.urdf
    check_same_model(dog, DOG)
    arm = robots.robot(
        link("a", inertial(1)), world, joint("w", "world", "a", kind="fixed", extra=""),
        link("b", inertial(1)), joint("j", "a", "b"),
    )  # fmt: skip
    assert convert(parse_urdf(arm)).spec.compile().nv == 1


@pytest.mark.parametrize(
    "parts",
    [(), (MARK,), (MARK, shape('mesh filename="no.stl"', kind="visual")), (inertial(0),)],
)
def test_a_footprint_from_which_the_trunk_floats_is_dropped(parts):
    dog, notes = read_dog(extend(DOG, link("footprint", *parts), FLOATS))
    assert "dropped: the ground's link and its floating joint: footprint" in notes
    check_same_model(dog, DOG)


@pytest.mark.parametrize("missing", ['effort="20"', 'velocity="10"', 'effort="20" velocity="10"'])
def test_a_limit_without_effort_or_speed_leaves_them_to_flags(missing):
    text = DOG.replace(missing, "")
    flags = {"effort": "--robot.effort NM", "velocity": "--robot.speed RAD_PER_S"}
    flags = [flag for name, flag in flags.items() if name in missing]
    with pytest.raises(UrdfError, match=f"or pass {' '.join(flags)}$"):
        make_quadruped(parse_urdf(text))
    dog, notes = read_dog(text, effort=12.0, speed=7.0)
    assert "for <limit> has none" in notes
    assert set(dog.effort) == {12.0 if "effort" in missing else 20.0}
    assert set(dog.velocity) == {7.0 if "velocity" in missing else 10.0}


def test_motors_without_a_limit_are_those_of_the_flags():
    text = DOG.replace(LIMIT, "")
    with pytest.raises(UrdfError, match="no effort limit for 'bj1' and 'bj2' and 10 more, no spee"):
        make_quadruped(parse_urdf(text))
    dog, _ = read_dog(text, effort=30, speed=12)
    np.testing.assert_array_equal(dog.make_full_model().actuator_ctrlrange, [[-30, 30]] * 12)
    np.testing.assert_array_equal(dog.velocity, 12)
    np.testing.assert_array_equal(dog.upper, np.pi)
    np.testing.assert_array_equal(read_dog(DOG, effort=30)[0].effort, 20)  # the URDF's own


@pytest.mark.parametrize(
    ("parts", "flag"),
    [
        (HEAD, "neck"),
        (HEAD.replace('"neck"', '"the neck"'), "'the neck'"),
        (HEAD + GRIPPER, "neck grip"),
        (WHEELS, "awheel bwheel cwheel dwheel"),
        (HEAD.replace("revolute", "continuous").replace(LIMIT, ""), "neck"),
    ],
)
def test_a_joint_that_is_no_legs_is_fixed_by_the_flag_that_the_line_names(parts, flag):
    text = extend(DOG, parts)
    with pytest.raises(UrdfError, match=f"or pass --robot.fix {flag}$"):
        make_quadruped(parse_urdf(text))
    names = ("the neck",) if "'" in flag else tuple(flag.split())
    dog, notes = read_dog(text, fix=names)
    assert "fixed at 0, as a flag says: " + names[0] in notes
    # As if the file had it so.
    for name in names:
        moving = f'(<joint name="{name}" type=)"\\w+"(.*?)<axis.*?</joint>'
        text = re.sub(moving, r'\1"fixed"\2</joint>', text)
    check_same_model(dog, text)
    assert dog.make_full_model().nv == 18


def test_patterns_fix_several_joints_and_one_that_names_none_is_refused():
    dog, notes = read_dog(extend(DOG, WHEELS), fix=("*wheel",))
    assert "awheel, bwheel, cwheel, dwheel" in notes
    assert len(dog.joints) == 12
    with pytest.raises(UsageError, match=r"--robot\.fix tail: names no joint; there are aj1, "):
        parse_urdf(DOG, fix=("tail",))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize(("limits", "position"), [((0.5, 3), 0.5), ((-3, -0.2), -0.2)])
def test_a_joint_whose_limits_leave_out_0_is_fixed_at_the_nearest(kind, limits, position):
    """Compare with MuJoCo, where the joint is there and is at that position."""
    attributes = {"axis": "1 2 -2", "xyz": "0.1 0.2 0.3", "rpy": "0.3 -0.7 2", "kind": kind}
    moving = joint("j", "a", "b", extra=robots.limit(*limits), **attributes)
    text = robots.robot(link("a", inertial(1)), link("b", inertial(1)), moving)
    model = convert(parse_urdf(text)).spec.compile()
    data = make_data(model, np.array([0, 0, 0, 1, 0, 0, 0, position]))
    fixed = parse_urdf(text, fix=("j",))
    assert f"fixed at {position:g}, as a flag says: j" in "\n".join(fixed.report.to_lines())
    placement = fixed.tree.placement["b"]
    np.testing.assert_allclose(placement[:3, 3], data.body("b").xpos, atol=1e-12)
    np.testing.assert_allclose(placement[:3, :3].ravel(), data.body("b").xmat, atol=1e-12)
