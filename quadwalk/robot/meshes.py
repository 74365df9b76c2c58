"""Mesh files of a URDF: names that stay inside the allowed folders, shapes in metres.

The names in a URDF and the files they lead to are untrusted: a name may not leave the folders it
is looked up in, COLLADA is parsed without entities, and no file leads to another (no .mtl, no
textures).
"""

import io
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
from lxml import etree

from quadwalk.robot.validate import UrdfError

KINDS = (".dae", ".obj", ".stl")
MAX_BYTES = 64 * 2**20


class MissingMeshError(UrdfError):
    """A mesh file that is in none of the folders it may be in."""


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Triangles of one colour.

    Attributes:
        vertices: (n, 3) m.
        faces: (m, 3) indices of vertices, counter-clockwise seen from outside.
        rgba: (4,) in 0 .. 1, or None where the file gives no colour.
    """

    vertices: np.ndarray
    faces: np.ndarray
    rgba: np.ndarray | None


def find_mesh(name: str, folders: list[Path], source: str) -> Path:
    """The file that a URDF's mesh name means: relative, absolute, `file://` or `package://`.

    `package://PACKAGE/rest` is looked up in each folder as PACKAGE/rest and as rest.
    """
    place = urlsplit(name)
    where = f"{source}: mesh '{name}'"
    if place.scheme in ("package", "model"):
        rest = unquote(place.path).lstrip("/")
        names = [f"{unquote(place.netloc)}/{rest}", rest]
    elif place.scheme == "file":
        names = [unquote(place.path)]
    elif "://" in name:
        raise UrdfError(f"{where} is not a file; expected a path, file:// or package://")
    else:
        names = [name]
    shown = ", ".join(f"'{folder}'" for folder in folders) or "no folder"
    outside = False
    for folder in folders:
        for candidate in (folder / n for n in names):
            try:
                file = candidate.resolve()
                if not any(file.is_relative_to(allowed.resolve()) for allowed in folders):
                    outside = True
                elif file.is_file():
                    return file
            except (OSError, ValueError):  # a name that no file can have
                continue
    if outside:
        raise UrdfError(f"{where} lies outside {shown}; expected inside, or pass --mesh-dir")
    raise MissingMeshError(f"{where} is not in {shown}; expected a file, or pass --mesh-dir")


def load_mesh(file: Path, scale: np.ndarray, source: str) -> list[MeshPart]:
    """The triangles of a .dae, .obj or .stl file, times `scale` (3,), in metres.

    A COLLADA file's unit is respected; its up axis is not, as in RViz.
    """
    import trimesh

    where = f"{source}: mesh file '{file}'"
    kind = file.suffix.lower()
    if kind not in KINDS:
        raise UrdfError(f"{where} is of kind '{kind}'; expected {', '.join(KINDS)}")
    try:
        with file.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise UrdfError(f"{where} cannot be read ({error.strerror}); expected a mesh") from None
    if len(data) > MAX_BYTES:
        raise UrdfError(f"{where} is larger than {MAX_BYTES // 2**20} MB; expected a smaller one")
    try:
        unit = _collada_unit(data) if kind == ".dae" else 1.0
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind[1:], resolver=None)
        meshes = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]
        parts = [_part(mesh, scale * unit, coloured=kind == ".dae") for mesh in meshes]
    except Exception as error:  # the parsers raise whatever a broken file leads them to
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise UrdfError(f"{where} is not valid {kind}: {reason}") from None
    parts = [part for part in parts if len(part.faces)]
    if not parts or not all(np.isfinite(part.vertices).all() for part in parts):
        raise UrdfError(f"{where} has no triangles, or not finite ones; expected a mesh")
    return parts


def _collada_unit(data: bytes) -> float:
    """Metres per unit of a COLLADA file; refuses a DOCTYPE, before another parser expands it."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False)
    root = etree.fromstring(data, parser)
    if root.getroottree().docinfo.doctype:
        raise ValueError("has a DOCTYPE")
    unit = root.find("{*}asset/{*}unit")
    return 1.0 if unit is None else float(unit.get("meter", "1"))


def _part(mesh, scale: np.ndarray, coloured: bool) -> MeshPart:
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    faces = np.asarray(mesh.faces)
    if np.prod(scale) < 0:
        faces = faces[:, ::-1]  # a mirrored mesh, turned inside out
    rgba = None
    if coloured and hasattr(mesh.visual, "material"):
        rgba = np.asarray(mesh.visual.material.main_color) / 255
    return MeshPart(np.asarray(mesh.vertices) * scale, faces, rgba)
