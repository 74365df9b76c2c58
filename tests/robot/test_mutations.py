"""Whatever is changed in a valid URDF is converted exactly or refused: no silence, no traceback.

The independent readers are ElementTree, for limits and shapes, and Pinocchio, for the dynamics.
"""

import dataclasses
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.pinocchio_oracle import Pinocchio
from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.mjcf import convert, write_xml
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.legs import LEGS, find_legs
from quadwalk.robot.urdf import Urdf, parse_urdf


def without_visuals(text: str) -> str:
    """The URDF with its physics only, to spend the mutations there."""
    root = ET.fromstring(text)
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for material in root.findall("material"):
        root.remove(material)
    return ET.tostring(root, encoding="unicode")


TEXT = ALIENGO_URDF.read_text()
PHYSICS = without_visuals(TEXT)
ELEMENTS = len(list(ET.fromstring(PHYSICS).iter()))
WORDS = st.one_of(
    st.floats(-10, 10).map(repr),
    st.floats(allow_nan=True, allow_infinity=True).map(repr),
    st.integers(-3, 10**12).map(str),
    st.sampled_from(
        ["", " ", "nan", "-inf", "1e999", "1e-320", "1,0", "0x1", "1_0", "\u0661", "0", "-0"]
    ),
    st.sampled_from(["trunk", "FR_hip", "FR_foot", "world", "floor", "a<b&'c\"", "revolute"]),
    st.sampled_from(["fixed", "continuous", "prismatic", "floating", "0 0 0", "1 1 1", "0 -1 0"]),
    st.sampled_from(["3.1 -2 9", "0.1 0.2", "1 2 3 4", "-1.5"]),
    st.text(st.characters(min_codepoint=32, max_codepoint=0xD7FF), max_size=6),
)
TAGS = st.sampled_from(
    [
        *("origin", "axis", "limit", "mass", "inertia", "sphere", "box"),
        *("inertial", "link", "x", "mimic"),
    ]
)


@pytest.fixture
def pinocchio() -> Callable[[Urdf, mujoco.MjModel], Pinocchio]:
    return lambda urdf, model: Pinocchio(readable(urdf), model)


@st.composite
def mutated(draw) -> str:
    """AlienGo with one to three changes to its elements and attributes."""
    root = ET.fromstring(PHYSICS)
    for _ in range(draw(st.integers(1, 3))):
        elements = list(root.iter())
        parents = {child: parent for parent in root.iter() for child in parent}
        element = elements[draw(st.integers(0, ELEMENTS - 1)) % len(elements)]
        names = sorted(element.attrib)
        change = draw(
            st.sampled_from(["value", "word", "scale", "scale", "scale", "drop", "rename", "tree"])
        )
        if change == "tree" or not names:
            what = draw(st.sampled_from(["remove", "repeat", "tag", "move"]))
            if what == "tag":
                element.tag = draw(TAGS)
            elif element in parents:
                if what == "repeat":
                    parents[element].append(element)
                else:
                    parents[element].remove(element)
                if what == "move":
                    others = [e for e in root.iter() if e is not element]
                    others[draw(st.integers(0, ELEMENTS)) % len(others)].append(element)
            continue
        name = draw(st.sampled_from(names))
        if change == "value":
            element.set(name, draw(WORDS))
        elif change == "word":  # one number of a vector
            words = element.get(name).split() or [""]
            words[draw(st.integers(0, 3)) % len(words)] = draw(WORDS)
            element.set(name, " ".join(words))
        elif change == "scale":  # most of these are robots still
            try:
                numbers = [float(word) for word in element.get(name).split()]
            except ValueError:
                continue
            factors = [draw(st.sampled_from([1.0, 1.1, 0.9, -1.0])) for _ in numbers]
            scaled = [
                repr(number * factor) for number, factor in zip(numbers, factors, strict=True)
            ]
            element.set(name, " ".join(scaled))
        elif change == "drop":
            del element.attrib[name]
        else:
            element.set(draw(st.sampled_from(["xyz", "value", "foo", "lower"])), element.get(name))
            del element.attrib[name]
    return ET.tostring(root, encoding="unicode")


def load(text: str | bytes):
    """(urdf, spec), or None if the text is refused as it should be."""
    try:
        urdf = parse_urdf(text, "robot.urdf")
        try:
            legs = find_legs(urdf.tree)
        except UrdfError:
            legs = ()
        return urdf, convert(urdf, legs).spec
    except UrdfError as error:
        message = str(error)
        assert message.startswith("robot.urdf")
        assert "\n" not in message
        assert len(message) < 500
        return None


