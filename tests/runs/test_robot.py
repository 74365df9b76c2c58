"""The robot of a run: found again with its meshes and settings, and known when it is another."""

import dataclasses
import json
from pathlib import Path

import pytest
import trimesh

from quadwalk.learn.flags import parse_config
from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.load import load_robot
from quadwalk.robot.report import UrdfError
from quadwalk.runs.directory import Run
from quadwalk.runs.resume import compare_robot, make_run, read_config
from quadwalk.settings.training import RobotConfig
from quadwalk.tasks.sprint import TASK

BOX = '<box size="0.647 0.15 0.112"/>'


@pytest.fixture
def start(tmp_path):
    """Return a function that makes a run of a robot.

    That one returns the run, and the robot's settings in its files.
    """

    def make(config: RobotConfig) -> tuple[Run, RobotConfig]:
        settings = dataclasses.replace(TASK, robot=config, runs=tmp_path, name="run")
        run = make_run(settings, load_robot(config))
        return run, read_config(run).robot

    return make


def test_a_run_finds_its_meshes_and_says_where_its_robot_is_another_one(tmp_path, start):
    """Check that meshes that moved leave the trunk without a shape.

    A mesh that is only seen may go.
    """
    home = tmp_path / "robots"
    (home / "meshes").mkdir(parents=True)
    for name in ("trunk", "cover"):
        trimesh.creation.box((0.647, 0.15, 0.112)).export(home / "meshes" / f"{name}.stl")
    cover = '<visual><geometry><mesh filename="meshes/cover.stl"/></geometry></visual>'
    text = ALIENGO_URDF.read_text()
    assert text.count(BOX) == 1
    text = text.replace(BOX, '<mesh filename="meshes/trunk.stl"/>')
    text = text.replace('<link name="trunk">', f'<link name="trunk">{cover}')
    (home / "dog.urdf").write_text(text)
    run, config = start(RobotConfig(urdf=home / "dog.urdf"))
    assert config.urdf == run.urdf  # apart from the meshes that it names

    def check(meshes: int, is_same: bool) -> None:
        robot = load_robot(config)
        assert robot.make_full_model().nmesh == meshes
        lines = compare_robot(run, robot)
        assert len(lines) == (not is_same)
        for line in lines:
            assert line.startswith(f"warning: {run.path} was trained on another robot than it has")
            missing = "dropped: collision meshes that were not found: meshes/trunk.stl"
            assert missing in robot.notes

    check(2, is_same=True)
    (home / "meshes" / "cover.stl").unlink()
    check(1, is_same=True)
    (home / "meshes").rename(home / "moved")
    check(0, is_same=False)
    (home / "moved").rename(run.path / "meshes")  # beside its own URDF they are found
    check(1, is_same=True)
    (run.path / "meshes").rename(home / "moved")
    about = json.loads(run.config.read_text())
    run.config.write_text(json.dumps({name: about[name] for name in ("config", "versions")}))
    check(0, is_same=True)  # a run of before there was a hash


def test_a_run_keeps_the_joints_of_its_robot_that_were_fixed(tmp_path, start):
    inertia = '<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/>'
    head = f"""<link name="head"><inertial><mass value="1"/>{inertia}</inertial></link>
    <joint name="neck" type="continuous"><parent link="trunk"/><child link="head"/></joint>
    </robot>"""
    (tmp_path / "dog.urdf").write_text(ALIENGO_URDF.read_text().replace("</robot>", head))
    flags = ["walk", "--robot.urdf", str(tmp_path / "dog.urdf"), "--robot.fix", "imu*", "neck"]
    config = parse_config(flags)[0].robot
    for settings in (config, start(config)[1]):
        model = load_robot(settings).make_full_model()
        assert model.nv == 18
        assert model.body("trunk").mass == pytest.approx(11.644 + 1)


def test_a_run_keeps_what_its_robot_was_given(tmp_path: Path, start):
    """Check motors that the URDF does not have, and leave to repair an inertia."""
    urdf = tmp_path / "dog.urdf"
    text = ALIENGO_URDF.read_text().replace('effort="44.4"', 'effort="0"')
    urdf.write_text(text.replace('ixx="0.051944892"', 'ixx="0.5519"'))
    with pytest.raises(UrdfError, match="repair-inertia"):
        load_robot(RobotConfig(urdf=urdf, effort=30))
    with pytest.raises(UrdfError, match=r"pass --robot\.effort NM$"):
        load_robot(RobotConfig(urdf=urdf, repair_inertia=True))
    config = RobotConfig(urdf=urdf, effort=30, repair_inertia=True)
    for robot in map(load_robot, (config, start(config)[1])):
        assert list(robot.effort[:3]) == [35.278, 35.278, 30]
        assert any(note.startswith("repaired: inertia of 'trunk'") for note in robot.notes)
