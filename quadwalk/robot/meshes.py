"""Mesh files of a URDF: names that stay inside the allowed folders, shapes in meters.

The names in a URDF and the files they lead to are untrusted: a name may not leave the folders it is
looked up in, COLLADA is parsed without entities, no file leads to another (no .mtl, no textures).
"""

import io
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from urllib.parse import unquote, urlsplit

import numpy as np
import yourdfpy
from lxml import etree

from quadwalk.files import resolve_path
from quadwalk.robot.report import Report, UrdfError

KINDS = (".dae", ".obj", ".ply", ".stl")
MAX_BYTES = 64 * 2**20
MAX_PACKAGE_BYTES = 2**20
LARGEST = 1e6  # m, from the link's frame
MOST_PARTS = 4  # of the end of a mesh's name, by which it is looked for in other folders
FLATTEST = 1e-5  # thinnest over longest extent of a mesh; thinner ones are flat for MuJoCo's hulls
# Beside the meshes' folder in a package, by ROS's custom; a package need not have a package.xml.
URDF_FOLDERS = ("urdf", "urdfs", "robots", "xacro")


class MissingMeshError(UrdfError):
    """A mesh file that is in none of the folders it may be in."""


class UnreadMeshError(UrdfError):
    """A mesh file of a kind that is not read."""


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Triangles of one color."""

    vertices: np.ndarray  # (n, 3) m
    faces: np.ndarray  # (m, 3) indices of vertices, counter-clockwise seen from outside
    rgba: np.ndarray | None  # (4,) in 0 .. 1; None: the file gives no color


def find_mesh(name: str, folders: list[Path], source: str) -> Path:
    """Find the file of a URDF's mesh name: relative, absolute, `file://` or `package://`.

    `package://PACKAGE/rest` is rest in the nearest folder that is called PACKAGE, or has its
    package.xml, at or above one of `folders`; or it is PACKAGE/rest or rest in one of them. A
    relative name may lead, over `..`, through the package that a folder is in, and no further.
    `folders` are where to look, the URDF's own first. Raise `MissingMeshError` where none is found,
    and `UrdfError` where it lies outside.
    """
    where = f"{source}: mesh '{name}'"
    try:
        place = urlsplit(name)
    except ValueError as error:
        raise MissingMeshError(f"{where} is no name: {error}; expected a file") from None
    allowed = _list_allowed(folders)
    if place.scheme in ("package", "model"):
        # Some write package:///PACKAGE/rest.
        package, _, rest = unquote(place.netloc + place.path).lstrip("/").partition("/")
        packages = [root for folder in folders if (root := _find_package(package, folder))]
        allowed += packages
        candidates = [root / rest for root in packages]
        candidates += [folder / n for folder in folders for n in (f"{package}/{rest}", rest)]
    elif "://" in name and place.scheme != "file":
        raise MissingMeshError(f"{where} is not a file; expected a path, file:// or package://")
    else:
        path = unquote(place.path) if place.scheme == "file" else name
        candidates = [folder / path for folder in folders]
    listing = ", ".join(f"'{folder}'" for folder in folders) or "no folder"
    outside = False
    for candidate in candidates:
        try:
            file = resolve_path(candidate)
            if not _is_in_any(file, allowed):
                outside = outside or file.is_file()
            elif file.is_file():
                return file
        except (OSError, ValueError):  # a name that no file can have
            continue
    if outside:
        raise UrdfError(
            f"{where} lies outside {listing}; expected inside, or pass --robot.mesh-dirs"
        )
    raise MissingMeshError(
        f"{where} is not in {listing}; expected a file, or pass --robot.mesh-dirs"
    )


def find_by_name(name: str, folders: list[Path]) -> Path | None:
    """Return the file in one of `folders` that is called as the end of a mesh's name is.

    A name of another machine, `/home/me/dog/meshes/visual/hip.stl`, is `visual/hip.stl` or
    `hip.stl` here; the longer end of the name counts.
    """
    parts = PureWindowsPath(unquote(name)).parts[-MOST_PARTS:]
    for first in range(len(parts)):
        for folder in folders:
            file = folder.joinpath(*parts[first:])
            try:
                if file.is_file() and is_inside(file, [folder]):
                    return resolve_path(file)
            except (OSError, ValueError):  # a name that no file can have
                continue
    return None


def is_inside(path: Path, folders: list[Path]) -> bool:
    """Return True if `path` is in one of `folders`, or in the package that one of them is in."""
    return _is_in_any(resolve_path(path), _list_allowed(folders))


def _list_allowed(folders: list[Path]) -> list[Path]:
    return [*folders, *filter(None, map(_find_enclosing_package, folders))]


def _is_in_any(file: Path, folders: list[Path]) -> bool:
    """Return True if a resolved path is in one of `folders`, at any depth."""
    return any(file.is_relative_to(resolve_path(folder)) for folder in folders)


def _find_package(name: str, folder: Path) -> Path | None:
    """Return the nearest folder, `folder` or above it, that is the package `name`."""
    for place in (resolve_path(folder), *resolve_path(folder).parents):
        if name and (place.name == name or _read_package_name(place) == name):
            return place
    return None


def _find_enclosing_package(folder: Path) -> Path | None:
    """Return the package that `folder` is in: with a package.xml, or above a folder for URDFs."""
    folder = resolve_path(folder)
    for place in (folder, *folder.parents):
        if _read_package_name(place) is not None:
            return place
    return folder.parent if folder.name in URDF_FOLDERS else None


def _read_package_name(folder: Path) -> str | None:
    """Return the name in a folder's package.xml; None where there is none to be read."""
    try:
        with (folder / "package.xml").open("rb") as file:
            data = file.read(MAX_PACKAGE_BYTES)
        root = etree.fromstring(data, etree.XMLParser(resolve_entities=False, no_network=True))
    except (OSError, etree.XMLSyntaxError):
        return None
    return root.findtext("name", "").strip() or None


