"""The robot that a configuration or a run names."""

from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.train.runs.directory import Run
from quadwalk.train.settings import RobotConfig


def load_robot(config: RobotConfig) -> Quadruped:
    """The robot that `config` names; `UrdfError` where it is none that can be trained."""
    return load_quadruped(config.urdf, Options(mesh_folders=config.mesh_dirs))


def load_run_robot(run: Run, config: RobotConfig) -> Quadruped:
    """The robot of a run, from the run's own copy; its mesh files, if any, are where they were."""
    folders = (config.urdf.parent, *config.mesh_dirs)
    return load_quadruped(run.urdf, Options(mesh_folders=folders))
