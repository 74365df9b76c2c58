"""Pictures without a GL library: MuJoCo's ray caster, and colors for what its rays meet.

It shows what `mjr_render` shows of geoms, but opaque and unmirrored, and no sites, tendons, skins.
"""

import copy

import mujoco
import numpy as np

from quadwalk.render.shading import Hits, Shader

_FINER = 3  # rays across and down a pixel in which there is an edge
_CREASE = np.cos(np.radians(20.0))  # normals that are further apart make an edge
_SUN = 1e3  # m: from so far away the rays of a directional light are cast
_TOUCH = 1e-4  # m: what they meet so close to the point they are cast at is that point


class RayPainter:
    """Paints scenes of one model, `width` by `height` pixels."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._size = (width, height)
        self._model = _with_whole_bounds(model)
        self._shader = Shader(model)
        self._shown = mujoco.MjvOption().geomgroup
        self._fields = [_Field(self._model, geom) for geom in _fields(model, self._shown)]

    def paint(self, data: mujoco.MjData, scene: mujoco.MjvScene) -> np.ndarray:
        """(height, width, 3) uint8 of a scene that `mjv_updateScene` has made from `data`."""
        width, height = self._size
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
        color, labels, normals = self._look(data, scene, grid + 0.5)
        rows, columns = np.nonzero(_edges(labels, normals))
        if len(rows):
            steps = (np.arange(_FINER) + 0.5) / _FINER
            finer = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
            colors, *_ = self._look(data, scene, grid[rows, columns][:, None] + finer)
            color[rows, columns] = colors.mean(axis=1)
        return np.round(255 * color).astype(np.uint8)

    def _look(
        self, data: mujoco.MjData, scene: mujoco.MjvScene, places: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What is at `places` (a, b, 2), pixels from the upper left corner: colors (a, b, 3) in
        0 .. 1, labels (a, b) that tell geoms and their shadows apart, normals (a, b, 3).
        """
        camera = mujoco.mjv_averageCamera(*scene.camera)
        eye, ray, pixel = _rays(camera, places.reshape(-1, 2), *self._size)
        hits = Hits(eye, ray.astype(np.float32), *self._cast(data, eye, ray))
        lit = {
            index: self._reached(data, light, hits)
            for index, light in enumerate(scene.lights[: scene.nlight])
            if light.castshadow
        }
        color = self._shader.color(data, scene, hits, lit, pixel)
        label = hits.geom.astype(int)
        for reached in lit.values():
            label = 2 * label + reached
        shape = places.shape[:2]
        return color.reshape(*shape, 3), label.reshape(shape), hits.normal.reshape(*shape, 3)

    def _cast(
        self, data: mujoco.MjData, origin: np.ndarray, ray: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Geom (n,), -1 for none, its distance (n,) m, and its normal (n, 3) toward `origin`."""
        geom, distance, normal = _met(self._model, data, origin, ray, self._shown)
        for field in self._fields:
            one, far, upright = field.cast(origin, ray)
            nearer = (one >= 0) & ((geom < 0) | (far < distance))
            geom[nearer], distance[nearer] = field.geom, far[nearer]
            normal[nearer] = upright[nearer]
        normal[geom < 0] = 0.0
        normal[np.einsum("ij,ij->i", normal, ray) > 0] *= -1  # the inside of an open mesh
        return geom, distance, normal.astype(np.float32)

    def _reached(self, data: mujoco.MjData, light: mujoco.MjvLight, hits: Hits) -> np.ndarray:
        """(n,) bool: whether nothing is between a directional light and each hit."""
        direction = light.dir.astype(float) / np.linalg.norm(light.dir)
        solid = self._model.geom_rbound > 0  # all but planes
        if not solid.any():
            return np.ones(len(hits.geom), bool)
        size, place = self._model.geom_rbound[solid, None], data.geom_xpos[solid]
        low, high = (place - size).min(axis=0), (place + size).max(axis=0)
        center, radius = (low + high) / 2, np.linalg.norm(high - low) / 2
        offset = hits.point - center
        across = np.einsum("ij,ij->i", offset, offset) - (offset @ direction) ** 2
        reached = hits.normal @ light.dir < 0
        asked = np.flatnonzero(reached & (across < radius**2))
        source = center - _SUN * direction
        way = hits.point[asked] - source
        length = np.linalg.norm(way, axis=1)
        _, first, _ = self._cast(data, source, way / length[:, None])
        reached[asked] = first > length - _TOUCH
        return reached


class _Field:
    """A heightfield of a model as a mesh: a ray finds its triangle through the mesh's tree.

    MuJoCo's own ray tries every cell that it passes over. The field is hidden in `model`.
    """

    def __init__(self, model: mujoco.MjModel, geom: int) -> None:
        self.geom = geom
        model.geom_matid[geom], model.geom_rgba[geom, 3] = -1, 0.0
        points, faces = _triangles(model, int(model.geom_dataid[geom]))
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
        return _met(self._model, self._data, origin, ray, None)


def _fields(model: mujoco.MjModel, groups: np.ndarray) -> list[int]:
    """The geoms of the world that are heightfields, of the groups that are shown."""
    fields = model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD
    shown = groups[model.geom_group].astype(bool)
    return np.flatnonzero(fields & shown & (model.geom_bodyid == 0)).tolist()


def _triangles(model: mujoco.MjModel, field: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3), m, and faces (m, 3) of a heightfield, with its walls."""
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
    one, two, three = np.moveaxis(points[faces], 1, 0)
    return points, faces[np.any(np.cross(two - one, three - one) != 0, axis=1)]


def _met(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    origin: np.ndarray,
    ray: np.ndarray,
    groups: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What MuJoCo's rays (n, 3) meet: geom (n,), -1 for none, distance (n,) m, normal (n, 3)."""
    n = len(ray)
    geom, distance, normal = np.empty(n, np.int32), np.empty(n), np.empty((n, 3))
    mujoco.mj_multiRay(
        model, data, origin, ray.ravel(), groups, True, -1,
        geom, distance, normal.reshape(-1), n, mujoco.mjMAXVAL,
    )  # fmt: skip
    return geom, distance, normal


def _with_whole_bounds(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy whose bodies are bounded by spheres around all of their geoms.

    `mj_multiRay` leaves out a body whose bounding sphere a ray misses, and the compiler makes that
    for the geoms that collide, so that others are overlooked.
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


def _rays(
    camera: mujoco.MjvGLCamera, places: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Eye (3,) m, unit vectors (n, 3) to `places` (n, 2), and a pixel's width, m at 1 m ahead."""
    forward, up = camera.forward.astype(float), camera.up.astype(float)
    pixel = (camera.frustum_top - camera.frustum_bottom) / camera.frustum_near / height
    across = pixel * (places[:, 0] - width / 2) + camera.frustum_center / camera.frustum_near
    along = camera.frustum_top / camera.frustum_near - pixel * places[:, 1]
    ray = forward + np.outer(across, np.cross(forward, up)) + np.outer(along, up)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    return camera.pos.astype(float), ray, pixel


def _edges(labels: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(height, width) bool: the pixels on both sides of each edge."""
    edges = np.zeros(labels.shape, bool)
    for axis in (0, 1):
        one, other = (
            tuple(part if k == axis else slice(None) for k in (0, 1))
            for part in (slice(None, -1), slice(1, None))
        )
        crease = np.einsum("ijk,ijk->ij", normals[one], normals[other]) < _CREASE
        found = (labels[one] != labels[other]) | (crease & (labels[one] >= 0))
        edges[one] |= found
        edges[other] |= found
    return edges
