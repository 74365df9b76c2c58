"""Pictures of models, drawn with and without a GL library, against those of Mesa's OpenGL."""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from quadwalk.render import canvas as canvas_module
from quadwalk.render.canvas import Camera, Canvas, render_home
from quadwalk.render.opengl import find_working_library
from quadwalk.render.raycast import RayPainter
from quadwalk.robot.scene import add_sun, make_spec
from quadwalk.terrain.heightfield import Heightfield, lay

# Scenes drawn once by Mesa's software OpenGL, one below the other:
# `MUJOCO_GL=egl python tests/render/test_canvas.py` draws them anew.
REFERENCE = Path(__file__).with_name("reference.png")
LIBRARIES = [None, *({find_working_library()} - {None})]
WIDTH, HEIGHT = 240, 150
VIEW = Camera((0.1, 0.05, 0.2), distance=1.6, azimuth=130.0, elevation=-20.0)
RED, GREEN, BLUE = (0.8, 0.1, 0.1, 1.0), (0.1, 0.7, 0.2, 1.0), (0.2, 0.3, 0.9, 1.0)
Type = mujoco.mjtGeom
BALL = {"type": Type.mjGEOM_SPHERE, "size": [0.15] * 3, "pos": [0.3, 0.5, 0.2], "rgba": RED}


@pytest.fixture(params=LIBRARIES, ids=lambda library: library or "rays")
def library(request, monkeypatch):
    """Draw with rays, and then with the GL library that works on this machine, if there is one."""
    monkeypatch.setattr(canvas_module, "find_working_library", lambda: request.param)
    return request.param


def make_scene(*shapes: dict, haze: float | None = None) -> mujoco.MjModel:
    """Return a model of shapes above the floor that robots stand on."""
    spec = make_spec()
    spec.stat.extent = 1.0
    add_sun(spec.worldbody)
    for shape in shapes:
        if "meshname" in shape:
            corners = np.array(np.meshgrid(*[(-0.1, 0.1)] * 3)).reshape(3, -1).T
            spec.add_mesh(name="cube", uservert=corners.ravel())
        spec.worldbody.add_geom(**shape)
    model = spec.compile()
    if haze is not None:
        model.vis.map.haze = haze
        model.vis.rgba.haze[:3] = RED[:3]
    return model


def make_shapes() -> mujoco.MjModel:
    """Return a scene with every kind of shape."""
    rotation = {"quat": [0.9, 0.2, 0.3, 0.1]}
    return make_scene(
        {"type": Type.mjGEOM_BOX, "size": [0.1, 0.2, 0.05], "pos": [0, 0, 0.25], "rgba": RED},
        {"type": Type.mjGEOM_SPHERE, "size": [0.08] * 3, "pos": [0.4, 0, 0.08], "rgba": BLUE},
        {"type": Type.mjGEOM_CYLINDER, "size": [0.05, 0.1, 0], "pos": [0, 0.4, 0.3], "rgba": GREEN,
         **rotation},
        {"type": Type.mjGEOM_CAPSULE, "size": [0.04, 0.1, 0], "pos": [-0.3, -0.1, 0.3],
         "rgba": RED, **rotation},
        {"type": Type.mjGEOM_ELLIPSOID, "size": [0.1, 0.05, 0.07], "pos": [0.1, -0.4, 0.2],
         "rgba": GREEN},
        {"type": Type.mjGEOM_MESH, "meshname": "cube", "pos": [-0.4, 0.5, 0.2], "rgba": BLUE,
         **rotation},
    )  # fmt: skip


SCENES = {
    "every shape": (make_shapes, VIEW),
    "a floor in haze": (lambda: make_scene(haze=0.5), Camera((0, 0, 0.3), 1.5, 30.0, -12.0)),
    "a clear horizon": (lambda: make_scene(haze=1e-3), Camera((0, 0, 0.3), 1.5, 30.0, -12.0)),
    "a shadow from above": (lambda: make_scene(BALL), Camera((0, 0, 0), 2.0, 90.0, -89.0)),
}


