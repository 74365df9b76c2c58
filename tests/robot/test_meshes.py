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
from tests.robot.robots import inertial, link, make_data, robot, shape

ONE = np.ones(3)
SIDES = [0.2, 0.4, 0.6]  # m, of the box in all files


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


def make_robot(visual: str = "", collision: str = "", extension: str = "") -> str:
    """Return a robot of one link 1 m above its frame, with these mesh files."""
    files = {"visual": visual, "collision": collision}
    shapes = [shape(f'mesh filename="{f}"', "0 0 1", kind) for kind, f in files.items() if f]
    return robot(extension, link("a", inertial(1, "1 1 1"), *shapes))


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a ROS package: pack/urdf/ beside pack/meshes/box.* and meshes/{visual,large}/."""
    folder = tmp_path / "pack"
    (folder / "urdf").mkdir(parents=True)
    box = trimesh.creation.box(SIDES)
    for kind, scale in (("visual", 1), ("large", 2)):
        (folder / "meshes" / kind).mkdir(parents=True)
        trimesh.creation.box(np.array(SIDES) * scale).export(folder / f"meshes/{kind}/box.stl")
    for kind in ("stl", "obj", "ply"):
        box.export(folder / "meshes" / f"box.{kind}")
    (folder / "meshes" / "box.dae").write_text(COLLADA)
    box.export(tmp_path / "secret.stl")
    return folder


def measure(text: str, folder: Path | None, *mesh_folders: Path) -> tuple[list[float], str]:
    """Return the sides of the only mesh, m, none if it is left out, and the report."""
    options = Options(mesh_folders=mesh_folders)
    conversion = convert(parse_urdf(text, "r.urdf", folder), options=options)
    model = conversion.spec.compile()
    vertices = model.mesh_vert.astype(float)
    sides = np.sort(np.ptp(vertices, axis=0)).round(5).tolist() if model.nmesh else []
    return sides, "\n".join(conversion.report.to_lines())


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("box.stl", "meshes"),
        ("meshes/box.stl", ""),
        ("meshes/../meshes/box.stl", ""),
        ("{pack}/meshes/box.stl", ""),
        ("file://{pack}/meshes/box.stl", ""),
        ("package://pack/meshes/box.stl", ".."),
        ("package://pack/meshes/box.stl", ""),
        ("model://pack/meshes/box.stl", ""),
        ("../meshes/box.stl", "urdf"),
        ("package://pack/meshes/box.stl", "urdf"),
        ("package://pack/meshes/box.stl", "urdf/deep"),
        ("package:///pack/meshes/box.stl", "urdf/deep"),
    ],
)
def test_finds_names_of_every_kind_inside_the_folders(package, name, folder):
    (package / "urdf" / "deep").mkdir()
    path = find_mesh(name.format(pack=package), [package / folder], "r")
    assert path == (package / "meshes" / "box.stl").resolve()


def test_a_package_may_have_another_name_than_its_folder(package):
    deep = package / "urdf" / "deep"
    deep.mkdir()
    for declared in (False, True):
        if declared:
            (package / "package.xml").write_text("<package><name>other</name></package>")
        for name in ("package://other/meshes/box.stl", "../../meshes/box.stl"):
            if declared:
                path = find_mesh(name, [deep], "r")
                assert path == (package / "meshes" / "box.stl").resolve()
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
    path = find_mesh("package://pack/meshes/box.stl", [inner], "r")
    assert path == (inner.parent / "meshes" / "box.stl").resolve()
    path = find_mesh("package://pack/meshes/box.obj", [inner, package], "r")
    assert path == (package / "meshes" / "box.obj").resolve()


def test_a_package_xml_that_is_none_declares_nothing(package):
    entity = '<!DOCTYPE p [<!ENTITY a "pack2">]><package><name>&a;</name></package>'
    for text in ("", "<package>", entity):
        (package / "package.xml").write_text(text)
        with pytest.raises(UrdfError):
            find_mesh("package://pack2/meshes/box.stl", [package / "urdf"], "r")


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
    expected = r"lies outside .* expected inside, or pass --robot\.mesh-dirs"
    with pytest.raises(UrdfError, match=expected):
        find_mesh(name, [package], "r")
    with pytest.raises(UrdfError, match=expected):
        convert(parse_urdf(make_robot(name), "r.urdf", package))


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


@pytest.mark.parametrize(
    "name",
    [
        "/opt/nowhere/meshes/visual/box.stl",
        "/opt/nowhere/box.stl",
        "file:///home/me/dog/visual/box.stl",
        r"C:\Users\me\dog\meshes\visual\box.stl",
        "package://nowhere/visual/box.stl",
        "../../elsewhere/box.stl",
        "http://example.org/dog/visual/box.stl",
    ],
)
def test_a_mesh_of_another_machine_is_looked_for_by_its_name_or_left_out(package, tmp_path, name):
    (tmp_path / "away").mkdir()
    sides, notes = measure(make_robot(name), tmp_path / "away")
    assert sides == []
    assert f"dropped: visual meshes that were not found: {name}" in notes
    sides, notes = measure(make_robot(name), tmp_path / "away", package / "meshes" / "visual")
    assert sides == SIDES
    assert "assumed: visual meshes found by the ends of their names: box.stl" in notes


def test_the_longer_end_of_a_meshs_name_counts(package):
    for kind, scale in (("visual", 1), ("large", 2)):
        text = make_robot(f"/opt/nowhere/meshes/{kind}/box.stl")
        for folder in (package, package / "meshes"):
            assert measure(text, None, folder)[0][0] == scale * SIDES[0]


@pytest.mark.parametrize(
    ("compiler", "name"),
    [
        ('meshdir="meshes/visual"', "box.stl"),
        ('meshdir="meshes/visual/" balanceinertia="true"', "package://d/m/box.stl"),
        ('meshdir="meshes" strippath="false"', "visual/box.stl"),
        ('meshdir="./meshes/visual"', "/opt/nowhere/box.stl"),
    ],
)
def test_meshes_are_where_mujocos_extension_says(package, tmp_path, compiler, name):
    text = make_robot(name, extension=f"<mujoco><compiler {compiler}/><option/></mujoco>")
    sides, notes = measure(text, package)
    assert sides == SIDES
    assert "<option> of a mujoco (1)" in notes
    # A run's copy of the URDF has the original's folder among those of meshes.
    assert measure(text, tmp_path, package)[0] == SIDES
    # Written anew, for another reason, the text still says so.
    text = text.replace("<robot name", '<robot xmlns="http://drake.mit.edu" name')
    assert measure(parse_urdf(text).text, package)[0] == SIDES


@pytest.mark.parametrize("place", ["..", "/etc", "x" * 5000])
def test_mujocos_extension_leads_to_no_other_folder(package, place):
    extension = f'<mujoco><compiler meshdir="{place}"/></mujoco>'
    assert measure(make_robot("secret.stl", extension=extension), package)[0] == []


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "dae"])
def test_shapes_are_in_meters_whatever_the_format(package, kind):
    (part,) = load_mesh(package / "meshes" / f"box.{kind}", ONE, "r")
    np.testing.assert_allclose(np.ptp(part.vertices, axis=0), SIDES, atol=1e-6)
    # Colors are kept where the format has some.
    assert part.rgba is None if kind != "dae" else part.rgba.tolist() == [1, 0, 0, 1]


def test_a_mirrored_mesh_is_not_inside_out(package):
    (part,) = load_mesh(package / "meshes" / "box.stl", np.array([1.0, -1, 2]), "r")
    mirrored = trimesh.Trimesh(part.vertices, part.faces)
    assert mirrored.volume == pytest.approx(2 * np.prod(SIDES))


def test_the_result_stands_alone(package):
    file = package / "urdf" / "robot.urdf"
    file.write_text(make_robot("package://pack/meshes/box.dae", "package://pack/meshes/box.stl"))
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
    file.write_text(make_robot("package://other/none.dae", "meshes/box.stl"))
    conversion = convert(read_urdf(file))
    model = conversion.spec.compile()
    assert sorted(model.geom_group[1:]) == [2, 3]
    assert any(
        "not found: package://other/none.dae" in line for line in conversion.report.to_lines()
    )


DOCTYPE = '<!DOCTYPE x [<!ENTITY a "b">]>'
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
        ("a.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "collision meshes that are broken: a"),
        ("a.ply", "ply", "collision meshes that are broken: a.ply is not valid .ply"),
        ("a.stl", "nonsense", "collision meshes that are broken: a.stl"),
        ("a.stl", "", "collision meshes that are broken: a.stl"),
        ("a.dae", "<COLLADA>", "collision meshes that are broken: a.dae is not valid .dae"),
        ("a.dae", DOCTYPE + COLLADA[21:], "collision meshes that are broken: a.dae is not valid"),
        ("a.glb", "glTF", "collision meshes that are not read: a.glb is of kind '.glb'"),
        ("a.stl", FLAT, "flat parts of collision meshes: a.stl"),
        ("a.stl", POINT, ""),
    ],
)  # fmt: skip
def test_a_mesh_that_is_missing_broken_or_flat_is_left_out(package, name, data, says):
    if data is not None:
        (package / name).write_text(data)
    conversion = convert(parse_urdf(make_robot(collision=name), "r.urdf", package))
    assert conversion.spec.compile().ngeom == 1  # the floor
    (line,) = [line for line in conversion.report.to_lines() if line.startswith("dropped")]
    assert line.startswith(f"dropped: {says}")


def test_meshes_can_be_left_out(package):
    urdf = parse_urdf(make_robot(collision="none.stl"), "r.urdf", package)
    conversion = convert(urdf, options=Options(meshes=False))
    assert conversion.spec.compile().ngeom == 1
    assert "dropped: collision meshes: none.stl" in conversion.report.to_lines()
