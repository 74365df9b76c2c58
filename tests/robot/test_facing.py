"""Robots whose root link does not have x ahead and z up: turned, or refused if unclear."""

import math
import re

import mujoco
import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from quadwalk.robot.cli import main
from quadwalk.robot.mirror import RobotMirror, find_robot_mirror
from quadwalk.robot.mjcf import Options, convert, write_xml
from quadwalk.robot.quadruped import Quadruped, find_quadruped, make_quadruped
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.facing import read_names
from quadwalk.robot.structure.legs import find_chains
from quadwalk.robot.urdf import parse_urdf
from tests.robot import robots
from tests.robot.robots import Walker, check_dynamics

HALF, QUARTER = math.pi, math.pi / 2
TURNS = {
    "y ahead": (0.0, 0.0, QUARTER),
    "-y ahead": (0.0, 0.0, -QUARTER),
    "-x ahead": (0.0, 0.0, HALF),
    "z down": (HALF, 0.0, 0.0),
    "z down, -x ahead": (0.0, HALF, 0.0),
    "y up": (QUARTER, 0.0, 0.0),
    "y up, z ahead": (HALF, -QUARTER, -QUARTER),
    "x up": (0.0, QUARTER, 0.0),
}
PARTS = ("hip", "thigh", "calf")
NAMED = ("FR", "FL", "RR", "RL")
UNNAMED = ("one", "two", "three", "four")
EITHER_WAY = (-2.6, 2.6)  # rad, of calves


def read(walker: Walker) -> Quadruped:
    return make_quadruped(parse_urdf(walker.to_text(), "dog.urdf"))


def measure(quadruped: Quadruped) -> dict[str, np.ndarray]:
    """Return places and axes in the world of a standing robot's parts, by MuJoCo."""
    model = quadruped.make_full_model()
    data = robots.make_data(model, quadruped.home)
    joints = [data.joint(name) for name in quadruped.joints]
    bodies = [model.joint(name).bodyid[0] for name in quadruped.joints]
    axes = data.ximat[1].reshape(3, 3)
    return {
        "anchors": np.array([joint.xanchor for joint in joints]),
        "axes": np.array([joint.xaxis for joint in joints]),
        "feet": np.array([data.geom(foot).xpos for foot in quadruped.feet]),
        "centers of mass": data.xipos[[1, *bodies]],
        "inertia of the trunk": axes * model.body_inertia[1] @ axes.T,
        "home": quadruped.home,
    }


@pytest.mark.parametrize("names", [NAMED, UNNAMED], ids=["named", "unnamed"])
@pytest.mark.parametrize("bolted", [False, True], ids=["itself", "by a fixed joint"])
@pytest.mark.parametrize("turn", TURNS)
def test_a_robot_that_is_turned_is_the_same_one(turn, bolted, names):
    if names == UNNAMED and turn == "-x ahead":
        return  # see the next test
    quadruped = read(Walker(rpy=TURNS[turn], bolted=bolted, names=names))
    expected = measure(read(Walker(names=names)))
    for what, values in measure(quadruped).items():
        np.testing.assert_allclose(values, expected[what], atol=1e-9, err_msg=what)
    assert quadruped.joints[:3] == tuple(f"{names[0]}_{part}_joint" for part in PARTS)
    assert any("is ahead and" in note for note in quadruped.notes)
    assert [note.split()[0] for note in quadruped.notes[-4:]] == ["FR", "FL", "RR", "RL"]


def test_without_names_x_is_ahead_where_it_may_be():
    quadruped = read(Walker(rpy=TURNS["-x ahead"], names=UNNAMED))
    assert quadruped.trunk == "trunk"
    assert quadruped.joints[0] == "four_hip_joint"
    assert min(robots.measure_knees(quadruped).values()) > 0.1  # ahead, as of some robots


@pytest.mark.parametrize("turn", ["y ahead", "z down, -x ahead"])
def test_its_dynamics_are_those_of_the_file_as_it_was(turn):
    original = parse_urdf(Walker(rpy=TURNS[turn], thigh=(-1, 1)).to_text(), "dog.urdf")
    urdf, legs = find_quadruped(original, Options())
    spec = convert(urdf, legs, Options()).spec
    check_dynamics(urdf, spec, {"position of FR_foot"})
    # Pinocchio reads the original, whose root stands in the world as it does in the turned one.
    model = spec.compile()
    oracle = pinocchio.buildModelFromXML(original.text, pinocchio.JointModelFreeFlyer())
    computed = oracle.createData()
    rng = np.random.default_rng(0)
    data = mujoco.MjData(model)
    data.qpos[3:] = rng.normal(size=16)
    mujoco.mj_normalizeQuat(model, data.qpos)
    mujoco.mj_forward(model, data)
    trunk = Rotation.from_quat(data.qpos[3:7], scalar_first=True)
    q = pinocchio.neutral(oracle)
    q[3:7] = (trunk * Rotation.from_euler("xyz", TURNS[turn]).inv()).as_quat()
    joints = [name for leg in legs for name in leg.joints]
    places = [oracle.joints[oracle.getJointId(name)] for name in joints]
    q[[place.idx_q for place in places]] = data.qpos[7:]
    rows = [place.idx_v for place in places]
    weight = pinocchio.computeGeneralizedGravity(oracle, computed, q)
    np.testing.assert_allclose(data.qfrc_bias[6:], weight[rows], atol=1e-9)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    whole = np.triu(pinocchio.crba(oracle, computed, q))
    whole += np.triu(whole, 1).T
    np.testing.assert_allclose(mass[6:, 6:], whole[np.ix_(rows, rows)], atol=1e-9)


