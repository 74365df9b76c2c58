"""Torques of the motors, in JAX and in NumPy, and gains that hold the home pose."""

import copy
import dataclasses

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadwalk.physics.motor import (
    FACTORS,
    Motor,
    MotorConfig,
    compute_friction_torque,
    compute_joint_inertia,
    compute_motor_torque,
    make_motor,
    make_standing_motor,
)
from quadwalk.robot.quadruped import Quadruped, make_quadruped
from quadwalk.robot.urdf import parse_urdf
from tests.robot.robots import Walker, simulate_standing

PROPORTIONAL = MotorConfig(kp=100.0, kd=0.0)
# Legs of 12 cm and 0.24 kg; of a SpotMicro's size and weight, 2.4 kg.
TOY, SPOT = Walker(size=0.3, mass=0.02, effort=2), Walker(size=0.6, mass=0.2, effort=4)
CROUCHED = (-2.6, -2.2)  # rad: legs that cannot stretch


@pytest.fixture(scope="module")
def model(quadruped) -> mujoco.MjModel:
    return quadruped.make_training_model(0.004)


@pytest.fixture(scope="module")
def motors(quadruped, model):
    """Return a function that makes the AlienGo's motors with a `MotorConfig`."""
    return lambda config=PROPORTIONAL: make_motor(model, quadruped, config)


@pytest.fixture(scope="module")
def light(model) -> mujoco.MjModel:
    """Return the AlienGo with calves of a tenth of its own and no rotors."""
    light = copy.copy(model)
    light.dof_armature[:] = 0
    calves = light.jnt_bodyid[3::3]
    light.body_mass[calves] /= 10
    light.body_inertia[calves] /= 10
    mujoco.mj_setConst(light, mujoco.MjData(light))
    return light


def compute_torque(motor: Motor, error: float, speed: float) -> np.ndarray:
    """Return the torque of all 12 motors for one position error and joint speed."""
    q = np.zeros(12)
    torque = compute_motor_torque(motor, q + error, q, q + speed)
    assert isinstance(torque, np.ndarray)
    in_jax = compute_motor_torque(motor, *map(jnp.asarray, (q + error, q, q + speed)))
    np.testing.assert_allclose(in_jax, torque, rtol=1e-5, atol=1e-3)
    return torque


def test_within_the_limits_the_controller_is_proportional_and_derivative(motors):
    torque = compute_torque(motors(MotorConfig(kp=100.0, kd=3.0)), 0.1, 1.0)
    np.testing.assert_allclose(torque, 100 * 0.1 - 3 * 1.0, rtol=1e-6)


def test_gains_follow_from_the_robot_unless_set(quadruped, model):
    def find_gains(config: MotorConfig, model: mujoco.MjModel = model) -> tuple:
        return make_motor(model, quadruped, config)[:2]

    assert find_gains(MotorConfig()) == pytest.approx((120.0, 3.0), rel=0.01)
    half = copy.copy(model)
    half.body_mass[:] /= 2
    mujoco.mj_setConst(half, mujoco.MjData(half))
    assert find_gains(MotorConfig(), half) == pytest.approx((60.0, 1.5), rel=0.01)
    assert find_gains(MotorConfig(kp=30.0)) == pytest.approx((30.0, 0.75))
    assert find_gains(MotorConfig(kp=30.0, kd=0.0)) == (30.0, 0.0)


def test_the_inertia_of_a_joint_is_what_a_torque_on_it_meets(quadruped, light):
    def accelerate(joint: int, torque: float) -> float:
        data = mujoco.MjData(light)
        data.qpos[:] = quadruped.home
        data.qpos[2] = 1.0
        data.qfrc_applied[6 + joint] = torque
        mujoco.mj_forward(light, data)
        return data.qacc[6 + joint]

    inertia = np.array([1 / (accelerate(k, 1.0) - accelerate(k, 0.0)) for k in range(12)])
    expected = inertia.reshape(4, 3).min(axis=0)
    np.testing.assert_allclose(compute_joint_inertia(light, quadruped), expected, rtol=1e-6)


def test_light_calves_are_damped_less_lest_they_shake(quadruped, light):
    def simulate_damping(kd: np.ndarray | float) -> float:
        """Return the fastest joint's speed, rad/s, after 50 steps in the air of damping alone."""
        data = mujoco.MjData(light)
        data.qpos[:] = quadruped.home
        data.qpos[2] = 2.0
        data.qvel[8::3] = 1.0
        for _ in range(50):
            # As if loads and randomization made it half as strong again.
            data.ctrl[:] = -1.5 * kd * data.qvel[6:]
            mujoco.mj_step(light, data)
        return float(np.abs(data.qvel[6:]).max())

    motor = make_motor(light, quadruped, MotorConfig())
    kd = np.asarray(motor.kd).reshape(4, 3)
    assert (kd == kd[0]).all()
    assert kd[0].max() <= 0.025 * motor.kp
    assert kd[0, 2] < 0.5 * kd[0, 0]
    assert simulate_damping(motor.kd) < 0.5
    assert simulate_damping(0.025 * motor.kp) > 10.0


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
    torque = compute_torque(motors(), error, speed)
    np.testing.assert_allclose(torque, expected, rtol=1e-5, atol=1e-5)
    weak = motors()._replace(strength=np.linspace(0.5, 1.0, 12))
    torque = compute_torque(weak, error, speed)
    np.testing.assert_allclose(torque, expected * weak.strength, rtol=1e-5, atol=1e-5)


