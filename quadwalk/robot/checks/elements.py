"""Checks of the elements of a URDF document: names, numbers, and what each may hold.

Every finding is one line: the file, the line, the element, what is wrong and what is expected.
An element or attribute that URDF does not know is left out and reported, as every other reader
passes it over; it is refused where it is nearly the name of one that is missing there.
"""

import math
import re
from collections import Counter
from collections.abc import Iterable, MutableMapping
from dataclasses import dataclass, field
from typing import NoReturn

import mujoco
import numpy as np
from lxml import etree

from quadwalk.errors import find_similar
from quadwalk.robot.checks.schema import (
    EXTENSIONS,
    FORMS,
    JOINT_TYPES,
    LENGTHS,
    MISPLACED,
    NOT_NEGATIVE,
    SHAPES,
    SIZES,
    TEXT_ATTRIBUTES,
)
from quadwalk.robot.report import Report, UrdfError
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

_SHAPES = ", ".join(f"<{tag}>" for tag in SHAPES)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity|1\.#\w+)", re.IGNORECASE)


@dataclass
class Checker:
    """The checks of one document, which raise `UrdfError`, and what they removed and assumed."""

    source: str
    report: Report
    taken_out: Counter = field(default_factory=Counter)
    # whether the document was changed to say in plain URDF 1.0 what it said otherwise
    rewritten: bool = False

    def refuse(self, element: etree._Element, message: str) -> NoReturn:
        """Raise `UrdfError` on `element`, with its line and the link or joint that it is in."""
        where = f"{self.source}, line {element.sourceline}: "
        name = element.get("name")
        if element.tag in ("link", "joint") and name:
            raise UrdfError(f"{where}{element.tag} '{name}' {message}")
        for owner in element.iterancestors("link", "joint"):
            where += f"{owner.tag} '{owner.get('name', '')}': "
        raise UrdfError(f"{where}<{element.tag}> {message}")

    def take_out(self, element: etree._Element, label: str) -> None:
        """Remove an element that is ignored; the report gives the number removed under `label`."""
        self.taken_out[label] += 1
        element.getparent().remove(element)

    def check_root(self, root: etree._Element) -> None:
        """Raise `UrdfError` for the first wrong element of the document; remove unknown ones."""
        if any("xacro" in str(element.tag).partition("}")[0] for element in root.iter()):
            raise make_xacro_error(self.source)
        if root.tag != "robot":
            raise UrdfError(f"{self.source}: root element is <{root.tag}>; expected <robot>")
        links, joints = root.findall("link"), root.findall("joint")
        if not links:
            raise UrdfError(f"{self.source}: has no <link>; expected at least one")
        moving = sum(joint.get("type") != "fixed" for joint in joints)
        for count, what, most in (
            (max(len(links), len(joints)), "links or joints", MAX_LINKS),
            (moving, "joints that move", MAX_MOVING),
        ):
            if count > most:
                raise UrdfError(f"{self.source}: has {count} {what}; expected at most {most}")
        self._check_children(root)
        self._check_colors(root)
        for label, count in self.taken_out.items():
            self.report.add("dropped", "extensions of other tools", f"{label} ({count})")

    def _check_element(self, element: etree._Element) -> None:
        """Raise `UrdfError` for what is wrong in an element of URDF, or in any within it.

        Children and attributes must be those of its `FORMS`, and numbers must be finite. Unknown
        ones are removed. The method `_check_TAG`, if there is one, checks and mends the rest.
        """
        form = FORMS[element.tag]
        if not form.children and not element.attrib and (element.text or "").strip():
            excerpt = element.text.strip()[:40]
            expected = ", ".join(form.attributes)
            self.refuse(element, f"holds '{excerpt}' as text; expected attributes: {expected}")
        self._check_attributes(element)
        self._check_children(element)
        counts = Counter(child.tag for child in element)
        for tag in form.one + form.most_one:
            if counts[tag] > 1:
                self.refuse(element, f"has {counts[tag]} <{tag}> elements; expected one")
        for tag in form.one:
            if counts[tag] == 0:
                self.refuse(element, f"has no <{tag}>; expected one")
        self._check_signs(element)
        check = getattr(self, f"_check_{element.tag}", None)
        if check is not None:
            check(element)

    def _check_attributes(self, element: etree._Element) -> None:
        """Raise `UrdfError` for a missing or wrong attribute; remove those not of URDF."""
        form = FORMS[element.tag]
        for name, value in list(element.attrib.items()):
            if name not in form.attributes:
                self._refuse_mistake(element, name, is_attribute=True)
                self.taken_out[f"{element.tag} {name}"] += 1
                del element.attrib[name]
            elif "${" in value or "$(" in value:
                raise make_xacro_error(self.source)
            elif name not in TEXT_ATTRIBUTES:
                self._check_numbers(element, name, value)
        for name in form.required:
            if element.get(name) is None:
                self.refuse(element, f"has no '{name}'; expected {name}=\"...\"")
            if name in TEXT_ATTRIBUTES and not element.get(name).strip():
                self.refuse(element, f"has an empty '{name}'; expected {name}=\"...\"")

    def _check_children(self, element: etree._Element) -> None:
        """Raise `UrdfError` for what is wrong within an element; remove what is not of URDF."""
        for child in list(element):
            if child.tag in FORMS[element.tag].children:
                self._check_element(child)
                continue
            if element.tag == "geometry" and not any(c.tag in SHAPES for c in element):
                self.refuse(element, f"has a <{child.tag}> in it; expected {_SHAPES}")
            self._refuse_mistake(element, child.tag, is_attribute=False)
            if child.tag in EXTENSIONS.get(element.tag, ()):
                self._check_finite(child)
            place = "" if element.tag == "robot" else f" of a {element.tag}"
            self.take_out(child, f"<{child.tag}>{place}")

    def _refuse_mistake(self, element: etree._Element, name: str, is_attribute: bool) -> None:
        """Raise `UrdfError` if `name`, unknown in `element`, stands for something missing there.

        It is an attribute, or else a child. It may be misspelled, or an attribute where a child is
        expected, or the reverse. Or it is physics, such as a mass, a level too high or too low.
        """
        form = FORMS[element.tag]
        attributes = [other for other in form.attributes if other not in element.attrib]
        single = [tag for tag in form.one + form.most_one if element.find(tag) is None]
        if is_attribute:
            similar = _find_misspelled(name, attributes)
            expected = similar or (f"<{name.lower()}>" if name.lower() in single else "")
        else:
            similar = _find_misspelled(name, [*single, *form.many])
            numbers = set(attributes) - TEXT_ATTRIBUTES
            expected = f"<{similar}>" if similar else ""
            if not similar and name.lower() in numbers:
                expected = f'{name.lower()}="..."'
        expected = expected or _find_place(element, name.lower())
        if expected:
            what = f"attribute '{name}'" if is_attribute else f"a <{name}> in it"
            self.refuse(element, f"has {what}; expected {expected}")

    def _check_finite(self, element: etree._Element) -> None:
        """Raise `UrdfError` for NaN or infinity in an element that is ignored.

        What wrote it there may have written wrong numbers elsewhere.
        """
        for part in element.iter():
            for name, value in part.attrib.items():
                if name not in TEXT_ATTRIBUTES and _NOT_FINITE.fullmatch(value.strip()):
                    self.refuse(part, f'has {name}="{value}"; expected a finite number')

    def _check_numbers(self, element: etree._Element, name: str, value: str) -> None:
        """Raise `UrdfError` unless attribute `name` has as many finite numbers as it needs.

        Tiny numbers of an origin become 0.
        """
        words = value.split()
        length = LENGTHS.get(name, 1)
        # A color without transparency is none that a robot should fail for.
        allowed = {"scale": (1, 3), "rgba": (3, 4)}.get(name, (length,))
        excerpt = f'{name}="{value if len(value) <= 40 else value[:37] + "..."}"'
        if len(words) not in allowed:
            expected = "one number" if length == 1 else f"{length} numbers"
            self.refuse(element, f"has {excerpt}; expected {expected}")
        for word in words:
            if not _NUMBER.fullmatch(word) or not math.isfinite(float(word)):
                self.refuse(element, f"has {excerpt}; expected finite numbers")
            size = abs(float(word))
            if 0 < size < MIN_NUMBER and element.tag == "origin":
                element.set(name, element.get(name).replace(word, "0"))
            elif 0 < size < MIN_NUMBER:
                self.refuse(element, f"has {excerpt}; expected 0 or at least {MIN_NUMBER:g}")
            if size > MAX_NUMBER and element.tag != "limit":
                self.refuse(element, f"has {excerpt}; expected at most {MAX_NUMBER:g}")

    def _check_signs(self, element: etree._Element) -> None:
        """Raise `UrdfError` for a size that is not above 0; a visual shape may have size 0.

        Raise it for a mass, effort, speed, damping, friction or armature below 0, too.
        """
        is_visual = any(parent.tag == "visual" for parent in element.iterancestors())
        for name, value in element.attrib.items():
            expected = ""
            if name in SIZES and any(
                size < MIN_SIZE and not (is_visual and size == 0)
                for size in map(float, value.split())
            ):
                expected = f"above {MIN_SIZE:g} m"
            elif name in NOT_NEGATIVE and float(value) < 0:
                expected = "0 or more"
            if expected:
                self.refuse(element, f'has {name}="{value}"; expected {expected}')

    def _check_visual(self, element: etree._Element) -> None:
        """Remove all but the first `<material>` of a visual."""
        for material in element.findall("material")[1:]:
            self.take_out(material, "<material> of a visual beside another")

    def _check_geometry(self, element: etree._Element) -> None:
        """Raise `UrdfError` unless a `<geometry>` holds exactly one shape."""
        if len(element) != 1:
            self.refuse(element, f"holds {len(element)} shapes; expected one of {_SHAPES}")

    def _check_mesh(self, element: etree._Element) -> None:
        """Raise `UrdfError` if a `<mesh>` has a scale of 0."""
        if any(float(word) == 0 for word in element.get("scale", "1").split()):
            self.refuse(element, f'has scale="{element.get("scale")}"; expected none 0')

    def _check_origin(self, element: etree._Element) -> None:
        """Replace URDF 1.1's `quat_xyzw` by `rpy`, which every reader knows.

        Raise `UrdfError` if both are there, or the quaternion is 0.
        """
        if element.get("quat_xyzw") is None:
            return
        if element.get("rpy") is not None:
            self.refuse(element, "has both rpy and quat_xyzw; expected one of them")
        x, y, z, w = (float(word) for word in element.attrib.pop("quat_xyzw").split())
        length = math.hypot(x, y, z, w)
        if length < MIN_QUAT:
            self.refuse(element, "has quat_xyzw of length 0; expected a rotation")
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, np.array([w, x, y, z]) / length)
        element.set("rpy", write_numbers(to_roll_pitch_yaw(turn.reshape(3, 3))))
        self.rewritten = True

    def _check_color(self, element: etree._Element) -> None:
        """Scale a color from 0 .. 255 to 0 .. 1 where it is far beyond, or clip it to that."""
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

    def _check_texture(self, element: etree._Element) -> None:
        """Remove a `<texture>` without a file."""
        if not (element.get("filename") or "").strip():
            self.take_out(element, "<texture> without a file")

    def _check_limit(self, element: etree._Element) -> None:
        """Remove efforts and speeds too large to be limits; note those, and missing ones."""
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

    def _check_axis(self, element: etree._Element) -> None:
        """Raise `UrdfError` for the axis 0 of a joint that needs one."""
        length = math.hypot(*map(float, element.get("xyz").split()))
        if length < 1e-6 and element.getparent().get("type") not in ("fixed", "floating"):
            self.refuse(element, f'has xyz="{element.get("xyz")}"; expected a direction')

    def _check_joint(self, element: etree._Element) -> None:
        """Raise `UrdfError` for an unknown type of joint, or wrong position limits."""
        kind = element.get("type")
        if kind not in JOINT_TYPES:
            expected = ", ".join(JOINT_TYPES)
            self.refuse(element, f"is of type '{kind}'; expected one of {expected}")
        limit = element.find("limit")
        if kind in ("revolute", "prismatic"):
            self._check_range(element, {} if limit is None else limit.attrib)

    def _check_range(self, joint: etree._Element, limit: MutableMapping[str, str]) -> None:
        """Raise `UrdfError` unless the lower position limit is below the upper one.

        One that is left out becomes 0. Both are removed where they are 0 or beyond 1e9.
        """
        ends = [name for name in ("lower", "upper") if name in limit]
        if len(ends) == 1:
            absent = "upper" if ends == ["lower"] else "lower"
            limit[absent] = "0"
            ends = ["lower", "upper"]
            note = f"{absent} limits of 0, as by URDF's rule, where only the other is given"
            self.report.add("assumed", note, joint.get("name"))
            self.rewritten = True
        lower, upper = (float(limit[name]) for name in ends) if ends else (0.0, 0.0)
        reason = "" if ends else "there are none"
        if ends and lower == upper == 0:  # what exporters write where none is set
            reason = "both are 0"
        elif lower < -MAX_NUMBER and upper > MAX_NUMBER:
            reason = "they are beyond 1e9"
        elif ends and lower >= upper:
            ends_shown = f"lower {lower:g} and upper {upper:g}"
            self.refuse(joint.find("limit"), f"has {ends_shown}; expected lower below upper")
        if reason:
            for name in ends:
                del limit[name]
            self.report.add("assumed", f"no position limits, for {reason}", joint.get("name"))
        elif max(abs(lower), abs(upper)) > MAX_NUMBER:
            limit["lower"], limit["upper"] = (
                repr(min(max(bound, -MAX_NUMBER), MAX_NUMBER)) for bound in (lower, upper)
            )

    def _check_colors(self, root: etree._Element) -> None:
        """Raise `UrdfError` where a material of the robot has no name, or a name two colors."""
        colors: dict[str, str] = {}
        for material in root.findall("material"):
            name, color = material.get("name"), material.find("color")
            if not name:
                self.refuse(material, 'has no name; expected <material name="...">')
            if color is None:
                continue
            rgba = color.get("rgba")
            if colors.setdefault(name, rgba) != rgba:
                self.refuse(material, f"gives '{name}' a second color; expected one")


