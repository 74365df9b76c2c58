"""Strict reading of URDF: lxml without recovery, our own validation, and only then yourdfpy.

yourdfpy alone loads a truncated file as a partial robot, and takes unknown parents, cycles,
duplicates, NaN masses and reversed limits without a word. What reaches it here has been checked.
"""

import io
from dataclasses import dataclass
from pathlib import Path

import yourdfpy
from lxml import etree

from quadwalk.errors import UserError
from quadwalk.robot.validate import UrdfError, check_robot

__all__ = ["MAX_BYTES", "Urdf", "UrdfError", "parse_urdf", "read_urdf"]

# The largest quadruped descriptions are some 100 kB; a thousand links with meshes are about 1 MB.
MAX_BYTES = 16 * 2**20


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
    """

    source: str
    folder: Path | None
    text: str
    robot: yourdfpy.Robot
    armature: dict[str, float]


def read_urdf(path: Path) -> Urdf:
    """Read and check the URDF file at `path`; `UrdfError` if it is not valid."""
    path = Path(path)
    try:
        if path.is_dir():
            raise UrdfError(f"{path}: is a folder; expected a URDF file")
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise UrdfError(
            f"{path}: cannot be read ({error.strerror}); expected a URDF file"
        ) from None
    return parse_urdf(data, source=str(path), folder=path.resolve().parent)


def parse_urdf(data: bytes | str, source: str = "URDF", folder: Path | None = None) -> Urdf:
    """Check and parse a URDF's text; `source` is what error messages call it."""
    data = data.encode() if isinstance(data, str) else data
    root = _parse_xml(data, source)
    check_robot(root, source)
    model = yourdfpy.URDF.load(
        io.BytesIO(etree.tostring(root)), load_meshes=False, build_scene_graph=False
    )
    armature = {
        joint.get("name"): float(dynamics.get("armature"))
        for joint in root.iterfind("joint")
        if (dynamics := joint.find("dynamics")) is not None and dynamics.get("armature")
    }
    text = data.decode(root.getroottree().docinfo.encoding or "utf-8")
    return Urdf(source, folder, text, model.robot, armature)


def _parse_xml(data: bytes, source: str) -> etree._Element:
    """The root element, or a `UrdfError` for anything that is not plain, complete, finite XML."""
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
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise UrdfError(f"{source}: is not well-formed XML: {reason}") from None
    if root.getroottree().docinfo.doctype:
        raise UrdfError(f"{source}: has a DOCTYPE; expected a URDF without one (no entities)")
    return root


assert issubclass(UrdfError, UserError)
