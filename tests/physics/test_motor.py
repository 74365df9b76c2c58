"""Torques of the motors, in JAX and in NumPy."""

import copy

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadwalk.physics.motor import (
    Motor,
    MotorConfig,
    compute_friction_torque,
    compute_joint_inertia,
    compute_motor_torque,
    make_motor,
)

PROPORTIONAL = MotorConfig(kp=100.0, kd=0.0)


@pytest.fixture(scope="module")
def model(quadruped) -> mujoco.MjModel:
    return quadruped.make_training_model(0.004)


@pytest.fixture(scope="module")
def motors(quadruped, model):
    """MotorConfig -> Motor, of the AlienGo."""
    return lambda config=PROPORTIONAL: make_motor(model, quadruped, config)


def torque(motor: Motor, error: float, speed: float) -> np.ndarray:
    """Torque of all 12 motors for one position error and joint speed."""
    q = np.zeros(12)
    found = compute_motor_torque(motor, q + error, q, q + speed)
    assert isinstance(found, np.ndarray)
    in_jax = compute_motor_torque(
        motor, jnp.asarray(q + error), jnp.asarray(q), jnp.asarray(q + speed)
    )
    np.testing.assert_allclose(in_jax, found, rtol=1e-5, atol=1e-3)
    return found


def test_within_the_limits_the_controller_is_proportional_and_derivative(motors):
    config = MotorConfig(kp=100.0, kd=3.0)
    np.testing.assert_allclose(torque(motors(config), 0.1, 1.0), 100 * 0.1 - 3 * 1.0, rtol=1e-6)


def test_gains_follow_from_the_robot_unless_set(quadruped, model, motors):
    def gains(config: MotorConfig, model: mujoco.MjModel = model) -> tuple:
        return make_motor(model, quadruped, config)[:2]

    assert gains(MotorConfig()) == pytest.approx((120.0, 3.0), rel=0.01)
    light = copy.copy(model)
    light.body_mass[:] /= 2
    mujoco.mj_setConst(light, mujoco.MjData(light))
    assert gains(MotorConfig(), light) == pytest.approx((60.0, 1.5), rel=0.01)
    assert gains(MotorConfig(kp=30.0)) == pytest.approx((30.0, 0.75))
    assert gains(MotorConfig(kp=30.0, kd=0.0)) == (30.0, 0.0)


@pytest.fixture(scope="module")
def light(model) -> mujoco.MjModel:
    """The AlienGo with calves of a tenth of its own and no rotors."""
    light = copy.copy(model)
    light.dof_armature[:] = 0
    calves = light.jnt_bodyid[3::3]
    light.body_mass[calves] /= 10
    light.body_inertia[calves] /= 10
    mujoco.mj_setConst(light, mujoco.MjData(light))
    return light


def test_the_inertia_of_a_joint_is_what_a_torque_on_it_meets(quadruped, light):
    def accelerate(joint: int, torque: float) -> float:
        data = mujoco.MjData(light)
        data.qpos[:] = quadruped.home
        data.qpos[2] = 1.0
        data.qfrc_applied[6 + joint] = torque
        mujoco.mj_forward(light, data)
        return data.qacc[6 + joint]

    met = np.array([1 / (accelerate(k, 1.0) - accelerate(k, 0.0)) for k in range(12)])
    np.testing.assert_allclose(
        compute_joint_inertia(light, quadruped), met.reshape(4, 3).min(0), rtol=1e-6
    )


def test_light_calves_are_damped_less_lest_they_shake(quadruped, light):
    def speed_after(kd: np.ndarray | float) -> float:
        """Of the fastest joint, rad/s, after 50 steps in the air, when motors only damp."""
        data = mujoco.MjData(light)
        data.qpos[:] = quadruped.home
        data.qpos[2] = 2.0
        data.qvel[8::3] = 1.0
        for _ in range(50):
            # As if loads and draws made it half as strong again.
            data.ctrl[:] = -1.5 * kd * data.qvel[6:]
            mujoco.mj_step(light, data)
        return float(np.abs(data.qvel[6:]).max())

    usual = make_motor(light, quadruped, MotorConfig())
    kd = np.asarray(usual.kd).reshape(4, 3)
    assert (kd == kd[0]).all()
    assert kd[0].max() <= 0.025 * usual.kp
    assert kd[0, 2] < 0.5 * kd[0, 0]
    assert speed_after(usual.kd) < 0.5
    assert speed_after(0.025 * usual.kp) > 10.0


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
def test_motors_follow_their_torque_speed_line(motors, error, speed, hip, calf):
    expected = np.tile([hip, hip, calf], 4)
    np.testing.assert_allclose(torque(motors(), error, speed), expected, rtol=1e-5, atol=1e-5)


def test_without_the_speed_limit_only_the_effort_holds(quadruped, motors):
    motor = motors(MotorConfig(kp=100.0, kd=0.0, speed_limit=False))
    np.testing.assert_allclose(torque(motor, 10.0, 30.0), quadruped.effort, rtol=1e-6)


def test_effort_may_be_that_of_other_motors(motors):
    motor = motors(MotorConfig(kp=100.0, kd=0.0, effort=7.0))
    np.testing.assert_allclose(torque(motor, 10.0, 0.0), 7.0)


def test_weak_motors_give_a_share_of_every_torque_and_limit(motors):
    weak = motors()._replace(strength=np.linspace(0.5, 1.0, 12))
    for error, speed in [(0.1, 0.0), (10.0, 0.0), (-10.0, -10.0), (10.0, -25.0)]:
        expected = torque(motors(), error, speed) * np.linspace(0.5, 1.0, 12)
        np.testing.assert_allclose(torque(weak, error, speed), expected)


@settings(deadline=None)
@given(st.floats(-5, 5), st.floats(-60, 60), st.floats(0, 500), st.floats(0, 20))
def test_no_motor_ever_leaves_its_limits(quadruped, motors, error, speed, kp, kd):
    result = torque(motors(MotorConfig(kp, kd)), error, speed)
    share = np.abs(result) / quadruped.effort
    assert (share <= 1 + 1e-5).all()
    driving = result * speed > 0
    allowed = np.clip(1 - abs(speed) / quadruped.velocity, 0, 1)
    assert (share[driving] <= allowed[driving] + 1e-5).all()


def test_friction_opposes_motion_up_to_its_coulomb_value(quadruped, motors):
    fast = compute_friction_torque(motors(), np.full(12, 5.0))
    np.testing.assert_allclose(fast, -quadruped.friction, rtol=1e-6)
    assert (quadruped.friction > 0).all()
    back = compute_friction_torque(motors(), jnp.full(12, -5.0))
    np.testing.assert_allclose(back, -fast, rtol=1e-6)
    off = motors(MotorConfig(joint_friction=False))
    assert not compute_friction_torque(off, np.full(12, 5.0)).any()
