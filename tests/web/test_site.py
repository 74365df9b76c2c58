"""The page's files: what a folder and a single file hold, and what cannot be shared."""

import base64
import dataclasses
import gzip
import hashlib
import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.shared import find_example_robots
from quadwalk.errors import UserError
from quadwalk.paths import PRETRAINED
from quadwalk.robot.mjcf import write_xml
from quadwalk.runs.directory import Run
from quadwalk.settings.terms import Observation
from quadwalk.settings.training import OtherRobotConfig
from quadwalk.task_files import load_task
from quadwalk.web import site, vendor
from quadwalk.web.decimate import decimate_visuals, merge_vertices
from quadwalk.web.robots import LiveSite, load, load_getup


def test_a_dog_is_its_policy_and_its_robot(loaded_runs):
    dog = site.make_dog(loaded_runs["drive"], loaded_runs["getup"])
    assert set(dog.files) == {"drive.xml", "drive.policy.json", "drive.getup.policy.json"}
    entry = json.loads(dog.to_json())
    assert entry["policies"] == {"last": "drive.policy.json"}
    assert entry["getup"] == "drive.getup.policy.json"
    assert entry["note"] is None  # its meshes are light as they are
    model = mujoco.MjModel.from_xml_string(dog.files["drive.xml"].decode())
    assert model.nq == 19


def test_other_runs_are_loaded_when_they_are_asked_for(vendor_files, tmp_path):
    missing = Run(tmp_path / "gone")
    others = [Run(PRETRAINED / "run"), missing, Run(PRETRAINED / "walk")]
    live = LiveSite(Run(PRETRAINED / "walk"), "last", None, others)
    index = json.loads(live.files["dogs.json"])
    assert index["dogs"] == ["walk", "run", "gone"]
    assert "run.policy.json" not in live.files
    entry = json.loads(live.files["run.dog.json"]())
    assert {entry["robot"], entry["getup"], *entry["policies"].values()} <= set(live.files)
    with pytest.raises(UserError, match="gone"):
        live.files["gone.dog.json"]()


def test_a_robot_gets_up_by_its_own_policy_or_by_that_of_many_bodies(loaded_runs):
    packaged = {name: Run(PRETRAINED / name) for name in ("getup", "universal", "universal_getup")}
    file = find_example_robots() / "anymal_c_simple_description/urdf/anymal.urdf"
    anymal = load(packaged["universal"], "last", OtherRobotConfig(urdf=file).find())
    riser = load_getup(anymal, None)
    assert riser is not None
    assert riser.run.path == packaged["universal_getup"].path
    assert riser.env.quadruped.joints == anymal.env.quadruped.joints
    assert load_getup(anymal, packaged["getup"]) is None  # that is the AlienGo's

    riser = load_getup(loaded_runs["drive"], None)
    assert riser is not None
    assert riser.run.path == packaged["getup"].path
    assert load_getup(loaded_runs["getup"], None) is None  # it gets up by itself


def test_ground_is_written_to_a_millimeter(loaded_runs):
    terrain = site.make_ground(loaded_runs["drive"].env)
    value = json.loads(site.pack_ground(terrain))
    units = np.frombuffer(gzip.decompress(base64.b64decode(value["heights"])), "<u2")
    heights = value["low"] + value["step"] * units.reshape(value["rows"], value["columns"])
    np.testing.assert_allclose(heights, terrain.field.heights, atol=0.51e-3)
    assert {tile["difficulty"] for tile in value["tiles"]} == set(site.GROUND_LEVELS)


def test_the_import_map_is_what_the_security_policy_allows():
    html = (site.PAGE / site.INDEX).read_text()
    script = re.search(r'<script type="importmap">(.*?)</script>', html, re.DOTALL)
    assert script is not None
    digest = base64.b64encode(hashlib.sha256(script[1].encode()).digest()).decode()
    assert f"'sha256-{digest}'" in html


def test_modules_come_after_those_that_they_import(vendor_files):
    files = {path.name: path.read_bytes() for path in site.PAGE.iterdir()} | vendor_files
    order = site.order_modules(files)
    assert order[-1] == "main.js"
    for name in order[2:]:
        for target in re.findall(r'from "\./([^"]+)"', files[name].decode()):
            assert order.index(target) < order.index(name)
    assert set(order) >= {path.name for path in site.PAGE.glob("*.js")} - set(site.LIVE_MODULES)


