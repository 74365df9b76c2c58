"""A policy of many bodies as one of a single robot: it acts the same, in meters and seconds."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import quadwalk
from benchmarks.shared import find_example_robots
from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UserError
from quadwalk.evaluation.load import load_run
from quadwalk.export.policy_graph import find_joint_targets
from quadwalk.learn import ppo
from quadwalk.learn.acting import make_policy
from quadwalk.learn.devices import make_mesh
from quadwalk.learn.networks import make_env_networks
from quadwalk.learn.one_robot import make_one_robot_config, translate_observations
from quadwalk.learn.warm_start import warm_start_from
from quadwalk.paths import PRETRAINED
from quadwalk.robot.bodies import make_body, sample_bodies
from quadwalk.runs.directory import Run
from quadwalk.settings.environment import NO_RANDOMIZATION, BodiesConfig
from quadwalk.settings.training import OtherRobotConfig
from quadwalk.tasks import drive, universal
from tests.untrained import write_run

PPO = dataclasses.replace(universal.TASK.ppo, hidden=(16,), symmetric=False)
TASK = dataclasses.replace(
    universal.TASK,
    env=dataclasses.replace(universal.TASK.env, bodies=BodiesConfig()),
    ppo=PPO,
)
UNDISTURBED = dataclasses.replace(TASK.env, randomization=NO_RANDOMIZATION)


def make_short(hind_knees):
    """Return a quadruped with legs of 0.3 m whose hind knees may point ahead."""
    figures = next(sample_bodies(1, 0))
    return make_body(
        dataclasses.replace(figures, leg=0.3, front_knees=False, hind_knees=hind_knees)
    )


@pytest.fixture(scope="module")
def body():
    return make_short(hind_knees=True)


@pytest.fixture(scope="module")
def loaded(quadruped, body, tmp_path_factory):
    """Return a random policy of many bodies in the environment of that robot."""
    run = write_run(tmp_path_factory.mktemp("runs"), "many", quadruped, {"policy.npz": 1}, TASK)
    loaded = load_run(run, 1.0, engine="fast")
    return dataclasses.replace(loaded, env=QuadrupedEnv(body, UNDISTURBED))


def observe_random_states(env):
    """Return the policy's observations (n, ...) of `env` in random states with a history."""
    rng = np.random.default_rng(3)
    start = env.make_example_state()

    @jax.jit
    def observe(env, physics, action, velocity):
        state = start._replace(command=start.command._replace(velocity=velocity))
        state = env.sensors.start_history(env.robot, state)
        for i in range(6):
            at_rest = start.physics
            pose = at_rest._replace(
                qpos=at_rest.qpos + physics[i, :19], qvel=at_rest.qvel + physics[i, 19:]
            )
            state = env.sensors.measure(
                env.robot, state._replace(physics=pose, last_action=action[i])
            )
        return env.sensors.observe(env.robot, state)[: env.policy_size]

    physics, actions = rng.normal(size=(5, 6, 37)), rng.uniform(-1, 1, (5, 6, 12))
    inputs = map(jnp.float32, (0.3 * physics, actions, rng.normal(size=(5, 3))))
    return jnp.stack([observe(env, *row) for row in zip(*inputs, strict=True)])


def test_it_acts_the_same_in_every_state(loaded):
    one = loaded.to_one_robot()
    assert one.to_one_robot() is one
    names = one.env.sensors.names
    assert not any("body" in name for name in names)
    expected = loaded.policy.act(observe_random_states(loaded.env))
    actual = one.policy.act(observe_random_states(one.env))
    assert np.abs(expected).mean() > 0.05
    np.testing.assert_allclose(actual, expected, atol=2e-4)


def test_it_observes_and_moves_the_robots_own_joints(loaded, body):
    """Check that it observes meters and seconds of its robot.

    The policy of many bodies sees all at the AlienGo's size: times by the root of the legs' length.
    """
    env = loaded.to_one_robot().env
    state = env.make_example_state()
    state = state._replace(
        physics=state.physics._replace(qvel=jnp.arange(18.0)),
        command=state.command._replace(velocity=jnp.array([1.0, 2.0, 3.0])),
    )
    state = env.sensors.start_history(env.robot, state)
    observed = dict(zip(env.sensors.names, env.sensors.observe(env.robot, state), strict=False))
    assert observed["command_lateral"] == 2.0
    assert observed["angular_velocity_z"] == 5.0
    assert observed[f"joint_vel_{body.joints[7]}"] == 13.0


