"""Strict reading of URDF: lxml without recovery, our own validation, and only then yourdfpy.

yourdfpy alone loads a truncated file as a partial robot, and takes unknown parents, cycles,
duplicates, NaN masses and reversed limits without a word. What reaches it here has been checked.
"""

import io
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import yourdfpy
from lxml import etree

from quadwalk.robot.inertia import SMALLEST, body_inertia, nearest_valid, principal
from quadwalk.robot.tree import Tree, build_tree
from quadwalk.robot.validate import UrdfError, check_robot

__all__ = ["MAX_BYTES", "Report", "Urdf", "UrdfError", "parse_urdf", "read_urdf"]

# The largest quadruped descriptions are some 100 kB; a thousand links with meshes are about 1 MB.
MAX_BYTES = 16 * 2**20
_VERSION_0 = re.compile(rb"(<\?xml\s+version\s*=\s*[\"'])0\.0(?=[\"'])")
_KINDS = ("fused", "repaired", "dropped", "assumed")  # of notes in a report
# Room for rounding when principal moments are compared, relative to the largest.
_ROUNDING = 1e-10


class Report:
    """What is not plain in the result of a conversion: what was fused, repaired, dropped,
    assumed, in the URDF's order.
    """

    def __init__(self) -> None:
        self.found: dict[str, dict[str, list[str]]] = {kind: {} for kind in _KINDS}

    def add(self, kind: str, what: str, name: str = "") -> None:
        """Note `what` happened, to the element `name`; notes of one `what` become one line."""
        names = self.found[kind].setdefault(what, [])
        if name and name not in names:
            names.append(name)

    def copy(self) -> "Report":
        """A report that starts with what this one holds."""
        other = Report()
        for kind, found in self.found.items():
            other.found[kind] = {what: list(names) for what, names in found.items()}
        return other

    def lines(self, most: int = 4) -> list[str]:
        """The report as lines of text, with at most `most` names in each."""
        lines = []
        for kind, found in self.found.items():
            for what, names in found.items():
                shown = ", ".join(names[:most])
                more = f" and {len(names) - most} more" if len(names) > most else ""
                lines.append(f"{kind}: {what}" + (f": {shown}{more}" if names else ""))
        return lines


@dataclass(frozen=True)
class Urdf:
    """A URDF that has been read and checked.

    Attributes:
        source: what error messages call it (the file's path).
        folder: where relative mesh names are looked up; None when the text came from no file.
        text: the file's text, as read.
        robot: yourdfpy's model of it (lengths m, angles rad, masses kg).
        armature: kg m^2 by joint name, from `<dynamics armature="...">`, an extension that other
            readers ignore. Joints without it are left out.
        report: what reading left out or repaired.
    """

    source: str
    folder: Path | None
    text: str
    robot: yourdfpy.Robot
    armature: dict[str, float]
    report: Report

    @cached_property
    def tree(self) -> Tree:
        """The tree of its links."""
        return build_tree(self.robot)


def read_urdf(path: Path, repair_inertia: bool = False) -> Urdf:
    """Read and check the URDF file at `path`; `UrdfError` if it is not valid.

    With `repair_inertia`, an inertia that no body can have is replaced by the nearest valid one,
    and the report says by how much it changed.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise UrdfError(f"{path}: is a folder; expected a URDF file")
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
        reason = getattr(error, "strerror", None) or error
        raise UrdfError(f"{path}: cannot be read ({reason}); expected a URDF file") from None
    return parse_urdf(data, str(path), path.resolve().parent, repair_inertia)


def parse_urdf(
    data: bytes | str,
    source: str = "URDF",
    folder: Path | None = None,
    repair_inertia: bool = False,
) -> Urdf:
    """Check and parse a URDF's text; `source` is what error messages call it."""
    if isinstance(data, str):
        # Text has no encoding any more, whatever its declaration says.
        data = re.sub(r"^\s*<\?xml[^>]*\?>", "", data).encode()
    report = Report()
    root, text = _parse_xml(data, source, report)
    for what in check_robot(root, source):
        report.add("dropped", "extensions of other tools", what)
    if _drop_ground(root, report):
        text = etree.tostring(root, encoding="unicode")
    model = yourdfpy.URDF.load(
        io.BytesIO(etree.tostring(root)), load_meshes=False, build_scene_graph=False
    )
    armature = {
        joint.get("name"): float(dynamics.get("armature"))
        for joint in root.iterfind("joint")
        if (dynamics := joint.find("dynamics")) is not None and dynamics.get("armature")
    }
    urdf = Urdf(source, folder, text, model.robot, armature, report)
    _check_inertias(urdf.tree, source, repair_inertia, report)
    return urdf