def draw(model: mujoco.MjModel, camera: Camera = VIEW, qpos=()) -> np.ndarray:
    return Canvas(model, WIDTH, HEIGHT).draw(np.array(qpos), camera)


def is_red(picture: np.ndarray) -> np.ndarray:
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return (red > 2 * green) & (red > 2 * blue)


@pytest.mark.parametrize("name", SCENES)
def test_all_libraries_and_rays_draw_the_same_picture(library, name):
    make_model, camera = SCENES[name]
    picture = draw(make_model(), camera).astype(int)
    first = HEIGHT * list(SCENES).index(name)
    reference = np.asarray(Image.open(REFERENCE))[first : first + HEIGHT].astype(int)
    difference = np.abs(picture - reference)
    assert difference.mean() < 2.5
    assert (difference.max(axis=-1) > 24).mean() < 0.03  # along edges, which OpenGL draws in steps
    for channel in range(3):
        one, other = (np.argmax(p, -1) == channel for p in (picture, reference))
        one &= np.ptp(picture, axis=-1) > 60
        other &= np.ptp(reference, axis=-1) > 60
        assert (one & other).sum() >= 0.9 * (one | other).sum()


def test_a_sphere_is_where_projection_puts_it(library):
    azimuth, elevation = np.radians([VIEW.azimuth, VIEW.elevation])
    cos, sin = np.cos(elevation), np.sin(elevation)
    ahead = np.array([cos * np.cos(azimuth), cos * np.sin(azimuth), sin])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    half = np.tan(np.radians(45.0) / 2)  # MuJoCo's default field of view
    y, x = np.mgrid[HEIGHT - 1 : -HEIGHT : -2, 1 - WIDTH : WIDTH : 2] / HEIGHT * half
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ [right, np.cross(right, ahead), ahead]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    center = BALL["pos"] - (VIEW.lookat - VIEW.distance * ahead)
    expected = rays @ center > np.sqrt(center @ center - BALL["size"][0] ** 2)
    disk = is_red(draw(make_scene(BALL)))
    assert expected.sum() > 300
    # Edges are half covered.
    assert (disk & expected).sum() > 0.95 * (disk | expected).sum()


def test_an_empty_floor_has_no_specks_of_its_own_shadow(library):
    model = make_scene()
    model.stat.extent = 0.86  # of AlienGo's model
    canvas = Canvas(model, WIDTH, HEIGHT)
    for azimuth in range(0, 360, 90):
        for elevation in (-14.0, -30.0):
            view = Camera((0.1, 0.05, 0.3), 1.45, azimuth, elevation)
            light = canvas.draw(np.zeros(0), view).astype(int).sum(axis=-1)
            inner = light[1:-1, 1:-1]
            around = [light[:-2, 1:-1], light[2:, 1:-1], light[1:-1, :-2], light[1:-1, 2:]]
            assert np.max(np.min(around, axis=0) - inner) < 60


def test_groups_that_a_viewer_hides_are_not_drawn(library):
    hidden = draw(make_scene({**BALL, "group": 3}))
    assert not is_red(hidden).any()
    np.testing.assert_array_equal(hidden, draw(make_scene()))  # and they throw no shadow


def test_a_shape_that_does_not_collide_is_seen_beyond_those_that_do(library):
    """Check a shape that MuJoCo's ray caster alone overlooks."""
    spec = make_spec()
    body = spec.worldbody.add_body(pos=[-0.2, 0, 0.2])
    body.add_geom(type=Type.mjGEOM_SPHERE, size=[0.02] * 3, rgba=BLUE)
    visual = {"pos": [0.4, 0, 0], "rgba": RED, "contype": 0, "conaffinity": 0}
    body.add_geom(type=Type.mjGEOM_SPHERE, size=[0.1] * 3, **visual)
    assert is_red(draw(spec.compile())).sum() > 100


