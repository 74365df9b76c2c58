"""Elements of an MjSpec from those of a URDF: joints, shapes, their materials and meshes."""

import mujoco
import numpy as np
import yourdfpy

from quadwalk.robot.meshes import Meshes, MeshPart
from quadwalk.robot.report import Report
from quadwalk.robot.scene import CONTACT_TIME, FRICTION, SPHERE_NAMES
from quadwalk.robot.structure.legs import Leg
from quadwalk.robot.structure.tree import Capsule, Tree, is_limited, joint_range, to_matrix, unit

SINGLE = {
    "revolute": mujoco.mjtJoint.mjJNT_HINGE,
    "continuous": mujoco.mjtJoint.mjJNT_HINGE,
    "prismatic": mujoco.mjtJoint.mjJNT_SLIDE,
}
VISUAL, COLLISION = 2, 3  # geom groups; MuJoCo's viewer hides 3 and above
_Type = mujoco.mjtGeom
# Attributes of a geom (lengths in m), and the color (4,) that comes with it, if any.
_Piece = tuple[dict, np.ndarray | None]


def add_single(
    body: mujoco.MjsBody, joint: yourdfpy.Joint, armature: float, frame: np.ndarray
) -> None:
    """Add a joint of a type in `SINGLE` to what it moves, with its limits, damping and friction.

    `armature`: kg m^2, or kg of a slide; `frame`: (4, 4) in the body's, with all joints at 0.
    """
    axis = frame[:3, :3] @ unit(joint.axis)
    added = body.add_joint(name=joint.name, type=SINGLE[joint.type], axis=axis, pos=frame[:3, 3])
    if is_limited(joint):
        added.range = joint_range(joint)
    if joint.limit is not None and 0 < joint.limit.effort < np.inf:
        added.actfrcrange = [-joint.limit.effort, joint.limit.effort]
    if joint.limit is not None and joint.limit.velocity < np.inf:
        # MuJoCo knows no largest speed: it is kept as the joint's user datum.
        added.userdata = [joint.limit.velocity]
    if joint.dynamics is not None:
        added.damping[0] = float(joint.dynamics.damping or 0)
        added.frictionloss = float(joint.dynamics.friction or 0)
    added.armature = armature


def add_several(body: mujoco.MjsBody, joint: yourdfpy.Joint, taken: set[str]) -> None:
    """Add the joints of a `planar` or `floating` one, without limits, which URDF has none for.

    Planar: slides JOINT_x and JOINT_y across the axis, then hinge JOINT_turn about it. The first
    slide is along the joint frame's x where the axis is its z; for another axis both are turned by
    the smallest rotation that takes z there. Floating: slides JOINT_x, JOINT_y and JOINT_z along
    the joint frame's axes, then ball JOINT_ball. (A free joint would have to be at the world.)
    """

    slide = mujoco.mjtJoint.mjJNT_SLIDE
    if joint.type == "planar":
        x, y, z = _frame_along(unit(joint.axis))
        parts = [("x", slide, x), ("y", slide, y), ("turn", mujoco.mjtJoint.mjJNT_HINGE, z)]
    else:
        x, y, z = np.eye(3)
        parts = [("x", slide, x), ("y", slide, y), ("z", slide, z)]
        parts.append(("ball", mujoco.mjtJoint.mjJNT_BALL, z))
    for suffix, kind, axis in parts:
        body.add_joint(name=unique(f"{joint.name}_{suffix}", taken), type=kind, axis=axis)


def _frame_along(axis: np.ndarray) -> np.ndarray:
    """(3, 3), rows x, y and z = `axis` (3,): the standard axes, turned the shortest way."""
    turn, rows = np.zeros(4), np.zeros((3, 3))
    mujoco.mju_quatZ2Vec(turn, axis)
    for row, standard in zip(rows, np.eye(3), strict=True):
        mujoco.mju_rotVecQuat(row, standard, turn)
    return rows


def add_geom_classes(spec: mujoco.MjSpec) -> None:
    """Add the default classes `visual`, `collision`, and within that `foot`."""
    visual = spec.add_default("visual", spec.default)
    visual.geom.contype = visual.geom.conaffinity = 0
    visual.geom.group = VISUAL
    collision = spec.add_default("collision", spec.default)
    collision.geom.group = COLLISION
    collision.geom.friction = [FRICTION, 0.005, 0.0001]
    collision.geom.solref[:] = [CONTACT_TIME, 1.0]
    collision.geom.rgba = [0.9, 0.3, 0.3, 0.5]
    foot = spec.add_default("foot", collision)
    # Sliding friction only: a small hard foot has next to no torsional or rolling friction.
    foot.geom.condim = 3


