"""What the elements of a URDF document must be: names, numbers, and what each may hold.

Every finding is one line: the file, the line, the element, what is wrong and what is expected.
An element or attribute that URDF does not know is left out and reported, as every other reader
passes it over; it is refused where it is nearly the name of one that is missing there.
"""

import math
import re
from collections import Counter
from collections.abc import MutableMapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
from lxml import etree

from quadwalk.errors import UserError
from quadwalk.robot.checks.forms import (
    FORMS,
    JOINT_TYPES,
    LENGTHS,
    MISPLACED,
    SHAPES,
    TEXT_ATTRIBUTES,
    Form,
)
from quadwalk.robot.report import Report
from quadwalk.robot.structure.tree import to_roll_pitch_yaw

# Quadrupeds have some 50 links, humanoids with hands some 100.
MAX_LINKS = 2000
# Bodies may be nested to a depth of 1023 in MuJoCo, and its effort grows with depth.
MAX_MOVING = 500
# MuJoCo takes a coordinate beyond 1e10 for a simulation that has exploded.
MAX_NUMBER = 1e9
# Below that, products of a few numbers leave the range of floating point.
MIN_NUMBER = 1e-50
MIN_SIZE = 1e-9  # m; atoms are 1e-10
MIN_QUAT = 1e-3  # the length of a quaternion that still has a direction


class UrdfError(UserError):
    """A URDF that cannot be read, or describes no robot that can exist, in one line."""

    def __init__(self, message: str):
        # The names and values in it are the file's, which may hold line breaks or be endless.
        line = re.sub(r"[\x00-\x1f\x7f-\x9f]+", " ", message)
        super().__init__(line if len(line) <= 800 else line[:500] + " ... " + line[-250:])


_SHAPES = ", ".join(f"<{tag}>" for tag in SHAPES)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity|1\.#\w+)", re.IGNORECASE)


