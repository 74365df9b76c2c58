"""How hard the feet push on the floor: from a rollout's states, for those who want to see it."""

import dataclasses

import mujoco
import numpy as np

from quadwalk.evaluate.rollout import Rollout
from quadwalk.evaluate.simulate import Engine, engine_model
from quadwalk.physics.motor import friction_torque, motor_torque
from quadwalk.task.env import QuadrupedEnv


def with_foot_forces(rollout: Rollout, env: QuadrupedEnv, engine: Engine) -> Rollout:
    """`rollout` with its `foot_force`, N: the floor's push on each foot, normal to the floor.

    Those of each state, with the motors' torques at that moment, in MuJoCo C on the model that
    `engine` stepped. Some 0.2 s for 20 s of running, so it is left to the rollouts that are shown.
    """
    qpos, qvel = rollout.qpos[1:], rollout.qvel[1:]
    actuation, joint_speed = env.config.actuation, qvel[:, 6:]
    torque = np.asarray(
        motor_torque(env.robot, actuation, rollout.target, qpos[:, 7:], joint_speed)
    )
    friction = np.asarray(friction_torque(env.robot, actuation, joint_speed))
    model = engine_model(env, engine)
    data = mujoco.MjData(model)
    column = {model.geom(name).id: k for k, name in enumerate(env.quadruped.feet)}
    floor = model.geom("floor").id
    forces = np.zeros((rollout.steps, 4))
    contact = np.zeros(6)
    for row in range(rollout.steps):
        data.qpos, data.qvel = qpos[row], qvel[row]
        data.ctrl, data.qfrc_applied[6:] = torque[row], friction[row]
        mujoco.mj_forward(model, data)
        for i, (a, b) in enumerate(data.contact.geom[: data.ncon]):
            foot = column.get(int(b) if a == floor else int(a))
            if foot is not None and floor in (a, b):
                # The contact frame's x axis is the floor's normal, up or down.
                mujoco.mj_contactForce(model, data, i, contact)
                forces[row, foot] += contact[0]
    return dataclasses.replace(rollout, foot_force=forces)