class Shapes:
    """Adds the geoms of links; holds the names, materials and meshes that are already there.

    `spec` has its scene and default classes. Geoms of the feet of `legs` are named like the foot.
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
        shown = [self._add_visual(body, name, visual, placement) for visual in link.visuals]
        stand_in = link.collisions and not any(shown) and (self.invisible or link.visuals)
        if stand_in:
            self.report.add("assumed", "shown by their collision shapes", name)
        leg = self.legs.get(name)
        for index, collision in enumerate(link.collisions):
            if leg is not None and index in leg.foot.replaced:
                continue
            foot = leg.foot_name if leg is not None and index == leg.foot.shape else None
            pieces = self._pieces(name, collision.geometry, collision=True)
            for shape, _ in pieces:
                frame = placement @ to_matrix(collision.origin)
                geom = self._add(body, "foot" if foot else "collision", shape, frame)
                geom.name = foot or unique(name, self.geom_names)
                if stand_in:
                    twin = self._add(body, "visual", shape, frame)
                    self._paint(twin, link.visuals[0].material if link.visuals else None, None)
        if leg is not None and leg.foot.shape is None:
            sphere = {"type": _Type.mjGEOM_SPHERE, "size": [leg.foot.radius, 0, 0]}
            frame = np.eye(4)
            frame[:3, 3] = leg.foot.center
            self._add(body, "foot", sphere, frame).name = leg.foot_name
            what = f"the feet are spheres of {leg.foot.radius * 1000:.3g} mm"
            self.report.add("assumed", f"{what} {leg.foot.reason}", leg.foot_name)

    def _add_visual(self, body, name: str, visual, placement: np.ndarray) -> bool:
        """Add a visual shape; False if there is nothing of it to show."""
        pieces = self._pieces(name, visual.geometry, collision=False)
        for shape, rgba in pieces:
            geom = self._add(body, "visual", shape, placement @ to_matrix(visual.origin))
            self._paint(geom, visual.material, rgba)
        return bool(pieces)

    def _add(self, body, kind: str, shape: dict, frame: np.ndarray) -> mujoco.MjsGeom:
        pos, quat = pose(frame)
        return body.add_geom(self.spec.find_default(kind), pos=pos, quat=quat, **shape)

    def _pieces(self, name: str, geometry, collision: bool) -> list[_Piece]:
        """The geoms that make up a shape; a mesh may be several."""
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
            return self._mesh_pieces(name, geometry.mesh, collision)
        if not collision and min(np.trim_zeros(size, "b"), default=0) <= 0:
            self.report.add("dropped", "visual shapes of size 0", name)
            return []
        return [({"type": kind, "size": size}, None)]

    def _mesh_pieces(self, name: str, mesh, collision: bool) -> list[_Piece]:
        """The geoms of a mesh; on its first use it is added to the spec with its data inline."""
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
        name = unique(stem, {mesh.name for mesh in self.spec.meshes})
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
        name = unique(material.name, {"floor"} | set(self.materials.values()))
        self.spec.add_material(name=name, rgba=material.color.rgba, specular=0.3, shininess=0.4)
        self.materials[material.name] = name
        self.rgba[material.name] = tuple(material.color.rgba)

    def _paint(self, geom, material, rgba: np.ndarray | None) -> None:
        """Give a geom the URDF's material, or else the color `rgba` that came with its mesh."""
        if material is not None and material.name in self.materials:
            same = material.color is None or tuple(material.color.rgba) == self.rgba[material.name]
            if same:
                geom.material = self.materials[material.name]
                return
        if material is not None and material.color is not None:
            geom.rgba = material.color.rgba
        elif rgba is not None:
            geom.rgba = rgba
        elif material is not None and material.name:
            self.report.add("assumed", "materials that are not defined are gray", material.name)


def unique(name: str, taken: set[str]) -> str:
    """`name`, or with the first number from 2 that makes it new; it joins those `taken`."""
    candidate, count = name, 1
    while candidate in taken:
        count += 1
        candidate = f"{name}_{count}"
    taken.add(candidate)
    return candidate


def pose(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and quaternion wxyz (4,) of a (4, 4) frame."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, frame[:3, :3].ravel())
    return frame[:3, 3], quat
