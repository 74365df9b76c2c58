"""The MJCF that the command writes: complete, deterministic, quick; and its command line."""

import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image

from quadwalk.errors import UserError
from quadwalk.paths import ALIENGO_URDF, ASSETS
from quadwalk.robot.cli import main
from quadwalk.robot.mjcf import convert
from quadwalk.robot.urdf import parse_urdf, read_urdf
from tests.robot.robots import inertial, joint, link, make_data, robot, shape

XML = ASSETS / "aliengo.xml"


def test_regenerating_the_asset_is_byte_identical_also_as_part_of_another_command(tmp_path, capsys):
    out = tmp_path / "aliengo.xml"
    main([str(ALIENGO_URDF), "-o", str(out)])
    assert out.read_bytes() == XML.read_bytes()
    assert "fused: by fixed joints: imu_link with trunk" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["aliengo.xml"]
    main([str(ALIENGO_URDF), "--quiet"], prog="quadwalk robot")
    assert capsys.readouterr() == (XML.read_text(), "")
    with pytest.raises(SystemExit):
        main(["--help"], prog="quadwalk robot")
    assert capsys.readouterr().out.startswith("usage: quadwalk robot ")


def test_the_asset_is_complete():
    model = mujoco.MjModel.from_xml_path(str(XML))
    bodies = {model.body(i).name for i in range(model.nbody)}
    sites = {model.site(i).name for i in range(model.nsite)}
    feet = [f"{leg}_foot" for leg in ("FR", "FL", "RR", "RL")]
    links = {link.name for link in read_urdf(ALIENGO_URDF).robot.links}
    assert bodies | sites == links | {"world"}
    assert sites == {"imu_link", *feet}
    assert set(model.geom_group) == {0, 2, 3}
    visual, collision = model.geom_group == 2, model.geom_group == 3
    assert not model.geom_contype[visual].any()
    assert model.geom_contype[collision].all()
    assert (model.geom_matid[visual] >= 0).all()
    assert all(model.geom(i).name for i in np.flatnonzero(collision))
    sensors = {model.sensor(i).name for i in range(model.nsensor)}
    imu = {"imu_gyro", "imu_accelerometer", "imu_orientation"}
    assert sensors == imu | {f"{foot}_touch" for foot in feet}
    efforts = np.tile([35.278, 35.278, 44.4], 4)
    np.testing.assert_allclose(model.actuator_ctrlrange, np.stack([-efforts, efforts], axis=1))
    np.testing.assert_allclose(model.jnt_actfrcrange[1:], model.actuator_ctrlrange)
    np.testing.assert_allclose(model.jnt_user[1:, 0], np.tile([20, 20, 15.89], 4))
    assert (model.jnt_type[0], model.joint(0).name) == (0, "floating_base")
    assert model.nexclude == 12
    assert model.key("home").qpos[2] == pytest.approx(0.374853)
    assert model.geom("floor").type == mujoco.mjtGeom.mjGEOM_PLANE


def test_touch_sensors_and_imu_feel_the_robot_stand():
    model = mujoco.MjModel.from_xml_path(str(XML))
    home = model.key("home").qpos
    data = make_data(model, home)
    while data.time < 2:
        data.ctrl = 200 * (home[7:] - data.qpos[7:]) - 5 * data.qvel[6:]
        mujoco.mj_step(model, data)
    touch = sum(data.sensor(f"{leg}_foot_touch").data[0] for leg in ("FR", "FL", "RR", "RL"))
    assert touch == pytest.approx(23.24 * 9.81, rel=0.01)
    assert np.linalg.norm(data.sensor("imu_accelerometer").data) == pytest.approx(9.81, rel=0.01)
    assert np.linalg.norm(data.sensor("imu_gyro").data) < 0.01


def test_no_mass_is_invented():
    body, box = link("a", inertial(2, "1 1 1")), link("b", shape('box size="1 1 1"'))
    text = robot(body, box, joint("j", "a", "b", kind="fixed", extra=""))
    model = convert(parse_urdf(text)).spec.compile()
    assert model.body_mass.sum() == 2
    assert model.body("a").inertia == pytest.approx([1, 1, 1])


