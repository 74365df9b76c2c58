"""What is drawn, with and without a GL library, against projection and lighting worked out here."""

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
from quadwalk.robot.scene import add_scene, add_sun
from quadwalk.terrain.heightfield import Heightfield, lay

# A scene with every kind of shape, drawn once by Mesa's software OpenGL:
# `MUJOCO_GL=egl python tests/render/test_canvas.py` draws it anew.
REFERENCE = Path(__file__).with_name("reference.png")
LIBRARIES = [None, *({find_working_library()} - {None})]
WIDTH, HEIGHT = 240, 150
FOVY = np.radians(45.0)  # MuJoCo's default
VIEW = Camera((0.1, 0.05, 0.2), distance=1.6, azimuth=130.0, elevation=-20.0)
RED, GREEN, BLUE = (0.8, 0.1, 0.1, 1.0), (0.1, 0.7, 0.2, 1.0), (0.2, 0.3, 0.9, 1.0)
_Type = mujoco.mjtGeom


@pytest.fixture(params=LIBRARIES, ids=lambda library: library or "rays")
def library(request, monkeypatch):
    """Draws with rays, and then with the GL library that works here, if there is one."""
    monkeypatch.setattr(canvas_module, "find_working_library", lambda: request.param)
    return request.param


def scene(*shapes: dict, sun: bool = True, matt: bool = True) -> mujoco.MjModel:
    """Shapes above the floor that robots stand on, without gloss if `matt`."""
    spec = mujoco.MjSpec()
    spec.stat.extent = 1.0
    add_scene(spec)
    if sun:
        add_sun(spec.worldbody)
    for light in (spec.visual.headlight, *spec.lights):
        if matt:
            light.specular = [0.0, 0.0, 0.0]
    for shape in shapes:
        if "meshname" in shape and not spec.meshes:
            corners = np.array(np.meshgrid(*[(-0.1, 0.1)] * 3)).reshape(3, -1).T
            spec.add_mesh(name="cube", uservert=corners.ravel())
        spec.worldbody.add_geom(**shape)
    return spec.compile()


def draw(model: mujoco.MjModel, camera: Camera = VIEW, qpos=()) -> np.ndarray:
    return Canvas(model, WIDTH, HEIGHT).draw(np.array(qpos), camera)