def test_settings_replace_the_robots_own_limits(quadruped, motors):
    unlimited = motors(MotorConfig(kp=100.0, kd=0.0, speed_limit=False))
    np.testing.assert_allclose(compute_torque(unlimited, 10.0, 30.0), quadruped.effort, rtol=1e-6)
    other = motors(MotorConfig(kp=100.0, kd=0.0, effort=7.0))
    np.testing.assert_allclose(compute_torque(other, 10.0, 0.0), 7.0)


@settings(deadline=None)
@given(st.floats(-5, 5), st.floats(-60, 60), st.floats(0, 500), st.floats(0, 20))
def test_no_motor_ever_leaves_its_limits(quadruped, motors, error, speed, kp, kd):
    torque = compute_torque(motors(MotorConfig(kp, kd)), error, speed)
    share = np.abs(torque) / quadruped.effort
    assert (share <= 1 + 1e-5).all()
    driving = torque * speed > 0
    allowed = np.clip(1 - abs(speed) / quadruped.velocity, 0, 1)
    assert (share[driving] <= allowed[driving] + 1e-5).all()


def test_friction_opposes_motion_up_to_its_coulomb_value(quadruped, motors):
    assert (quadruped.friction > 0).all()
    ahead = compute_friction_torque(motors(), np.full(12, 5.0))
    np.testing.assert_allclose(ahead, -quadruped.friction, rtol=1e-6)
    back = compute_friction_torque(motors(), jnp.full(12, -5.0))
    np.testing.assert_allclose(back, quadruped.friction, rtol=1e-6)
    off = motors(MotorConfig(joint_friction=False))
    assert not compute_friction_torque(off, np.full(12, 5.0)).any()


def read_walker(walker: Walker) -> Quadruped:
    return make_quadruped(parse_urdf(walker.to_text()))


def make_both_motors(quadruped: Quadruped, kp: float | None = None) -> tuple[Motor, Motor, str]:
    """Return the default motors, the standing ones, and the note about these."""
    model, config = quadruped.make_training_model(0.004, 2, 3), MotorConfig(kp=kp)
    return make_motor(model, quadruped, config), *make_standing_motor(model, quadruped, config)


def test_gains_that_hold_the_robot_stay(quadruped):
    damped = '<dynamics damping="10"/></joint>'
    text = Walker().to_text().replace('velocity="20"/></joint>', f'velocity="20"/>{damped}')
    strongly_damped = make_quadruped(parse_urdf(text))
    assert strongly_damped.make_training_model(0.004).dof_damping[6:].min() == 10
    spec = quadruped.spec.copy()  # on uneven ground; it is tried on level ground
    grid = spec.add_hfield(name="floor", nrow=2, ncol=2, size=[5, 5, 1, 0.1])
    grid.userdata = [0, 1, 0, 1]
    floor = spec.geom("floor")
    floor.type, floor.hfieldname = mujoco.mjtGeom.mjGEOM_HFIELD, "floor"
    uneven = dataclasses.replace(quadruped, spec=spec)
    for robot in (*map(read_walker, (Walker(), TOY, SPOT)), strongly_damped, uneven):
        default, motor, note = make_both_motors(robot)
        assert note == ""
        np.testing.assert_array_equal(motor.kp, default.kp)
        np.testing.assert_array_equal(motor.kd, default.kd)


@pytest.mark.parametrize(
    "walker",
    [
        dataclasses.replace(SPOT, calf=CROUCHED),
        dataclasses.replace(TOY, calf=CROUCHED),
        dataclasses.replace(SPOT, wide=0.2),  # m, from hip to thigh
    ],
    ids=["crouched", "crouched toy", "wide"],
)
def test_gains_that_let_the_robot_sink_are_raised(walker):
    quadruped = read_walker(walker)
    default, motor, note = make_both_motors(quadruped)
    factor = float(motor.kp / default.kp)
    assert any(factor == pytest.approx(candidate) for candidate in FACTORS)
    assert note.startswith(f"gains raised to {factor:g} times the default, ")
    # In MuJoCo C with all shapes, and for longer than when they were chosen.
    sunk = simulate_standing(quadruped, 4, default.kp, default.kd)[-1]
    standing = simulate_standing(quadruped, 4, motor.kp, motor.kd)[-1]
    assert sunk[2] < 0.9 * quadruped.home[2]
    assert standing[2] > 0.88 * quadruped.home[2]
    assert standing[3] > np.cos(np.radians(8) / 2)
    _, motor, note = make_both_motors(quadruped, kp=1.0)  # stated by the user
    assert (motor.kp, note) == (1.0, "")


def test_motors_too_weak_for_the_robot_are_said():
    quadruped = read_walker(dataclasses.replace(SPOT, effort=0.2))
    default, motor, note = make_both_motors(quadruped)
    assert motor.kp == default.kp
    assert "of 0.2 Nm at most, too weak?" in note
