"""A step from the mirrored state by the mirrored action is the step's image.

Robots are made exactly symmetric, so that only float32's errors remain. In their files, halves
differ in inertias and centers of mass; that is averaged away.
"""

import dataclasses
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.observations import height_scan, scan_ahead
from quadwalk.env.reflections import find_mirror
from quadwalk.physics.motor import PhysicsState
from quadwalk.physics.rotation import from_euler
from quadwalk.robot.mirror import find_robot_mirror
from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import Quadruped, load_quadruped
from quadwalk.task_files import load_task
from quadwalk.tasks import list_tasks, sprint
from quadwalk.terrain.terrain import FLAT
from tests.physics.reference import place_robot
from tests.robot import zoo

FLIP = np.array([1.0, -1.0, 1.0], np.float32)  # of a vector; -FLIP: of an axial one
HALF_A_STRIDE = 10  # control steps, of the tasks' trot


def symmetric(quadruped: Quadruped) -> Quadruped:
    """Return the robot with exactly symmetric masses.

    Each body's mass distribution is the mean of its own and its partner's image.
    """
    model = quadruped.make_full_model()
    data = place_robot(model, quadruped.home)
    bodies = model.jnt_bodyid[:13]
    images = np.r_[0, 1 + find_robot_mirror(quadruped, model).joints.source]
    centers = data.xipos[bodies] - quadruped.home[:3]
    frames = data.ximat[bodies].reshape(-1, 3, 3)
    inertias = frames * model.body_inertia[bodies, None] @ frames.transpose(0, 2, 1)
    centers = (centers + centers[images] * FLIP) / 2 + quadruped.home[:3]
    inertias = (inertias + np.outer(FLIP, FLIP) * inertias[images]) / 2
    spec = quadruped.spec.copy()
    for body, center, inertia in zip(bodies, centers, inertias, strict=True):
        turn, link = data.xmat[body].reshape(3, 3), spec.body(model.body(body).name)
        link.ipos = turn.T @ (center - data.xpos[body])
        link.inertia, principal = np.linalg.eigh(turn.T @ inertia @ turn)
        principal[:, 2] = np.cross(principal[:, 0], principal[:, 1])  # right-handed
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, principal.ravel())
        link.iquat = quat
    return dataclasses.replace(quadruped, spec=spec)


def draw_physics(env, key, canonical):
    """Draw any pose and velocity, or return the canonical ones.

    These are of a robot with one leg lifted that is rolled, moves to the left and turns.
    """
    joints, turn, linear, angular, speeds = jax.random.split(key, 5)
    off = jnp.where(canonical, jnp.zeros(12).at[1:3].set(jnp.array([0.3, -0.5])), 0.0)
    off += jnp.where(canonical, 0.0, 0.3) * jax.random.normal(joints, (12,))
    roll, pitch, yaw = jax.random.uniform(turn, (3,), minval=-0.3, maxval=0.3)
    quat = jnp.where(canonical, from_euler(0.2, 0.0, 0.1), from_euler(roll, pitch, yaw))
    angles = jnp.clip(env.robot.home_joints + off, env.robot.lower, env.robot.upper)
    place = jnp.array([0.3, -0.2, env.robot.home_height + 0.01])
    moving = jnp.where(canonical, jnp.zeros(18).at[1].set(0.5).at[5].set(0.7), 0.0)
    trunk_velocity = [jax.random.normal(linear, (3,)), jax.random.normal(angular, (3,))]
    moving += jnp.where(canonical, 0.0, 1.0) * jnp.concatenate(
        [*trunk_velocity, 2.0 * jax.random.normal(speeds, (12,))]
    )
    return PhysicsState(jnp.concatenate([place, quat, angles]), moving)


def image(env, robot, state):
    """Return the state in the mirror, half a stride later for the sake of its trot."""

    def qvel(x):
        return jnp.concatenate([FLIP * x[:3], -FLIP * x[3:6], robot.joints(x[6:])])

    qpos, speed = state.physics
    quat = jnp.concatenate([qpos[3:4], -FLIP * qpos[4:7]])
    qpos = jnp.concatenate([FLIP * qpos[:3], quat, robot.joints(qpos[7:])])
    mirror_state = state._replace(
        physics=PhysicsState(qpos, qvel(speed)),
        last_action=robot.joints(state.last_action),
        steps=state.steps + HALF_A_STRIDE,
    )
    if state.command is not None:
        velocity = state.command.velocity * jnp.array([1.0, -1.0, -1.0])
        mirror_state = mirror_state._replace(command=state.command._replace(velocity=velocity))
    if state.contact is not None:
        mirror_state = mirror_state._replace(contact=state.contact[robot.feet.source])
    if state.frames is not None:
        size = state.frames.shape[-1]
        mirror = env.mirrors.observation
        frames = mirror.sign[:size] * state.frames[:, mirror.source[:size]]
        mirror_state = mirror_state._replace(frames=frames)
    if (conditions := state.conditions) is not None:
        variation = conditions.variation._replace(
            trunk_center=FLIP * conditions.variation.trunk_center,
            link_mass=conditions.variation.link_mass[robot.joints.source],
        )
        conditions = conditions._replace(
            variation=variation,
            encoder=robot.joints(conditions.encoder),
            tilt=-FLIP * conditions.tilt,
            targets=robot.joints(conditions.targets),
        )
        mirror_state = mirror_state._replace(conditions=conditions)
    return mirror_state


