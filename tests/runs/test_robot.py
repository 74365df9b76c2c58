import dataclasses
import json
import shutil

import pytest
import trimesh

from quadwalk.learn.flags import parse_config
from quadwalk.learn.prepare import make_run
from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.load import load_robot
from quadwalk.robot.report import UrdfError
from quadwalk.runs.directory import Run
from quadwalk.runs.resume import compare_robot, restore_config
from quadwalk.settings.serialize import to_dict
from quadwalk.settings.training import RobotConfig
from quadwalk.tasks.sprint import TASK

BOX = '<box size="0.647 0.15 0.112"/>'


def as_in(run: Run, robot: RobotConfig) -> RobotConfig:
    """`robot`, as the configuration of a run that was trained on it has it."""
    return restore_config(to_dict(dataclasses.replace(TASK, robot=robot)), run, "here", "0.2").robot


def test_a_run_finds_the_mesh_files_of_its_robot(tmp_path):
    """A run's copy of a URDF lies apart from the meshes that it names."""
    home, run = tmp_path / "robots", Run(tmp_path / "run")
    (home / "meshes").mkdir(parents=True)
    run.path.mkdir()
    trimesh.creation.box((0.647, 0.15, 0.112)).export(home / "meshes" / "trunk.stl")
    text = ALIENGO_URDF.read_text()
    assert text.count(BOX) == 1
    (home / "dog.urdf").write_text(text.replace(BOX, '<mesh filename="meshes/trunk.stl"/>'))
    config = RobotConfig(urdf=home / "dog.urdf")
    original = load_robot(config)
    shutil.copy(home / "dog.urdf", run.urdf)
    copy = load_robot(as_in(run, config))
    for robot in (original, copy):
        assert robot.make_full_model().nmesh == 1
    without = load_robot(RobotConfig(urdf=run.urdf))
    assert without.make_full_model().nmesh == 0
    missing = "meshes that were not found: meshes/trunk.stl"
    assert without.notes[0] == f"dropped: collision {missing}"
    elsewhere = RobotConfig(urdf=run.urdf, mesh_dirs=(home,))
    assert load_robot(elsewhere).make_full_model().nmesh == 1


def test_a_run_says_that_its_robot_is_another_one(tmp_path):
    """Meshes that moved leave the trunk without a shape; what only shows may go."""
    home = tmp_path / "robots"
    (home / "meshes").mkdir(parents=True)
    for name in ("trunk", "cover"):
        trimesh.creation.box((0.647, 0.15, 0.112)).export(home / "meshes" / f"{name}.stl")
    cover = '<visual><geometry><mesh filename="meshes/cover.stl"/></geometry></visual>'
    text = ALIENGO_URDF.read_text().replace(BOX, '<mesh filename="meshes/trunk.stl"/>')
    text = text.replace('<link name="trunk">', f'<link name="trunk">{cover}')
    (home / "dog.urdf").write_text(text)
    config = RobotConfig(urdf=home / "dog.urdf")
    settings = dataclasses.replace(TASK, robot=config, runs=tmp_path, name="run")
    run = make_run(settings, load_robot(config))
    here = as_in(run, config)
    assert compare_robot(run, load_robot(here)) == ()
    (home / "meshes" / "cover.stl").unlink()
    assert compare_robot(run, load_robot(here)) == ()
    (home / "meshes").rename(home / "moved")
    (line,) = compare_robot(run, load_robot(here))
    assert line.startswith(f"warning: {run.path} was trained on another robot than it has now")
    (home / "moved").rename(run.path / "meshes")  # beside its own URDF they are found
    assert compare_robot(run, load_robot(here)) == ()
    (run.path / "meshes").rename(home / "moved")
    about = json.loads(run.config.read_text())
    run.config.write_text(json.dumps({name: about[name] for name in ("config", "versions")}))
    assert compare_robot(run, load_robot(here)) == ()  # one of before there was a hash


def test_a_run_keeps_the_joints_of_its_robot_that_were_fixed(tmp_path):
    run = Run(tmp_path / "run")
    run.path.mkdir()
    inertia = '<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/>'
    head = f"""<link name="head"><inertial><mass value="1"/>{inertia}</inertial></link>
    <joint name="neck" type="continuous"><parent link="trunk"/><child link="head"/></joint>
    </robot>"""
    (tmp_path / "dog.urdf").write_text(ALIENGO_URDF.read_text().replace("</robot>", head))
    flags = ["walk", "--robot.urdf", str(tmp_path / "dog.urdf"), "--robot.fix", "imu*", "neck"]
    config = parse_config(flags)[0].robot
    original = load_robot(config)
    run.urdf.write_text(original.urdf)
    copy = load_robot(as_in(run, config))
    for robot in (original, copy):
        model = robot.make_full_model()
        assert model.nv == 18
        assert model.body("trunk").mass == pytest.approx(11.644 + 1)


def test_a_run_keeps_what_its_robot_was_given(tmp_path):
    """Motors that the URDF has none of, and leave to repair an inertia."""
    run = Run(tmp_path)
    text = ALIENGO_URDF.read_text().replace('effort="44.4"', 'effort="0"')
    run.urdf.write_text(text.replace('ixx="0.051944892"', 'ixx="0.5519"'))
    with pytest.raises(UrdfError, match="repair-inertia"):
        load_robot(RobotConfig(urdf=run.urdf, effort=30))
    with pytest.raises(UrdfError, match=r"pass --robot\.effort NM$"):
        load_robot(RobotConfig(urdf=run.urdf, repair_inertia=True))
    config = RobotConfig(urdf=run.urdf, effort=30, repair_inertia=True)
    for robot in (load_robot(config), load_robot(as_in(run, config))):
        assert list(robot.effort[:3]) == [35.278, 35.278, 30]
        assert any(note.startswith("repaired: inertia of 'trunk'") for note in robot.notes)
