import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadwalk.physics.rotation import compute_yaw, euler, from_euler, rotate, rotate_inverse

number = st.floats(-1.0, 1.0, width=32)
quaternions = st.tuples(number, number, number, number).filter(lambda q: np.dot(q, q) > 0.1)
angles = st.floats(-1.5, 1.5, width=32)


def unit(q) -> np.ndarray:
    return np.array(q, np.float32) / np.linalg.norm(q).astype(np.float32)


@settings(deadline=None)
@given(quaternions, st.tuples(number, number, number))
def test_rotations_are_mujocos(q, vector):
    q, vector = unit(q), np.array(vector)
    expected = np.zeros(3)
    mujoco.mju_rotVecQuat(expected, vector, q.astype(float))
    np.testing.assert_allclose(rotate(q, vector), expected, atol=1e-5)
    np.testing.assert_allclose(rotate_inverse(q, expected), vector, atol=1e-5)


@settings(deadline=None)
@given(angles, angles, st.floats(-3.125, 3.125, width=32))
def test_euler_angles_are_scipys(roll, pitch, heading):
    q = np.asarray(from_euler(roll, pitch, heading))
    expected = Rotation.from_euler("xyz", [roll, pitch, heading])
    difference = expected.inv() * Rotation.from_quat(q[[1, 2, 3, 0]])
    assert difference.magnitude() < 1e-5
    np.testing.assert_allclose(compute_yaw(q), heading, atol=1e-4)


@pytest.mark.parametrize(
    ("quat", "expected"),
    [
        ((0.5, 0.5, 0.5, 0.5), (np.pi / 2, 0.0, np.pi / 2)),
        # Straight up and down, roll is 0 and yaw is whatever else there is, within two turns.
        ((1.0, 0.0, 1.0, 0.0), (0.0, np.pi / 2, 0.0)),
        ((0.5, 0.5, 0.5, -0.5), (0.0, np.pi / 2, -np.pi / 2)),
        ((-0.5, -0.5, -0.5, 0.5), (0.0, np.pi / 2, 1.5 * np.pi)),
        ((-0.5, -0.5, 0.5, -0.5), (0.0, -np.pi / 2, -1.5 * np.pi)),
    ],
)
def test_euler_angles_where_pitch_is_a_right_angle(quat, expected):
    np.testing.assert_allclose(euler(jnp.asarray(unit(quat))), expected, atol=1e-5)


def test_euler_angles_of_random_rotations_are_scipys():
    quat = np.random.default_rng(0).normal(size=(3000, 4))
    quat = (quat / np.linalg.norm(quat, axis=1, keepdims=True)).astype(np.float32)
    expected = Rotation.from_quat(quat, scalar_first=True).as_euler("xyz")
    found = np.asarray(jax.vmap(euler)(quat))
    steep = np.abs(np.sin(expected[:, 1])) > 0.99  # of whose angles less digits are left
    assert 10 < steep.sum() < 100
    np.testing.assert_allclose(found[~steep], expected[~steep], atol=1e-5)
    np.testing.assert_allclose(found[steep], expected[steep], atol=2e-3)


@pytest.mark.parametrize(
    ("roll", "degrees", "heading", "expected"),
    [
        (0.5, 89.5, -1.0, (0.5, 1.5621, -1.0)),
        (0.5, 89.8, -1.0, (0.0, 1.5708, -1.5017)),
        (3.0, 89.8, 2.5, (0.0, 1.5708, -0.5005)),
        (-2.0, -89.5, 0.7, (-2.0, -1.5621, 0.7)),
        (-2.0, -89.8, 0.7, (0.0, -1.5708, -1.3032)),
    ],
)
def test_euler_angles_near_a_right_angle_of_pitch_are_pybullets(roll, degrees, heading, expected):
    """What PyBullet 3.2.7's getEulerFromQuaternion gives: roll is 0 within 0.26 degrees of it."""
    turn = Rotation.from_euler("xyz", [roll, np.radians(degrees), heading])
    quat = turn.as_quat(scalar_first=True).astype(np.float32)
    np.testing.assert_allclose(euler(jnp.asarray(quat)), expected, atol=2e-4)
