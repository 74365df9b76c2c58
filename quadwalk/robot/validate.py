"""What a URDF document must fulfil before it is converted: elements, numbers, names, topology.

Every finding is one line: the file, the line, the element, what is wrong and what is expected.
An element or attribute that is not known is refused where it could be a misspelt one that matters;
known extensions of other tools, and what stands beside links and joints, are left out and reported.
"""

import math
import re
from collections import Counter
from dataclasses import dataclass, field

from lxml import etree

from quadwalk.errors import UserError

# Quadrupeds have some 50 links, humanoids with hands some 100.
MAX_LINKS = 2000
# Bodies may be nested to a depth of 1023 in MuJoCo, and its effort grows with depth.
MAX_MOVING = 500
# MuJoCo takes a coordinate beyond 1e10 for a simulation that has exploded.
MAX_NUMBER = 1e9
# Below that, products of a few numbers leave the range of floating point.
MIN_NUMBER = 1e-50
MIN_SIZE = 1e-9  # m; atoms are 1e-10

JOINT_TYPES = ("revolute", "continuous", "prismatic", "planar", "floating", "fixed")
SHAPES = ("box", "sphere", "cylinder", "mesh")


class UrdfError(UserError):
    """A URDF that cannot be read, or describes no robot that can exist, in one line."""

    def __init__(self, message: str):
        # The names and values in it are the file's, which may hold line breaks or be endless.
        line = re.sub(r"[\x00-\x1f\x7f-\x9f]+", " ", message)
        super().__init__(line if len(line) <= 800 else line[:500] + " ... " + line[-250:])


@dataclass(frozen=True)
class _Form:
    """What an element may hold.

    Attributes:
        need, may: attributes that must or may be there.
        one, most_one, many: child elements that must be there once, may be, may be repeated.
        ignored: child elements and attributes of other tools, left out with a note.
    """

    need: tuple[str, ...] = ()
    may: tuple[str, ...] = ()
    one: tuple[str, ...] = ()
    most_one: tuple[str, ...] = ()
    many: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()


