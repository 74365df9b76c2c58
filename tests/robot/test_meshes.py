"""Mesh files: names that stay inside the allowed folders, units, colors, a whole result."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from quadwalk.robot.meshes import find_mesh, load_mesh
from quadwalk.robot.mjcf import Options, convert, write_xml
from quadwalk.robot.report import UrdfError
from quadwalk.robot.urdf import parse_urdf, read_urdf
from tests.robot import robots
from tests.robot.robots import inertial, link, make_data, shape

ONE = np.ones(3)


def robot(visual: str = "", collision: str = "") -> str:
    files = {"visual": visual, "collision": collision}
    shapes = [shape(f'mesh filename="{f}"', "0 0 1", kind) for kind, f in files.items() if f]
    return robots.robot(link("a", inertial(1, "1 1 1"), *shapes))


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package as in ROS: pack/urdf/robot.urdf beside pack/meshes/box.*, 20 x 40 x 60 cm."""
    folder = tmp_path / "pack"
    (folder / "urdf").mkdir(parents=True)
    (folder / "meshes").mkdir()
    box = trimesh.creation.box((0.2, 0.4, 0.6))
    for kind in ("stl", "obj"):
        box.export(folder / "meshes" / f"box.{kind}")
    (folder / "meshes" / "box.dae").write_text(COLLADA)
    (tmp_path / "secret.stl").write_bytes((folder / "meshes" / "box.stl").read_bytes())
    return folder


# The same box with a corner at the origin, in centimeters, red.
COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="centimeter" meter="0.01"/><up_axis>Z_UP</up_axis></asset>
<library_effects><effect id="e"><profile_COMMON><technique sid="t"><phong><diffuse>
<color>1 0 0 1</color></diffuse></phong></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="pa" count="12">0 0 0 20 0 0 0 40 0 0 0 60</float_array><technique_common>
<accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles material="m" count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g">
<bind_material><technique_common><instance_material symbol="m" target="#m"/></technique_common>
</bind_material></instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def test_finds_names_of_every_kind_inside_the_folders(package):
    meshes = package / "meshes"
    for name, folder in (
        ("box.stl", meshes),
        ("meshes/box.stl", package),
        ("meshes/../meshes/box.stl", package),
        (str(meshes / "box.stl"), package),
        (f"file://{meshes}/box.stl", package),
        ("package://pack/meshes/box.stl", package.parent),
        ("package://pack/meshes/box.stl", package),
        ("model://pack/meshes/box.stl", package),
    ):
        assert find_mesh(name, [folder], "r") == (meshes / "box.stl").resolve(), name


@pytest.mark.parametrize(
    "name",
    [
        *("../secret.stl", "../pack/../secret.stl", "{tmp}/secret.stl", "file://{tmp}/secret.stl"),
        *("package://../secret.stl", "package://pack/../../secret.stl", "link.stl", "/etc/passwd"),
        "package://pack/%2e%2e/%2e%2e/secret.stl",
    ],
)
def test_refuses_names_that_leave_the_folders(package, name):
    (package / "link.stl").symlink_to(package.parent / "secret.stl")
    name = name.format(tmp=package.parent)
    with pytest.raises(
        UrdfError, match=r"lies outside .* expected inside, or pass --robot\.mesh-dirs"
    ):
        find_mesh(name, [package], "r")


@pytest.mark.parametrize(
    "name",
    [
        *("http://example.org/box.stl", "none.stl", "x" * 5000, "", "http://[", "a\nb", "a\0b"),
        *("round.stl", "round.stl/a", "package://round.stl/a", "meshes", "file://"),
    ],
)
def test_refuses_what_is_no_file(package, name):
    (package / "round.stl").symlink_to("round.stl")
    with pytest.raises(UrdfError, match="expected"):
        find_mesh(name, [package], "r")


@pytest.mark.parametrize("kind", ["stl", "obj", "dae"])
def test_shapes_are_in_meters_whatever_the_format(package, kind):
    (part,) = load_mesh(package / "meshes" / f"box.{kind}", ONE, "r")
    np.testing.assert_allclose(np.ptp(part.vertices, axis=0), [0.2, 0.4, 0.6], atol=1e-6)
    # Colors are kept where the format has some.
    assert part.rgba is None if kind != "dae" else part.rgba.tolist() == [1, 0, 0, 1]


