"""A valid URDF with any change is converted exactly or refused: no silence, no traceback.

The independent readers are ElementTree, for limits and shapes, and Pinocchio, for the dynamics.
"""

import contextlib
import dataclasses
import xml.etree.ElementTree as ET
from collections import Counter

import mujoco
import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.pinocchio_oracle import Pinocchio
from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.mjcf import convert, write_xml
from quadwalk.robot.report import UrdfError
from quadwalk.robot.structure.legs import LEGS, find_legs
from quadwalk.robot.urdf import Urdf, parse_urdf


def remove_visuals(text: str) -> str:
    """Return the URDF with its physics only, to spend the mutations there."""
    root = ET.fromstring(text)
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for material in root.findall("material"):
        root.remove(material)
    return ET.tostring(root, encoding="unicode")


TEXT = ALIENGO_URDF.read_text()
PHYSICS = remove_visuals(TEXT)
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


def change_tree(draw, root: ET.Element, element: ET.Element) -> None:
    """Rename, remove, repeat or move an element."""
    parents = {child: parent for parent in root.iter() for child in parent}
    change = draw(st.sampled_from(["remove", "repeat", "tag", "move"]))
    if change == "tag":
        element.tag = draw(TAGS)
    elif element in parents and change == "repeat":
        parents[element].append(element)
    elif element in parents:
        parents[element].remove(element)
        if change == "move":
            others = [other for other in root.iter() if other is not element]
            others[draw(st.integers(0, ELEMENTS)) % len(others)].append(element)


def change_attribute(draw, element: ET.Element, name: str, change: str) -> None:
    """Change an attribute's value, one of its numbers or all, or its name; or drop it."""
    value = element.attrib.pop(name)
    if change == "value":
        element.set(name, draw(WORDS))
    elif change == "word":
        words = value.split() or [""]
        words[draw(st.integers(0, 3)) % len(words)] = draw(WORDS)
        element.set(name, " ".join(words))
    elif change == "scale":  # most of these are robots still
        words = value.split()
        with contextlib.suppress(ValueError):  # what are no numbers stay
            factors = [draw(st.sampled_from([1.0, 1.1, 0.9, -1.0])) for _ in map(float, words)]
            words = [repr(float(w) * factor) for w, factor in zip(words, factors, strict=True)]
        element.set(name, " ".join(words))
    elif change == "rename":
        element.set(draw(st.sampled_from(["xyz", "value", "foo", "lower"])), value)


@st.composite
def mutate(draw) -> str:
    """Draw an AlienGo with one to three changes to its elements and attributes."""
    root = ET.fromstring(PHYSICS)
    for _ in range(draw(st.integers(1, 3))):
        elements = list(root.iter())
        element = elements[draw(st.integers(0, ELEMENTS - 1)) % len(elements)]
        changes = ["value", "word", "scale", "scale", "scale", "drop", "rename", "tree"]
        change = draw(st.sampled_from(changes))
        if change == "tree" or not element.attrib:
            change_tree(draw, root, element)
        else:
            name = draw(st.sampled_from(sorted(element.attrib)))
            change_attribute(draw, element, name, change)
    return ET.tostring(root, encoding="unicode")


def load(text: str | bytes):
    """Return the URDF and its spec, or None if the text is refused as it should be."""
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
    """Check that limits, damping, friction and collision shapes are what the text says."""
    root = ET.fromstring(text)
    for joint in root.findall("joint"):
        if joint.get("type") in ("fixed", "planar", "floating"):
            continue  # without limits, and no motor
        converted = model.joint(joint.get("name"))
        limit, dynamics = joint.find("limit"), joint.find("dynamics")
        # One that is left out is 0, and both 0 are none.
        ends = {} if limit is None else limit.attrib
        expected = [float(ends.get("lower", 0)), float(ends.get("upper", 0))]
        if joint.get("type") == "continuous" or expected == [0, 0]:
            assert not model.jnt_limited[converted.id]
        else:
            np.testing.assert_array_equal(converted.range, expected)
        if float(ends.get("effort", 0)) > 0:
            assert model.jnt_actfrcrange[converted.id][1] == float(limit.get("effort"))
        if dynamics is not None:
            address = converted.dofadr[0]
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
    radii = Counter(model.geom_size[collides, 0].tolist())
    assert not Counter(sizes) - radii
    # A leg whose foot is gone or moved may have been given a sphere; one that is as it was, none.
    parts, original = {ET.tostring(part) for part in root}, ET.fromstring(PHYSICS)
    intact = sum(
        all(ET.tostring(part) in parts for part in original if part.get("name", "").startswith(leg))
        for leg in LEGS
    )
    assert sum((radii - Counter(sizes)).values()) <= 4 - intact
    boxes = (model.geom_contype > 0) & (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)
    assert boxes.sum() == len(root.findall("link/collision/geometry/box"))


def make_readable(urdf: Urdf) -> Urdf:
    """Return the same dynamics, with limit and damping wherever Pinocchio's reader wants one."""
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
    suppress_health_check=[HealthCheck.too_slow],
)


@SETTINGS
@given(text=mutate())
def test_changes_to_elements_convert_exactly_or_are_refused(text):
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
        errors = Pinocchio(make_readable(urdf), model).compute_errors(states=1)
        assert max(errors.values()) < 1e-9, errors


@SETTINGS
@given(at=st.integers(0, len(TEXT) - 1), length=st.integers(0, 40), new=st.binary(max_size=8))
def test_changes_to_bytes_convert_or_are_refused(at, length, new):
    data = TEXT.encode()
    loaded = load(data[:at] + new + data[at + length :])
    if loaded is not None:
        loaded[1].compile()


def test_every_truncation_is_refused():
    for share in np.linspace(0.01, 0.99, 25):
        assert load(TEXT[: int(share * len(TEXT))]) is None
