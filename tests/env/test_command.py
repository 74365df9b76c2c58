"""The robot's command: drawn, renewed, observed and rewarded."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadwalk.env.command import (
    Command,
    advance_command,
    compute_target_velocity,
    sample_velocity,
    start_command,
)
from quadwalk.env.env import QuadrupedEnv
from quadwalk.errors import UsageError
from quadwalk.settings.environment import NO_RANDOMIZATION, CommandConfig
from quadwalk.tasks import drive, walk

COMMANDS = CommandConfig(
    forward=(-0.5, 1.5), lateral=(0.25, 0.25), yaw_rate=(-1.0, 0.0), standing=0.2, seconds=5.0
)
PERIOD = 3  # control steps
DRIVE_CONFIG = dataclasses.replace(drive.TASK.env.command, margin=0.0)


@pytest.fixture(scope="module")
def command_env(env) -> QuadrupedEnv:
    """Return an environment of the same robot, with a new command every three control steps."""
    command = dataclasses.replace(COMMANDS, seconds=PERIOD * 0.02, turning=1.0)
    ideal = NO_RANDOMIZATION  # what is seen is so
    config = dataclasses.replace(walk.TASK.env, command=command, randomization=ideal)
    return QuadrupedEnv(env.quadruped, config)


@pytest.fixture(scope="module")
def step(command_env):
    """Return the compiled step of two episodes."""
    return jax.jit(jax.vmap(command_env.step))


@pytest.fixture(scope="module")
def course(command_env, step):
    """Return the states of two episodes before and after each of eight steps."""
    states = [jax.jit(jax.vmap(command_env.reset))(jax.random.split(jax.random.PRNGKey(1), 2))]
    for _ in range(8):
        states.append(step(states[-1], jnp.full((2, 12), 0.1)))
    return states


def headings(qpos: np.ndarray) -> np.ndarray:
    """Return the headings (...), rad, of positions (..., 19), by SciPy."""
    turns = Rotation.from_quat(qpos[..., [4, 5, 6, 3]].reshape(-1, 4))
    return turns.as_euler("ZYX")[:, 0].reshape(qpos.shape[:-1])


def many(config: CommandConfig, *grip: float) -> np.ndarray:
    """Draw 4000 commands (4000, 3)."""
    keys = jax.random.split(jax.random.PRNGKey(0), 4000)
    return np.asarray(jax.vmap(lambda key: sample_velocity(config, key, *grip))(keys))


def test_commands_fill_their_ranges_and_some_are_to_stand():
    velocities = many(COMMANDS)
    standing = ~velocities.any(axis=1)
    assert 0.17 < standing.mean() < 0.23
    moving = velocities[~standing]
    for column, (low, high) in enumerate([COMMANDS.forward, COMMANDS.lateral, COMMANDS.yaw_rate]):
        assert moving[:, column].min() == pytest.approx(low, abs=0.01)
        assert moving[:, column].max() == pytest.approx(high, abs=0.01)
        assert moving[:, column].mean() == pytest.approx((low + high) / 2, abs=0.05)
    assert abs(np.corrcoef(moving[:, 0], moving[:, 2])[0, 1]) < 0.1


def test_some_commands_are_to_turn_on_the_spot_as_fast_as_any():
    config = dataclasses.replace(DRIVE_CONFIG, spot=0.3)
    keys = jax.random.split(jax.random.PRNGKey(0), 4000)
    velocities = np.asarray(jax.vmap(lambda key: sample_velocity(config, key))(keys))
    spot = ~velocities[:, :2].any(axis=1) & velocities.any(axis=1)
    assert 0.27 < spot.mean() < 0.33
    low, high = config.yaw_rate
    assert velocities[spot, 2].min() == pytest.approx(low, abs=0.02)
    assert velocities[spot, 2].max() == pytest.approx(high, abs=0.02)


def test_slow_commands_are_a_fifth_of_the_others():
    config = dataclasses.replace(COMMANDS, slow=0.3)
    changed = (many(config) != many(COMMANDS)).any(axis=1)
    assert 0.27 < changed.mean() < 0.33
    np.testing.assert_allclose(many(config)[changed], 0.2 * many(COMMANDS)[changed], rtol=1e-5)


def test_commands_that_are_nearly_zero_are_to_stand():
    config = dataclasses.replace(COMMANDS, still=0.3)
    before, after = many(COMMANDS), many(config)
    is_slow = (np.hypot(before[:, 0], before[:, 1]) < 0.3) & (np.abs(before[:, 2]) < 0.3)
    assert (is_slow & before.any(axis=1)).any()
    np.testing.assert_array_equal(after, np.where(is_slow[:, None], 0.0, before))


def test_some_commands_are_straight_ahead_or_back():
    velocities = many(dataclasses.replace(COMMANDS, straight=0.5))
    standing = ~velocities.any(axis=1)
    straight = ~velocities[:, 1:].any(axis=1) & ~standing
    assert 0.17 < standing.mean() < 0.23
    assert 0.47 < straight.mean() < 0.53
    assert velocities[straight, 0].min() == pytest.approx(-0.5, abs=0.01)
    assert velocities[straight, 0].max() == pytest.approx(1.5, abs=0.01)


@pytest.mark.parametrize(
    ("shares", "message"),
    [
        ({"straight": 1.5}, "env.command.straight is 1.5"),
        ({"straight": 0.9}, "--env.command.standing is 0.2, --env.command.straight 0.9"),
        ({"spot": 0.9}, "--env.command.spot 0.9 and --env.command.slow 0.0"),
    ],
)
def test_shares_are_shares(shares, message):
    with pytest.raises(UsageError, match=message):
        dataclasses.replace(COMMANDS, **shares)


def test_a_command_stays_for_its_time_and_no_longer():
    command = start_command(COMMANDS, jax.random.PRNGKey(3), 1.25)
    course = []
    for steps in range(1, 12):
        command = advance_command(COMMANDS, command, jnp.asarray(steps), 1.25)
        course.append(np.asarray(command.velocity))
    changed = [bool((a != b).any()) for a, b in itertools.pairwise(course)]
    assert [steps for steps, new in enumerate(changed, 2) if new] == [4, 8]


def test_lateral_commands_fade_and_turns_are_bounded():
    forward, lateral, turn = np.abs(many(DRIVE_CONFIG, 9.81)).T
    assert np.all(lateral <= 0.5 * np.maximum(1.0 - forward / 2.0, 0.0) + 1e-6)
    assert np.all(forward * turn <= 4.0 + 1e-4)
    assert turn[forward < 2.0].max() > 1.95  # rad/s: slow turns keep all of their range
    assert (forward * turn).max() > 3.9  # m/s^2
    # On a floor that bears 2 m/s^2 a turn needs half of it at most.
    forward, _, turn = np.abs(many(DRIVE_CONFIG, 2.0)).T
    assert 0.9 < (forward * turn).max() <= 1.0 + 1e-4


def test_training_goes_beyond_the_ranges_by_their_margin():
    wide = dataclasses.replace(DRIVE_CONFIG, margin=0.1, lateral_until=None)
    velocities = many(wide, 9.81)
    # A tenth wider: by 0.275 m/s at either end of 5.5 m/s, by 0.05 of 1 m/s, by 0.2 of 4 rad/s.
    ends = np.array([[-1.275, -0.55, -2.2], [4.775, 0.55, 2.2]])
    np.testing.assert_allclose(velocities.min(axis=0), ends[0], atol=0.03)
    np.testing.assert_allclose(velocities.max(axis=0), ends[1], atol=0.03)
    centripetal = np.abs(velocities[:, 0] * velocities[:, 2])
    assert 4.3 < centripetal.max() <= 4.4 + 1e-4  # m/s^2
    # Rewards count all of what is commanded.
    command = Command(jnp.array([4.0, 0.0, 1.1]), jax.random.PRNGKey(0))
    for config, turn in ((wide, 1.1), (DRIVE_CONFIG, 1.0)):
        config = dataclasses.replace(config, acceleration=None)
        target_velocity = compute_target_velocity(config, command, jnp.asarray(4.0), 9.81)
        np.testing.assert_allclose(target_velocity, [4.0, 0.0, turn], rtol=1e-6)


def test_of_a_turn_counts_what_friction_bears_at_the_robots_speed():
    config = dataclasses.replace(DRIVE_CONFIG, acceleration=None)
    command = Command(jnp.array([0.0, 0.1, -2.0]), jax.random.PRNGKey(0))
    # 4 m/s^2, or half of what friction bears; at a stand all of it.
    for speed, grip, turn in ((0.0, 9.81, -2.0), (4.0, 9.81, -1.0), (4.0, 4.0, -0.5)):
        target_velocity = compute_target_velocity(config, command, jnp.asarray(speed), grip)
        np.testing.assert_allclose(target_velocity, [0.0, 0.1, turn], rtol=1e-6)
    np.testing.assert_array_equal(
        compute_target_velocity(COMMANDS, command, jnp.asarray(4.0), 9.81), command.velocity
    )


def test_a_velocity_counts_as_if_commands_came_to_it_at_a_rate():
    # 4 m/s^2 for 0.25 s a step: 1 m/s of the 2.5 m/s to (1.5, 2.0), then another, then the rest.
    config = dataclasses.replace(COMMANDS, seconds=100.0, acceleration=4.0)
    command = start_command(config, jax.random.PRNGKey(0), 0.25)
    for velocity, way in (
        ((1.5, 2.0), [(0.0, 0.0), (0.6, 0.8), (1.2, 1.6), (1.5, 2.0), (1.5, 2.0)]),
        ((1.5, 1.5), [(1.5, 2.0), (1.5, 1.5)]),
        ((-0.5, 1.5), [(1.5, 1.5), (0.5, 1.5), (-0.5, 1.5)]),
    ):
        command = command._replace(velocity=jnp.array([*velocity, 0.3]))
        for expected in way:
            target_velocity = compute_target_velocity(config, command, jnp.asarray(0.0), 9.81)
            np.testing.assert_allclose(target_velocity, [*expected, 0.3], atol=1e-6)
            command = advance_command(config, command, jnp.asarray(1), 0.25)


def test_commands_hold_for_a_random_time():
    config = drive.TASK.env.command

    @jax.jit
    def course(key):
        def step(command, steps):
            command = advance_command(config, command, steps, 0.02)
            return command, command.velocity

        return jax.lax.scan(step, start_command(config, key, 0.02), jnp.arange(1, 4001))[1]

    velocity = np.asarray(course(jax.random.PRNGKey(0)))
    change_steps = np.flatnonzero(np.diff(velocity, axis=0).any(axis=1))
    # In s; the sum of two where one command to stand follows another.
    holds = np.diff(change_steps) * 0.02
    assert holds.min() >= 2.0 - 1e-6
    assert np.all((holds < 5.0 + 1e-6) | (holds >= 4.0))
    assert 3.2 < np.median(holds) < 3.9
    with pytest.raises(UsageError, match=r"env.command.soonest is 6.0; expected at most .*5.0"):
        dataclasses.replace(config, soonest=6.0)


def test_an_episode_is_told_anew_on_time(course):
    velocities = np.array([state.pipeline_state.command.velocity for state in course])
    assert velocities.shape == (9, 2, 3)
    np.testing.assert_array_equal(
        velocities[:, :, 1] * ~(velocities == 0).all(axis=2), velocities[:, :, 1]
    )
    new = (np.diff(velocities, axis=0) != 0).any(axis=2)
    # After the third and the sixth step, unless it is to stand again.
    assert set(np.flatnonzero(new.any(axis=1)) + 1) == {3, 6}
    assert not np.array_equal(velocities[:, 0], velocities[:, 1])


def test_the_command_is_seen_in_place_of_the_line(command_env, course):
    names = command_env.sensors.names
    assert command_env.policy_size == len(set(names))
    assert not {"heading", "offset"} & set(names)
    for state in course:
        assert state.obs.shape == (2, command_env.observation_size)
        observation = dict(zip(names, np.asarray(state.obs)[:, : len(names)].T, strict=True))
        command = [observation[f"command_{part}"] for part in ("forward", "lateral", "yaw_rate")]
        np.testing.assert_array_equal(np.transpose(command), state.pipeline_state.command.velocity)
        joints = np.asarray(state.pipeline_state.physics.qpos[:, 7])
        first = f"joint_pos_{command_env.quadruped.joints[0]}"
        np.testing.assert_allclose(
            observation[first], joints - command_env.robot.home[7], atol=1e-6
        )


def test_a_step_is_rewarded_for_the_command_it_was_given(command_env, course):
    before, after = course[2], course[3]  # the command changes at the end of this step
    qpos = np.asarray(after.pipeline_state.physics.qpos, float)
    velocity = (qpos - np.asarray(before.pipeline_state.physics.qpos))[:, :3] / 0.02
    body_velocity = Rotation.from_euler("z", headings(qpos)[:, None]).inv().apply(velocity)[:, :2]
    commanded_velocity = np.asarray(before.pipeline_state.command.velocity)[:, :2]
    error = np.linalg.norm(body_velocity - commanded_velocity, axis=1)
    expected = np.exp(-np.square(error / walk.TASK.env.reward["follow"].params["width"]))
    np.testing.assert_allclose(after.metrics["reward/follow"], expected, rtol=1e-3)
    expected = np.linalg.norm(commanded_velocity, axis=1) - error
    np.testing.assert_allclose(after.metrics["speed"], expected, atol=1e-3)
    np.testing.assert_allclose(after.metrics["velocity_error"], error, atol=1e-3)


def test_a_turn_at_a_run_is_rewarded_as_far_as_the_ground_bears_it(command_env, course, step):
    before = course[2]
    now = before.pipeline_state
    running = now.physics._replace(qvel=now.physics.qvel.at[:, 0].set(jnp.array([2.0, 0.2])))
    turn = now.command._replace(velocity=jnp.array([[0.0, 0.0, -1.0]] * 2))
    start = now._replace(physics=running, command=turn)
    after = step(before.replace(pipeline_state=start), jnp.zeros((2, 12)))
    qpos = np.asarray([now.qpos, after.pipeline_state.qpos], float)
    speed = np.linalg.norm((qpos[1] - qpos[0])[:, :2], axis=1) / 0.02
    assert speed[0] > 1.5
    assert speed[1] < 0.9
    turn_angle = np.diff(headings(qpos), axis=0)[0]
    off = turn_angle / 0.02 + np.minimum(1.0 / speed, 1.0)  # borne: 1 m/s^2
    width = walk.TASK.env.reward["follow_yaw_rate"].params["width"]
    expected = np.exp(-np.square(off / width))
    np.testing.assert_allclose(after.metrics["reward/follow_yaw_rate"], expected, rtol=1e-3)


def test_starts_do_not_depend_on_being_told(env, command_env):
    key = jax.random.PRNGKey(5)
    plain, with_command = env.reset(key), command_env.reset(key)
    assert plain.pipeline_state.command is None
    assert isinstance(with_command.pipeline_state.command, Command)
    for a, b in zip(plain.pipeline_state.physics, with_command.pipeline_state.physics, strict=True):
        np.testing.assert_array_equal(a, b)