def check_attributes(text: str, model: mujoco.MjModel) -> None:
    """Limits, damping, friction and collision shapes are what the text says."""
    root = ET.fromstring(text)
    for joint in root.findall("joint"):
        if joint.get("type") in ("fixed", "planar", "floating"):
            continue  # without limits, and no motor
        found = model.joint(joint.get("name"))
        limit, dynamics = joint.find("limit"), joint.find("dynamics")
        # One that is left out is 0, and both 0 are none.
        ends = {} if limit is None else limit.attrib
        expected = [float(ends.get("lower", 0)), float(ends.get("upper", 0))]
        if joint.get("type") == "continuous" or expected == [0, 0]:
            assert not model.jnt_limited[found.id]
        else:
            np.testing.assert_array_equal(found.range, expected)
        if float(ends.get("effort", 0)) > 0:
            assert model.jnt_actfrcrange[found.id][1] == float(limit.get("effort"))
        if dynamics is not None:
            address = found.dofadr[0]
            assert np.ravel(model.dof_damping[address])[0] == float(dynamics.get("damping", 0))
            assert model.dof_frictionloss[address] == float(dynamics.get("friction", 0))
            assert model.dof_armature[address] == float(dynamics.get("armature", 0))
    sizes = sorted(
        float(shape.get("radius"))
        for shape in root.findall("link/collision/geometry/*")
        if shape.tag in ("sphere", "cylinder")
    )
    kinds = (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CYLINDER)
    collides = (model.geom_contype > 0) & np.isin(model.geom_type, kinds)
    found = Counter(model.geom_size[collides, 0].tolist())
    assert not Counter(sizes) - found
    # A leg whose foot is gone or moved may have been given a sphere; one that is as it was, none.
    there, before = {ET.tostring(part) for part in root}, ET.fromstring(PHYSICS)
    whole = sum(
        all(ET.tostring(part) in there for part in before if part.get("name", "").startswith(leg))
        for leg in LEGS
    )
    assert sum((found - Counter(sizes)).values()) <= 4 - whole
    boxes = (model.geom_contype > 0) & (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)
    assert boxes.sum() == len(root.findall("link/collision/geometry/box"))


def readable(urdf: Urdf) -> Urdf:
    """The same dynamics, with a limit and a damping wherever Pinocchio's reader wants one."""
    root = ET.fromstring(urdf.text)
    for joint in root.findall("joint"):
        if joint.get("type") in ("revolute", "prismatic") and joint.find("limit") is None:
            ET.SubElement(joint, "limit", lower="-1", upper="1", effort="0", velocity="0")
        for limit in joint.findall("limit"):
            limit.attrib.update({"effort": "0", "velocity": "0", **limit.attrib})
        for dynamics in joint.findall("dynamics"):
            dynamics.set("damping", dynamics.get("damping", "0"))
    return dataclasses.replace(urdf, text=ET.tostring(root, encoding="unicode"))


SETTINGS = settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@SETTINGS
@given(text=mutated())
def test_changes_to_elements_convert_exactly_or_are_refused(pinocchio, text):
    loaded = load(text)
    if loaded is None:
        return
    urdf, spec = loaded
    model = spec.compile()
    check_attributes(text, model)
    from_xml = mujoco.MjModel.from_xml_string(write_xml(spec))
    assert [from_xml.joint(i).name for i in range(model.njnt)] == [
        model.joint(i).name for i in range(model.njnt)
    ]
    if model.nv:
        # MuJoCo takes a frame within some 1e-6 rad of its body's for the same, and skips a product.
        # No robot is drawn so, but a mutation may be: compare the frames as the model has them.
        for frames in (model.body_sameframe, model.geom_sameframe, model.site_sameframe):
            frames[:] = 0
        errors = pinocchio(urdf, model).compute_errors(states=1)
        assert max(errors.values()) < 1e-9, errors


@SETTINGS
@given(at=st.integers(0, len(TEXT) - 1), length=st.integers(0, 40), new=st.binary(max_size=8))
def test_changes_to_bytes_convert_or_are_refused(at, length, new):
    data = TEXT.encode()
    loaded = load(data[:at] + new + data[at + length :])
    if loaded is not None:
        loaded[1].compile()


@pytest.mark.parametrize("share", np.linspace(0.01, 0.99, 25))
def test_every_truncation_is_refused(share):
    assert load(TEXT[: int(share * len(TEXT))]) is None
