"""Strict reading of URDF: lxml without recovery, the project's own checks, only then yourdfpy.

yourdfpy alone loads a truncated file as a partial robot, and takes unknown parents, cycles,
duplicates, NaN masses and reversed limits without a word. What reaches it here has been checked.
"""

import io
import re
from copy import deepcopy
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import yourdfpy
from lxml import etree
from trimesh.transformations import (
    compose_matrix,
    euler_from_matrix,
    rotation_matrix,
    translation_matrix,
)

from quadwalk.errors import UsageError
from quadwalk.robot.checks.bodies import check_bodies, read_resolutions
from quadwalk.robot.checks.elements import Checker, make_xacro_error, write_numbers
from quadwalk.robot.checks.topology import check_mimic, check_topology
from quadwalk.robot.names import suggest_packages
from quadwalk.robot.report import Report, UrdfError
from quadwalk.robot.structure.tree import (
    Capsule,
    Tree,
    build_tree,
    make_unique,
    name_axis,
    normalize,
    to_roll_pitch_yaw,
)

# The largest quadruped descriptions are some 100 kB; a thousand links with meshes are about 1 MB.
MAX_BYTES = 16 * 2**20
# Blank space before the XML declaration, which must come first; a byte order mark may precede it.
_BLANK_FIRST = re.compile(rb"\A(\xef\xbb\xbf)?(\s+)(<\?xml\b[^>]*\?>)")
_DECLARATION = re.compile(r"^\s*<\?xml[^>]*\?>")
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
    # rad by joint name, the pose to stand in, from `<dynamics home="...">`, an extension too; such
    # joints alone as the file has it for
    home: dict[str, float]
    report: Report  # what reading left out or repaired
    # where MuJoCo's extension says that meshes are, from `folder`; None: it does not
    mesh_folder: str | None = None

    @cached_property
    def tree(self) -> Tree:
        """The tree of its links."""
        return build_tree(self.robot, self.source)


def read_urdf(path: Path, repair_inertia: bool = False, fix: tuple[str, ...] = ()) -> Urdf:
    """Read and check the URDF file at `path`; raise `UrdfError` if it is not valid.

    With `repair_inertia`, an inertia that no body can have is replaced by the nearest valid one,
    and the report says by how much it changed. Joints whose names match the patterns `fix` are
    fixed, at 0 or at the limit nearest to it; `UsageError` if a pattern matches none.
    """
    path = Path(path)
    return parse_urdf(read_file(path), str(path), path.resolve().parent, repair_inertia, fix)


def read_file(path: Path) -> bytes:
    """Return the content of a robot's file, or the start of one that is too large to be one."""
    expected = f"expected a URDF or MJCF file{suggest_packages(path)}"
    try:
        if path.is_dir():
            raise UrdfError(f"{path}: is a folder; expected a URDF or MJCF file")
        with path.open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
        reason = getattr(error, "strerror", None) or error
        raise UrdfError(f"{path}: cannot be read ({reason}); {expected}") from None


def parse_urdf(
    data: bytes | str,
    source: str = "URDF",
    folder: Path | None = None,
    repair_inertia: bool = False,
    fix: tuple[str, ...] = (),
) -> Urdf:
    """Check and parse a URDF's text, as `read_urdf`; `source` is what error messages call it."""
    if isinstance(data, str):
        # Text has no encoding any more, whatever its declaration says.
        data = _DECLARATION.sub("", data).encode()
    report = Report()
    root, text = _parse_xml(data, source, report)
    checker = Checker(source, report)
    _drop_namespace(checker, root)
    if root.tag == "robot" and not root.get("name", "").strip():
        root.set("name", Path(source).stem)
        report.add("assumed", "the robot's name, for it has none", root.get("name"))
        checker.rewritten = True
    compiler = root.find("mujoco/compiler")
    mesh_folder = None if compiler is None else compiler.get("meshdir")
    checker.check_root(root)
    check_topology(checker, root)
    _fix_joints(checker, root, fix)
    check_mimic(checker, root.findall("joint"))
    _drop_ground(checker, root)
    if checker.rewritten:
        text = etree.tostring(root, encoding="unicode")
    armature, home = (_read_dynamics(root, name) for name in ("armature", "home"))
    resolutions = read_resolutions(root)
    urdf = Urdf(source, folder, text, _load_robot(root), armature, home, report, mesh_folder)
    check_bodies(urdf.tree, resolutions, repair_inertia, report)
    return urdf


