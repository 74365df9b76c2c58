"""The robot that a configuration names, and all that is trained on it."""

import hashlib
import json
from typing import Any

import numpy as np

from quadwalk.errors import UserError
from quadwalk.files import DAMAGE, read_bytes
from quadwalk.robot.mjcf import Options, write_xml
from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.runs.checkpoint import sha256
from quadwalk.runs.directory import Run
from quadwalk.settings.serialize import task_source, to_dict
from quadwalk.settings.training import RobotConfig, TrainConfig
from quadwalk.task_files import OWN

ROBOT_HASH = "robot_sha256"  # in a run's config.json


def load_robot(config: RobotConfig) -> Quadruped:
    """The robot that `config` names; `UrdfError` where it is none that can be trained."""
    options = Options(mesh_folders=config.mesh_dirs, effort=config.effort, speed=config.speed)
    return load_quadruped(config.urdf, options, config.repair_inertia, config.fix)


def hash_robot(quadruped: Quadruped) -> str:
    """Return the SHA-256 of what moves a robot: masses, joints, motors and shapes that collide.

    It is the same wherever the robot's files are, and whatever it looks like.
    """
    model = quadruped.make_full_model(visuals=False)
    shapes = model.geom_bodyid > 0
    arrays = (
        *(model.body_mass, model.body_inertia, model.body_ipos, model.body_pos),
        *(model.jnt_axis, model.jnt_range, model.dof_armature, model.dof_damping),
        *(model.geom_type[shapes], model.geom_bodyid[shapes], model.geom_rbound[shapes]),
        *(quadruped.effort, quadruped.velocity, quadruped.friction, quadruped.home),
    )
    # To five digits, for the last ones differ from machine to machine.
    rows = [[f"{x + 0.0:.5g}" for x in np.round(array, 9).ravel()] for array in arrays]
    return hashlib.sha256(json.dumps([quadruped.joints, rows]).encode()).hexdigest()


def compare_robot(run: Run, quadruped: Quadruped) -> tuple[str, ...]:
    """Return a line that says so where a run's robot is not the one that it was trained on.

    A run that does not tell the hash of its robot is taken as it is.
    """
    try:
        trained = json.loads(read_bytes(run.config)).get(ROBOT_HASH)
    except (*DAMAGE, UserError):
        trained = None
    if trained is None or trained == hash_robot(quadruped):
        return ()
    return (
        f"warning: {run.path} was trained on another robot than it has now, in masses, joints, "
        "motors or shapes: expected the same robot.urdf, and mesh files where they were or in "
        f"{run.path}",
    )


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