def load_mesh(file: Path, scale: np.ndarray, source: str) -> list[MeshPart]:
    """Return the triangles of a .dae, .obj, .ply or .stl file, times `scale` (3,), in meters.

    A COLLADA file's unit is respected; its up axis is not, as in RViz. Raise `UrdfError` where it
    is no mesh.
    """
    import trimesh

    where = f"{source}: mesh file '{file}'"
    kind = file.suffix.lower()
    if kind not in KINDS:
        raise UnreadMeshError(f"{where} is of kind '{kind}'; expected {', '.join(KINDS)}")
    try:
        with file.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise UrdfError(f"{where} cannot be read ({error.strerror}); expected a mesh") from None
    if len(data) > MAX_BYTES:
        raise UrdfError(f"{where} is larger than {MAX_BYTES // 2**20} MB; expected a smaller one")
    try:
        unit = _read_collada_unit(data) if kind == ".dae" else 1.0
        with np.errstate(all="ignore"):
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind[1:], resolver=None)
            meshes = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]
            parts = [_make_part(mesh, scale * unit, colored=kind == ".dae") for mesh in meshes]
    except Exception as error:  # the parsers raise whatever a broken file leads them to
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise UrdfError(f"{where} is not valid {kind}: {reason}") from None
    parts = [part for part in parts if len(part.faces)]
    if not parts or not all((np.abs(part.vertices) < LARGEST).all() for part in parts):
        raise UrdfError(f"{where} has no triangles, or some beyond {LARGEST:g} m; expected a mesh")
    return parts


class Meshes:
    """The mesh files of one URDF, each read once.

    What cannot be found or read is left out, with a note in `report`: it never keeps a robot from
    training. `folders` are where files may be; None leaves all meshes out.
    """

    def __init__(self, folders: list[Path] | None, source: str, report: Report):
        self.folders, self.source, self.report = folders, source, report
        self._parts: dict[tuple, list[MeshPart]] = {}

    def load(self, mesh: yourdfpy.Mesh, kind: str) -> tuple[Path, list[MeshPart]] | None:
        """Return the file and its parts, scaled, in meters; None if there are none.

        `kind` is `visual` or `collision`. Raise `UrdfError` for a name that leads out of the
        folders.
        """
        if self.folders is None:
            self.report.add("dropped", f"{kind} meshes", mesh.filename)
            return None
        try:
            file = find_mesh(mesh.filename, self.folders, self.source)
        except UrdfError as error:
            by_name = find_by_name(mesh.filename, self.folders)
            if by_name is not None:
                file = by_name
                note = f"{kind} meshes found by the ends of their names"
                self.report.add("assumed", note, file.name)
            elif isinstance(error, MissingMeshError):
                self.report.add("dropped", f"{kind} meshes that were not found", mesh.filename)
                return None
            else:
                raise
        scale = np.ones(3) * (1.0 if mesh.scale is None else mesh.scale)
        key = (file, tuple(scale), kind)
        if key not in self._parts:
            try:
                parts = load_mesh(file, scale, self.source)
            except UrdfError as error:
                why = str(error).partition(f"'{file}' ")[2]
                fault = "not read" if isinstance(error, UnreadMeshError) else "broken"
                self.report.add("dropped", f"{kind} meshes that are {fault}", f"{file.name} {why}")
                parts = []
            solid = [part for part in parts if _has_volume(part.vertices)]
            if len(solid) < len(parts):
                self.report.add("dropped", f"flat parts of {kind} meshes", file.name)
            self._parts[key] = solid
        return (file, self._parts[key]) if self._parts[key] else None


def _has_volume(vertices: np.ndarray) -> bool:
    """Return True if points (n, 3) span three dimensions, as MuJoCo's convex hulls must."""
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    return len(spread) == 3 and bool(spread[2] > FLATTEST * spread[0])


def _read_collada_unit(data: bytes) -> float:
    """Return meters per unit of a COLLADA file; refuse a DOCTYPE that another would expand."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=True)
    root = etree.fromstring(data, parser)
    if root.getroottree().docinfo.doctype:
        raise ValueError("has a DOCTYPE")
    unit = root.find("{*}asset/{*}unit")
    return 1.0 if unit is None else float(unit.get("meter", "1"))


def _make_part(mesh, scale: np.ndarray, colored: bool) -> MeshPart:
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    faces = np.asarray(mesh.faces)
    if np.prod(scale) < 0:
        faces = faces[:, ::-1]  # a mirrored mesh, turned inside out
    rgba = None
    if colored and hasattr(mesh.visual, "material"):
        rgba = np.asarray(mesh.visual.material.main_color) / 255
    return MeshPart(np.asarray(mesh.vertices) * scale, faces, rgba)