def write_numbers(numbers: np.ndarray) -> str:
    """Return numbers (n,) as a URDF has them, with all their digits."""
    return " ".join(map(repr, numbers.tolist()))


def make_xacro_error(source: str) -> UrdfError:
    """Return the error for a xacro file, from which a URDF is still to be made."""
    return UrdfError(
        f"{source}: is not expanded: run xacro, as in 'xacro dog.xacro > dog.urdf'; expected the "
        "file that it writes"
    )


def _find_misspelled(name: str, missing: Iterable[str]) -> str:
    """Return the first of the `missing` names that `name` misspells by a letter or so, or ""."""
    for other in missing:
        letters = min(len(other), 5)
        if find_similar(name.lower(), [other], cutoff=(letters - 1) / letters):
            return other
    return ""


def _find_place(element: etree._Element, name: str) -> str:
    """Return the place for physics called `name` that is in the wrong one, or "".

    There is none where that place is taken, or for a fixed joint, without axis, limits or damping.
    """
    for owner in (element, *element.iterancestors("link", "joint")):
        if owner.get("type") == "fixed":
            return ""
        path, attribute = MISPLACED.get(owner.tag, {}).get(name, ("", ""))
        holder = owner.find(path) if path else owner
        if holder is None or (attribute and holder.get(attribute) is None):
            return f'<{path} {attribute}="...">' if attribute else f"<{path}>"
    return ""