def check(env):
    """Assert that steps mirror, from one canonical and three random states."""
    of = partial(image, env, find_robot_mirror(env.quadruped, env.mj_model))

    def draw_state(key, canonical):
        start = env.reset(key)
        state, (a, b, c, d) = start.pipeline_state, jax.random.split(key, 4)
        state = state._replace(
            physics=draw_physics(env, a, canonical),
            last_action=jax.random.uniform(b, (12,)),
            steps=jnp.asarray(3),
        )
        if state.frames is not None:
            state = state._replace(frames=jax.random.normal(c, state.frames.shape))
        if (conditions := state.conditions) is not None:
            # Noise, pushes' sides and jitter are of a key, and differ from step to step.
            conditions = conditions._replace(
                noise=jnp.zeros(()), push=jnp.zeros(2), delay=jnp.ones(())
            )
            state = state._replace(conditions=conditions)
        return start.replace(pipeline_state=state), jax.random.uniform(d, (12,), minval=-1.0)

    @jax.jit
    def step_pairs(keys):
        """Step drawn states and their images; return both, and the images of the former."""
        states, actions = jax.vmap(draw_state)(keys, jnp.arange(4) == 0)
        images = states.replace(pipeline_state=jax.vmap(of)(states.pipeline_state))
        actions = jnp.concatenate([actions, env.mirrors.action(actions)])
        both = jax.tree.map(lambda *x: jnp.concatenate(x), states, images)
        after = jax.vmap(env.step)(both, actions)
        one, other = (jax.tree.map(lambda x, k=k: x[k : k + 4], after) for k in (0, 4))
        return one, other, jax.vmap(of)(one.pipeline_state)

    def close(one, other):
        one, other = np.asarray(one), np.asarray(other)
        scale = np.maximum(1.0, np.abs(one))
        assert (np.abs(one - other) / scale).max() < 2e-3

    one, other, expected = step_pairs(jax.random.split(jax.random.PRNGKey(3), 4))
    for name in ("qpos", "qvel"):
        close(getattr(expected.physics, name), getattr(other.pipeline_state.physics, name))
    close(env.mirrors.observation(np.asarray(one.obs)), other.obs)
    assert np.ptp(np.asarray(one.obs) - np.asarray(other.obs)) > 0.1
    close(one.reward, other.reward)
    np.testing.assert_array_equal(one.done, other.done)
    for name, value in one.metrics.items():
        close(value, other.metrics[name])


@pytest.mark.parametrize("name", list_tasks())
def test_a_task_is_its_own_image(quadruped, name):
    config = dataclasses.replace(load_task(name).env, ground=FLAT)
    check(QuadrupedEnv(symmetric(quadruped), config))


@zoo.repeat_for(zoo.QUADRUPEDS)
def test_a_robot_of_the_zoo_is_its_own_image(urdf):
    quadruped = load_quadruped(urdf, Options(meshes=False))
    # A solver that has converged, for what few iterations leave depends on the last digit.
    config = dataclasses.replace(sprint.TASK.env, solver_iterations=20, line_search_iterations=20)
    check(QuadrupedEnv(symmetric(quadruped), config))


@pytest.mark.parametrize(
    ("scan", "sizes"),
    [
        (height_scan, {"length": 0.4, "width": 0.6}),
        (scan_ahead, {"first": -0.1, "last": 0.5, "width": 0.2}),
    ],
)
def test_a_scan_sees_the_image_of_uneven_ground(env, scan, sizes):
    class Ground:
        def __init__(self, side):
            self.side = side

        def measure(self, x, y):
            y = self.side * y
            return 0.1 * jnp.sin(3.0 * x + 5.0 * y) + 0.05 * y, None

    params = {**sizes, "spacing": 0.1, "reach": 0.5}
    robot = find_robot_mirror(env.quadruped, env.mj_model)
    state = jax.eval_shape(env.reset, jax.random.PRNGKey(0)).pipeline_state
    qpos = jnp.array([0.3, -0.2, 0.4, np.cos(0.2), 0, 0, np.sin(0.2), *[0.0] * 12])
    mirror_qpos = qpos * jnp.array([1, -1, 1, 1, -1, 1, -1, *[1] * 12])
    scans = [
        scan(
            SimpleNamespace(home_height=env.robot.home_height, ground=Ground(side)),
            state._replace(physics=PhysicsState(place, jnp.zeros(18))),
            **params,
        )
        for side, place in ((1, qpos), (-1, mirror_qpos))
    ]
    mirror = find_mirror(scan, params, robot)
    assert np.ptp(scans[0] - scans[1]) > 0.01
    np.testing.assert_allclose(mirror(np.asarray(scans[0])), scans[1], atol=1e-6)