def test_a_turned_robot_mirrors_and_stands():
    quadruped = read(Walker(rpy=TURNS["y ahead"]))
    assert isinstance(
        find_robot_mirror(quadruped, quadruped.make_training_model(0.004)), RobotMirror
    )
    robots.check_stands(quadruped, 2, 0.85)


@pytest.mark.parametrize("turn", ["y ahead", "z down"])
def test_the_text_of_a_turned_robot_is_read_as_the_same_robot(turn):
    first = read(Walker(rpy=TURNS[turn]))
    again = make_quadruped(parse_urdf(first.urdf, "dog.urdf"))
    assert write_xml(again.spec) == write_xml(first.spec)
    assert again.urdf == first.urdf  # it is not turned once more
    np.testing.assert_array_equal(again.home, first.home)


def test_the_turned_root_has_a_name_of_its_own():
    text = Walker(rpy=TURNS["y ahead"]).to_text().replace("FR_hip_joint", "trunk_ahead_joint")
    quadruped = make_quadruped(parse_urdf(text.replace('"FL_hip"', '"trunk_ahead"')))
    assert quadruped.trunk == "trunk_ahead_2"
    assert quadruped.joints[0] == "trunk_ahead_joint"


def test_legs_that_splay_from_upright_hips_are_left_as_they_are():
    text = Walker(names=UNNAMED).to_text()
    spider = re.sub(r'(hip_joint".*?<axis xyz=)"1 0 0"', r'\1"0 0 1"', text)
    assert make_quadruped(parse_urdf(spider)).trunk == "trunk"


@pytest.mark.parametrize(
    ("walker", "reason"),
    [
        (Walker(names=("FL", "FR", "RL", "RR")), "names and places .* contradict each other"),
        (
            Walker(names=("RR", "FL", "FR", "RL")),
            "FR_hip_joint .-0.2, -0.08, 0.*thighs turn about y",
        ),
        (Walker(rpy=(0, 0, QUARTER), names=("RR", "FR", "RL", "FL")), "thighs turn about x"),
        (Walker(rpy=(0, 0, QUARTER / 2)), "askew"),
        (Walker(rpy=(0, QUARTER / 2, 0)), "askew"),
        (Walker(rpy=(0, 0, QUARTER), names=UNNAMED, calf=EITHER_WAY), "neither names nor knees"),
        (Walker(rpy=(HALF, 0, 0), names=UNNAMED, calf=EITHER_WAY), "feet lie toward .z"),
        (Walker(names=("RL", "RR", "FL", "FR")), "names and knees .* face -x, where knees"),
    ],
)
def test_what_contradicts_itself_or_is_unclear_is_refused(walker, reason):
    with pytest.raises(UrdfError, match=f"^dog.urdf: .*{reason}.*expected"):
        read(walker)


CORNERS = ["FR", "FL", "RR", "RL"]


@pytest.mark.parametrize(
    ("names", "corners"),
    [
        (("RF", "LF", "RH", "LH"), CORNERS),
        (("front_right", "front_left", "hind_right", "hind_left"), CORNERS),
        (("legFR", "legFL", "legBR", "legBL"), CORNERS),
        (("rightFront", "leftFront", "rightRear", "leftRear"), CORNERS),
        (("fr0", "fl1", "hr2", "hl3"), CORNERS),
        (UNNAMED, []),
        (("FR", "FL", "RR", "leg4"), []),
        (("FR", "FL", "RR", "FLRR"), []),
    ],
)
def test_corners_are_read_from_names(names, corners):
    urdf = parse_urdf(Walker(names=names).to_text())
    assert read_names(find_chains(urdf.tree)) == corners


def test_the_command_shows_joints_and_signs(tmp_path, capsys):
    file = tmp_path / "dog.urdf"
    # A calf whose axis points to the right turns the other way.
    text = Walker(rpy=TURNS["y ahead"]).to_text()
    reversed_calf = '(RL_calf_joint".*?<axis xyz=)"0 1 0"/>.*?/>'
    limits = robots.limit(0.6, 2.6)
    file.write_text(re.sub(reversed_calf, rf'\1"0 -1 0"/>{limits}', text, count=1))
    main([str(file), "-o", str(tmp_path / "dog.xml")])
    lines = capsys.readouterr().err.splitlines()
    at = next(at for at, line in enumerate(lines) if line.startswith("leg "))
    first, last = (re.sub(" +", " ", lines[row]) for row in (at + 1, at + 4))
    assert first == "FR +x FR_hip_joint +y FR_thigh_joint +y FR_calf_joint"
    assert last == "RL +x RL_hip_joint +y RL_thigh_joint -y RL_calf_joint"
    assert lines[at + 5] == "trains as a quadruped: yes"