def test_one_file_has_nothing_to_load(loaded_runs, vendor_files):
    files = site.make_site([site.make_dog(loaded_runs["walk"])], None)
    html = site.to_single_file(files).decode()
    assert len(html) < 5_000_000
    assert not re.search(r'(src|href)="(?!data:)', html)
    assert "http://" not in html.split("QUADWALK_FILES")[0]


def test_third_party_files_are_pinned_with_their_hashes():
    lock = json.loads((vendor.FOLDER / "package-lock.json").read_text())
    pinned = json.loads((vendor.FOLDER / "package.json").read_text())["dependencies"]
    for name, version in pinned.items():
        package = lock["packages"][f"node_modules/{name}"]
        assert package["version"] == version
        assert package["integrity"].startswith("sha512-")


def test_without_npm_one_line_says_what_is_missing(monkeypatch, tmp_path):
    monkeypatch.setattr(vendor, "find_cache", lambda: tmp_path / "none")
    monkeypatch.setattr(vendor, "FOLDER", tmp_path)
    monkeypatch.setattr("shutil.which", lambda *_, **__: None)
    with pytest.raises(UserError, match="the page needs npm once"):
        vendor.load_vendor_files()


def test_a_policy_that_observes_by_python_is_not_shared(loaded_runs, tmp_path):
    file = tmp_path / "my_task.py"
    file.write_text(
        "import dataclasses\n"
        "from quadwalk.settings.terms import Observation\n"
        "from quadwalk.tasks import walk\n"
        "def clock(robot, state):\n"
        "    return state.steps * 0.1\n"
        "observation = {**walk.TASK.env.observation, 'clock': Observation(clock)}\n"
        "TASK = dataclasses.replace(\n"
        "    walk.TASK, env=dataclasses.replace(walk.TASK.env, observation=observation))\n"
    )
    loaded = loaded_runs["walk"]
    clock = load_task(file).env.observation["clock"]
    assert isinstance(clock, Observation)
    config = dataclasses.replace(loaded.env.config, observation={"clock": clock})
    env = type("Env", (), {"config": config})()
    with pytest.raises(UserError, match="observation 'clock' is Python of your own"):
        site.check_shareable(dataclasses.replace(loaded, env=env))
    site.check_shareable(loaded)


def make_ball(faces: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a sphere of 0.1 m of about so many triangles."""
    rows = int(np.sqrt(faces / 2))
    around, up = np.meshgrid(np.arange(rows), np.arange(rows + 1))
    angle, height = 2 * np.pi * around / rows, np.pi * up / rows
    vertices = 0.1 * np.stack(
        [np.sin(height) * np.cos(angle), np.sin(height) * np.sin(angle), np.cos(height)], -1
    )
    right, left = (around + 1) % rows, around
    node = rows * up
    first = np.stack([node + left, node + rows + left, node + right], -1)[:-1]
    second = np.stack([node + right, node + rows + left, node + rows + right], -1)[:-1]
    return vertices.reshape(-1, 3), np.concatenate([first, second]).reshape(-1, 3)


def test_meshes_to_see_become_light_and_keep_their_shape(monkeypatch):
    monkeypatch.setattr("quadwalk.web.decimate.MOST_FACES", 1000)
    vertices, faces = make_ball(20_000)
    spec = mujoco.MjSpec()
    spec.add_mesh(name="ball", uservert=vertices.ravel(), userface=faces.ravel().astype(np.int32))
    body = spec.worldbody.add_body(name="body")
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0, 0])
    mesh = mujoco.mjtGeom.mjGEOM_MESH
    body.add_geom(name="skin", type=mesh, meshname="ball", contype=0, conaffinity=0, mass=0)
    light, note = decimate_visuals(spec)
    assert note is not None
    model = mujoco.MjModel.from_xml_string(write_xml(light))
    assert 100 < model.nmeshface <= 1000
    radius = np.linalg.norm(model.mesh_vert, axis=1)
    assert radius.max() == pytest.approx(0.1, abs=0.01)
    assert spec.mesh("ball") is not None


def test_merging_keeps_only_triangles():
    vertices, faces = make_ball(2000)
    merged, triangles = merge_vertices(vertices, faces, 0.03)
    assert triangles.max() == len(merged) - 1
    assert all(len(set(face)) == 3 for face in triangles.tolist())


def test_a_page_is_written_as_a_folder(tmp_path: Path):
    site.write_folder({"a.js": b"1", "vendor/b.js": b"2"}, tmp_path / "page")
    assert (tmp_path / "page/vendor/b.js").read_bytes() == b"2"