def test_rays_meet_a_field_where_those_of_mujoco_do():
    rng = np.random.default_rng(0)
    spec = make_spec()
    lay(spec, Heightfield(rng.uniform(-0.2, 0.3, (9, 12)).astype(np.float32), 0.1, (-0.3, 0.2)))
    spec.worldbody.add_geom(type=Type.mjGEOM_SPHERE, size=[0.2, 0, 0], pos=[0.2, 0.6, 0.4])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    eye = np.array([1.5, -0.9, 0.8])  # from outside, so that walls are seen too
    rays = np.array([0.25, 0.6, 0.0]) - eye + rng.normal(0, 0.5, (2000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    geoms, distances, normals = RayPainter(model, WIDTH, HEIGHT)._cast(data, eye, rays)
    assert all(np.sum(geoms == geom) > 50 for geom in (-1, 0, 1))
    for ray, hit, hit_distance, hit_normal in zip(rays, geoms, distances, normals, strict=True):
        geom, normal = np.zeros((1, 1), np.int32), np.zeros((3, 1))
        distance = mujoco.mj_ray(model, data, eye, ray, None, True, -1, geom, normal)
        assert hit == geom[0, 0]
        if hit >= 0:
            assert hit_distance == pytest.approx(distance, abs=1e-5)
            np.testing.assert_allclose(hit_normal, normal[:, 0], atol=1e-4)


def test_far_from_the_origin_it_looks_the_same(library):
    spec = make_spec()
    body = spec.worldbody.add_body()
    body.add_freejoint()
    add_sun(body)
    body.add_geom(type=Type.mjGEOM_BOX, size=[0.2, 0.1, 0.05], rgba=GREEN)
    model, pictures = spec.compile(), []
    for meters in (0, 307):  # the floor's pattern repeats every meter
        camera = Camera((meters, -meters, 0.2), 1.6, 130.0, -20.0)
        pictures.append(draw(model, camera, [meters, -meters, 0.3, 1, 0, 0, 0]).astype(int))
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.3


def test_the_same_pose_gives_the_same_bytes(library):
    one, other = (Canvas(make_shapes(), 64, 40) for _ in range(2))
    first = one.draw(np.zeros(0), VIEW)
    assert (first.shape, first.dtype) == ((40, 64, 3), np.uint8)
    other.draw(np.zeros(0), Camera((1, 1, 1), 2.0, 10.0, -40.0))
    for canvas in (other, one):
        np.testing.assert_array_equal(first, canvas.draw(np.zeros(0), VIEW))


def test_a_model_is_drawn_without_materials_lights_and_floor_too(library):
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=Type.mjGEOM_SPHERE, size=[0.2] * 3, rgba=RED)
    picture = draw(spec.compile())
    assert is_red(picture).any()
    np.testing.assert_array_equal(picture[0, 0], 0)


def test_home_shows_the_whole_robot_and_changes_nothing_of_its_model(library, quadruped):
    model = quadruped.make_full_model()
    arrays = ("geom_rgba", "mat_reflectance", "bvh_aabb")
    before = [getattr(model, name).copy() for name in arrays]
    picture = render_home(model, 300, 200)
    for name, array in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(getattr(model, name), array)
    orange = (picture[..., 0] > 180) & (picture[..., 2] < 70)
    rows, columns = np.nonzero(orange)
    assert 0.01 < orange.mean() < 0.2
    assert (rows.min() > 20) & (rows.max() < 180) & (columns.min() > 40) & (columns.max() < 260)


if __name__ == "__main__":
    if find_working_library() is None:
        sys.exit("no GL library")
    pictures = [draw(make_model(), camera) for make_model, camera in SCENES.values()]
    Image.fromarray(np.concatenate(pictures)).save(REFERENCE, optimize=True)