def view_axes(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The eye (3,), and as rows its right, its up and its line of sight."""
    azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
    cos, sin = np.cos(elevation), np.sin(elevation)
    ahead = np.array([cos * np.cos(azimuth), cos * np.sin(azimuth), sin])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    axes = np.stack([right, np.cross(right, ahead), ahead])
    return camera.lookat - camera.distance * ahead, axes


def pixel_of(point: np.ndarray, camera: Camera = VIEW) -> tuple[int, int]:
    """Row and column that a point (3,) is seen in."""
    eye, axes = view_axes(camera)
    x, y, depth = axes @ (point - eye)
    scale = HEIGHT / 2 / np.tan(FOVY / 2) / depth
    return int(HEIGHT / 2 - scale * y), int(WIDTH / 2 + scale * x)


def test_an_empty_floor_has_no_specks_of_its_own_shadow(library):
    model = scene()
    model.stat.extent = 0.86  # of AlienGo's model
    canvas = Canvas(model, 480, 300)
    for azimuth in range(0, 360, 45):
        for elevation in (-14.0, -30.0):
            view = Camera((0.1, 0.05, 0.3), 1.45, azimuth, elevation)
            light = canvas.draw(np.zeros(0), view).astype(int).sum(axis=-1)
            inner = light[1:-1, 1:-1]
            around = [light[:-2, 1:-1], light[2:, 1:-1], light[1:-1, :-2], light[1:-1, 2:]]
            assert np.max(np.min(around, axis=0) - inner) < 60


def reddish(picture: np.ndarray) -> np.ndarray:
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return (red > 2 * green) & (red > 2 * blue)


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    return (one & other).sum() / (one | other).sum()


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.3), (0.3, 0.5, 0.2), (-0.5, -0.1, 0.4)])
def test_a_sphere_is_where_projection_puts_it(library, place):
    radius = 0.15
    model = scene({"type": _Type.mjGEOM_SPHERE, "size": [radius] * 3, "pos": place, "rgba": RED})
    eye, axes = view_axes(VIEW)
    half = np.tan(FOVY / 2)
    y, x = np.mgrid[HEIGHT - 1 : -HEIGHT : -2, 1 - WIDTH : WIDTH : 2] / HEIGHT * half
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ axes
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    to = place - eye
    expected = rays @ to > np.sqrt(to @ to - radius**2)
    found = reddish(draw(model))
    assert expected.sum() > 300
    assert overlap(found, expected) > 0.95  # edges are half covered


def test_the_horizon_is_level_with_the_eye(library):
    model = scene()
    model.vis.map.haze = 1e-3
    picture = draw(model, Camera((0, 0, 0.3), 1.5, 30.0, -12.0)).astype(float)
    row = HEIGHT / 2 * (1 - np.tan(np.radians(12.0)) / np.tan(FOVY / 2))
    blueness = (picture[..., 2] / picture[..., 0]).mean(axis=1)
    assert blueness[: round(row) - 1].min() > 1.2  # sky
    assert blueness[round(row) + 4 :].max() < 1.12  # floor


def test_the_floor_fades_into_haze(library):
    pictures = []
    for haze in (1e-3, 0.5):
        model = scene()
        model.vis.map.haze = haze
        model.vis.rgba.haze[:3] = RED[:3]
        pictures.append(draw(model, Camera((0, 0, 0.3), 1.5, 30.0, -12.0)))
    clear, hazy = (reddish(picture).mean(axis=1) for picture in pictures)
    # The horizon is at row 36; the floor from some 56 m on is haze, or from half as far.
    assert clear[:37].max() == hazy[:37].max() == 0.0
    assert 0 < (clear > 0.5).sum() < (hazy > 0.5).sum() < 8
    assert hazy[50:].max() == 0.0


def brightness(model: mujoco.MjModel, normal, lit: bool, camera: Camera = VIEW) -> np.ndarray:
    """Share (3,) of a matt surface's color that is seen."""
    headlight = model.vis.headlight
    _, axes = view_axes(camera)
    light = headlight.ambient + headlight.diffuse * max(-axes[2] @ normal, 0)
    if lit:
        light = light + model.light_diffuse[0] * max(-model.light_dir[0] @ normal, 0)
    return light


@pytest.mark.parametrize("kind", ["box", "mesh"])
def test_faces_have_the_color_that_light_gives_them(library, kind):
    shape = {"type": _Type.mjGEOM_BOX, "size": [0.1] * 3}
    if kind == "mesh":
        shape = {"type": _Type.mjGEOM_MESH, "meshname": "cube"}
    model = scene({**shape, "pos": [0, 0, 0.3], "rgba": RED})
    picture = draw(model)
    for normal, lit in (([0, 0, 1], True), ([1, 0, 0], False), ([0, -1, 0], True)):
        seen = picture[pixel_of(np.array([0, 0, 0.3]) + 0.1 * np.array(normal))]
        expected = 255 * np.clip(RED[:3] * brightness(model, np.array(normal), lit), 0, 1)
        np.testing.assert_allclose(seen, expected, atol=2.5, err_msg=str(normal))


def test_a_mesh_of_a_cube_looks_like_a_box(library):
    place = {"pos": [0.1, 0.2, 0.3], "quat": [0.9, 0.1, 0.3, 0.2], "rgba": RED}
    box = draw(scene({"type": _Type.mjGEOM_BOX, "size": [0.1] * 3, **place}))
    mesh = draw(scene({"type": _Type.mjGEOM_MESH, "meshname": "cube", **place}))
    assert np.abs(box.astype(int) - mesh).mean() < 0.3


def test_a_shadow_lies_where_the_sun_does_not_reach(library):
    place = np.array([0.0, 0.0, 0.5])
    ball = {"type": _Type.mjGEOM_SPHERE, "size": [0.08] * 3, "pos": place, "rgba": RED}
    model = scene(ball)
    sun = model.light_dir[0]
    under = place - sun * place[2] / sun[2]
    shaded, bare = draw(model), draw(scene())
    # The sun is nearly overhead: straight beneath it, the ball's shadow, on the same floor.
    dark = shaded[pixel_of(under)] / bare[pixel_of(under)]
    up = np.array([0, 0, 1])
    expected = brightness(model, up, lit=False) / brightness(model, up, lit=True)
    np.testing.assert_allclose(dark, expected, atol=0.03)
    for side in ([0.12, 0, 0], [-0.12, 0, 0], [0, 0.12, 0], [0, -0.12, 0]):
        at = pixel_of(under + side)
        np.testing.assert_allclose(shaded[at], bare[at], atol=3)


def test_the_floor_is_a_checkerboard_of_squares_of_half_a_meter(library):
    down = Camera((0, 0, 0), 2.0, 90.0, -89.0)
    model = scene(sun=False)
    picture = draw(model, down)
    light = brightness(model, np.array([0, 0, 1]), lit=False, camera=down)
    dark, bright = 255 * np.array([[0.52, 0.56, 0.6], [0.6, 0.64, 0.68]]) * light
    corners = [(0.25, 0.25), (-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25)]
    squares = [picture[pixel_of(np.array([x, y, 0]), down)].astype(int) for x, y in corners]
    assert np.abs(squares[0] - squares[2]).min() > 5
    np.testing.assert_allclose(squares[0::2], squares[1::2], atol=2)
    for found in squares:
        assert min(np.abs(found - dark).max(), np.abs(found - bright).max()) < 4


def test_groups_that_a_viewer_hides_are_not_drawn(library):
    ball = {"type": _Type.mjGEOM_SPHERE, "size": [0.15] * 3, "pos": [0, 0, 0.3], "rgba": RED}
    assert reddish(draw(scene({**ball, "group": 2}))).any()
    hidden = draw(scene({**ball, "group": 3}))
    assert not reddish(hidden).any()
    np.testing.assert_array_equal(hidden, draw(scene()))  # and they throw no shadow


def test_a_shape_that_does_not_collide_is_seen_beyond_those_that_do(library):
    """MuJoCo's ray caster alone overlooks it."""
    spec = mujoco.MjSpec()
    add_scene(spec)
    body = spec.worldbody.add_body(pos=[-0.2, 0, 0.2])
    body.add_geom(type=_Type.mjGEOM_SPHERE, size=[0.02] * 3, rgba=BLUE)
    seen = {"pos": [0.4, 0, 0], "rgba": RED, "contype": 0, "conaffinity": 0}
    body.add_geom(type=_Type.mjGEOM_SPHERE, size=[0.1] * 3, **seen)
    picture = draw(spec.compile())
    assert reddish(picture)[pixel_of(np.array([0.2, 0, 0.2]))]
    assert reddish(picture).sum() > 100


def test_rays_meet_a_field_where_those_of_mujoco_do():
    rng = np.random.default_rng(0)
    spec = mujoco.MjSpec()
    add_scene(spec)
    lay(spec, Heightfield(rng.uniform(-0.2, 0.3, (9, 12)).astype(np.float32), 0.1, (-0.3, 0.2)))
    spec.worldbody.add_geom(type=_Type.mjGEOM_SPHERE, size=[0.2, 0, 0], pos=[0.2, 0.6, 0.4])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    eye = np.array([1.5, -0.9, 0.8])  # from outside, so that walls are seen too
    rays = np.array([0.25, 0.6, 0.0]) - eye + rng.normal(0, 0.5, (2000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    geoms, distances, normals = RayPainter(model, WIDTH, HEIGHT)._cast(data, eye, rays)
    assert [np.sum(geoms == each) > 50 for each in (-1, 0, 1)] == [True] * 3
    for ray, *met in zip(rays, geoms, distances, normals, strict=True):
        geom, normal = np.zeros((1, 1), np.int32), np.zeros((3, 1))
        distance = mujoco.mj_ray(model, data, eye, ray, None, True, -1, geom, normal)
        assert met[0] == geom[0, 0]
        if met[0] >= 0:
            assert met[1] == pytest.approx(distance, abs=1e-5)
            np.testing.assert_allclose(met[2], normal[:, 0], atol=1e-4)


def test_far_from_the_origin_it_looks_the_same(library):
    spec = mujoco.MjSpec()
    add_scene(spec)
    body = spec.worldbody.add_body()
    body.add_freejoint()
    add_sun(body)
    body.add_geom(type=_Type.mjGEOM_BOX, size=[0.2, 0.1, 0.05], rgba=GREEN)
    model, pictures = spec.compile(), []
    for meters in (0, 307):  # the floor's pattern repeats every meter
        camera = Camera((meters, -meters, 0.2), 1.6, 130.0, -20.0)
        pictures.append(draw(model, camera, [meters, -meters, 0.3, 1, 0, 0, 0]).astype(int))
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.3


def every_shape() -> mujoco.MjModel:
    turned = {"quat": [0.9, 0.2, 0.3, 0.1]}
    return scene(
        {"type": _Type.mjGEOM_BOX, "size": [0.1, 0.2, 0.05], "pos": [0, 0, 0.25], "rgba": RED},
        {"type": _Type.mjGEOM_SPHERE, "size": [0.08] * 3, "pos": [0.4, 0, 0.08], "rgba": BLUE},
        {"type": _Type.mjGEOM_CYLINDER, "size": [0.05, 0.1, 0], "pos": [0, 0.4, 0.3], "rgba": GREEN,
         **turned},
        {"type": _Type.mjGEOM_CAPSULE, "size": [0.04, 0.1, 0], "pos": [-0.3, -0.1, 0.3],
         "rgba": RED, **turned},
        {"type": _Type.mjGEOM_ELLIPSOID, "size": [0.1, 0.05, 0.07], "pos": [0.1, -0.4, 0.2],
         "rgba": GREEN},
        {"type": _Type.mjGEOM_MESH, "meshname": "cube", "pos": [-0.4, 0.5, 0.2], "rgba": BLUE,
         **turned},
        matt=False,
    )  # fmt: skip


def test_all_libraries_and_rays_draw_the_same_picture(library):
    picture = draw(every_shape()).astype(int)
    reference = np.asarray(Image.open(REFERENCE)).astype(int)
    apart = np.abs(picture - reference)
    assert apart.mean() < 2.5
    assert (apart.max(axis=-1) > 24).mean() < 0.03  # along edges, which OpenGL draws in steps
    for channel in range(3):
        one, other = (np.argmax(p, -1) == channel for p in (picture, reference))
        strong = [np.ptp(p, axis=-1) > 60 for p in (picture, reference)]
        assert overlap(one & strong[0], other & strong[1]) > 0.9


def test_the_same_pose_gives_the_same_bytes(library):
    model = every_shape()
    one, other = (Canvas(model, 64, 40) for _ in range(2))
    first = one.draw(np.zeros(0), VIEW)
    assert first.shape == (40, 64, 3)
    assert first.dtype == np.uint8
    other.draw(np.zeros(0), Camera((1, 1, 1), 2.0, 10.0, -40.0))
    np.testing.assert_array_equal(first, other.draw(np.zeros(0), VIEW))
    np.testing.assert_array_equal(first, one.draw(np.zeros(0), VIEW))


def test_a_model_is_drawn_without_materials_lights_and_floor_too(library):
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=_Type.mjGEOM_SPHERE, size=[0.2] * 3, rgba=RED)
    picture = draw(spec.compile())
    assert reddish(picture)[pixel_of(np.zeros(3))]
    np.testing.assert_array_equal(picture[0, 0], 0)


def test_home_shows_the_whole_robot_and_changes_nothing_of_its_model(library, quadruped):
    model = quadruped.make_full_model()
    before = [model.geom_rgba.copy(), model.mat_reflectance.copy(), model.bvh_aabb.copy()]
    picture = render_home(model, 300, 200)
    after = [model.geom_rgba, model.mat_reflectance, model.bvh_aabb]
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one, other)
    robot = Canvas(model, 300, 200).draw(model.key("home").qpos, Camera((0, 0, 90), 1, 0, 0))
    assert np.ptp(robot.astype(int), axis=(0, 1)).max() < 60  # nothing but sky up there
    orange = (picture[..., 0] > 180) & (picture[..., 2] < 70)
    rows, columns = np.nonzero(orange)
    assert 0.01 < orange.mean() < 0.2
    assert (rows.min() > 20) & (rows.max() < 180) & (columns.min() > 40) & (columns.max() < 260)


if __name__ == "__main__":
    if find_working_library() is None:
        sys.exit("no GL library")
    Image.fromarray(draw(every_shape())).save(REFERENCE, optimize=True)
