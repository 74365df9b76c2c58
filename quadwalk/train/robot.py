"""The robot that a configuration names, and all that is trained on it."""

from typing import Any

from quadwalk.robot.mjcf import Options, write_xml
from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.settings.serialize import task_source, to_dict
from quadwalk.settings.training import RobotConfig, TrainConfig
from quadwalk.task_files import OWN
from quadwalk.train.runs.checkpoint import sha256


def load_robot(config: RobotConfig) -> Quadruped:
    """The robot that `config` names; `UrdfError` where it is none that can be trained."""
    options = Options(mesh_folders=config.mesh_dirs, effort=config.effort, speed=config.speed)
    return load_quadruped(config.urdf, options, config.repair_inertia)


def content(config: TrainConfig, quadruped: Quadruped) -> dict[str, Any]:
    """What is trained, with `quadruped` as its robot: the same wherever the files are."""
    parts = {name: to_dict(getattr(config, name)) for name in ("robot", "env", "ppo")}
    del parts["robot"]["mesh_dirs"]
    parts["robot"]["urdf"] = quadruped.urdf
    if config.env.ground.file is not None:
        parts["env"]["ground"]["file"] = sha256(config.env.ground.file)
    model = quadruped.spec.copy()  # which has the meshes
    model.comment = ""  # that names the URDF's file
    return {**parts, "model": write_xml(model), OWN: task_source(config)}
