"""What inertia is valid, the nearest that is, and how links compose."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadwalk.paths import ALIENGO_URDF
from quadwalk.robot.inertia import Inertia, compose, nearest_valid, principal, printable
from quadwalk.robot.urdf import parse_urdf

MOMENTS = st.tuples(*[st.floats(-1, 3)] * 3).map(np.array)


def is_valid(tensor: np.ndarray) -> bool:
    moments = np.linalg.eigvalsh(tensor)
    return moments[0] > 0 and moments[0] + moments[1] >= moments[2] * (1 - 1e-12)


@settings(derandomize=True, deadline=None)
@given(moments=MOMENTS, angles=MOMENTS, other=MOMENTS)
def test_repair_gives_a_valid_inertia_and_none_is_nearer(moments, angles, other):
    turn, _ = np.linalg.qr(np.outer(angles, [1, 2, 3]) + np.diag([3.0, 2, 1]))
    tensor = turn @ np.diag(moments) @ turn.T
    valid = nearest_valid(1.0, tensor)
    assert is_valid(valid)
    # Any valid inertia of the same axes, at least as thick, is at least as far away.
    second = np.abs(other) + 1e-6
    rival = turn @ np.diag(second.sum() - second) @ turn.T
    nearest = np.linalg.norm(valid - tensor)
    assert nearest <= np.linalg.norm(rival - tensor) + 1e-9


def test_repair_leaves_a_valid_inertia_alone():
    tensor = np.array([[3, 0.1, 0.2], [0.1, 4, 0.3], [0.2, 0.3, 5]])
    np.testing.assert_allclose(nearest_valid(1.0, tensor), tensor, atol=1e-12)


def test_repair_by_hand():
    # (1, 1, 5): the excess of 3 is shared, a third to each moment; THINNEST adds a trace of 1e-6.
    np.testing.assert_allclose(
        nearest_valid(1.0, np.diag([1.0, 1, 5])), np.diag([2.0, 2, 4]), atol=3e-6
    )


def test_repair_is_asked_for_and_reported():
    broken = ALIENGO_URDF.read_text().replace('ixx="0.051944892"', 'ixx="0.5519"')
    urdf = parse_urdf(broken, repair_inertia=True)
    (line,) = urdf.report.lines()
    assert line.startswith("repaired: inertia of 'trunk', principal moments (0.2469, 0.2709, 0.5")
    trunk = next(link for link in urdf.robot.links if link.name == "trunk")
    assert is_valid(trunk.inertial.inertia)


def test_two_balls_on_a_rod_by_hand():
    ball = np.diag([0.1, 0.1, 0.1])
    pair = compose(
        [Inertia(1.0, np.array([1.0, 0, 0]), ball), Inertia(3.0, np.array([-1.0, 0, 0]), ball)]
    )
    assert pair.mass == 4
    np.testing.assert_allclose(pair.com, [-0.5, 0, 0])
    # 1 kg at 1.5 m and 3 kg at 0.5 m from the centre of mass: 3 kg m^2 across the rod.
    np.testing.assert_allclose(pair.about_com, np.diag([0.2, 3.2, 3.2]))


@settings(derandomize=True, deadline=None)
@given(st.floats(1e-6, 1), st.floats(1e-6, 1))
def test_a_plate_survives_six_digits(a, b):
    # The largest moment of a flat body is the sum of the others: rounding must not break that.
    moments, _ = principal(np.diag([a, b, a + b]))
    first, second, third = printable(moments)
    assert first <= second + third
    assert first == pytest.approx(a + b, rel=2e-5)
