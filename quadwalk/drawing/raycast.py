"""Pictures without a GL library: MuJoCo's ray caster, and colors for what its rays meet.

It shows what `mjr_render` shows of geoms, but opaque and unmirrored, and no sites, tendons, skins.
"""

import copy

import mujoco
import numpy as np

from quadwalk.drawing.shading import Hits, Shader

_FINER = 3  # rays across and down a pixel in which there is an edge
_CREASE = np.cos(np.radians(20.0))  # normals that are further apart make an edge
_SUN = 1e3  # m: from so far away the rays of a directional light are cast
_TOUCH = 1e-4  # m: what they meet so close to the point they are cast at is that point


class RayPainter:
    """Paints scenes of one model, `width` by `height` pixels."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._model, self._size = _with_whole_bounds(model), (width, height)
        self._shader = Shader(model)
        self._shown = mujoco.MjvOption().geomgroup

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
        n = len(ray)
        geom, distance, normal = np.empty(n, np.int32), np.empty(n), np.empty((n, 3))
        mujoco.mj_multiRay(
            self._model, data, origin, ray.ravel(), self._shown, True, -1,
            geom, distance, normal.reshape(-1), n, mujoco.mjMAXVAL,
        )  # fmt: skip
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