def turn_root(urdf: Urdf, turn: np.ndarray, reasons: str) -> Urdf:
    """Put the robot on a new root link, on which the old one stands turned by `turn` (3, 3).

    Its text has that link as well, so that whoever reads it again meets the same frames. `reasons`
    are for the report.
    """
    root = urdf.tree.root
    names = {*urdf.tree.links, *(joint.name for joint in urdf.robot.joints)}
    link, joint = (make_unique(f"{root}_{end}", names) for end in ("ahead", "ahead_joint"))
    rpy = euler_from_matrix(turn)
    elements = f"""\
  <link name={quoteattr(link)}/>
  <joint name={quoteattr(joint)} type="fixed">
    <parent link={quoteattr(link)}/>
    <child link={quoteattr(root)}/>
    <origin rpy="{write_numbers(np.array(rpy))}"/>
  </joint>
"""
    before, end, after = urdf.text.rpartition("</robot")
    text = before + elements + end + after
    ahead, _, up = (name_axis(row) for row in turn)
    report = deepcopy(urdf.report)
    note = f"{ahead} is ahead and {up} up, by {reasons}, so '{link}' is the new root"
    report.add("assumed", note, root)
    fixed = yourdfpy.Joint(joint, "fixed", link, root, origin=compose_matrix(angles=rpy))
    robot = replace(
        urdf.robot,
        links=[*urdf.robot.links, yourdfpy.Link(link)],
        joints=[*urdf.robot.joints, fixed],
    )
    return replace(urdf, text=text, robot=robot, report=report)


def release_from_world(urdf: Urdf) -> Urdf:
    """Remove a link `world` that only holds one other link by a fixed joint.

    So a file places the robot in a simulator. An arm is to stay there; a quadruped is to float.
    """
    below = urdf.tree.joints_below.get("world", ())
    if urdf.tree.root != "world" or [joint.type for joint in below] != ["fixed"]:
        return urdf
    (holder,) = below
    root = etree.fromstring(_DECLARATION.sub("", urdf.text).encode())
    for element in (*root.findall("link"), *root.findall("joint")):
        if (element.tag, element.get("name")) in (("link", "world"), ("joint", holder.name)):
            root.remove(element)
    robot = replace(
        urdf.robot,
        links=[link for link in urdf.robot.links if link.name != "world"],
        joints=[joint for joint in urdf.robot.joints if joint.name != holder.name],
    )
    report = deepcopy(urdf.report)
    report.add("dropped", "the link 'world' and the joint that holds the robot there", holder.name)
    return replace(urdf, robot=robot, text=etree.tostring(root, encoding="unicode"), report=report)


def _load_robot(root: etree._Element) -> yourdfpy.Robot:
    """Load the robot of a checked document, which is changed to what yourdfpy can read."""
    for limit in root.iter("limit"):
        for name in ("effort", "velocity"):
            limit.set(name, limit.get(name, "inf"))
    links = root.findall("link")
    capsules = [
        (row, kind, index)
        for row, link in enumerate(links)
        for kind in ("visual", "collision")
        for index, shape in enumerate(link.findall(kind))
        if shape.find("geometry/capsule") is not None
    ]
    for capsule in root.iter("capsule"):
        capsule.tag = "cylinder"
    data = io.BytesIO(etree.tostring(root))
    robot = yourdfpy.URDF.load(data, load_meshes=False, build_scene_graph=False).robot
    for row, kind, index in capsules:
        geometry = getattr(robot.links[row], f"{kind}s")[index].geometry
        geometry.cylinder = Capsule(geometry.cylinder.radius, geometry.cylinder.length)
    return robot


def _read_dynamics(root: etree._Element, name: str) -> dict[str, float]:
    """Return attribute `name` of each joint's `<dynamics>` that has it, by joint name."""
    return {
        joint.get("name"): float(dynamics.get(name))
        for joint in root.iterfind("joint")
        if (dynamics := joint.find("dynamics")) is not None and dynamics.get(name)
    }


def _drop_namespace(checker: Checker, root: etree._Element) -> None:
    """Take a robot's own namespace off its elements; those of other namespaces stay."""
    name = etree.QName(root)
    if not name.namespace or name.localname != "robot":
        return
    for element in root.iter(f"{{{name.namespace}}}*"):
        element.tag = etree.QName(element).localname
    etree.cleanup_namespaces(root)
    checker.report.add("dropped", "the namespace", name.namespace)
    checker.rewritten = True


