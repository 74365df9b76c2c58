"""Terminations, and the lowest points of shapes that they look at."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mujoco import mjtGeom
from scipy.spatial.transform import Rotation

from quadwalk.env.state import Step
from quadwalk.env.terminations import find_falls
from quadwalk.physics.model import Shell
from quadwalk.physics.rotation import from_euler
from quadwalk.tasks import sprint

KINDS = (mjtGeom.mjGEOM_SPHERE, mjtGeom.mjGEOM_CAPSULE, mjtGeom.mjGEOM_CYLINDER, mjtGeom.mjGEOM_BOX)


def sample_surface(kind: mjtGeom, size: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return many points of a shape's surface, the corners and rims among them."""
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


@settings(max_examples=40, deadline=None)
@given(kind=st.sampled_from(KINDS), seed=st.integers(0, 2**32 - 1))
def test_the_lowest_point_is_that_of_the_surface(kind, seed):
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.02, 0.3, 3)
    center, turn = rng.normal(size=3), Rotation.random(rng=rng).as_matrix()
    up = Rotation.random(rng=rng).as_matrix()[2]  # the world's vertical in the link's frame
    points = sample_surface(kind, size, rng) @ turn.T + center
    shape = Shell(
        link=None, kind=int(kind), center=tuple(center), axes=tuple(map(tuple, turn.T)), size=size
    )
    assert float(shape.compute_bottom(tuple(up))) == pytest.approx((points @ up).min(), abs=2e-3)


def find_named_falls(env, qpos, lowest=1.0, terms=sprint.TASK.env.termination) -> dict[str, bool]:
    nothing = jnp.zeros(())
    step = Step(**dict.fromkeys(Step._fields, nothing) | {"qpos": qpos, "lowest": lowest})
    return dict(zip(terms, np.asarray(find_falls(terms, env.robot, step)).tolist(), strict=True))


def test_each_termination_stands_for_itself(env):
    home = jnp.asarray(env.robot.home)
    none = {"tipped": False, "low": False, "touched": False}
    assert find_named_falls(env, home) == none
    assert find_named_falls(env, home, lowest=-0.001) == {**none, "touched": True}
    assert find_named_falls(env, home.at[2].set(0.1)) == {**none, "low": True}
    for roll, pitch, tipped in [(0.9, 0, False), (1.1, 0, True), (0, -1.1, True), (0.8, 0.8, True)]:
        qpos = home.at[3:7].set(from_euler(roll, pitch, 2.0))
        assert find_named_falls(env, qpos) == {**none, "tipped": tipped}


def test_without_terminations_nothing_is_a_fall(env):
    upside_down = jnp.asarray(env.robot.home).at[2].set(-9.0).at[3:7].set(jnp.eye(4)[1])
    assert find_named_falls(env, upside_down, lowest=-9.0, terms={}) == {}