@dataclass
class Check:
    """The checks of one document, what they left out of it, and what they took for granted."""

    source: str
    report: Report
    left_out: Counter = field(default_factory=Counter)
    # whether the document was changed to say in plain URDF 1.0 what it said otherwise
    rewritten: bool = False

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
        """Check an element and all within: what it holds, and that every number is one.

        What URDF does not know is taken out of it, so that no later reader stumbles over it.
        """
        form = FORMS[element.tag]
        known = form.one + form.most_one + form.many
        if not known and not element.attrib and (element.text or "").strip():
            shown = element.text.strip()[:40]
            expected = ", ".join(form.need + form.may)
            raise self.fail(element, f"holds '{shown}' as text; expected attributes: {expected}")
        self.attributes(element, form)
        for child in list(element):
            if child.tag in known:
                self.element(child)
            elif element.tag == "geometry" and not any(c.tag in known for c in element):
                raise self.fail(element, f"has a <{child.tag}> in it; expected {_SHAPES}")
            else:
                there = {c.tag for c in element} - set(form.many)
                self.not_misspelt(child.tag, known, there, element)
                self.not_misplaced(child.tag, form, element)
                if child.tag in form.ignored:
                    self.ignored(child)
                self.take_out(child, f"<{child.tag}> of a {element.tag}")
        for tag in form.first:
            for child in element.findall(tag)[1:]:
                self.take_out(child, f"<{tag}> of a {element.tag} beside another")
        counts = Counter(child.tag for child in element)
        for tag in form.one + form.most_one:
            if counts[tag] > 1:
                raise self.fail(element, f"has {counts[tag]} <{tag}> elements; expected one")
        for tag in form.one:
            if counts[tag] == 0:
                raise self.fail(element, f"has no <{tag}>; expected one")
        self.sizes(element, form)
        check = getattr(self, f"check_{element.tag}", None)
        if check is not None:
            check(element)

    def attributes(self, element: etree._Element, form: Form) -> None:
        """Check an element's attributes; those that URDF does not know are taken out."""
        known = form.need + form.may
        for name, value in list(element.attrib.items()):
            if name not in known:
                self.not_misspelt(name, known, set(element.attrib), element, attribute=True)
                self.not_misplaced(name, form, element, attribute=True)
                self.left_out[f"{element.tag} {name}"] += 1
                del element.attrib[name]
            elif "${" in value or "$(" in value:
                raise not_expanded(self.source)
            elif name not in TEXT_ATTRIBUTES:
                self.numbers(element, name, value)
        for name in form.need:
            if element.get(name) is None:
                raise self.fail(element, f"has no '{name}'; expected {name}=\"...\"")
            if name in TEXT_ATTRIBUTES and not element.get(name).strip():
                raise self.fail(element, f"has an empty '{name}'; expected {name}=\"...\"")

    def not_misspelt(
        self,
        name: str,
        known: tuple[str, ...],
        there: set[str],
        element: etree._Element,
        attribute: bool = False,
    ) -> None:
        """Refuse the name of a child, or an attribute, nearly a known one which is not there."""
        for other in known:
            if other not in there and nearly(name.lower(), other):
                if attribute:
                    raise self.fail(element, f"has attribute '{name}'; expected {other}")
                raise self.fail(element, f"has a <{name}> in it; expected <{other}>")

    def not_misplaced(
        self, name: str, form: Form, element: etree._Element, attribute: bool = False
    ) -> None:
        """Refuse a child that should be an attribute, or the other way, and physics elsewhere."""
        lowered = name.lower()
        what = f"attribute '{name}'" if attribute else f"a <{name}> in it"
        if attribute:
            alike = set(form.one + form.most_one) - {child.tag for child in element}
        else:
            alike = set(form.need + form.may) - TEXT_ATTRIBUTES - set(element.attrib)
        if lowered in alike:
            expected = f"<{lowered}>" if attribute else f'{lowered}="..."'
            raise self.fail(element, f"has {what}; expected {expected}")
        for owner in (element, *element.iterancestors("link", "joint")):
            if owner.get("type") == "fixed":
                return  # without axis, limits or damping
            path, place = MISPLACED.get(owner.tag, {}).get(lowered, ("", ""))
            holder = owner.find(path) if path else owner
            if holder is None or (place and holder.get(place) is None):
                inside = f' {place}="..."' if place else ""
                raise self.fail(element, f"has {what}; expected <{path}{inside}>")

    def take_out(self, element: etree._Element, what: str) -> None:
        """Remove an element that is passed over, and note it by kind."""
        self.left_out[what] += 1
        element.getparent().remove(element)

    def ignored(self, element: etree._Element) -> None:
        """Even what is left out must not hold a number that is none."""
        for part in element.iter():
            for name, value in part.attrib.items():
                if name not in TEXT_ATTRIBUTES and _NOT_FINITE.fullmatch(value.strip()):
                    raise self.fail(part, f'has {name}="{value}"; expected a finite number')

    def numbers(self, element: etree._Element, name: str, value: str) -> None:
        """Check that the attribute is one number, or as many as its name asks for."""
        words = value.split()
        length = LENGTHS.get(name, 1)
        # A color without transparency is none that a robot should fail for.
        allowed = {"scale": (1, 3), "rgba": (3, 4)}.get(name, (length,))
        shown = value if len(value) <= 40 else value[:37] + "..."
        if len(words) not in allowed:
            expected = "one number" if length == 1 else f"{length} numbers"
            raise self.fail(element, f'has {name}="{shown}"; expected {expected}')
        for word in words:
            if not _NUMBER.fullmatch(word) or not math.isfinite(float(word)):
                raise self.fail(element, f'has {name}="{shown}"; expected finite numbers')
            size = abs(float(word))
            if 0 < size < MIN_NUMBER and element.tag == "origin":
                element.set(name, element.get(name).replace(word, "0"))
            elif 0 < size < MIN_NUMBER:
                given = f'{name}="{shown}"'
                raise self.fail(element, f"has {given}; expected 0 or at least {MIN_NUMBER:g}")
            if size > MAX_NUMBER and element.tag != "limit":
                raise self.fail(element, f'has {name}="{shown}"; expected at most {MAX_NUMBER:g}')

    def sizes(self, element: etree._Element, form: Form) -> None:
        """Check that sizes are above 0; a visual shape may be of size 0, and is left out then."""
        visual = any(parent.tag == "visual" for parent in element.iterancestors())
        for name in form.sizes:
            for value in map(float, element.get(name).split()):
                if value < MIN_SIZE and not (visual and value == 0):
                    given = f'{name}="{element.get(name)}"'
                    raise self.fail(element, f"has {given}; expected above {MIN_SIZE:g} m")
        for name in form.not_negative:
            if float(element.get(name, "0")) < 0:
                raise self.fail(element, f'has {name}="{element.get(name)}"; expected 0 or more')

    def check_geometry(self, element: etree._Element) -> None:
        if len(element) != 1:
            raise self.fail(element, f"holds {len(element)} shapes; expected one of {_SHAPES}")

    def check_mesh(self, element: etree._Element) -> None:
        if any(float(word) == 0 for word in element.get("scale", "1").split()):
            raise self.fail(element, f'has scale="{element.get("scale")}"; expected none 0')

    def check_origin(self, element: etree._Element) -> None:
        """Turn URDF 1.1's quaternion into the angles that every reader knows."""
        if element.get("quat_xyzw") is None:
            return
        if element.get("rpy") is not None:
            raise self.fail(element, "has both rpy and quat_xyzw; expected one of them")
        x, y, z, w = (float(word) for word in element.attrib.pop("quat_xyzw").split())
        length = math.hypot(x, y, z, w)
        if length < MIN_QUAT:
            raise self.fail(element, "has quat_xyzw of length 0; expected a rotation")
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, np.array([w, x, y, z]) / length)
        element.set("rpy", as_words(to_roll_pitch_yaw(turn.reshape(3, 3))))
        self.rewritten = True

    def check_color(self, element: etree._Element) -> None:
        """Bring a color into 0 .. 1, from 0 .. 255 where it is far beyond: it is only seen."""
        rgba = element.get("rgba")
        values = [float(word) for word in rgba.split()]
        if len(values) == 4 and all(0 <= value <= 1 for value in values):
            return
        rgb, alpha = np.array(values[:3]), (*values, 1.0)[3]
        if rgb.max() > 2:
            rgb = rgb / 255
        if alpha > 2:
            alpha = alpha / 255
        color = np.clip([*rgb, alpha], 0, 1)
        element.set("rgba", " ".join(f"{value:.6g}" for value in color))
        self.report.add("assumed", "colors of 0 .. 255, or clipped to 0 .. 1", rgba)
        self.rewritten = True

    def check_texture(self, element: etree._Element) -> None:
        if not (element.get("filename") or "").strip():
            self.take_out(element, "<texture> without a file")

    def check_limit(self, element: etree._Element) -> None:
        joint = element.getparent()
        for name in ("effort", "velocity"):
            if element.get(name) is None:
                reason = "where no flag gives one, for <limit> has none"
            elif float(element.get(name)) > MAX_NUMBER:
                del element.attrib[name]
                reason = "for the limit is beyond 1e9"
            else:
                continue
            if joint.get("type") != "fixed":
                self.report.add("assumed", f"any {name}, {reason}", joint.get("name"))

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
        if kind in ("revolute", "prismatic"):
            self.check_range(element, {} if limit is None else limit.attrib)

    def check_range(self, joint: etree._Element, limit: MutableMapping[str, str]) -> None:
        """Position limits: one that is left out is 0; none are left where they are no limits."""
        given = [name for name in ("lower", "upper") if name in limit]
        if len(given) == 1:
            absent = "upper" if given == ["lower"] else "lower"
            limit[absent] = "0"
            given = ["lower", "upper"]
            what = f"{absent} limits of 0, as by URDF's rule, where only the other is given"
            self.report.add("assumed", what, joint.get("name"))
            self.rewritten = True
        lower, upper = (float(limit[name]) for name in given) if given else (0.0, 0.0)
        reason = "" if given else "there are none"
        if given and lower == upper == 0:  # what exporters write where none is set
            reason = "both are 0"
        elif lower < -MAX_NUMBER and upper > MAX_NUMBER:
            reason = "they are beyond 1e9"
        elif given and lower >= upper:
            raise self.fail(
                joint.find("limit"),
                f"has lower {lower:g} and upper {upper:g}; expected lower below upper",
            )
        if reason:
            for name in given:
                del limit[name]
            self.report.add("assumed", f"no position limits, for {reason}", joint.get("name"))
        elif max(abs(lower), abs(upper)) > MAX_NUMBER:
            limit["lower"], limit["upper"] = (
                repr(min(max(bound, -MAX_NUMBER), MAX_NUMBER)) for bound in (lower, upper)
            )