def test_targets_of_a_knee_ahead_follow_from_two_actions(loaded):
    env = loaded.to_one_robot().env
    targets = find_joint_targets(env.config.action, env.robot)
    assert targets.scale is None
    matrix = targets.matrix.copy()
    for thigh in (7, 10):  # of the hind legs
        assert abs(matrix[thigh, thigh + 1]) > 0.5
        matrix[thigh, thigh + 1] = 0.0
    np.testing.assert_array_equal(matrix, np.diag(np.diag(matrix)))
    action = np.linspace(-0.9, 0.9, 12)
    expected = env.config.action(env.robot, jnp.float32(action), jnp.zeros(12))
    np.testing.assert_allclose(targets(action), expected, atol=1e-5)


def test_the_value_network_observes_the_same_too(body):
    """Check its observations, conditions among them: shares of the mass, and lengths."""
    many, one = (QuadrupedEnv(body, x) for x in (TASK.env, make_one_robot_config(TASK.env)))
    translation = translate_observations(many, one, "critic")
    state = many.make_example_state(jax.random.PRNGKey(9))
    state = state._replace(
        physics=state.physics._replace(qvel=jnp.linspace(-1.0, 1.0, 18)),
        contact=jnp.array([True, False, False, True]),
    )
    expected, inputs = (
        np.asarray(env.sensors.compute(env.config.critic, env.robot, state)) for env in (many, one)
    )
    assert np.abs(expected - inputs).max() > 0.1
    actual = translation.matrix @ inputs + translation.constant
    is_stride = np.array(["strides" in name for name in many.sensors.critic_names])
    assert translation.fits[~is_stride].all()
    np.testing.assert_allclose(actual[~is_stride], expected[~is_stride], atol=1e-4)


def test_a_training_of_one_robot_begins_with_it(loaded):
    """Check knees behind; where they are ahead, only small actions are the same."""
    quadruped = make_short(hind_knees=False)
    env = QuadrupedEnv(quadruped, drive.TASK.env)
    config = dataclasses.replace(drive.TASK, envs=8, ppo=PPO)
    networks = make_env_networks(env, PPO)
    state = ppo.init_state(env, networks, PPO, make_mesh(), 8, 0)
    learner = jax.device_get(state.learner)
    learner, notes = warm_start_from(loaded.run, config, env, networks, learner)
    assert not any("body" in note or "new to" in note for note in notes)
    plain = networks.to_plain(learner.normalizer, learner.params.policy)
    one = dataclasses.replace(loaded, env=QuadrupedEnv(quadruped, UNDISTURBED)).to_one_robot()
    observed = observe_random_states(one.env)
    expected = one.policy.act(observed)
    np.testing.assert_allclose(make_policy(PPO, *plain)(observed), expected, atol=2e-4)


def test_it_drives_a_robot_from_a_file(loaded):
    """Check joints with other names.

    A table says how near the robot is to those trained on.
    """
    robot = OtherRobotConfig(urdf=find_example_robots() / "go1_description/urdf/go1.urdf").find()
    other = load_run(loaded.run, 1.0, engine="fast", robot=robot)
    assert other.env.quadruped.name == "go1"
    assert other.env.robot.leg == pytest.approx(0.426)
    assert other.policy.config.robot == robot
    assert "mass, kg" in " ".join(other.notes)


def test_a_policy_of_one_robot_drives_no_other():
    robot = OtherRobotConfig(urdf=Path("other.urdf")).find()
    with pytest.raises(UserError, match="drives the robot that it was trained on") as error:
        load_run(Run(PRETRAINED / "walk"), 1.0, robot=robot)
    assert "\n" not in str(error.value)
    for show in (quadwalk.evaluate, quadwalk.play):
        with pytest.raises(UserError, match="drives the robot that it was trained on"):
            show("walk", robot="other.urdf")
    with pytest.raises(UserError, match="need --robot"):
        OtherRobotConfig(speed=1.0)
