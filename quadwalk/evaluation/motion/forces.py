"""The floor's push on the feet, from MuJoCo C's contacts."""

import dataclasses

import mujoco
import numpy as np

from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.rollout import Rollout
from quadwalk.physics import mujoco_c
from quadwalk.physics.model import randomize_motor
from quadwalk.physics.motor import compute_friction_torque, compute_motor_torque


def with_foot_forces(rollout: Rollout, env: QuadrupedEnv) -> Rollout:
    """`rollout` with its `foot_force`, N: the floor's push on each foot, normal to the floor.

    Those of each state, with the motors' torques at that moment, in MuJoCo C on the model that the
    engine stepped. Some 0.2 s for 20 s of running, so it is left to the rollouts that are shown.
    """
    qpos, qvel = rollout.qpos[1:], rollout.qvel[1:]
    motor, joint_speed, model = env.motor, qvel[:, 6:], env.mj_model_of(env.quadruped)
    if rollout.conditions is not None and rollout.conditions.variation is not None:
        motor = randomize_motor(motor, rollout.conditions.variation)
        model = mujoco_c.randomize_model(model, rollout.conditions.variation)
    target = rollout.target if rollout.applied_target is None else rollout.applied_target
    torque = np.asarray(
        compute_motor_torque(motor, target, qpos[:, 7:], joint_speed)
        + compute_friction_torque(motor, joint_speed)
    )
    data = mujoco.MjData(model)
    feet = geom_ids(model, env.quadruped.feet)
    forces = np.zeros((rollout.steps, 4))
    for row in range(rollout.steps):
        data.qpos, data.qvel = qpos[row], qvel[row]
        data.qfrc_applied[6:] = torque[row]  # not by actuators, whose limits are the model's own
        mujoco.mj_forward(model, data)
        forces[row] = foot_forces(model, data, feet)
    return dataclasses.replace(rollout, foot_force=forces)


def geom_ids(model: mujoco.MjModel, feet: tuple[str, ...]) -> tuple[int, ...]:
    """The floor's geom and those of `feet`."""
    return tuple(int(model.geom(name).id) for name in ("floor", *feet))


def foot_forces(model: mujoco.MjModel, data: mujoco.MjData, geoms: tuple[int, ...]) -> np.ndarray:
    """(4,) N, the floor's push on each foot along its normal, by `data`; `geoms` are `geom_ids`."""
    floor, *feet = geoms
    column = {foot: k for k, foot in enumerate(feet)}
    forces, contact = np.zeros(4), np.zeros(6)
    for i, (a, b) in enumerate(data.contact.geom[: data.ncon]):
        foot = column.get(int(b) if a == floor else int(a))
        if foot is not None and floor in (a, b):
            # The contact frame's x axis is the floor's normal, up or down.
            mujoco.mj_contactForce(model, data, i, contact)
            forces[foot] += contact[0]
    return forces
