"""The robot that settings name."""

import hashlib
import json

import numpy as np

from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.settings.training import RobotConfig


def load_robot(config: RobotConfig) -> Quadruped:
    """Load the robot that `config` names; `UrdfError` where it is none that can be trained."""
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
