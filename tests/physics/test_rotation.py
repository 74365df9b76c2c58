import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadwalk.physics.rotation import euler, from_euler, rotate, rotate_inverse, yaw

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
    np.testing.assert_allclose(yaw(q), heading, atol=1e-4)


@settings(deadline=None)
@given(angles, angles, st.floats(-3.125, 3.125, width=32))
def test_euler_angles_come_back(roll, pitch, heading):
    found = euler(from_euler(roll, pitch, heading))
    np.testing.assert_allclose(found, [roll, pitch, heading], atol=2e-4)


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


def test_euler_angles_are_pybullets():
    pybullet = pytest.importorskip("pybullet")
    rng = np.random.default_rng(0)
    drawn = rng.normal(size=(3000, 4))
    # Every third within half a degree of a pitch of +-90, where PyBullet makes an exception.
    pitch = rng.choice([-1, 1], 1000) * (np.pi / 2 - rng.uniform(0, 0.01, 1000))
    roll, heading = rng.uniform(-3, 3, (2, 1000))
    drawn[::3] = Rotation.from_euler("xyz", np.stack([roll, pitch, heading], axis=1)).as_quat(
        scalar_first=True
    )
    quat = (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).astype(np.float32)
    expected = np.array([pybullet.getEulerFromQuaternion(q) for q in quat[:, [1, 2, 3, 0]]])
    sine = 2 * (quat[:, 0] * quat[:, 2] - quat[:, 1] * quat[:, 3])
    excepted, near = np.abs(sine) >= 0.99999, np.abs(np.abs(sine) - 0.99999) < 1e-6
    assert 200 < excepted.sum() < 1000
    found = np.asarray(jax.vmap(euler)(quat))
    # A sine so close to 1 leaves single precision four digits of the angle.
    np.testing.assert_allclose(found[~near, 1], expected[~near, 1], atol=1e-4)
    np.testing.assert_allclose(found[~near], expected[~near], atol=2e-3)
    plain = np.abs(sine) < 0.99
    np.testing.assert_allclose(found[plain], expected[plain], atol=1e-5)
