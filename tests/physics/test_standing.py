"""Default gains hold the home pose, or are raised until they do, or motors are too weak."""

import dataclasses

import mujoco
import numpy as np
import pytest

from quadwalk.physics.motor import FACTORS, MotorConfig, make_motor, make_standing_motor
from quadwalk.robot.quadruped import Quadruped, make_quadruped
from quadwalk.robot.urdf import parse_urdf
from tests.robot.robots import Walker, simulate_standing

# Legs of 12 cm and 0.24 kg; of a SpotMicro's size and weight, 2.4 kg.
TOY, SPOT = Walker(size=0.3, mass=0.02, effort=2), Walker(size=0.6, mass=0.2, effort=4)
CROUCHED = (-2.6, -2.2)  # rad: legs that cannot stretch
WIDE = 0.2  # m, from hip to thigh


def read(walker: Walker) -> Quadruped:
    return make_quadruped(parse_urdf(walker.text()))


def motors(quadruped: Quadruped, kp: float | None = None):
    return make_standing_motor(
        quadruped.make_training_model(0.004, 2, 3), quadruped, MotorConfig(kp=kp)
    )


@pytest.mark.parametrize("walker", [Walker(), TOY, SPOT])
def test_gains_that_hold_the_robot_stay(walker):
    quadruped = read(walker)
    motor, note = motors(quadruped)
    usual = make_motor(quadruped.make_training_model(0.004, 2, 3), quadruped, MotorConfig())
    assert note == ""
    np.testing.assert_array_equal(motor.kp, usual.kp)
    np.testing.assert_array_equal(motor.kd, usual.kd)


@pytest.mark.parametrize(
    "walker",
    [
        dataclasses.replace(SPOT, calf=CROUCHED),
        dataclasses.replace(TOY, calf=CROUCHED),
        dataclasses.replace(SPOT, wide=WIDE),
    ],
    ids=["crouched", "crouched toy", "wide"],
)
def test_gains_that_let_the_robot_sink_are_raised(walker):
    quadruped = read(walker)
    motor, note = motors(quadruped)
    usual = make_motor(quadruped.make_training_model(0.004, 2, 3), quadruped, MotorConfig())
    factor = float(motor.kp / usual.kp)
    assert any(factor == pytest.approx(known) for known in FACTORS)
    assert note.startswith(f"gains raised to {factor:g} times the default, ")
    # In MuJoCo C with all shapes, for longer than was looked at before.
    sunk = simulate_standing(quadruped, 4, usual.kp, usual.kd)[-1]
    held = simulate_standing(quadruped, 4, motor.kp, motor.kd)[-1]
    assert sunk[2] < 0.9 * quadruped.home[2]
    assert held[2] > 0.88 * quadruped.home[2]
    assert held[3] > np.cos(np.radians(8) / 2)


def test_gains_that_are_stated_stay():
    motor, note = motors(read(dataclasses.replace(SPOT, calf=CROUCHED)), kp=1.0)
    assert (motor.kp, note) == (1.0, "")


def test_motors_too_weak_for_the_robot_are_said():
    quadruped = read(dataclasses.replace(SPOT, effort=0.2))
    motor, note = motors(quadruped)
    usual = make_motor(quadruped.make_training_model(0.004, 2, 3), quadruped, MotorConfig())
    assert motor.kp == usual.kp
    assert "of 0.2 Nm at most, too weak?" in note


def test_strong_damping_is_no_reason_to_raise_gains():
    damped = '<dynamics damping="10"/></joint>'
    text = Walker().text().replace('velocity="20"/></joint>', f'velocity="20"/>{damped}')
    quadruped = make_quadruped(parse_urdf(text))
    assert quadruped.make_training_model(0.004).dof_damping[6:].min() == 10
    assert motors(quadruped)[1] == ""


def test_a_robot_on_uneven_ground_is_looked_at_on_level_ground(quadruped):
    spec = quadruped.spec.copy()
    grid = spec.add_hfield(name="floor", nrow=2, ncol=2, size=[5, 5, 1, 0.1])
    grid.userdata = [0, 1, 0, 1]
    floor = spec.geom("floor")
    floor.type, floor.hfieldname = mujoco.mjtGeom.mjGEOM_HFIELD, "floor"
    assert motors(dataclasses.replace(quadruped, spec=spec))[1] == ""
