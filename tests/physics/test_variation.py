"""MuJoCo C as an engine of robots that differ, against models that are changed one by one."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from quadwalk.physics import mujoco_c
from quadwalk.physics.model import RobotRandomization
from quadwalk.physics.motor import Stepping
from quadwalk.task.env import QuadrupedEnv


def test_each_robot_of_a_batch_is_another(env):
    steps = dataclasses.replace(env.stepping, dt=mujoco_c.TIMESTEP, substeps=3)
    assert isinstance(steps, Stepping)
    judge = QuadrupedEnv(env.quadruped, env.config, "mujoco")
    rng = np.random.default_rng(0)
    links = rng.uniform(0.8, 1.2, (3, 12))
    rows = RobotRandomization(
        friction=np.array([0.3, 0.8, 1.2]), trunk_mass=np.array([-1.0, 0.0, 5.0]),
        trunk_center=rng.uniform(-0.05, 0.05, (3, 3)), link_mass=links,
        strength=np.array([0.7, 1.0, 1.1]), kp=np.array([0.8, 1.0, 1.2]),
        kd=np.array([1.2, 1.0, 0.8]), joint_friction=np.array([0.5, 1.0, 2.0]),
        damping=np.array([0.5, 1.0, 3.0]), armature=np.array([0.8, 1.0, 1.5]),
    )  # fmt: skip
    rows = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), rows)
    state = jax.jit(env.reset)(jax.random.PRNGKey(0)).pipeline_state.physics
    target = jnp.asarray(env.robot.home_joints + 0.2, jnp.float32)

    def control_step(variation):
        model = mujoco_c.vary(judge.model, variation)
        return mujoco_c.control_step(model, steps, state, target)[0]

    found = jax.jit(jax.vmap(control_step))(rows)
    motor, dog = env.motor, env.quadruped
    for k in range(3):
        row = jax.tree.map(lambda x, k=k: np.asarray(x[k], float), rows)
        model = judge.mj_model_of(judge.quadruped)
        model.geom_friction[:, 0] = row.friction
        model.body_mass[1] += row.trunk_mass
        model.body_ipos[1] += row.trunk_center
        for joint, factor in zip(dog.joints, row.link_mass, strict=True):
            body = model.jnt_bodyid[model.joint(joint).id]
            model.body_mass[body] *= factor
            model.body_inertia[body] *= factor
        model.dof_armature[6:] *= row.armature
        model.dof_damping[6:] *= row.damping
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        data.qpos[:], data.qvel[:] = state.qpos, state.qvel
        for _ in range(3):
            qd = data.qvel[6:].copy()
            torque = row.kp * motor.kp * (np.asarray(target) - data.qpos[7:])
            torque -= row.kd * motor.kd * qd
            upper = dog.effort * np.clip(1 - qd / dog.velocity, 0, 1)
            lower = -dog.effort * np.clip(1 + qd / dog.velocity, 0, 1)
            torque = row.strength * np.clip(torque, lower, upper)
            rub = row.joint_friction * dog.friction * np.tanh(qd / 0.1)
            data.qfrc_applied[6:] = torque - rub
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(found.qpos[k], data.qpos, atol=1e-5)
        np.testing.assert_allclose(found.qvel[k], data.qvel, atol=2e-3)
    assert np.ptp(found.qvel, axis=0).max() > 0.1