def _fix_joints(checker: Checker, root: etree._Element, patterns: tuple[str, ...]) -> None:
    """Make the joints that match `patterns` fixed ones, at 0 or at the limit nearest to it."""
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    for pattern in patterns:
        names = [name for name in joints if fnmatchcase(name, pattern)]
        if not names:
            moving = ", ".join(n for n, joint in joints.items() if joint.get("type") != "fixed")
            raise UsageError(f"--robot.fix {pattern}: names no joint; there are {moving or 'none'}")
        for name in names:
            if joints[name].get("type") != "fixed":
                position = _fix_joint(joints[name])
                checker.report.add("assumed", f"fixed at {position:g}, as a flag says", name)
                checker.rewritten = True


def _fix_joint(joint: etree._Element) -> float:
    """Make a joint a fixed one, and return its position, rad or m."""
    limit, axis, origin = (joint.find(tag) for tag in ("limit", "axis", "origin"))
    kind = joint.get("type")
    position = 0.0
    if limit is not None and kind in ("revolute", "prismatic"):
        lower, upper = (float(limit.get(end, "0")) for end in ("lower", "upper"))
        position = float(np.clip(0.0, lower, upper))
    if position:
        if origin is None:
            origin = etree.SubElement(joint, "origin")
        xyz, rpy = (np.array(origin.get(x, "0 0 0").split(), float) for x in ("xyz", "rpy"))
        direction = np.array((axis.get("xyz") if axis is not None else "1 0 0").split(), float)
        frame = compose_matrix(translate=xyz, angles=rpy)
        if kind == "prismatic":
            frame = frame @ translation_matrix(position * normalize(direction))
        else:
            frame = frame @ rotation_matrix(position, direction)
        origin.set("xyz", write_numbers(frame[:3, 3]))
        origin.set("rpy", write_numbers(to_roll_pitch_yaw(frame[:3, :3])))
    joint.set("type", "fixed")
    for tag in ("axis", "limit", "dynamics", "mimic"):
        for element in joint.findall(tag):
            joint.remove(element)
    return position


def _drop_ground(checker: Checker, root: etree._Element) -> None:
    """Remove a root link that only a floating joint leads from: it is the ground's frame.

    It has no mass and nothing that could touch, at most a mark to be seen. What floats on it is
    then the root link, which floats in any case.
    """
    joints = root.findall("joint")
    children = {joint.find("child").get("link") for joint in joints}
    (ground,) = (link for link in root.findall("link") if link.get("name") not in children)
    below = [j for j in joints if j.find("parent").get("link") == ground.get("name")]
    mass = ground.find("inertial/mass")
    is_frame = ground.find("collision") is None and (mass is None or float(mass.get("value")) == 0)
    if not is_frame or [joint.get("type") for joint in below] != ["floating"]:
        return
    note = "the ground's link and its floating joint"
    checker.report.add("dropped", note, ground.get("name"))
    for element in (ground, *below):
        root.remove(element)
    checker.rewritten = True


def _parse_xml(data: bytes, source: str, report: Report) -> tuple[etree._Element, str]:
    """Return the root element and the text; raise `UrdfError` unless it is plain, complete XML."""
    if not data.strip():
        raise UrdfError(f"{source}: is empty; expected a URDF <robot>")
    if len(data) > MAX_BYTES:
        raise UrdfError(f"{source}: is larger than {MAX_BYTES // 2**20} MB; expected a URDF")
    # By default it recovers from no error, and loads no DTD and nothing from the network.
    parser = etree.XMLParser(
        resolve_entities=False, remove_comments=True, remove_pis=True, remove_blank_text=True
    )
    if _BLANK_FIRST.match(data):
        data = _BLANK_FIRST.sub(rb"\1\3\2", data)  # which leaves the numbers of lines
        report.add("assumed", "the XML declaration comes first, where blank space stands before it")
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
        if "prefix xacro" in reason:
            raise make_xacro_error(source) from None
        raise UrdfError(f"{source}: is not well-formed XML: {reason}; expected a URDF") from None
    if info.doctype:
        raise UrdfError(f"{source}: has a DOCTYPE; expected a URDF without one (no entities)")
    return root, text
