"""Strict reading of URDF: lxml without recovery, our own validation, and only then yourdfpy.

yourdfpy alone loads a truncated file as a partial robot, and takes unknown parents, cycles,
duplicates, NaN masses and reversed limits without a word. What reaches it here has been checked.
"""

import io
import re
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import yourdfpy
from lxml import etree
from trimesh.transformations import compose_matrix, euler_from_matrix

from quadwalk.robot.checks.bodies import check_bodies, resolutions
from quadwalk.robot.checks.topology import check_mimic, check_topology
from quadwalk.robot.checks.validate import Check, UrdfError, check_elements
from quadwalk.robot.report import Report
from quadwalk.robot.structure.tree import Tree, build_tree, find_free_name, name_axis

__all__ = ["MAX_BYTES", "Report", "Urdf", "UrdfError", "parse_urdf", "read_urdf"]

# The largest quadruped descriptions are some 100 kB; a thousand links with meshes are about 1 MB.
MAX_BYTES = 16 * 2**20
_VERSION_0 = re.compile(rb"(<\?xml\s+version\s*=\s*[\"'])0\.0(?=[\"'])")


@dataclass(frozen=True)
class Urdf:
    """A URDF that has been read and checked."""

    source: str  # what error messages call it (the file's path)
    folder: Path | None  # where relative mesh names are looked up; None: the text is of no file
    text: str  # the file's, as read
    robot: yourdfpy.Robot  # lengths m, angles rad, masses kg
    # kg m^2 by joint name, from `<dynamics armature="...">`, an extension that other readers
    # ignore; joints without it are left out
    armature: dict[str, float]
    report: Report  # what reading left out or repaired

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
    if root.tag == "robot" and not root.get("name", "").strip():
        root.set("name", Path(source).stem)
        report.add("assumed", "the robot's name, for it has none", root.get("name"))
        text = etree.tostring(root, encoding="unicode")
    check = Check(source, report)
    check_elements(check, root)
    check_topology(check, root)
    check_mimic(check, root.findall("joint"))
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
    check_bodies(urdf.tree, resolutions(root), source, repair_inertia, report)
    return urdf


def turn_root(urdf: Urdf, turn: np.ndarray, reasons: str) -> Urdf:
    """Return the robot on a new root link, on which the old one stands turned by `turn` (3, 3).

    Its text has that link as well, so that whoever reads it again meets the same frames. `reasons`
    are for the report.
    """
    root = urdf.tree.root
    names = {*urdf.tree.links, *(joint.name for joint in urdf.robot.joints)}
    link, joint = (find_free_name(f"{root}_{end}", names) for end in ("ahead", "ahead_joint"))
    rpy = euler_from_matrix(turn)
    end = list(re.finditer(r"</(\w+:)?robot\s*>", urdf.text))[-1]
    prefix = end[1] or ""
    elements = f"""\
  <{prefix}link name={quoteattr(link)}/>
  <{prefix}joint name={quoteattr(joint)} type="fixed">
    <{prefix}parent link={quoteattr(link)}/>
    <{prefix}child link={quoteattr(root)}/>
    <{prefix}origin rpy="{" ".join(repr(float(angle)) for angle in rpy)}"/>
  </{prefix}joint>
"""
    ahead, _, up = (name_axis(row) for row in turn)
    report = deepcopy(urdf.report)
    what = f"{ahead} is ahead and {up} up, by {reasons}, so '{link}' is the new root"
    report.add("assumed", what, root)
    fixed = yourdfpy.Joint(joint, "fixed", link, root, origin=compose_matrix(angles=rpy))
    robot = replace(
        urdf.robot,
        links=[*urdf.robot.links, yourdfpy.Link(link)],
        joints=[*urdf.robot.joints, fixed],
    )
    text = urdf.text[: end.start()] + elements + urdf.text[end.start() :]
    return replace(urdf, text=text, robot=robot, report=report)


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
        # PyBullet's own exports say so, and there is no XML other than 1.0 that they could be.
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
