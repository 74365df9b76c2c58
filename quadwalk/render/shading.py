"""Colors of what rays meet: MuJoCo's materials, textures, lights, sky and haze.

The formulas are those of OpenGL's fixed pipeline as MuJoCo's renderer uses it (its
`src/render/classic`), so that a picture looks the same drawn with and without a GL library.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from PIL import Image

_RGB = mujoco.mjtTextureRole.mjTEXROLE_RGB
# On OpenGL's faces of a cube, toward +x, -x, +y, -y, +z, -z: the axis and the sense in which their
# columns run, and their rows.
_ACROSS = np.array([(2, -1), (2, 1), (0, 1), (0, 1), (0, 1), (0, -1)])
_DOWN = np.array([(1, -1), (1, -1), (2, 1), (2, -1), (1, -1), (1, -1)])


@dataclass(frozen=True)
class Hits:
    """The first hits of n rays from the eye, in world axes."""

    eye: np.ndarray  # (3,) m
    ray: np.ndarray  # (n, 3) unit vectors from the eye
    geom: np.ndarray  # (n,) ids; -1 for the sky
    distance: np.ndarray  # (n,) m from the eye
    normal: np.ndarray  # (n, 3) unit vectors, out of the surfaces toward the eye

    @property
    def point(self) -> np.ndarray:
        """Points (n, 3), m, that the rays hit, in the world frame."""
        return self.eye + self.distance[:, None] * self.ray


class Texture:
    """A picture (height, width, 3), uint8, and its mipmaps, each half as large as the last."""

    def __init__(self, pixels: np.ndarray) -> None:
        levels = [Image.fromarray(pixels)]
        while max(levels[-1].size) > 1:
            levels.append(levels[-1].reduce(2))
        self._sizes = np.array([level.size for level in levels], np.int32)
        self._starts = np.append(0, np.cumsum(self._sizes.prod(axis=1))).astype(np.int32)
        texels = [np.asarray(level, np.float32).reshape(-1, 3) / 255 for level in levels]
        self._texels = np.concatenate(texels)

    def sample(self, at: np.ndarray, width: np.ndarray) -> np.ndarray:
        """Return colors (n, 3) in 0 .. 1 at `at` (n, 2), x and y from 0 to 1 and then repeated.

        `width` (n,), in the same unit, is the size of the pixel that each color fills.
        """
        exact = np.log2(np.maximum(width * self._sizes[0].max(), 1.0))
        level = np.minimum(exact.astype(np.int32), len(self._sizes) - 2)
        share = np.clip(exact - level, 0.0, 1.0)[:, None].astype(np.float32)
        at = (at % 1.0).astype(np.float32)
        return (1 - share) * self._blend(at, level) + share * self._blend(at, level + 1)

    def _blend(self, at: np.ndarray, level: np.ndarray) -> np.ndarray:
        """Return the colors (n, 3) at `at` (n, 2), 0 to 1, in mipmap `level` (n,), 0 the full size.

        They are bilinear between the four nearest texels.
        """
        size = self._sizes[level]
        place = at * size - np.float32(0.5)
        first = np.floor(place).astype(np.int32)
        right, down = (place - first).T[..., None]
        (left, top), (width, _) = (first % size).T, size.T
        start = self._starts[level]
        beside, below = np.where(first + 1 == size, 0, first + 1).T
        rows = [start + row * width for row in (top, below)]
        upper, lower = (
            (1 - right) * self._texels[row + left] + right * self._texels[row + beside]
            for row in rows
        )
        return (1 - down) * upper + down * lower


class Shader:
    """Colors of one model's hits; the pictures of its textures are prepared once."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        with_material = np.flatnonzero(model.geom_matid >= 0)
        self._texture_of = np.full(model.ngeom, -1)
        materials = model.geom_matid[with_material]
        self._texture_of[with_material] = model.mat_texid[materials, _RGB]
        self._textures = {
            int(index): Texture(_read_pixels(model, index))
            for index in np.unique(self._texture_of[self._texture_of >= 0])
            if model.tex_type[index] == mujoco.mjtTexture.mjTEXTURE_2D
        }
        skies = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
        self._sky = _read_pixels(model, skies[0]) if len(skies) else np.zeros((6, 1, 3))

    def compute_colors(
        self,
        data: mujoco.MjData,
        scene: mujoco.MjvScene,
        hits: Hits,
        lit: dict[int, np.ndarray],
        pixel: float,
    ) -> np.ndarray:
        """Return colors (n, 3) in 0 .. 1 of `hits`, by directional lights alone.

        `lit` maps the index of a light that casts shadows to the hits that it reaches, (n,) bool.
        `pixel` is a pixel's width, m at 1 m from the eye.
        """
        color = self._compute_lighting(scene, hits, lit)
        for index, texture in self._textures.items():
            on = np.flatnonzero((self._texture_of[hits.geom] == index) & (hits.geom >= 0))
            color[on] *= texture.sample(*self._find_texture_places(data, hits, on, pixel))
        sky = np.flatnonzero(hits.geom < 0)
        color[sky] = self._compute_sky(hits.ray[sky])
        self._add_haze(data, scene, hits, color)
        return np.clip(color, 0.0, 1.0)

    def _compute_lighting(
        self, scene: mujoco.MjvScene, hits: Hits, lit: dict[int, np.ndarray]
    ) -> np.ndarray:
        """Return the colors (n, 3) of `hits` by materials and lights, without textures.

        `lit` maps the index of a light that casts shadows to the hits that it reaches, (n,) bool.
        """
        # One more than there are geoms, for index -1.
        rgb, shine = np.zeros((2, self._model.ngeom + 1, 3), np.float32)
        for geom in scene.geoms[: scene.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                rgb[geom.objid] = geom.rgba[:3]
                shine[geom.objid] = geom.emission, geom.specular, 128 * geom.shininess
        emission, specular, exponent = shine[hits.geom].T
        amount, gloss = np.tile(emission[:, None], 3), np.zeros((len(hits.geom), 3), np.float32)
        for index, light in enumerate(scene.lights[: scene.nlight]):
            if light.type != mujoco.mjtLightType.mjLIGHT_DIRECTIONAL:
                continue
            slant = np.maximum(-hits.normal @ light.dir, 0.0)
            halfway = -light.dir - hits.ray
            glance = np.einsum("ij,ij->i", hits.normal, halfway)
            glance /= np.sqrt(np.maximum(np.einsum("ij,ij->i", halfway, halfway), 1e-9))
            glance = np.maximum(glance, 0.0) ** exponent
            reaches = lit.get(index, np.ones(1))[:, None]
            amount += reaches * (light.ambient + slant[:, None] * light.diffuse)
            gloss += reaches * ((slant > 0) * specular * glance)[:, None] * light.specular
        return rgb[hits.geom] * amount + gloss

    def _find_texture_places(
        self, data: mujoco.MjData, hits: Hits, on: np.ndarray, pixel: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the places (n, 2) in their textures of the hits number `on`, and pixels' widths.

        Both are in units of a texture's size.
        """
        model, geom = self._model, hits.geom[on]
        offset = hits.point[on] - data.geom_xpos[geom]
        local = np.einsum("ij,ijk->ik", offset, data.geom_xmat[geom].reshape(-1, 3, 3)[..., :2])
        size, material = model.geom_size[geom, :2], model.geom_matid[geom]
        spread = np.where(model.mat_texuniform[material, None] | (size <= 0), 1.0, size)
        scale = 0.5 * model.mat_texrepeat[material] / spread
        # Seen at a slant a pixel is wide along the line of sight alone: the mean of both widths.
        slant = np.abs(np.einsum("ij,ij->i", hits.ray[on], hits.normal[on]))
        width = pixel * hits.distance[on] / np.sqrt(np.maximum(slant, 1e-9))
        return local * scale * (1, -1) - 0.5, width * scale.max(axis=1)

    def _compute_sky(self, ray: np.ndarray) -> np.ndarray:
        """Return colors (n, 3) of the sky in the directions `ray` (n, 3)."""
        # Its y points up.
        cube, rows = np.stack([ray[:, 0], ray[:, 2], -ray[:, 1]], axis=1), np.arange(len(ray))
        axis = np.abs(cube).argmax(axis=1)
        depth = cube[rows, axis]
        face = 2 * axis + (depth < 0)
        side = self._sky.shape[1]

        def find_texel(table: np.ndarray) -> np.ndarray:
            along, sense = table[face].T
            place = (sense * cube[rows, along] / np.abs(depth) + 1) / 2
            return np.clip((side * place).astype(int), 0, side - 1)

        return self._sky[side * face + find_texel(_DOWN), find_texel(_ACROSS)] / 255

    def _add_haze(
        self, data: mujoco.MjData, scene: mujoco.MjvScene, hits: Hits, color: np.ndarray
    ) -> None:
        """Change the `color` (n, 3) of hits on an endless floor, so that it has a horizon.

        With distance the floor's color turns into that of the haze. Farther away the haze turns
        into the sky. So MuJoCo's renderer looks, which draws the haze as a cone around the eye.
        """
        model = self._model
        endless = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & ~model.geom_size[:, :2].any(1)
        for floor in np.flatnonzero(endless)[:1]:
            normal = data.geom_xmat[floor].reshape(3, 3)[:, 2]
            on = np.flatnonzero(hits.geom == floor)
            reach = 0.7 * scene.camera[0].frustum_far
            span = model.vis.map.haze
            along = hits.ray[on] - np.outer(hits.ray[on] @ normal, normal)
            away = hits.distance[on] * np.linalg.norm(along, axis=1) / reach
            height = 1 - 1 / np.maximum(away + span, 1.0)  # on the cone, 1 is that of the eye
            peak = max(span / (1 + span), mujoco.mjMINVAL)
            share = np.where(height < peak, height / peak, (1 - height) / (1 - peak))[:, None]
            beyond = height >= peak
            color[on[beyond]] = self._compute_sky(hits.ray[on[beyond]])
            color[on] = (1 - share) * color[on] + share * model.vis.rgba.haze[:3]


def _read_pixels(model: mujoco.MjModel, texture: int) -> np.ndarray:
    """Return the picture of a texture (height, width, 3) uint8; a sky's six faces are stacked."""
    height, width = model.tex_height[texture], model.tex_width[texture]
    channels, start = model.tex_nchannel[texture], model.tex_adr[texture]
    flat = model.tex_data[start : start + height * width * channels]
    return flat.reshape(height, width, channels)[..., [0, 1, 2] if channels > 2 else [0, 0, 0]]
