"""Bodies that differ from episode to episode, in one compiled program."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from quadwalk.brax import State
from quadwalk.env.constants import Description
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.similarity import resize_robot, resize_state, resize_step
from quadwalk.env.state import Strides
from quadwalk.errors import UsageError
from quadwalk.learn import ppo
from quadwalk.learn.devices import make_mesh
from quadwalk.learn.networks import make_env_networks
from quadwalk.physics import fast
from quadwalk.physics.motor import MotorConfig, PhysicsState, make_standing_motor
from quadwalk.robot.bodies import Body, make_body, sample_bodies
from quadwalk.tasks import drive, universal, universal_getup
from tests.physics.reference import place_robot, step_control

BODIES = 3
SEED = 5
EPISODES = 300


@pytest.fixture(scope="module")
def figures() -> list[Body]:
    """Return three bodies, of which the first has all knees ahead."""
    first, *others = sample_bodies(BODIES, SEED)
    return [dataclasses.replace(first, front_knees=True, hind_knees=True), *others]


@pytest.fixture(scope="module")
def bodies(figures):
    return [make_body(body, f"body{place}") for place, body in enumerate(figures)]


@pytest.fixture(scope="module")
def env(quadruped, bodies) -> QuadrupedEnv:
    return QuadrupedEnv(quadruped, universal.TASK.env, bodies=bodies)


@pytest.fixture(scope="module")
def starts(env):
    """Return the states of many fresh episodes, and their bodies."""
    keys = jax.random.split(jax.random.PRNGKey(1), EPISODES)
    state = jax.jit(lambda env, keys: jax.vmap(env.reset)(keys))(env, keys)
    return state, np.asarray(state.pipeline_state.body)


def test_a_control_step_of_each_body_is_that_of_mujoco(env, bodies):
    stepping = dataclasses.replace(env.stepping, iterations=8, line_search=10)
    rng = np.random.default_rng(0)
    qpos = np.stack([body.home for body in bodies])
    qpos[:, 2] -= 0.002
    qvel = rng.uniform(-0.5, 0.5, (BODIES, 18))
    targets = qpos[:, 7:] + rng.uniform(-0.1, 0.1, (BODIES, 12))

    @jax.jit
    @jax.vmap
    def step(place, qpos, qvel, target):
        robot = env.get_body(place).robot
        return fast.step(robot.geometry, stepping, PhysicsState(qpos, qvel), target)

    places = jnp.arange(BODIES)
    after, effort = step(places, *(jnp.asarray(x, jnp.float32) for x in (qpos, qvel, targets)))
    for place, body in enumerate(bodies):
        model = body.make_training_model(stepping.dt, 100, 50)
        motor, _ = make_standing_motor(model, body, MotorConfig())
        motor = motor._replace(friction=body.friction)
        expected = step_control(model, motor, qpos[place], qvel[place], [targets[place]] * 5)
        assert expected.touching
        np.testing.assert_allclose(after.qpos[place], expected.qpos, atol=1e-4)
        np.testing.assert_allclose(after.qvel[place], expected.qvel, atol=2e-2)
        np.testing.assert_allclose(effort.torque[place], expected.torque, rtol=1e-2, atol=2e-2)


def test_an_episode_has_one_body_from_its_start_to_its_end(env, figures, bodies, starts):
    state, places = starts
    assert set(places) == set(range(BODIES))
    described = list(env.sensors.names).index("body_size")
    qpos = np.asarray(state.pipeline_state.qpos)
    for place, body in enumerate(bodies):
        rows = places == place
        size = np.log(figures[place].leg / 0.5)
        np.testing.assert_allclose(state.obs[rows, described], size, atol=1e-5)
        # Starts are near the home pose, in which the knees of one body are ahead.
        assert np.abs(qpos[rows, 7:] - body.home[7:]).max() < 0.201
        np.testing.assert_allclose(qpos[rows, 2], body.home[2], rtol=0.4)
    few = jax.tree.map(lambda x: x[:8], state)
    after = jax.jit(lambda env, *a: jax.vmap(env.step)(*a))(env, few, jnp.zeros((8, 12)))
    np.testing.assert_array_equal(after.pipeline_state.body, places[:8])
    assert np.isfinite(after.obs).all()
    np.testing.assert_array_equal(after.metrics["nan"], 0.0)
    heavy = [figures[place].mass >= 35.0 for place in places[:8]]
    np.testing.assert_array_equal(after.metrics["count/bodies/heavy"], heavy)


def test_commands_are_bounded_by_the_legs_and_motors_of_a_body(figures, bodies, starts):
    state = starts[0].pipeline_state
    for place, body in enumerate(bodies):
        commands = np.asarray(state.command.velocity)[np.asarray(state.body) == place]
        similar = np.sqrt(figures[place].leg / 0.5)
        fastest = min(4.5 * similar, 0.61 * body.foot_speed)  # of drive's 4.5 m/s for 0.5 m
        assert 0.8 * fastest < commands[:, 0].max() <= 1.1 * fastest
        assert np.abs(commands[:, 2]).max() <= 1.1 * 2.0 / similar + 1e-6


def test_the_description_of_the_alien_go(quadruped):
    description = Description(*QuadrupedEnv(quadruped, universal.TASK.env).robot.description)
    torque, time = 23.24 * 9.81 * 0.5, np.sqrt(0.5 / 9.81)
    expected = {
        "size": 0.0,
        "thigh": 0.5,
        "length": 0.4814 / 0.5,
        "width": 0.102 / 0.5,
        "offset": 0.0868 / 0.5,
        "foot": 0.0265 / 0.5,
        "legs": 1.0 - 11.644 / 23.24,
        "ahead": 0.008811 / 0.5,
        "above": 0.000273 / 0.5,
        "pitch": np.sqrt(0.24693924 / 23.24) / 0.5,
        "thigh_effort": np.log(35.278 / torque),
        "calf_effort": np.log(44.4 / torque),
        "thigh_speed": np.log(20.0 * time),
        "stiffness": np.log(1.4 * quadruped.home[2] / 0.5),
        "damping": np.log(1.4 * quadruped.home[2] / 0.5 * 0.025 / time),
        "front_knees": -1.0,
        "hind_knees": -1.0,
    }
    for name, value in expected.items():
        assert getattr(description, name) == pytest.approx(value, abs=2e-3), name


def test_for_the_alien_go_the_task_is_drive(quadruped):
    """Check that only the description is new.

    The AlienGo is of unit size, and its joints are standard.
    """
    env, alike = (QuadrupedEnv(quadruped, task.TASK.env) for task in (drive, universal))
    state = alike.make_example_state()
    qpos = state.qpos.at[7:].add(jnp.linspace(-0.2, 0.2, 12))
    state = state._replace(physics=PhysicsState(qpos, jnp.linspace(-1.0, 1.0, 18)))
    observed, expected = (
        {name: float(x) for name, x in zip(names, values, strict=True)}
        for names, values in (
            ([*e.sensors.names, *e.sensors.critic_names], e.start_episode(start).obs)
            for e, start in ((e, State(state, *[None] * 3)) for e in (alike, env))
        )
    )
    # In `drive`'s critic the trunk's added mass is in kg, not in shares of 20 kg.
    del expected["conditions_1"]
    new = {name for name in set(observed) - set(expected) if not name.startswith("strides")}
    assert new == {"conditions_1", *(f"body_{name}" for name in Description._fields)}
    for name, value in expected.items():
        assert observed[name] == pytest.approx(value, rel=1e-5, abs=1e-5), name
    action = jnp.linspace(-0.5, 0.5, 12)
    targets = [e.config.action(e.robot, action, qpos[7:]) for e in (env, alike)]
    np.testing.assert_allclose(*targets, atol=1e-6)


def test_standard_joints_move_the_feet_of_all_bodies_alike(figures):
    """Check that feet under the same hips go the same way, wherever the knees are."""
    behind = dataclasses.replace(figures[0], front_knees=False, hind_knees=False)
    joint_changes = np.array([0.0, 0.02, -0.03] * 4)
    places = []
    for body in (behind, figures[0]):
        quadruped = make_body(body)
        env = QuadrupedEnv(quadruped, universal.TASK.env)
        model, robot = env.mj_model, env.robot
        np.testing.assert_allclose(
            robot.to_standard(robot.from_standard(joint_changes)), joint_changes, atol=1e-6
        )
        feet = [model.geom(name).id for name in quadruped.feet]
        home = place_robot(model, quadruped.home).geom_xpos[feet]
        qpos = quadruped.home.copy()
        qpos[7:] += robot.from_standard(joint_changes)
        places.append((place_robot(model, qpos).geom_xpos[feet] - home) / body.leg)
    assert np.abs(places[0]).max() > 0.01
    np.testing.assert_allclose(places[0], places[1], atol=6e-4)


def test_a_robot_four_times_as_large_moves_twice_as_fast(env, quadruped):
    robot, state = env.robot, jax.eval_shape(env.reset, jax.random.PRNGKey(0)).pipeline_state
    small = dataclasses.replace(robot, leg=robot.leg / 4.0)
    qpos, qvel = np.r_[1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0, quadruped.home[7:] + 0.1], np.ones(18)
    state = state._replace(
        physics=PhysicsState(jnp.asarray(qpos, jnp.float32), jnp.asarray(qvel, jnp.float32)),
        command=state.command._replace(velocity=jnp.ones(3), reached=jnp.ones(2)),
        conditions=None,
        strides=Strides(jnp.ones(4), jnp.ones(4), jnp.ones(())),
    )
    resized = resize_state(small, state, robot.leg)
    np.testing.assert_allclose(resized.qpos[:3], [4.0, 8.0, 12.0])
    np.testing.assert_allclose(resized.qpos[3:], qpos[3:], atol=1e-6)
    np.testing.assert_allclose(resized.qvel, [2.0] * 3 + [0.5] * 15)
    np.testing.assert_allclose(resized.command.velocity, [2.0, 2.0, 0.5])
    np.testing.assert_allclose(resized.strides.time, 2.0)
    np.testing.assert_allclose(resized.strides.peak, 4.0)
    np.testing.assert_allclose(resized.strides.yaw_rate_error, 0.5)
    assert resize_robot(small, robot.leg).home_height == pytest.approx(4.0 * robot.home_height)
    before = state._replace(physics=state.physics._replace(qpos=state.qpos.at[0].add(-0.02)))
    zero = jnp.zeros(())
    step = env._make_step(robot, before, state, fast.Effort(jnp.zeros(12), zero + 3.0), zero == 0.0)
    larger = resize_step(small, step, robot.leg)
    # The mean velocity of 1 m/s and the power are twice as large, as all speeds are.
    np.testing.assert_allclose(larger.mean_velocity, [2.0, 0.0], rtol=1e-4, atol=1e-5)
    assert larger.power == pytest.approx(2.0 * float(step.power))
    assert larger.height == pytest.approx(12.0)


def test_a_start_becomes_one_of_another_body(env, starts, bodies, figures):
    state, places = starts
    first = jax.tree.map(lambda x: x[0], state)
    place = (int(places[0]) + 1) % BODIES
    start = env.start_with_body(first, jnp.int32(place)).pipeline_state
    before, after = (bodies[k] for k in (int(places[0]), place))
    angles = np.clip(
        after.home[7:] + first.pipeline_state.qpos[7:] - before.home[7:], after.lower, after.upper
    )
    np.testing.assert_allclose(start.qpos[7:], angles, atol=1e-5)
    soles, _ = fast.compute_lowest_points(env.get_body(place).robot.geometry, start.qpos)
    assert np.min(soles[:, 2]) == pytest.approx(0.0, abs=1e-5)
    command, expected = start.command.velocity, first.pipeline_state.command.velocity
    slower = np.sqrt(figures[places[0]].leg / figures[place].leg)
    np.testing.assert_allclose(command[2], slower * expected[2], rtol=1e-4)
    np.testing.assert_allclose(start.conditions.targets[0], after.home[7:], atol=1e-6)
    same = env.start_with_body(first, jnp.int32(places[0]))
    np.testing.assert_allclose(same.obs, first.obs, atol=1e-4)


def test_bodies_train(env):
    """Check a training in which bodies are tried once more after a fall."""
    config = dataclasses.replace(
        universal.TASK.ppo, eval_envs=2, unroll=4, minibatches=2, hidden=(16,), retry=0.5
    )
    networks, mesh = make_env_networks(env, config), make_mesh()
    assert networks.mirrors is not None
    state = ppo.init_state(env, networks, config, mesh, 16, seed=0)
    state, numbers = ppo.Iteration(env, networks, config, mesh, iterations=10)(state)
    row = jax.device_get(numbers)
    assert row["learner/finite"]
    assert row["count/nan"] == 0
    places = np.asarray(state.workers.envs.pipeline_state.body)
    assert set(places.ravel()) == set(range(BODIES))


def test_legs_of_standard_size_are_where_the_bodys_own_are(env):
    rng = np.random.default_rng(0)
    for place in range(BODIES):
        robot = env.get_body(place).robot
        offsets = rng.uniform(-0.5, 0.5, 12)
        joints = robot.home_joints + robot.to_standard(offsets)
        points = resize_robot(robot, 0.5).compute_leg_points(joints)
        expected = 0.5 / robot.leg * robot.compute_leg_points(robot.home_joints + offsets)
        np.testing.assert_allclose(points, expected, atol=1e-5)


def test_figures_are_counted_by_class(quadruped, bodies, env):
    getup = QuadrupedEnv(quadruped, universal_getup.TASK.env, bodies=bodies)
    for task_env, figure in ((env, "velocity_error"), (getup, "standing")):
        metrics = jax.eval_shape(task_env.reset, jax.random.PRNGKey(0)).metrics
        of_light = {name.split("/")[1] for name in metrics if name.endswith("/light")}
        assert of_light == {"bodies", "fell", figure}


def test_bodies_need_the_fast_engine_and_a_level_floor():
    with pytest.raises(UsageError, match=r"--env\.bodies\.number needs"):
        dataclasses.replace(universal.TASK.env, engine="mjx")
