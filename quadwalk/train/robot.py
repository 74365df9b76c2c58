"""The robot that a configuration or a run names."""

from pathlib import Path

from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.train.runs.directory import Run
from quadwalk.train.settings import RobotConfig


def load_robot(config: RobotConfig) -> Quadruped:
    """The robot that `config` names; `UrdfError` where it is none that can be trained."""
    return _load(config.urdf, config, config.mesh_dirs)


def load_run_robot(run: Run, config: RobotConfig) -> Quadruped:
    """The robot of a run, from the run's own copy; its mesh files, if any, are where they were."""
    folders = (config.urdf.parent, *config.mesh_dirs)
    return _load(run.urdf, config, folders)


def _load(urdf: Path, config: RobotConfig, folders: tuple[Path, ...]) -> Quadruped:
    options = Options(mesh_folders=folders, effort=config.effort, speed=config.speed)
    return load_quadruped(urdf, options, config.repair_inertia)
