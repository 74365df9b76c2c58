"""Shapes of an MjSpec from those of a URDF, with their materials and meshes."""

import mujoco
import numpy as np
import yourdfpy

from quadwalk.robot.meshes import Meshes, MeshPart
from quadwalk.robot.report import Report
from quadwalk.robot.scene import SPHERE_NAMES
from quadwalk.robot.structure.legs import Leg
from quadwalk.robot.structure.tree import Capsule, Tree, make_unique, to_matrix

_Type = mujoco.mjtGeom
# Attributes of a geom (lengths in m), and the color (4,) that comes with it, if any.
_Piece = tuple[dict, np.ndarray | None]


class Shapes:
    """A robot's shapes in a spec that has its scene and default classes: geoms, materials, meshes.

    Geoms of the feet of `legs` are named like the foot.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        robot: yourdfpy.Robot,
        legs: tuple[Leg, ...],
        meshes: Meshes,
        report: Report,
    ):
        self.spec, self.meshes, self.report = spec, meshes, report
        self.legs = {leg.foot.link: leg for leg in legs}
        self.geom_names = {*(leg.foot_name for leg in legs), "floor"}.union(*SPHERE_NAMES)
        self.mesh_names: dict[tuple, list[str]] = {}
        self.materials: dict[str, str] = {}
        self.rgba: dict[str, tuple] = {}
        inline = [v.material for link in robot.links for v in link.visuals if v.material]
        for material in [*robot.materials, *inline]:
            self._add_material(material)
        # Invisible as a whole, a robot shows its collision shapes.
        self.invisible = not any(link.visuals for link in robot.links)

    def add_link(self, body: mujoco.MjsBody, tree: Tree, name: str) -> None:
        """Add the geoms of link `name` to the body that carries it."""
        link, placement = tree.links[name], tree.placement[name]
        visuals = [self._add_visual(body, name, visual, placement) for visual in link.visuals]
        stand_in = link.collisions and not any(visuals) and (self.invisible or link.visuals)
        if stand_in:
            self.report.add("assumed", "shown by their collision shapes", name)
        leg = self.legs.get(name)
        for index, collision in enumerate(link.collisions):
            if leg is not None and index in leg.foot.replaced:
                continue
            foot = leg.foot_name if leg is not None and index == leg.foot.shape else None
            frame = placement @ to_matrix(collision.origin)
            for shape, _ in self._make_pieces(name, collision.geometry, collision=True):
                geom = self._add_geom(body, "foot" if foot else "collision", shape, frame)
                geom.name = foot or make_unique(name, self.geom_names)
                self.geom_names.add(geom.name)
                if stand_in:
                    twin = self._add_geom(body, "visual", shape, frame)
                    self._paint(twin, link.visuals[0].material if link.visuals else None, None)
        if leg is not None and leg.foot.shape is None:
            sphere = {"type": _Type.mjGEOM_SPHERE, "size": [leg.foot.radius, 0, 0]}
            frame = np.eye(4)
            frame[:3, 3] = leg.foot.center
            self._add_geom(body, "foot", sphere, frame).name = leg.foot_name
            note = f"the feet are spheres of {leg.foot.radius * 1000:.3g} mm {leg.foot.reason}"
            self.report.add("assumed", note, leg.foot_name)

    def _add_visual(self, body, name: str, visual, placement: np.ndarray) -> bool:
        """Add a visual shape; return False if there is nothing of it to show."""
        pieces = self._make_pieces(name, visual.geometry, collision=False)
        for shape, rgba in pieces:
            geom = self._add_geom(body, "visual", shape, placement @ to_matrix(visual.origin))
            self._paint(geom, visual.material, rgba)
        return bool(pieces)

    def _add_geom(self, body, kind: str, shape: dict, frame: np.ndarray) -> mujoco.MjsGeom:
        pos, quat = to_pose(frame)
        return body.add_geom(self.spec.find_default(kind), pos=pos, quat=quat, **shape)

    def _make_pieces(self, name: str, geometry, collision: bool) -> list[_Piece]:
        """Return the geoms that make up a shape of link `name`: one for each part of a mesh file.

        There are none for a mesh that is left out, or a visual shape of size 0.
        """
        if geometry.box is not None:
            size, kind = geometry.box.size / 2, _Type.mjGEOM_BOX
        elif geometry.sphere is not None:
            size, kind = [geometry.sphere.radius, 0, 0], _Type.mjGEOM_SPHERE
        elif geometry.cylinder is not None:
            cylinder = geometry.cylinder
            size = [cylinder.radius, cylinder.length / 2, 0]
            is_capsule = isinstance(cylinder, Capsule)
            kind = _Type.mjGEOM_CAPSULE if is_capsule else _Type.mjGEOM_CYLINDER
        else:
            return self._make_mesh_pieces(name, geometry.mesh, collision)
        if not collision and min(np.trim_zeros(size, "b"), default=0) <= 0:
            self.report.add("dropped", "visual shapes of size 0", name)
            return []
        return [({"type": kind, "size": size}, None)]

    def _make_mesh_pieces(self, name: str, mesh, collision: bool) -> list[_Piece]:
        """Return the geoms of a mesh; on its first use add it to the spec, with its data inline."""
        loaded = self.meshes.load(mesh, "collision" if collision else "visual")
        if loaded is None:
            return []
        if collision:
            self.report.add("assumed", "meshes collide as their convex hulls", name)
        file, parts = loaded
        key = (file, None if mesh.scale is None else tuple(np.ravel(mesh.scale)))
        if key not in self.mesh_names:
            self.mesh_names[key] = [self._add_mesh(file.stem, part) for part in parts]
        return [
            ({"type": _Type.mjGEOM_MESH, "meshname": added}, part.rgba)
            for added, part in zip(self.mesh_names[key], parts, strict=True)
        ]

    def _add_mesh(self, stem: str, part: MeshPart) -> str:
        name = make_unique(stem, {mesh.name for mesh in self.spec.meshes})
        self.spec.add_mesh(
            name=name,
            uservert=part.vertices.ravel(),
            userface=part.faces.ravel(),
            # No mass comes from meshes; this one needs no closed surface.
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        return name

    def _add_material(self, material: yourdfpy.Material) -> None:
        if material.texture is not None:
            self.report.add("dropped", "textures", material.texture.filename)
        if not material.name or material.color is None or material.name in self.materials:
            return
        name = make_unique(material.name, {"floor"} | set(self.materials.values()))
        self.spec.add_material(name=name, rgba=material.color.rgba, specular=0.3, shininess=0.4)
        self.materials[material.name] = name
        self.rgba[material.name] = tuple(material.color.rgba)

    def _paint(self, geom, material, rgba: np.ndarray | None) -> None:
        """Give a geom the URDF's material, or else the color `rgba` that came with its mesh."""
        name = None if material is None else material.name
        color = None if material is None or material.color is None else material.color.rgba
        if name in self.materials and (color is None or tuple(color) == self.rgba[name]):
            geom.material = self.materials[name]
        elif color is not None:
            geom.rgba = color
        elif rgba is not None:
            geom.rgba = rgba
        elif name:
            self.report.add("assumed", "materials that are not defined are gray", name)


def to_pose(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return position (3,) and quaternion wxyz (4,) of a frame (4, 4)."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, frame[:3, :3].ravel())
    return frame[:3, 3], quat
