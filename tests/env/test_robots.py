"""The environment of other quadrupeds: all that differs follows from the robot."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.env.env import QuadrupedEnv
from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.tasks import sprint
from tests.robot import zoo

NO_VARIETY = dataclasses.replace(
    sprint.TASK.env.reset, yaw=0, tilt=0, offset=0, joints=0, velocity=0, joint_velocity=0
)


def stands_for_a_second(urdf, options: Options | None = None) -> None:
    """Assert that a robot stays up for 1 s, from rest in its home pose and with action 0."""
    env = QuadrupedEnv(
        load_quadruped(urdf, options), dataclasses.replace(sprint.TASK.env, reset=NO_VARIETY)
    )
    state = jax.jit(env.reset)(jax.random.PRNGKey(0))

    def step(state, _):
        state = env.step(state, jnp.zeros(12))
        return state, (state.info["end"], state.pipeline_state.physics.qpos, state.info["torque"])

    _, (ends, qpos, torque) = jax.jit(lambda s: jax.lax.scan(step, s, None, length=50))(state)
    assert {env.ends[end] for end in np.asarray(ends)} == {"running"}
    assert np.asarray(qpos)[-1, 2] > 0.75 * env.robot.home_height
    assert (np.abs(torque) <= env.quadruped.effort * (1 + 1e-5)).all()
    # The gains hold every robot alike: its weight sags the legs by the same small share.
    weight = env.mj_model.body_mass.sum() * 9.81
    np.testing.assert_allclose(env.motor.kp, 1.4 * weight * env.robot.home[2], rtol=1e-6)


def test_other_quadrupeds_stand_in_the_environment(reference_urdf):
    stands_for_a_second(reference_urdf)


@zoo.repeat_for(zoo.QUADRUPEDS, "a1", "hyq")
def test_quadrupeds_of_the_zoo_stand_in_the_environment(urdf):
    stands_for_a_second(urdf, Options(meshes=False))
