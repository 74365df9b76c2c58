"""Pictures without a GL library: MuJoCo's ray caster, and colors for what its rays meet.

Geoms look as `mjr_render` shows them, but opaque and unmirrored. Sites, tendons and skins are left
out.
"""

import copy

import mujoco
import numpy as np

from quadwalk.render.shading import Hits, Shader

_FINER = 3  # rays across and down a pixel in which there is an edge
_CREASE = np.cos(np.radians(20.0))  # normals that are further apart make an edge
# m: at least from so far away the rays of a directional light are cast. From 1 km MuJoCo's culling
# of bodies is too coarse: shadows get jagged.
_SUN = 30.0
_TOUCH = 1e-4  # m: a hit so close to the point that a ray is cast at is that point


class RayPainter:
    """A painter of scenes of one model, `width` by `height` pixels."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._size = (width, height)
        self._model = _enlarge_bounds(model)
        self._shader = Shader(model)
        self._groups = mujoco.MjvOption().geomgroup
        mask = self._groups[model.geom_group].astype(bool) & (model.geom_bodyid == 0)
        fields = np.flatnonzero(mask & (model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD))
        self._fields = [_Field(self._model, int(geom)) for geom in fields]

    def paint(self, data: mujoco.MjData, scene: mujoco.MjvScene) -> np.ndarray:
        """Return the picture of a scene made by `mjv_updateScene`, (height, width, 3) uint8."""
        width, height = self._size
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
        color, labels, normals = self._look(data, scene, grid + 0.5)
        rows, columns = np.nonzero(_find_edges(labels, normals))
        if len(rows):
            steps = (np.arange(_FINER) + 0.5) / _FINER
            finer = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
            colors, *_ = self._look(data, scene, grid[rows, columns][:, None] + finer)
            color[rows, columns] = colors.mean(axis=1)
        return np.round(255 * color).astype(np.uint8)

    def _look(
        self, data: mujoco.MjData, scene: mujoco.MjvScene, places: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return colors (a, b, 3) in 0 .. 1, labels (a, b) and normals (a, b, 3) at `places`.

        `places` (a, b, 2) are x and y in pixels from the upper left corner. Labels are integers,
        which differ between geoms and between their lit and shaded parts.
        """
        camera = mujoco.mjv_averageCamera(*scene.camera)
        eye, ray, pixel = _compute_rays(camera, places.reshape(-1, 2), *self._size)
        hits = Hits(eye, ray.astype(np.float32), *self._cast(data, eye, ray))
        lit = {
            index: self._is_lit(data, light, hits)
            for index, light in enumerate(scene.lights[: scene.nlight])
            if light.castshadow
        }
        color = self._shader.compute_colors(data, scene, hits, lit, pixel)
        label = hits.geom.astype(int)
        for reached in lit.values():
            label = 2 * label + reached
        shape = places.shape[:2]
        return color.reshape(*shape, 3), label.reshape(shape), hits.normal.reshape(*shape, 3)

    def _cast(
        self, data: mujoco.MjData, origin: np.ndarray, ray: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what rays (n, 3) from `origin` hit first: geoms, distances and normals.

        Geoms (n,) are indices, -1 for none; distances (n,) are in m; normals (n, 3) point to
        `origin`.
        """
        geom, distance, normal = _cast_rays(self._model, data, origin, ray, self._groups)
        for field in self._fields:
            hit, hit_distance, hit_normal = field.cast(origin, ray)
            nearer = (hit >= 0) & ((geom < 0) | (hit_distance < distance))
            geom[nearer], distance[nearer] = field.geom, hit_distance[nearer]
            normal[nearer] = hit_normal[nearer]
        normal[geom < 0] = 0.0
        normal[np.einsum("ij,ij->i", normal, ray) > 0] *= -1  # the inside of an open mesh
        return geom, distance, normal.astype(np.float32)

    def _is_lit(self, data: mujoco.MjData, light: mujoco.MjvLight, hits: Hits) -> np.ndarray:
        """Return True for each hit that a directional light reaches, (n,) bool."""
        direction = light.dir.astype(float) / np.linalg.norm(light.dir)
        solid = self._model.geom_rbound > 0  # all but planes
        if not solid.any():
            return np.ones(len(hits.geom), bool)
        size, place = self._model.geom_rbound[solid, None], data.geom_xpos[solid]
        low, high = (place - size).min(axis=0), (place + size).max(axis=0)
        center, radius = (low + high) / 2, np.linalg.norm(high - low) / 2
        offset = hits.point - center
        across = np.einsum("ij,ij->i", offset, offset) - (offset @ direction) ** 2
        lit = hits.normal @ light.dir < 0
        behind = np.flatnonzero(lit & (across < radius**2))  # or in front of the solid geoms
        source = center - max(_SUN, 2.0 * radius) * direction
        way = hits.point[behind] - source
        length = np.linalg.norm(way, axis=1)
        _, first, _ = self._cast(data, source, way / length[:, None])
        lit[behind] = first > length - _TOUCH
        return lit


class _Field:
    """A heightfield of a model as a mesh, in which rays find their triangles by a tree.

    MuJoCo's own ray tries every cell that it passes over. So the field is hidden in `model`.
    """

    def __init__(self, model: mujoco.MjModel, geom: int) -> None:
        self.geom = geom
        model.geom_matid[geom], model.geom_rgba[geom, 3] = -1, 0.0
        points, faces = _make_triangles(model, int(model.geom_dataid[geom]))
        spec = mujoco.MjSpec()
        spec.add_mesh(
            name="field", uservert=points.ravel(), userface=faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )  # fmt: skip
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname="field", contype=0, conaffinity=0,
            pos=model.geom_pos[geom], quat=model.geom_quat[geom],
        )  # fmt: skip
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        mujoco.mj_kinematics(self._model, self._data)

    def cast(self, origin: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return what rays (n, 3) from `origin` hit of the field, as `_cast_rays` does."""
        return _cast_rays(self._model, self._data, origin, ray, None)


def _make_triangles(model: mujoco.MjModel, field: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points (k, 3), m, and faces (m, 3) of heightfield number `field`, with its side walls.

    The points are in the field's frame; a face has the indices of three points.
    """
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    first = int(model.hfield_adr[field])
    heights = model.hfield_data[first : first + rows * columns].reshape(rows, columns)
    length, width, height, base = model.hfield_size[field]
    # One row and column more on each side, at the same place but down at the base, are the walls.
    x = np.pad(np.linspace(-length, length, columns), 1, "edge")
    y = np.pad(np.linspace(-width, width, rows), 1, "edge")
    z = np.pad(height * heights, 1, constant_values=-base)
    points = np.stack([*np.meshgrid(x, y), z], axis=-1).reshape(-1, 3)
    node = np.arange(z.size).reshape(z.shape)
    low, along, up, far = node[:-1, :-1], node[:-1, 1:], node[1:, :-1], node[1:, 1:]
    faces = np.stack([low, along, far, low, far, up], axis=-1).reshape(-1, 3)
    a, b, c = np.moveaxis(points[faces], 1, 0)
    return points, faces[np.any(np.cross(b - a, c - a) != 0, axis=1)]


def _cast_rays(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    origin: np.ndarray,
    ray: np.ndarray,
    groups: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what rays (n, 3) from `origin` hit first: geoms, distances and normals.

    Geoms (n,) are indices, -1 for none; distances (n,) are in m; normals are (n, 3).
    """
    n = len(ray)
    geom, distance, normal = np.empty(n, np.int32), np.empty(n), np.empty((n, 3))
    mujoco.mj_multiRay(
        model, data, origin, ray.ravel(), groups, True, -1,
        geom, distance, normal.reshape(-1), n, mujoco.mjMAXVAL,
    )  # fmt: skip
    return geom, distance, normal


def _enlarge_bounds(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of `model` whose bodies have bounding spheres around all of their geoms.

    `mj_multiRay` leaves out a body whose bounding sphere a ray misses. MuJoCo's compiler bounds
    only the geoms that collide, so that others would be overlooked.
    """
    model = copy.copy(model)
    offset = np.linalg.norm(model.geom_pos - model.body_ipos[model.geom_bodyid], axis=1)
    size = np.where(model.geom_rbound > 0, model.geom_rbound, mujoco.mjMAXVAL)  # 0: a plane
    reach = np.zeros(model.nbody)
    np.maximum.at(reach, model.geom_bodyid, offset + size)
    bounded = model.body_bvhadr >= 0
    model.bvh_aabb[model.body_bvhadr[bounded], :3] = 0.0
    model.bvh_aabb[model.body_bvhadr[bounded], 3:] = reach[bounded, None] / np.sqrt(3.0)
    return model


def _compute_rays(
    camera: mujoco.MjvGLCamera, places: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the eye (3,), m, the directions (n, 3) of rays through `places`, and a pixel's width.

    `places` (n, 2) are x and y in pixels from the upper left corner. Directions are unit vectors in
    the world frame. The width is in m at 1 m ahead of the eye.
    """
    forward, up = camera.forward.astype(float), camera.up.astype(float)
    pixel = (camera.frustum_top - camera.frustum_bottom) / camera.frustum_near / height
    across = pixel * (places[:, 0] - width / 2) + camera.frustum_center / camera.frustum_near
    along = camera.frustum_top / camera.frustum_near - pixel * places[:, 1]
    ray = forward + np.outer(across, np.cross(forward, up)) + np.outer(along, up)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    return camera.pos.astype(float), ray, pixel


def _find_edges(labels: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return True for the pixels on both sides of each edge, (height, width) bool.

    An edge is where `labels` (height, width) differ or `normals` (height, width, 3) bend.
    """
    edges = np.zeros(labels.shape, bool)
    for one, other in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        crease = np.einsum("ijk,ijk->ij", normals[one], normals[other]) < _CREASE
        border = (labels[one] != labels[other]) | (crease & (labels[one] >= 0))
        edges[one] |= border
        edges[other] |= border
    return edges