# http://wiki.ros.org/urdf/XML; `ignored` is what PyBullet, Gazebo and older ROS files add.
_FORMS = {
    "link": _Form(
        need=("name",),
        most_one=("inertial",),
        many=("visual", "collision"),
        ignored=("contact", "audio_source", "self_collision_checking", "concave", "type", "gazebo"),
    ),
    "joint": _Form(
        need=("name", "type"),
        one=("parent", "child"),
        most_one=("origin", "axis", "limit", "dynamics", "mimic"),
        ignored=("joint_properties", "safety_controller", "calibration", "gazebo"),
    ),
    "inertial": _Form(one=("mass", "inertia"), most_one=("origin",)),
    "visual": _Form(may=("name",), one=("geometry",), most_one=("origin", "material")),
    "collision": _Form(
        may=("name",),
        one=("geometry",),
        most_one=("origin",),
        ignored=("material", "group", "mask", "concave", "verbose", "contact_coefficients"),
    ),
    "geometry": _Form(most_one=SHAPES),
    "origin": _Form(may=("xyz", "rpy")),
    "mass": _Form(need=("value",)),
    "inertia": _Form(need=("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "parent": _Form(need=("link",)),
    "child": _Form(need=("link",)),
    "axis": _Form(need=("xyz",), ignored=("rpy",)),
    "limit": _Form(need=("effort", "velocity"), may=("lower", "upper"), ignored=("twist",)),
    "dynamics": _Form(
        may=("damping", "friction", "armature"), ignored=("spring_stiffness", "spring_reference")
    ),
    "mimic": _Form(need=("joint",), may=("multiplier", "offset")),
    "box": _Form(need=("size",)),
    "sphere": _Form(need=("radius",)),
    "cylinder": _Form(need=("radius", "length")),
    "mesh": _Form(need=("filename",), may=("scale",)),
    "material": _Form(
        may=("name",), most_one=("color", "texture"), ignored=("specular", "ambient", "emissive")
    ),
    "color": _Form(need=("rgba",)),
    "texture": _Form(need=("filename",)),
}
_TEXT_ATTRIBUTES = frozenset({"name", "type", "link", "joint", "filename"})
_LENGTHS = {"xyz": 3, "rpy": 3, "size": 3, "rgba": 4, "scale": 3}
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity|1\.#\w+)", re.IGNORECASE)


@dataclass
class _Check:
    """The checks of one document, and what they left out of it."""

    source: str
    left_out: Counter = field(default_factory=Counter)

    def fail(self, element: etree._Element, message: str) -> UrdfError:
        """The error for `element`, with its line and the link or joint that it is part of."""
        where = f"{self.source}, line {element.sourceline}: "
        name = element.get("name")
        if element.tag in ("link", "joint") and name:
            return UrdfError(f"{where}{element.tag} '{name}' {message}")
        for owner in element.iterancestors("link", "joint"):
            where += f"{owner.tag} '{owner.get('name', '')}': "
        return UrdfError(f"{where}<{element.tag}> {message}")

    def element(self, element: etree._Element) -> None:
        """Check an element and all within: what it holds, and that every number is one."""
        form = _FORMS[element.tag]
        for name, value in element.attrib.items():
            if name in form.ignored or name.startswith("{"):
                self.left_out[f"{element.tag} {name}"] += 1
            elif name not in form.need and name not in form.may:
                expected = ", ".join(form.need + form.may) or "none"
                raise self.fail(element, f"has attribute '{name}'; expected {expected}")
            elif name not in _TEXT_ATTRIBUTES:
                self.numbers(element, name, value)
        for name in form.need:
            if element.get(name) is None:
                raise self.fail(element, f"has no '{name}'; expected {name}=\"...\"")
            if name in _TEXT_ATTRIBUTES and not element.get(name).strip():
                raise self.fail(element, f"has an empty '{name}'; expected {name}=\"...\"")
        known = form.one + form.most_one + form.many
        for child in element:
            if child.tag in form.ignored or child.tag.startswith("{"):
                self.left_out[f"<{child.tag}> of a {element.tag}"] += 1
                self.ignored(child)
            elif child.tag not in known:
                expected = ", ".join(f"<{tag}>" for tag in known) or "nothing in it"
                raise self.fail(element, f"has a <{child.tag}> in it; expected {expected}")
            else:
                self.element(child)
        counts = Counter(child.tag for child in element)
        for tag in form.one + form.most_one:
            if counts[tag] > 1:
                raise self.fail(element, f"has {counts[tag]} <{tag}> elements; expected one")
        for tag in form.one:
            if counts[tag] == 0:
                raise self.fail(element, f"has no <{tag}>; expected one")
        check = getattr(self, f"check_{element.tag}", None)
        if check is not None:
            check(element)

    def ignored(self, element: etree._Element) -> None:
        """Even what is left out must not hold a number that is none."""
        for part in element.iter():
            for name, value in part.attrib.items():
                if name not in _TEXT_ATTRIBUTES and _NOT_FINITE.fullmatch(value.strip()):
                    raise self.fail(part, f'has {name}="{value}"; expected a finite number')

    def numbers(self, element: etree._Element, name: str, value: str) -> None:
        """Check that the attribute is one number, or as many as its name asks for."""
        words = value.split()
        length = _LENGTHS.get(name, 1)
        allowed = (1, 3) if name == "scale" else (length,)
        shown = value if len(value) <= 40 else value[:37] + "..."
        if len(words) not in allowed:
            expected = "one number" if length == 1 else f"{length} numbers"
            raise self.fail(element, f'has {name}="{shown}"; expected {expected}')
        for word in words:
            if not _NUMBER.fullmatch(word) or not math.isfinite(float(word)):
                raise self.fail(element, f'has {name}="{shown}"; expected finite numbers')
            if 0 < abs(float(word)) < MIN_NUMBER:
                given = f'{name}="{shown}"'
                raise self.fail(element, f"has {given}; expected 0 or at least {MIN_NUMBER:g}")
            if abs(float(word)) > MAX_NUMBER:
                raise self.fail(element, f'has {name}="{shown}"; expected at most {MAX_NUMBER:g}')

    def positive(self, element: etree._Element, *names: str) -> None:
        """Check that sizes are above 0; a visual shape may be of size 0, and is left out then."""
        visual = any(parent.tag == "visual" for parent in element.iterancestors())
        for name in names:
            for value in map(float, element.get(name).split()):
                if value < MIN_SIZE and not (visual and value == 0):
                    given = f'{name}="{element.get(name)}"'
                    raise self.fail(element, f"has {given}; expected above {MIN_SIZE:g} m")

    def not_negative(self, element: etree._Element, *names: str) -> None:
        for name in names:
            if float(element.get(name, "0")) < 0:
                raise self.fail(element, f'has {name}="{element.get(name)}"; expected 0 or more')

    def check_geometry(self, element: etree._Element) -> None:
        if len(element) != 1:
            expected = ", ".join(f"<{tag}>" for tag in SHAPES)
            raise self.fail(element, f"holds {len(element)} shapes; expected one of {expected}")

    def check_box(self, element: etree._Element) -> None:
        self.positive(element, "size")

    def check_sphere(self, element: etree._Element) -> None:
        self.positive(element, "radius")

    def check_cylinder(self, element: etree._Element) -> None:
        self.positive(element, "radius", "length")

    def check_mesh(self, element: etree._Element) -> None:
        if any(float(word) == 0 for word in element.get("scale", "1").split()):
            raise self.fail(element, f'has scale="{element.get("scale")}"; expected none 0')

    def check_color(self, element: etree._Element) -> None:
        if not all(0 <= float(word) <= 1 for word in element.get("rgba").split()):
            raise self.fail(element, f'has rgba="{element.get("rgba")}"; expected 0 .. 1')

    def check_mass(self, element: etree._Element) -> None:
        self.not_negative(element, "value")

    def check_dynamics(self, element: etree._Element) -> None:
        self.not_negative(element, "damping", "friction", "armature")

    def check_limit(self, element: etree._Element) -> None:
        self.not_negative(element, "effort", "velocity")

    def check_axis(self, element: etree._Element) -> None:
        length = math.hypot(*map(float, element.get("xyz").split()))
        if length < 1e-6 and element.getparent().get("type") not in ("fixed", "floating"):
            raise self.fail(element, f'has xyz="{element.get("xyz")}"; expected a direction')

    def check_joint(self, element: etree._Element) -> None:
        kind = element.get("type")
        if kind not in JOINT_TYPES:
            raise self.fail(
                element, f"is of type '{kind}'; expected one of {', '.join(JOINT_TYPES)}"
            )
        limit = element.find("limit")
        if kind not in ("revolute", "prismatic"):
            return
        if limit is None or limit.get("lower") is None or limit.get("upper") is None:
            raise self.fail(element, f'is {kind}; expected <limit lower="..." upper="..."/>')
        lower, upper = float(limit.get("lower")), float(limit.get("upper"))
        if lower >= upper:
            raise self.fail(
                limit, f"has lower {lower:g} and upper {upper:g}; expected lower below upper"
            )


def check_robot(root: etree._Element, source: str) -> list[str]:
    """Check a URDF document; raise `UrdfError` for the first thing in it that is not valid.

    Returns what other tools' extensions were left out, for the report.
    """
    check = _Check(source)
    if root.tag != "robot":
        raise UrdfError(f"{source}: root element is <{root.tag}>; expected <robot>")
    if not root.get("name", "").strip():
        raise check.fail(root, 'has no name; expected <robot name="...">')
    links, joints = root.findall("link"), root.findall("joint")
    if not links:
        raise UrdfError(f"{source}: has no <link>; expected at least one")
    if max(len(links), len(joints)) > MAX_LINKS:
        count = max(len(links), len(joints))
        raise UrdfError(f"{source}: has {count} links or joints; expected at most {MAX_LINKS}")
    moving = sum(joint.get("type") != "fixed" for joint in joints)
    if moving > MAX_MOVING:
        raise UrdfError(f"{source}: has {moving} joints that move; expected at most {MAX_MOVING}")
    for element in root:
        if element.tag in ("link", "joint", "material"):
            check.element(element)
        else:
            check.left_out[f"<{element.tag}>"] += 1
    _check_materials(check, root)
    _check_topology(check, links, joints)
    _check_mimic(check, joints)
    return [f"{what} ({count})" for what, count in check.left_out.items()]


def _check_materials(check: _Check, root: etree._Element) -> None:
    colors: dict[str, str] = {}
    for material in root.findall("material"):
        name, color = material.get("name"), material.find("color")
        if not name:
            raise check.fail(material, 'has no name; expected <material name="...">')
        if color is not None and colors.setdefault(name, color.get("rgba")) != color.get("rgba"):
            raise check.fail(material, f"gives '{name}' a second color; expected one")


def _check_topology(
    check: _Check, links: list[etree._Element], joints: list[etree._Element]
) -> None:
    """One tree: unique names, one root, one parent each, no cycle."""
    for elements in (links, joints):
        seen: set[str] = set()
        for element in elements:
            if element.get("name") in seen:
                raise check.fail(element, "appears twice; expected unique names")
            seen.add(element.get("name"))
    names = [link.get("name") for link in links]
    parent_of: dict[str, str] = {}
    for joint in joints:
        parent, child = joint.find("parent").get("link"), joint.find("child").get("link")
        for end, name in (("parent", parent), ("child", child)):
            if name not in names:
                raise check.fail(joint, f"has {end} '{name}'; expected the name of a link")
        if parent == child:
            raise check.fail(joint, f"joins link '{child}' to itself; expected two links")
        if child in parent_of:
            raise check.fail(joint, f"gives link '{child}' a second parent; expected one")
        parent_of[child] = parent
    roots = [name for name in names if name not in parent_of]
    if len(roots) > 1:
        shown = ", ".join(f"'{name}'" for name in roots[:4]) + (", ..." if roots[4:] else "")
        raise UrdfError(
            f"{check.source}: {len(roots)} links have no parent ({shown}); expected one root link"
        )
    # With one parent each, a link that never leads up to the root leads into a cycle.
    sound = set(roots)
    for name in names:
        path = []
        while name not in sound:
            if name in path:
                raise UrdfError(
                    f"{check.source}: link '{name}' is its own ancestor; expected a tree of links"
                )
            path.append(name)
            name = parent_of[name]
        sound.update(path)
    if "world" in names and roots != ["world"]:
        raise UrdfError(
            f"{check.source}: link 'world' is not the root; expected another name, for that one "
            "is the ground's"
        )


def _check_mimic(check: _Check, joints: list[etree._Element]) -> None:
    leader_of = {
        joint.get("name"): joint.find("mimic").get("joint")
        for joint in joints
        if joint.find("mimic") is not None
    }
    kinds = {joint.get("name"): joint.get("type") for joint in joints}
    for joint in joints:
        name = joint.get("name")
        if name not in leader_of:
            continue
        leader = leader_of[name]
        one_way = ("revolute", "continuous", "prismatic")
        if kinds.get(leader) not in one_way or kinds[name] not in one_way:
            raise check.fail(
                joint.find("mimic"),
                f"follows joint '{leader}'; expected joints that move in one direction",
            )
        path = {name}
        while leader in leader_of:
            if leader in path:
                raise check.fail(
                    joint.find("mimic"), f"follows '{leader}' in a circle; expected a free joint"
                )
            path.add(leader)
            leader = leader_of[leader]
