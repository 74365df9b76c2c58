import shutil

import pytest
import trimesh

from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.urdf import UrdfError
from quadwalk.train.robot import load_robot, load_run_robot
from quadwalk.train.runs.directory import Run
from quadwalk.train.settings import RobotConfig

BOX = '<box size="0.647 0.15 0.112"/>'


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
    copy = load_run_robot(run, config)
    for robot in (original, copy):
        assert robot.full_model().nmesh == 1
    with pytest.raises(UrdfError, match=r"trunk\.stl"):
        load_robot(RobotConfig(urdf=run.urdf))
    elsewhere = RobotConfig(urdf=run.urdf, mesh_dirs=(home,))
    assert load_robot(elsewhere).full_model().nmesh == 1