def _drop_ground(root: etree._Element, report: Report) -> bool:
    """Remove a bare root link that only a floating joint leads from: it is the ground's frame.

    What floats on it is then the root link, which floats in any case.
    """
    joints = root.findall("joint")
    children = {joint.find("child").get("link") for joint in joints}
    (ground,) = (link for link in root.findall("link") if link.get("name") not in children)
    below = [j for j in joints if j.find("parent").get("link") == ground.get("name")]
    if len(ground) or [joint.get("type") for joint in below] != ["floating"]:
        return False
    report.add("dropped", "the ground's link and its floating joint", ground.get("name"))
    for element in (ground, *below):
        root.remove(element)
    return True


def _parse_xml(data: bytes, source: str, report: Report) -> tuple[etree._Element, str]:
    """The root element and the text; `UrdfError` for what is not plain, complete XML."""
    if not data.strip():
        raise UrdfError(f"{source}: is empty; expected a URDF <robot>")
    if len(data) > MAX_BYTES:
        raise UrdfError(f"{source}: is larger than {MAX_BYTES // 2**20} MB; expected a URDF")
    parser = etree.XMLParser(
        recover=False,
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        huge_tree=False,
        remove_comments=True,
        remove_pis=True,
        remove_blank_text=True,
    )
    if _VERSION_0.match(data):
        # PyBullet's own exports say so, and there is no XML but 1.0 that they could be.
        data = _VERSION_0.sub(rb"\g<1>1.0", data)
        report.add("assumed", "XML 1.0, for the file says 0.0")
    try:
        root = etree.fromstring(data, parser)
        info = root.getroottree().docinfo
        text = data.decode(info.encoding or "utf-8")
    except (etree.XMLSyntaxError, ValueError, LookupError) as error:
        reason = " ".join(str(error).replace("(<string>, ", "(").split())
        raise UrdfError(f"{source}: is not well-formed XML: {reason}; expected a URDF") from None
    if info.doctype:
        raise UrdfError(f"{source}: has a DOCTYPE; expected a URDF without one (no entities)")
    return root, text


def _check_inertias(tree: Tree, source: str, repair: bool, report: Report) -> None:
    """Refuse what no rigid body can have; with `repair`, put the nearest valid inertia instead.

    A moment of inertia is a sum of squares over the mass: the tensor is positive definite, and no
    principal moment exceeds the sum of the others. A link that is fused with another may be a
    point (moments 0) or have no mass; a body that moves may not.
    """
    root = body_inertia(tree, tree.root)
    for name, link in tree.links.items():
        if link.inertial is None or (root is None and tree.body_of[name] == tree.root):
            continue  # a root without any mass stands still, whatever its inertia
        mass, tensor = link.inertial.mass, link.inertial.inertia
        # Whether the root moves is decided later; where it is asked for, it is made fit to.
        moves = name == tree.body_of[name] and (name != tree.root or repair)
        where = f"{source}: link '{name}'"
        if moves and mass == 0 and name != tree.root:
            raise UrdfError(f"{where} moves, and its <mass> is 0; expected a mass above 0")
        problem = _problem(mass, tensor, moves)
        if problem is None:
            continue
        if not repair:
            raise UrdfError(f"{where}: <inertia> {problem} (or pass --repair-inertia)")
        valid = nearest_valid(mass, tensor)
        change = np.linalg.norm(valid - tensor) / max(float(np.linalg.norm(tensor)), SMALLEST)
        link.inertial.inertia = valid
        report.add(
            "repaired",
            f"inertia of '{name}', principal moments {_moments(tensor)} -> {_moments(valid)} "
            f"kg m^2, a change by {change:.2g} of its norm",
        )
    for body in tree.bodies[1:]:
        whole = body_inertia(tree, body)
        if whole is None or whole.mass < SMALLEST:
            raise UrdfError(
                f"{source}: link '{body}' moves (joint '{tree.joint_above[body].name}') and has "
                "no mass; expected <inertial> with a mass above 0"
            )
        if principal(whole.about_com)[0][2] < SMALLEST:
            raise UrdfError(
                f"{source}: link '{body}' moves, and its <inertia> is too small for MuJoCo; "
                f"expected principal moments above {SMALLEST:g} kg m^2"
            )


def _problem(mass: float, tensor: np.ndarray, moves: bool) -> str | None:
    """What is wrong with a link's inertia (3, 3), and what is expected; None if it is valid."""
    if mass == 0:
        return None if not tensor.any() else "is not 0 and the mass is; expected both or neither"
    smallest, middle, largest = np.linalg.eigvalsh(tensor)
    room = _ROUNDING * abs(largest)
    shown = _moments(tensor)
    if smallest < -room or (moves and smallest <= 0):
        return f"has principal moments {shown}; expected positive ones"
    if smallest + middle < largest - room:
        return f"has principal moments {shown}; expected none above the sum of the others"
    return None


def _moments(tensor: np.ndarray) -> str:
    return "(" + ", ".join(f"{moment:.4g}" for moment in np.linalg.eigvalsh(tensor)) + ")"
