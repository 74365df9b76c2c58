"""Training's own physics against MuJoCo C, the same problem solved by other code."""

import copy
import dataclasses
from functools import partial
from itertools import repeat

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from quadwalk.env.env import QuadrupedEnv
from quadwalk.physics.batching import BATCH, batch_robots
from quadwalk.physics.fast import (
    compute_acceleration,
    compute_leg_points,
    compute_lowest_points,
    integrate,
    make_model,
    step,
)
from quadwalk.physics.model import find_contact_geoms, find_shell_geoms
from quadwalk.physics.motor import MotorConfig, PhysicsState, make_motor
from quadwalk.robot.mjcf import Options
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.robot.scene import find_lowest_point
from tests.physics.reference import compute_accelerations, find_touching, place_robot, stack_models
from tests.robot import zoo

STATES = 40
States = tuple[np.ndarray, np.ndarray, np.ndarray]  # qpos, qvel and joint torques


def sample_states(quadruped, model, rng, states=STATES) -> States:
    """Sample robots in the air, on their feet, and bent past limits."""
    qpos = np.tile(quadruped.home, (states, 1))
    qpos[:, 2] *= rng.uniform(0.8, 1.3, states)
    qpos[:, 3:7] += 0.15 * rng.normal(size=(states, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    qpos[:, 7:] += 0.5 * rng.normal(size=(states, 12))
    return qpos, rng.normal(size=(states, 18)), 10 * rng.normal(size=(states, 12))


def sample_lying_states(quadruped, model, rng, states=STATES, turn=0.3) -> States:
    """Sample robots lowered until any of their spheres except the upper four is in the floor."""
    qpos, qvel, torque = sample_states(quadruped, model, rng, states)
    qpos[:, 3:7] += turn * rng.normal(size=(states, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    qpos[:, 7:] += 0.8 * rng.normal(size=(states, 12))
    spheres = np.concatenate(find_contact_geoms(model, quadruped.feet))
    for q in qpos:
        data = place_robot(model, q)
        bottoms = np.sort(data.geom_xpos[spheres, 2] - model.geom_size[spheres, 0])
        q[2] -= bottoms[rng.integers(max(len(spheres) - 4, 8))] + rng.uniform(0.0, 0.01)
    return qpos, qvel, torque


# Upside down and on their sides too; so many that each kind of sphere meets each other.
sample_tumbled_states = partial(sample_lying_states, states=240, turn=9.0)


@pytest.fixture(scope="module")
def body_env(env) -> QuadrupedEnv:
    """Return an environment in which knees and trunk touch the floor too."""
    return QuadrupedEnv(env.quadruped, dataclasses.replace(env.config, contacts="body"))


def make_constants(quadruped, model):
    return make_model(model, quadruped, make_motor(model, quadruped, MotorConfig()))


@partial(batch_robots, like=jax.ShapeDtypeStruct((18,), np.float64))
def solve(constants, qpos, qvel, torque) -> jax.Array:
    """Return accelerations, with the contact solver run until it has converged."""
    state = PhysicsState(qpos, qvel)
    return compute_acceleration(constants, state, torque, 30, 20)


def solve_constants(constants, *robots) -> jax.Array:
    """Return `solve` of robots (n, ...) by a program of their constants, as in a training."""
    return jax.jit(jax.vmap(partial(solve, constants)))(*robots)


@jax.jit
def solve_arguments(constants, *robots) -> jax.Array:
    """Return `solve` of robots (n, ...) by one program for all constants of one structure."""
    return jax.vmap(partial(solve, constants))(*robots)


def check_errors(accelerations, expected) -> None:
    """Assert that accelerations (robots, 18) are MuJoCo's, relative to each robot's greatest."""
    expected = np.array([data.qacc for data in expected])
    error = np.abs(np.asarray(accelerations) - expected).max(axis=1) / np.abs(expected).max(axis=1)
    assert error.max() < 1e-9, error


def check_accelerations(
    quadruped, contacts="feet", states=sample_states, combinations=True, solve=solve_arguments
) -> None:
    """Assert that accelerations, in double precision and solved to the end, are MuJoCo's.

    The states have all kinds of contact, with `combinations` in all combinations, and limits.
    """
    model = quadruped.make_training_model(0.004, 100, 50, contacts)
    model.opt.tolerance = 1e-14
    robots = states(quadruped, model, np.random.default_rng(0))
    kinds = find_contact_geoms(model, quadruped.feet)
    expected = compute_accelerations(repeat(model), *robots)
    rows = [data.nefc for data in expected]
    together = {tuple(leg) for data in expected for leg in np.isin(kinds, data.contact.geom).T}
    assert np.any(list(together), axis=0).all()
    if combinations:
        limit = mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
        assert contacts == "feet" or max(sum(data.efc_type == limit) for data in expected) > 1
        assert len(together) == 2 ** len(kinds)  # of a leg's foot, knee, corners, hip
    assert min(rows) == 0 or np.ptp(rows) > 8  # from few constraints to many
    with jax.enable_x64(True):
        # Without the shells, which only heights depend on, robots have one structure.
        accelerations = solve(make_constants(quadruped, model)._replace(shells=()), *robots)
    check_errors(accelerations, expected)


@pytest.mark.parametrize(
    ("contacts", "states"),
    [
        ("feet", sample_states),
        ("body", sample_lying_states),
        ("knees", sample_lying_states),
        ("all", sample_tumbled_states),
    ],
)
def test_accelerations_are_those_of_mujoco_whatever_touches(quadruped, contacts, states):
    check_accelerations(quadruped, contacts, states, solve=solve_constants)


def test_accelerations_of_other_quadrupeds(reference_urdf):
    check_accelerations(load_quadruped(reference_urdf))
    check_accelerations(load_quadruped(reference_urdf), "body", sample_lying_states)


@zoo.repeat_for(zoo.QUADRUPEDS)
def test_accelerations_of_the_zoos_quadrupeds(urdf):
    check_accelerations(load_quadruped(urdf, Options(meshes=False)))


@zoo.repeat_for(zoo.QUADRUPEDS, "go1", "go2", "a1_", "anymal_c", "solo12")
def test_accelerations_of_the_zoos_quadrupeds_where_all_touches(urdf):
    quadruped = load_quadruped(urdf, Options(meshes=False))
    check_accelerations(quadruped, "all", sample_tumbled_states, combinations=False)


def make_other_robot(base: mujoco.MjModel, rng: np.random.Generator) -> mujoco.MjModel:
    """Return another robot on another planet."""
    model = copy.copy(base)
    for name in ("body_mass", "body_inertia", "geom_size", "body_pos", "geom_pos"):
        values = getattr(model, name)
        values *= rng.uniform(0.8, 1.3, (len(values),) + (1,) * (values.ndim - 1))
    model.geom_size[0] = base.geom_size[0]  # the floor
    model.body_ipos[1:] += rng.uniform(-0.02, 0.02, (model.nbody - 1, 3))
    model.dof_armature[6:] += rng.uniform(0.0, 0.05, 12)
    model.dof_damping[6:] = rng.uniform(0.0, 1.0, model.dof_damping[6:].shape)
    model.jnt_range[1:] += rng.uniform(-0.2, 0.2, (12, 2))
    model.geom_friction[:, 0] = rng.uniform(0.2, 1.5)
    model.geom_solref[:, 0] *= rng.uniform(0.8, 2.0)
    model.opt.gravity[:] += rng.uniform(-3, 3, 3)
    mujoco.mj_setConst(model, mujoco.MjData(model))  # inverse weights, which contacts depend on
    return model


def test_accelerations_of_a_batch_in_which_no_two_robots_are_alike(quadruped):
    base = quadruped.make_training_model(0.004, 100, 50, "body")
    base.opt.tolerance = 1e-14
    rng = np.random.default_rng(4)
    models = [make_other_robot(base, rng) for _ in range(STATES)]
    robots = sample_lying_states(quadruped, base, rng)
    expected = compute_accelerations(models, *robots)
    assert all(
        find_touching(expected) & set(kind) for kind in find_contact_geoms(base, quadruped.feet)
    )
    leaves, assemble = stack_models([make_constants(quadruped, model) for model in models])
    assert len(leaves) > 80
    with jax.enable_x64(True):
        batched = jax.vmap(lambda leaves, *state: solve(assemble(leaves), *state))
        accelerations = jax.jit(batched)(leaves, *robots)
    check_errors(accelerations, expected)


def test_vmap_maps_the_leaves_of_a_model_that_are_given_an_axis(quadruped):
    """Change leaves that no other constant depends on; the others stay constants."""
    base = quadruped.make_training_model(0.004, 100, 50)
    base.opt.tolerance = 1e-14
    rng = np.random.default_rng(5)
    robots = sample_states(quadruped, base, rng)
    gravity, friction = rng.uniform(5, 15, STATES), rng.uniform(0.2, 1.2, STATES)
    damping = rng.uniform(0, 1, (STATES, 4))
    constants = make_constants(quadruped, base)
    feet, calf = constants.contacts[0], constants.links[2]

    def with_leaves(down, friction, damping):
        return constants._replace(
            gravity=(*constants.gravity[:2], down),
            contacts=(dataclasses.replace(feet, friction=friction),),
            links=(*constants.links[:2], calf._replace(damping=damping)),
        )

    axes = with_leaves(0, 0, 0)
    axes = jax.tree.map(lambda leaf: 0 if isinstance(leaf, int) else None, axes)
    batch = with_leaves(-gravity, friction, damping)
    with jax.enable_x64(True):
        batched = jax.vmap(solve, in_axes=(axes, 0, 0, 0))
        accelerations = jax.jit(partial(batched, batch))(*robots)
    models = [copy.copy(base) for _ in range(STATES)]
    for i, model in enumerate(models):
        model.opt.gravity[2], model.geom_friction[:, 0] = -gravity[i], friction[i]
        model.dof_damping[8::3] = damping[i]
    check_errors(accelerations, compute_accelerations(models, *robots))


def check_course(env, torques: np.ndarray, expected: np.ndarray) -> None:
    """Assert that torques (n, 12) lead through MuJoCo's states (n + 1, 37), in single precision."""
    start = PhysicsState(*np.split(jnp.asarray(expected[0], jnp.float32), [19]))
    dt = env.stepping.dt

    @partial(batch_robots, like=jax.eval_shape(lambda: start))
    def advance(model, state: PhysicsState, torque: jax.Array) -> PhysicsState:
        return integrate(state, compute_acceleration(model, state, torque, 10, 10, dt), dt)

    def step(state: PhysicsState, torque: jax.Array) -> tuple[PhysicsState, jax.Array]:
        state = advance(env.model, state, torque)
        return state, jnp.concatenate([state.qpos, state.qvel])

    _, states = jax.jit(lambda s, t: jax.lax.scan(step, s, t))(start, jnp.asarray(torques))
    error = np.abs(np.asarray(states) - expected[1:])
    assert len(error) == 200
    assert error[:, :3].max() < 5e-5
    assert error[:, 3:19].max() < 5e-4
    assert error[:, 19:].max() < 2e-3


def simulate(
    model: mujoco.MjModel, quadruped, steps: int, control=None, quat=(1, 0, 0, 0)
) -> tuple[np.ndarray, np.ndarray, set[int]]:
    """Return states, torques and geoms that touched, in MuJoCo C; `control` gives torques (12,)."""
    data = mujoco.MjData(model)
    data.qpos[:] = quadruped.home
    data.qpos[3:7] = quat
    data.qvel[:6] = np.random.default_rng(0).uniform(-0.2, 0.2, 6)
    states, torques, touching = [np.r_[data.qpos, data.qvel]], [], set()
    for k in range(steps):
        if control is not None:
            data.ctrl[:] = control(k, data)
        torques.append(data.ctrl.copy())
        mujoco.mj_step(model, data)
        states.append(np.r_[data.qpos, data.qvel])
        touching |= set(data.contact.geom.flat)
    return np.array(states), np.array(torques), touching


# Measured: 1e-5 m, 4e-5 rad, 5e-4 m/s or rad/s.
def test_200_steps_in_place_are_those_of_mujoco(env):
    quadruped = env.quadruped
    model = quadruped.make_training_model(0.004, iterations=100, ls_iterations=50)
    phase = np.pi * np.array([0, 1, 1, 0])

    def control(k: int, data: mujoco.MjData) -> np.ndarray:
        lift = np.maximum(np.sin(2 * np.pi * 2.5 * k * model.opt.timestep + phase), 0.0)
        target = env.robot.home_joints.reshape(4, 3) + np.stack([0 * lift, lift, -2 * lift], 1) / 8
        torque = 80 * (target.ravel() - data.qpos[7:]) - 2 * data.qvel[6:]
        return np.clip(torque, -quadruped.effort, quadruped.effort)

    states, torques, touching = simulate(model, quadruped, 200, control)
    assert np.ptp(states[:, 7:19], axis=0).max() > 0.1
    assert len(touching) > 4
    check_course(env, torques, states)


# Measured: 1e-7 m, 6e-6 rad, 2e-4 m/s or rad/s.
def test_a_limp_robot_drops_to_its_belly_as_in_mujoco(body_env):
    quadruped = body_env.quadruped
    model = quadruped.make_training_model(0.004, 100, 50, "body")
    states, torques, touching = simulate(model, quadruped, 200)
    assert all(touching & set(kind) for kind in find_contact_geoms(model, quadruped.feet))
    assert np.abs(states[-1, 19:25]).max() < 1e-2  # the trunk is at rest
    check_course(body_env, torques, states)


@pytest.mark.parametrize("quat", [(1, 0, 0, 0), (0, 1, 0, 0)])
def test_a_belly_or_back_rests_where_that_of_the_full_model_does(quadruped, quat):
    training = quadruped.make_training_model(0.004, 100, 50, "all")
    state, full_state = (
        simulate(model, quadruped, round(0.8 / model.opt.timestep), quat=quat)[0][-1]
        for model in (training, quadruped.make_full_model())
    )
    assert full_state[2] == pytest.approx(0.056, abs=1e-3)  # half of the trunk's height
    assert state[2] == pytest.approx(full_state[2], abs=1e-3)
    assert min(abs(state[3:7] @ quat), abs(full_state[3:7] @ quat)) > 0.99


def test_knees_and_corners_are_not_measured_as_shapes(env, body_env):
    qpos = jnp.asarray(env.robot.home).at[2].set(0.1)
    points = [compute_lowest_points(part.model, qpos) for part in (env, body_env)]
    for one, other in zip(*points, strict=True):
        np.testing.assert_array_equal(one, other)


def test_lowest_points_are_those_of_the_placed_shapes(env):
    model, feet = env.mj_model, env.quadruped.feet
    geoms, shells = find_contact_geoms(model, feet)[0], find_shell_geoms(model, feet)
    trunk = model.body(env.quadruped.trunk).id

    def find_hip(geom: int) -> int:
        """Return the body of a geom's leg that hangs on the trunk."""
        body = model.geom_bodyid[geom]
        while model.body_parentid[body] != trunk:
            body = model.body_parentid[body]
        return body

    hips = list(map(find_hip, geoms))
    rng = np.random.default_rng(2)
    compiled = jax.jit(lambda q: compute_lowest_points(env.model, q))
    for _ in range(5):
        qpos = env.robot.home + rng.uniform(-0.3, 0.3, 19)
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        data = place_robot(model, qpos)
        points, lowest = compiled(jnp.asarray(qpos, jnp.float32))
        soles = data.geom_xpos[geoms] - model.geom_size[geoms, :1] * [0, 0, 1]
        np.testing.assert_allclose(points, soles, atol=1e-6)
        expected = np.full(5, np.inf)
        for geom in shells:
            part = 0 if model.geom_bodyid[geom] == trunk else 1 + hips.index(find_hip(geom))
            expected[part] = min(expected[part], find_lowest_point(model, data, int(geom)))
        np.testing.assert_allclose(lowest, expected, atol=1e-6)


def test_leg_points_are_those_of_the_placed_feet_and_knees(body_env):
    model, quadruped = body_env.mj_model, body_env.quadruped
    trunk = model.body(quadruped.trunk).id
    data = place_robot(model, np.random.default_rng(3).uniform(-1, 1, 19))
    spheres = np.array(find_contact_geoms(model, quadruped.feet)[:2])
    expected = (data.geom_xpos[spheres] - data.xpos[trunk]) @ data.xmat[trunk].reshape(3, 3)
    points = compute_leg_points(body_env.model, data.qpos[7:])
    np.testing.assert_allclose(points, expected, atol=1e-6)


@pytest.mark.parametrize("robots", [3, BATCH, 2 * BATCH + 5])
def test_a_batch_is_its_robots_one_by_one(robots):
    """Check any number of robots, cut into whatever batches."""
    numbers = jnp.arange(2.0 * robots).reshape(robots, 2)
    like = {
        "sum": jax.ShapeDtypeStruct((), np.float32),
        "turned": jax.ShapeDtypeStruct((2,), np.float32),
    }
    function = batch_robots(lambda x, y: {"sum": x[0] + y * x[1], "turned": x[::-1]}, like)
    outputs = jax.jit(jax.vmap(function, in_axes=(0, None)))(numbers, 3.0)
    np.testing.assert_array_equal(outputs["sum"], numbers[:, 0] + 3 * numbers[:, 1])
    np.testing.assert_array_equal(outputs["turned"], numbers[:, ::-1])
    one = function(numbers[1], 3.0)
    assert (one["sum"], one["turned"].tolist()) == (
        outputs["sum"][1],
        outputs["turned"][1].tolist(),
    )


def test_a_function_is_traced_for_its_batch_alone():
    shapes = []

    def square(x):
        shapes.append(x.shape)
        return x**2

    function = batch_robots(square, jax.ShapeDtypeStruct((2,), np.float32))
    jax.jit(jax.vmap(function)).lower(jnp.ones((7, 2)))
    assert shapes == [(2, 7)]


@pytest.mark.parametrize("mapped", [False, True])
def test_it_has_derivatives(mapped):
    function = batch_robots(jnp.sin, jax.ShapeDtypeStruct((2,), np.float32))
    function = jax.vmap(function) if mapped else function
    x = jnp.arange(6.0).reshape(3, 2) if mapped else jnp.arange(2.0)
    _, tangent = jax.jvp(function, (x,), (2.0 * x,))
    np.testing.assert_allclose(tangent, 2 * x * jnp.cos(x), atol=1e-6)
    gradient = jax.grad(lambda x: jnp.sum(function(x)))(x)
    np.testing.assert_allclose(gradient, jnp.cos(x), atol=1e-6)


def test_wrong_structures_and_leaves_are_refused():
    function = batch_robots(lambda x, y: (x, x), jax.ShapeDtypeStruct((2,), np.float32))
    with pytest.raises(TypeError, match="expected"):
        jax.vmap(function, in_axes=(0, None))(jnp.ones((7, 2)), 2.0)
    with pytest.raises(TypeError, match="a leaf is a str; expected an array or a number"):
        function(jnp.ones(2), "two")


def test_a_robot_that_is_not_finite_leaves_the_others_alone(env):
    home = PhysicsState(*(jnp.asarray(x, jnp.float32) for x in (env.robot.home, np.zeros(18))))
    batch = jax.tree.map(lambda x: jnp.tile(x, (3, 1)), home)
    target = jnp.tile(jnp.asarray(env.robot.home_joints, jnp.float32), (3, 1))
    control = jax.jit(jax.vmap(lambda p, t: step(env.model, env.stepping, p, t)[0].qpos))
    sound = control(batch, target)
    for first in (jnp.nan, jnp.inf):
        ill = batch._replace(qpos=batch.qpos.at[0, 7].set(first).at[1, 2].set(first))
        np.testing.assert_array_equal(control(ill, target)[2], sound[2])