def test_a_fixed_base_and_armature_from_rotor_and_gear(tmp_path):
    flags = ["-q", "--fixed-base", "--rotor", "*_hip_joint=1.387e-4,8"]
    main([str(ALIENGO_URDF), "-o", str(tmp_path / "a.xml"), *flags])
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    assert (model.nv, model.nq) == (12, 12)
    assert model.joint("RL_hip_joint").armature == pytest.approx(1.387e-4 * 64, rel=1e-5)
    assert model.joint("RL_calf_joint").armature == pytest.approx(0.022)


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["none.urdf"], 1, "none.urdf: cannot be read (No such file or directory)"),
        ([ALIENGO_URDF, "-o", "/none/a.xml"], 1, "cannot write /none/a.xml"),
        ([ALIENGO_URDF, "--rotor", "hip"], 2, "expected JOINTS=INERTIA,GEAR"),
        ([ALIENGO_URDF, "--rotor", "tail*=1,1"], 2, "names no moving joint"),
        ([ALIENGO_URDF, "--mesh-dirs", "none"], 2, "--mesh-dirs none: expected a folder"),
        (["--mesh-dirs", "none", ALIENGO_URDF], 2, "--mesh-dirs none: expected a folder"),
        (["--mesh-dirs", "none"], 2, "no URDF; expected the path of one"),
        ([ALIENGO_URDF, "--fix", "tail"], 2, "--fix tail: names no joint"),
        ([ALIENGO_URDF, "--effort", "0"], 2, "--effort is 0.0; expected more than 0"),
    ],
)
def test_bad_use_is_one_line(capsys, arguments, status, says):
    with pytest.raises(UserError) as caught:
        main([*map(str, arguments)])
    assert caught.value.exit_status == status
    assert says in str(caught.value)
    assert capsys.readouterr() == ("", "")


def write_changed(path: Path, old: str, new: str) -> str:
    """Write AlienGo's URDF with every `old` replaced, and return the file's name."""
    text = ALIENGO_URDF.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return str(path)


def test_lines_name_the_flags_of_this_command_and_these_do_what_is_said(tmp_path, capsys):
    file = write_changed(tmp_path / "a.urdf", 'effort="44.4"', "")
    out = ["-o", str(tmp_path / "a.xml")]
    main([file, *out])
    assert "no: has no effort limit for 'FR_calf_joint'" in (err := capsys.readouterr().err)
    assert err.endswith("or pass --effort NM\n")
    main([file, *out, "--effort", "44.4"])
    assert capsys.readouterr().err.endswith("trains as a quadruped: yes\n")
    body = XML.read_text().partition("-->")[2]
    assert (tmp_path / "a.xml").read_text().partition("-->")[2] == body
    broken = write_changed(tmp_path / "b.urdf", 'ixx="0.051944892"', 'ixx="5"')
    with pytest.raises(UserError, match=r"\(or pass --repair-inertia\)$"):
        main([broken, *out])


@pytest.mark.parametrize("flag", ["--mesh-dirs", "--fix"])
def test_a_list_before_the_urdf_leaves_it_its_place(tmp_path, flag):
    value = {"--mesh-dirs": str(tmp_path), "--fix": "imu_joint"}[flag]
    main(["-q", "-o", str(tmp_path / "a.xml"), flag, value, str(ALIENGO_URDF)])
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    assert (model.nv, model.nu) == (18, 12)


def test_the_command_runs_and_draws(tmp_path: Path):
    run = [sys.executable, "-m", "quadwalk", "robot", str(ALIENGO_URDF), "--quiet", "--render"]
    done = subprocess.run([*run, "out.png"], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    picture = np.asarray(Image.open(tmp_path / "out.png"))
    assert picture.shape == (800, 1280, 3)
    orange = (picture[..., 0] > 200) & (picture[..., 1] < 150) & (picture[..., 2] < 75)
    assert 0.005 < orange.mean() < 0.3  # the robot is in the picture, and does not fill it
    assert picture.mean() > 80  # in daylight


def test_a_robot_is_drawn_with_its_meshes(tmp_path):
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    trimesh.convex.convex_hull(corners).export(tmp_path / "cube.stl")
    picture = {}
    for name, geometry in (("box", "box size='1 1 1'"), ("mesh", "mesh filename='cube.stl'")):
        red = "<material name='red'><color rgba='0.8 0.1 0.1 1'/></material>"
        visual = f"<visual><geometry><{geometry}/></geometry>{red}</visual>"
        text = f"<robot name='r'><link name='a'>{visual}</link></robot>"
        (tmp_path / f"{name}.urdf").write_text(text)
        main([str(tmp_path / f"{name}.urdf"), "-q", "--render", str(tmp_path / f"{name}.png")])
        picture[name] = np.asarray(Image.open(tmp_path / f"{name}.png")).astype(int)
    assert np.abs(picture["box"] - picture["mesh"]).mean() < 0.5
    assert (picture["mesh"][..., 0] > 2 * picture["mesh"][..., 1]).mean() > 0.05
