"""The floor's push on the feet, from MuJoCo C's contacts."""

import dataclasses

import mujoco
import numpy as np

from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.rollout import Rollout
from quadwalk.physics import mujoco_c
from quadwalk.physics.model import randomize_motor
from quadwalk.physics.motor import compute_friction_torque, compute_motor_torque


def add_foot_forces(rollout: Rollout, env: QuadrupedEnv) -> Rollout:
    """Return `rollout` with its `foot_force`, N: the floor's push on each foot along its normal.

    MuJoCo C computes it in each state from the motors' torques, on the model that the engine
    stepped. That takes some 0.2 s for 20 s of running, so only rollouts that are shown have it.
    """
    qpos, qvel = rollout.qpos[1:], rollout.qvel[1:]
    motor, joint_speed, model = env.motor, qvel[:, 6:], env.make_mj_model(env.quadruped)
    if rollout.conditions is not None and rollout.conditions.variation is not None:
        motor = randomize_motor(motor, rollout.conditions.variation)
        model = mujoco_c.randomize_model(model, rollout.conditions.variation)
    target = rollout.target if rollout.applied_target is None else rollout.applied_target
    torque = np.asarray(
        compute_motor_torque(motor, target, qpos[:, 7:], joint_speed)
        + compute_friction_torque(motor, joint_speed)
    )
    data = mujoco.MjData(model)
    geoms = find_floor_and_feet(model, env.quadruped.feet)
    forces = np.zeros((rollout.steps, 4))
    for row in range(rollout.steps):
        data.qpos, data.qvel = qpos[row], qvel[row]
        data.qfrc_applied[6:] = torque[row]  # not by actuators, whose limits are the model's own
        mujoco.mj_forward(model, data)
        forces[row] = compute_foot_forces(model, data, geoms)
    return dataclasses.replace(rollout, foot_force=forces)


def find_floor_and_feet(model: mujoco.MjModel, feet: tuple[str, ...]) -> tuple[int, ...]:
    """Return the indices of the floor's geom and of the geoms called `feet`, five in all."""
    return tuple(int(model.geom(name).id) for name in ("floor", *feet))


def compute_foot_forces(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: tuple[int, ...]
) -> np.ndarray:
    """Return the floor's push on each foot along its normal, (4,) N, from the contacts of `data`.

    `geoms` are those of `find_floor_and_feet`.
    """
    floor, *feet = geoms
    columns = {foot: k for k, foot in enumerate(feet)}
    forces, contact = np.zeros(4), np.zeros(6)
    for i, (a, b) in enumerate(data.contact.geom[: data.ncon]):
        column = columns.get(int(b) if a == floor else int(a))
        if column is not None and floor in (a, b):
            # The contact frame's x axis is the floor's normal, up or down.
            mujoco.mj_contactForce(model, data, i, contact)
            forces[column] += contact[0]
    return forces
