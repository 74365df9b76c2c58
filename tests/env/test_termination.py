import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mujoco import mjtGeom
from scipy.spatial.transform import Rotation

from quadwalk.env.config import TerminationConfig
from quadwalk.env.robot import RobotArrays
from quadwalk.env.rotation import from_euler
from quadwalk.env.termination import REASONS, fall_reasons, lowest_points

KINDS = (
    mjtGeom.mjGEOM_SPHERE,
    mjtGeom.mjGEOM_CAPSULE,
    mjtGeom.mjGEOM_CYLINDER,
    mjtGeom.mjGEOM_BOX,
)


def surface(kind: mjtGeom, size: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Many points of a shape's surface, the corners and rims among them."""
    angle = np.linspace(0, 2 * np.pi, 721)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * size[0]
    ball = rng.normal(size=(20000, 3))
    ball *= size[0] / np.linalg.norm(ball, axis=1, keepdims=True)
    ends = [np.array([0, 0, z * size[1]]) for z in (-1, 1)]
    if kind == mjtGeom.mjGEOM_SPHERE:
        return ball
    if kind == mjtGeom.mjGEOM_CAPSULE:
        return np.concatenate([ball + end for end in ends])
    if kind == mjtGeom.mjGEOM_CYLINDER:
        return np.concatenate([np.c_[ring, np.full(721, end[2])] for end in ends])
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return signs * size


def shell(env, kind, size) -> RobotArrays:
    """A robot whose only shell shape is this."""
    fields = {**vars(env.robot)}
    fields.update(
        shell_kind=np.array([int(kind)]), shell_size=np.array([size]), shell_geoms=np.array([0])
    )
    return RobotArrays(**fields)


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(KINDS), st.integers(0, 2**32 - 1))
def test_lowest_points_are_those_of_the_surface(env, kind, seed):
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.02, 0.3, 3)
    position, rotation = rng.normal(size=3), Rotation.random(rng=rng).as_matrix()
    world = surface(kind, size, rng) @ rotation.T + position
    found = lowest_points(shell(env, kind, size), position[None], rotation[None])
    assert float(found[0]) == pytest.approx(world[:, 2].min(), abs=2e-3)


def reasons(env, qpos, lowest=1.0) -> dict[str, bool]:
    flags = fall_reasons(env.robot, TerminationConfig(), qpos, jnp.array([1.0, lowest]))
    return dict(zip(REASONS, np.asarray(flags).tolist(), strict=True))


def test_each_reason_stands_for_itself(env):
    home = jnp.asarray(env.robot.home)
    none = {"tipped": False, "low": False, "touched": False}
    assert reasons(env, home) == none
    assert reasons(env, home, lowest=-0.001) == {**none, "touched": True}
    assert reasons(env, home.at[2].set(0.1)) == {**none, "low": True}
    for roll, pitch, tipped in [(0.9, 0, False), (1.1, 0, True), (0, -1.1, True), (0.8, 0.8, True)]:
        qpos = home.at[3:7].set(from_euler(roll, pitch, 2.0))
        assert reasons(env, qpos) == {**none, "tipped": tipped}
