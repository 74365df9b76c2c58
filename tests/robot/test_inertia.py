"""Valid inertia, the nearest valid one, and how links compose."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadwalk.robot.inertia import (
    Inertia,
    compose,
    find_nearest_valid,
    find_principal,
    round_moments,
)
from quadwalk.robot.mjcf import convert
from quadwalk.robot.report import UrdfError
from quadwalk.robot.urdf import parse_urdf
from tests.robot.robots import check_dynamics, inertial, joint, link, robot

MOMENTS = st.tuples(*[st.floats(-1, 3)] * 3).map(np.array)


def is_valid(tensor: np.ndarray) -> bool:
    moments = np.linalg.eigvalsh(tensor)
    return moments[0] > 0 and moments[0] + moments[1] >= moments[2] * (1 - 1e-12)


@settings(derandomize=True, deadline=None)
@given(moments=MOMENTS, angles=MOMENTS, other=MOMENTS)
def test_repair_gives_a_valid_inertia_and_none_is_nearer(moments, angles, other):
    turn, _ = np.linalg.qr(np.outer(angles, [1, 2, 3]) + np.diag([3.0, 2, 1]))
    tensor = turn @ np.diag(moments) @ turn.T
    valid = find_nearest_valid(1.0, tensor)
    assert is_valid(valid)
    # Any valid inertia of the same axes, at least as thick, is at least as far away.
    second = np.abs(other) + 1e-6
    rival = turn @ np.diag(second.sum() - second) @ turn.T
    nearest = np.linalg.norm(valid - tensor)
    assert nearest <= np.linalg.norm(rival - tensor) + 1e-9


def test_repair_by_hand_and_of_what_needs_none():
    valid = np.array([[3, 0.1, 0.2], [0.1, 4, 0.3], [0.2, 0.3, 5]])
    np.testing.assert_allclose(find_nearest_valid(1.0, valid), valid, atol=1e-12)
    # The excess of 3 is shared, a third to each moment; THINNEST adds a trace of 1e-6.
    repaired = find_nearest_valid(1.0, np.diag([1.0, 1, 5]))
    np.testing.assert_allclose(repaired, np.diag([2.0, 2, 4]), atol=3e-6)


def test_two_balls_on_a_rod_by_hand():
    ball = np.diag([0.1, 0.1, 0.1])
    ahead, behind = np.array([1.0, 0, 0]), np.array([-1.0, 0, 0])
    pair = compose([Inertia(1.0, ahead, ball), Inertia(3.0, behind, ball)])
    assert pair.mass == 4
    np.testing.assert_allclose(pair.com, [-0.5, 0, 0])
    # 1 kg at 1.5 m and 3 kg at 0.5 m from the center of mass: 3 kg m^2 across the rod.
    np.testing.assert_allclose(pair.about_com, np.diag([0.2, 3.2, 3.2]))


@settings(derandomize=True, deadline=None)
@given(st.floats(1e-6, 1), st.floats(1e-6, 1))
def test_a_plate_survives_six_digits(a, b):
    # The largest moment of a flat body is the sum of the others: rounding must not break that.
    moments, _ = find_principal(np.diag([a, b, a + b]))
    first, second, third = round_moments(moments)
    assert first <= second + third
    assert first == pytest.approx(a + b, rel=2e-5)


def make_arm(moments: str, mass: str = "1", more: str = "") -> str:
    """Return an arm of one link of these moments, or the six entries of its inertia."""
    return robot(link("world"), link("a", inertial(mass, moments)), more, joint("j", "world", "a"))


@pytest.mark.parametrize(
    # The first is 0.1e-3 too much, of which the digits explain half a unit each.
    "moments",
    ["0.001 0.002 0.0031", "0.01 0.02 0.0301", "0 0.00012 0.00012", "0 0 0", "-5.4e-20 -5.4e-20 0"],
)
def test_what_digits_explain_is_mended_and_reported(moments):
    urdf = parse_urdf(make_arm(moments))
    lines = [line for line in urdf.report.to_lines() if line.startswith("repaired: ")]
    assert lines
    assert all("a change by" in line for line in lines)
    model = convert(urdf).spec.compile()
    values = sorted(map(float, moments.split()))
    np.testing.assert_allclose(
        sorted(model.body("a").inertia), values, atol=0.02 * values[-1] + 1e-9
    )
    assert is_valid(np.diag(model.body("a").inertia))


@pytest.mark.parametrize(
    "moments", ["0.0010 0.0020 0.0033", "0.1000 0.2000 0.3100", "-0.0001 0.0100 0.0100", "1 2 9"]
)
def test_more_than_digits_explain_is_refused_with_the_flag_that_mends_it(moments):
    says = r"link 'a': <inertia> .* \(or pass --robot\.repair-inertia\)"
    with pytest.raises(UrdfError, match=says):
        parse_urdf(make_arm(moments))
    urdf = parse_urdf(make_arm(moments), repair_inertia=True)
    assert urdf.report.to_lines()[0].startswith("repaired: inertia of 'a', principal moments (")
    assert is_valid(np.diag(convert(urdf).spec.compile().body("a").inertia))


def test_a_frame_of_next_to_no_mass_is_as_the_file_has_it():
    base = inertial("1e-6", "1e-6 1e-6 1e-6 1e-6 1e-6 1e-6")  # Unitree's
    text = robot(
        link("base", base), link("trunk", inertial(5, "0.02 0.03 0.04")), link("arm", inertial(1)),
        joint("bolt", "base", "trunk", xyz="0.1 0 0", kind="fixed"), joint("j", "trunk", "arm"),
    )  # fmt: skip
    urdf = parse_urdf(text)
    check_dynamics(urdf, convert(urdf).spec, states=10)
    assert "next to nothing in 'base', as it is: base (" in "\n".join(urdf.report.to_lines())
    heavy = text.replace('"1e-6"', '"0.01"')
    with pytest.raises(UrdfError, match="link 'base': <inertia> has principal moments"):
        parse_urdf(heavy)


def test_inertia_without_mass_counts_in_the_body_that_has_some():
    foot = link("foot", inertial(0, "1e-4 2e-4 1.5e-4"))
    bolt = joint("bolt", "a", "foot", xyz="0.1 0 0", kind="fixed")
    urdf = parse_urdf(make_arm("0.01 0.01 0.01", more=foot + bolt))
    check_dynamics(urdf, convert(urdf).spec, states=10)


def test_what_moves_without_mass_is_given_some_when_asked():
    text = robot(link("world"), link("a"), joint("j", "world", "a"))
    with pytest.raises(UrdfError, match=r"'a' moves .* \(or pass --robot\.repair-inertia\)"):
        parse_urdf(text)
    urdf = parse_urdf(text, repair_inertia=True)
    assert convert(urdf).spec.compile().body("a").mass == pytest.approx(1e-6)
    assert "repaired: a mass of 1e-06 kg for what moves without any: a" in urdf.report.to_lines()