def test_a_mirrored_mesh_is_not_inside_out(package):
    (part,) = load_mesh(package / "meshes" / "box.stl", np.array([1.0, -1, 2]), "r")
    mirrored = trimesh.Trimesh(part.vertices, part.faces)
    assert mirrored.volume == pytest.approx(2 * 0.2 * 0.4 * 0.6)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.stl", b"nonsense"),
        ("a.obj", b"v 1 2\nf 1 2 3\n"),
        ("a.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("a.dae", b"<COLLADA>"),
        ("a.dae", b'<!DOCTYPE x [<!ENTITY a "b">]>' + COLLADA.split("?>", 1)[1].encode()),
        ("a.ply", b"ply"),
        ("a.stl", b""),
    ],
)
def test_refuses_broken_files_in_one_line(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(UrdfError) as raised:
        load_mesh(tmp_path / name, ONE, "r.urdf")
    assert str(raised.value).startswith("r.urdf: mesh file")


def test_the_result_stands_alone(package):
    file = package / "urdf" / "robot.urdf"
    file.write_text(robot("package://pack/meshes/box.dae", "package://pack/meshes/box.stl"))
    options = Options(mesh_folders=(package,))
    xml = write_xml(convert(read_urdf(file), options=options).spec)
    model = mujoco.MjModel.from_xml_string(xml)  # in memory: it has no file to look at
    assert model.nmesh == 2
    assert "collision meshes" not in xml
    np.testing.assert_allclose(make_data(model, model.qpos0).geom("a").xpos, [0, 0, 1], atol=1e-6)
    red = [i for i in range(model.ngeom) if tuple(model.geom_rgba[i]) == (1, 0, 0, 1)]
    assert len(red) == 1
    assert model.key("home").qpos[2] == pytest.approx(-0.7, abs=1e-6)  # the box stands on z = 0


def test_a_missing_visual_is_shown_by_its_collision_shape(package):
    file = package / "robot.urdf"
    file.write_text(robot("package://other/none.dae", "meshes/box.stl"))
    conversion = convert(read_urdf(file))
    model = conversion.spec.compile()
    assert sorted(model.geom_group[1:]) == [2, 3]
    assert any(
        "not found: package://other/none.dae" in line for line in conversion.report.to_lines()
    )


SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
FLAT, POINT = (
    trimesh.Trimesh(corners, [[0, 1, 3], [1, 2, 3]], process=False).export(file_type="stl_ascii")
    for corners in (SQUARE, 0 * SQUARE + 1)
)


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [
        ("none.stl", None, "collision meshes that were not found: none.stl"),
        ("http://a.org/b.stl", None, "collision meshes that were not found: http://a.org"),
        ("a.obj", "v 1\nf 1 2 3\n", "collision meshes that are broken: a.obj is not valid"),
        ("a.obj", "v 0 0 0\nv 3e38 0 0\nv 0 1 0\nf 1 2 3\n",
         "collision meshes that are broken: a.obj has no triangles, or some beyond"),
        ("a\nb.stl", None, "collision meshes that were not found: a b.stl"),
        ("a.ply", "ply", "collision meshes that are broken: a.ply is not valid .ply"),
        ("a.glb", "glTF", "collision meshes that are not read: a.glb is of kind '.glb'"),
        ("a.stl", FLAT, "flat parts of collision meshes: a.stl"),
        ("a.stl", POINT, ""),
    ],
)  # fmt: skip
def test_a_mesh_that_is_missing_broken_or_flat_is_left_out(package, name, data, says):
    if data is not None:
        (package / name).write_text(data)
    conversion = convert(parse_urdf(robot(collision=name), "r.urdf", package))
    assert conversion.spec.compile().ngeom == 1  # the floor
    (line,) = [line for line in conversion.report.to_lines() if line.startswith("dropped")]
    assert line.startswith(f"dropped: {says}")


def test_meshes_can_be_left_out(package):
    urdf = parse_urdf(robot(collision="none.stl"), "r.urdf", package)
    conversion = convert(urdf, options=Options(meshes=False))
    assert conversion.spec.compile().ngeom == 1
    assert "dropped: collision meshes: none.stl" in conversion.report.to_lines()


def test_a_name_that_leaves_the_folders_stops_the_conversion(package):
    with pytest.raises(UrdfError, match="lies outside"):
        convert(parse_urdf(robot("../secret.stl"), "r.urdf", package))


@pytest.mark.parametrize("declared", [False, True])
def test_the_usual_layouts_need_no_flag(package, declared):
    mesh = package / "meshes" / "box.stl"
    deep = package / "urdf" / "versions"
    deep.mkdir()
    if declared:  # under another name than its folder's
        (package / "package.xml").write_text("<package><name>other</name></package>")
    for name, folder in (
        ("../meshes/box.stl", package / "urdf"),
        ("package://pack/meshes/box.stl", package / "urdf"),
        ("package://pack/meshes/box.stl", deep),
        ("package:///pack/meshes/box.stl", deep),
    ):
        assert find_mesh(name, [folder], "r") == mesh.resolve(), name
    for name in ("package://other/meshes/box.stl", "../../meshes/box.stl"):
        if declared:
            assert find_mesh(name, [deep], "r") == mesh.resolve()
        else:
            with pytest.raises(UrdfError):
                find_mesh(name, [deep], "r")
    for start in ("../../", "package://pack/../", "package://other/../"):
        with pytest.raises(UrdfError):
            find_mesh(f"{start}secret.stl", [package / "urdf"], "r")


def test_the_nearest_package_of_a_name_counts(package):
    inner = package / "a" / "pack" / "urdf"
    inner.mkdir(parents=True)
    (inner.parent / "meshes").mkdir()
    (inner.parent / "meshes" / "box.stl").write_bytes((package / "meshes" / "box.stl").read_bytes())
    found = find_mesh("package://pack/meshes/box.stl", [inner], "r")
    assert found == (inner.parent / "meshes" / "box.stl").resolve()
    found = find_mesh("package://pack/meshes/box.obj", [inner, package], "r")
    assert found == (package / "meshes" / "box.obj").resolve()


def test_a_package_xml_that_is_none_declares_nothing(package):
    entity = '<!DOCTYPE p [<!ENTITY a "pack2">]><package><name>&a;</name></package>'
    for text in ("", "<package>", entity):
        (package / "package.xml").write_text(text)
        with pytest.raises(UrdfError):
            find_mesh("package://pack2/meshes/box.stl", [package / "urdf"], "r")