def as_words(numbers: np.ndarray) -> str:
    """Return numbers (n,) as a URDF has them, with all their digits."""
    return " ".join(map(repr, numbers.tolist()))


def not_expanded(source: str) -> UrdfError:
    """Return the error for a xacro file, from which a URDF is still to be made."""
    return UrdfError(
        f"{source}: is not expanded: run xacro, as in 'xacro dog.xacro > dog.urdf'; expected the "
        "file that it writes"
    )


def nearly(name: str, other: str) -> bool:
    """Whether one slip, or two in a long word, makes `name` of `other`.

    A slip (Damerau-Levenshtein): a letter too many, too few or wrong, or two neighbors exchanged.
    """
    slips = 1 if len(other) < 6 else 2
    if abs(len(name) - len(other)) > slips:
        return False
    before: list[int] = []
    row = list(range(len(other) + 1))
    for i, a in enumerate(name, start=1):
        before, above, row = row, before, [i]
        for j, b in enumerate(other, start=1):
            step = min(before[j] + 1, row[j - 1] + 1, before[j - 1] + (a != b))
            if i > 1 and j > 1 and (a, name[i - 2]) == (other[j - 2], b):
                step = min(step, above[j - 2] + 1)
            row.append(step)
    return row[-1] <= slips


def check_elements(check: Check, root: etree._Element) -> None:
    """Check each element, or raise `UrdfError` for the first wrong; take out what is not URDF's."""
    if any("xacro" in str(element.tag).partition("}")[0] for element in root.iter()):
        raise not_expanded(check.source)
    if root.tag != "robot":
        raise UrdfError(f"{check.source}: root element is <{root.tag}>; expected <robot>")
    links, joints = root.findall("link"), root.findall("joint")
    if not links:
        raise UrdfError(f"{check.source}: has no <link>; expected at least one")
    moving = sum(joint.get("type") != "fixed" for joint in joints)
    for count, what, most in (
        (max(len(links), len(joints)), "links or joints", MAX_LINKS),
        (moving, "joints that move", MAX_MOVING),
    ):
        if count > most:
            raise UrdfError(f"{check.source}: has {count} {what}; expected at most {most}")
    known = ("link", "joint", "material", "mujoco")
    for element in list(root):
        if element.tag in known:
            check.element(element)
        else:
            check.not_misspelt(element.tag, known, set(), root)
            check.take_out(element, f"<{element.tag}>")
    _check_materials(check, root)
    for what, count in check.left_out.items():
        check.report.add("dropped", "extensions of other tools", f"{what} ({count})")


def _check_materials(check: Check, root: etree._Element) -> None:
    colors: dict[str, str] = {}
    for material in root.findall("material"):
        name, color = material.get("name"), material.find("color")
        if not name:
            raise check.fail(material, 'has no name; expected <material name="...">')
        if color is not None and colors.setdefault(name, color.get("rgba")) != color.get("rgba"):
            raise check.fail(material, f"gives '{name}' a second color; expected one")
