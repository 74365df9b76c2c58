import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadwalk.physics.motor import friction_torque, gains, joint_target, motor_torque
from quadwalk.task.config import ActuationConfig

CONFIG = ActuationConfig(kp=100.0, kd=0.0)


def torque(env, error: float, speed: float, config: ActuationConfig = CONFIG) -> np.ndarray:
    """Torque of all 12 motors for one position error and joint speed."""
    q = jnp.zeros(12)
    return np.asarray(motor_torque(env.robot, config, q + error, q, q + speed))


def test_within_the_limits_the_controller_is_proportional_and_derivative(env):
    config = ActuationConfig(kp=100.0, kd=3.0)
    np.testing.assert_allclose(torque(env, 0.1, 1.0, config), 100 * 0.1 - 3 * 1.0, rtol=1e-6)


def test_gains_follow_from_the_robot_unless_set(env):
    assert gains(env.robot, ActuationConfig()) == pytest.approx((120.0, 3.0), rel=0.01)
    light = dataclasses.replace(env.robot, weight=env.robot.weight / 2)
    assert gains(light, ActuationConfig()) == pytest.approx((60.0, 1.5), rel=0.01)
    assert gains(env.robot, ActuationConfig(kp=30.0)) == pytest.approx((30.0, 0.75))
    assert gains(env.robot, ActuationConfig(kp=30.0, kd=0.0)) == (30.0, 0.0)


@pytest.mark.parametrize(
    ("error", "speed", "hip", "calf"),
    [
        (10.0, 0.0, 35.278, 44.4),  # stall
        (-10.0, 0.0, -35.278, -44.4),
        (10.0, 10.0, 35.278 / 2, 44.4 * (1 - 10 / 15.89)),  # driving at half the hip's top speed
        (-10.0, -10.0, -35.278 / 2, -44.4 * (1 - 10 / 15.89)),
        (10.0, 25.0, 0.0, 0.0),  # driving beyond top speed
        (-10.0, 25.0, -35.278, -44.4),  # braking
        (10.0, -25.0, 35.278, 44.4),
    ],
)
def test_motors_follow_their_torque_speed_line(env, error, speed, hip, calf):
    expected = np.tile([hip, hip, calf], 4)
    np.testing.assert_allclose(torque(env, error, speed), expected, rtol=1e-5, atol=1e-5)


def test_without_the_speed_limit_only_the_effort_holds(env):
    config = ActuationConfig(kp=100.0, kd=0.0, speed_limit=False)
    np.testing.assert_allclose(torque(env, 10.0, 30.0, config), env.robot.effort, rtol=1e-6)


@settings(deadline=None)
@given(st.floats(-5, 5), st.floats(-60, 60), st.floats(0, 500), st.floats(0, 20))
def test_no_motor_ever_leaves_its_limits(env, error, speed, kp, kd):
    result = torque(env, error, speed, ActuationConfig(kp=kp, kd=kd))
    share = np.abs(result) / env.robot.effort
    assert (share <= 1 + 1e-5).all()
    driving = result * speed > 0
    allowed = np.clip(1 - abs(speed) / env.robot.velocity, 0, 1)
    assert (share[driving] <= allowed[driving] + 1e-5).all()


def test_targets_lie_about_the_home_pose_and_within_the_joints_limits(env):
    robot = env.robot
    q = jnp.zeros(12)  # does not matter
    still = joint_target(robot, CONFIG, jnp.zeros(12), q)
    np.testing.assert_allclose(still, robot.home_joints, rtol=1e-6)
    wide = ActuationConfig(hip_range=5.0, thigh_range=5.0, calf_range=5.0)
    np.testing.assert_allclose(joint_target(robot, wide, jnp.ones(12), q), robot.upper, rtol=1e-6)
    np.testing.assert_allclose(joint_target(robot, wide, -jnp.ones(12), q), robot.lower, rtol=1e-6)


def test_targets_over_a_range_and_near_the_joint(env):
    config = ActuationConfig(
        targets="range", hip_bounds=(-1, 1), thigh_bounds=(0, 2), calf_bounds=(-2, -1)
    )
    for action, expected in [
        (-1, (-1, 0, -2)),
        (0, (0, 1, -1.5)),
        (1, (1, 2, -1)),
        (0.5, (0.5, 1.5, -1.25)),
    ]:
        found = joint_target(env.robot, config, jnp.full(12, action), jnp.zeros(12))
        np.testing.assert_allclose(found, np.tile(expected, 4), rtol=1e-6)
    for targets, wanted in [("range", (1, 2, -1)), ("home", (0.3, 1.7, -0.7))]:
        near = dataclasses.replace(config, targets=targets, step_limit=0.1)
        for q, side in [(-5.0, 0.1), (5.0, -0.1)]:
            found = joint_target(env.robot, near, jnp.ones(12), jnp.full(12, q))
            np.testing.assert_allclose(found, q + side, rtol=1e-6)
        q = jnp.tile(jnp.array(wanted), 4) + 0.05
        found = joint_target(env.robot, near, jnp.ones(12), q)
        np.testing.assert_allclose(found, np.tile(wanted, 4), atol=2e-3)


def test_friction_opposes_motion_up_to_its_coulomb_value(env):
    fast = np.asarray(friction_torque(env.robot, CONFIG, jnp.full(12, 5.0)))
    np.testing.assert_allclose(fast, -env.robot.friction, rtol=1e-6)
    assert (env.robot.friction > 0).all()
    back = np.asarray(friction_torque(env.robot, CONFIG, jnp.full(12, -5.0)))
    np.testing.assert_allclose(back, -fast)
    off = ActuationConfig(joint_friction=False)
    assert not np.asarray(friction_torque(env.robot, off, jnp.full(12, 5.0))).any()
