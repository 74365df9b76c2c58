import mujoco
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadwalk.physics.rotation import compute_yaw, from_euler, rotate, rotate_inverse

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
