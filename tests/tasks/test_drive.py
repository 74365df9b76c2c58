"""A robot that is driven: how its tracking of commands is measured, on one that only stands."""

import dataclasses

import jax
import numpy as np
import pytest

from quadwalk.env.command import sample_velocity
from quadwalk.env.env import QuadrupedEnv
from quadwalk.evaluation.load import LoadedRun
from quadwalk.evaluation.rollout import reset_episodes, reset_with_commands, roll_out
from quadwalk.evaluation.suites import commands as steering
from quadwalk.evaluation.suites import gaits
from quadwalk.evaluation.suites.commands import (
    draw_commands,
    make_changes,
    make_held_commands,
    measure_changing,
    measure_commands,
    measure_response,
    measure_still,
    print_commands,
    remove_creep,
    to_changing_run,
)
from quadwalk.evaluation.suites.gaits import to_held_run
from quadwalk.learn.acting import Policy
from quadwalk.runs.directory import Run
from quadwalk.settings.environment import COMMANDED, NO_RANDOMIZATION, REAL_WORLD
from quadwalk.tasks import drive
from tests.evaluation.conftest import make_glide_poses


@pytest.fixture(scope="module")
def standing(quadruped, tmp_path_factory) -> LoadedRun:
    """Return a run in MuJoCo C with a policy that holds the home pose."""
    command = dataclasses.replace(drive.TASK.env.command, soonest=None, seconds=20.0)
    still = dataclasses.replace(
        drive.TASK.env.reset, joints=0.0, velocity=0.0, joint_velocity=0.0, tilt=0.0
    )
    config = dataclasses.replace(
        drive.TASK.env, randomization=NO_RANDOMIZATION, command=command, reset=still
    )
    env = QuadrupedEnv(quadruped, config)
    act = jax.tree_util.Partial(lambda obs: 0.0 * obs[..., :12])
    policy = Policy(act, drive.TASK, quadruped.joints, env.policy_size, 0)
    folder = tmp_path_factory.mktemp("run")
    return to_held_run(LoadedRun(Run(folder), folder, policy, env, "0"))


def test_held_commands_cover_the_ranges_within_what_turns_may_need():
    commands = np.array(make_held_commands(drive.TASK.env.command))
    assert (commands[:, 0].min(), commands[:, 0].max()) == (-1.0, 4.5)
    assert (commands[:, 2].min(), commands[:, 2].max()) == (-2.0, 2.0)
    assert np.abs(commands[:, 0] * commands[:, 2]).max() <= 4.0 + 1e-6
    assert [0.0, 0.0, 0.0] in commands.tolist()


def test_each_command_is_held_from_the_same_starts(standing):
    commands = [(1.0, 0.0, 0.5), (-1.0, 0.2, 0.0)]
    starts = reset_with_commands(standing.env, commands, 3, 0)
    state = starts.pipeline_state
    np.testing.assert_allclose(state.command.velocity, np.repeat(commands, 3, axis=0), rtol=1e-6)
    np.testing.assert_array_equal(state.qpos[:3], state.qpos[3:])
    forward = standing.env.sensors.names.index("command_forward")
    np.testing.assert_array_equal(starts.obs[:, forward], [1.0] * 3 + [-1.0] * 3)


def test_a_robot_that_stands_is_as_far_off_as_its_command_says(standing, capsys, monkeypatch):
    monkeypatch.setattr(steering, "FORWARD", 5)
    monkeypatch.setattr(steering, "TURNS", 3)
    results = measure_commands(standing, 1, 0)
    assert len(results["cells"]) > 8
    for cell in results["cells"]:
        forward, _, turn = cell["command"]
        assert cell["success"] == 1.0
        assert cell["velocity_error"]["mean"] == pytest.approx(abs(forward), abs=0.01)
        assert cell["yaw_rate_error"]["mean"] == pytest.approx(abs(turn), abs=0.01)
    to_speed, to_stand, to_right = results["responses"]
    assert [each["part"] for each in results["responses"]] == ["forward", "forward", "yaw_rate"]
    assert to_speed["time"] is None
    assert to_stand["time"] == pytest.approx(0.25)  # the middle of the first half second
    assert to_right["time"] is None
    assert make_changes(drive.TASK.env.command)[0][1] == (pytest.approx(4.05), 0.0, 0.0)
    rows = gaits.measure_gaits(standing, 0)
    assert max(abs(each["speed"]) for each in rows) < 0.05
    still, without_creep = results["standing"], results["standing_without_creep"]
    assert 0.0 < without_creep["most"] < still["most"] == still["moved"]["mean"] < 0.03
    monkeypatch.setenv("COLUMNS", "120")
    changing = {"seconds": 20.0, "episodes": 4, "success": 0.75, "success_ci95": [0.3, 0.95]}
    print_commands(results | {"changing": changing})
    output = capsys.readouterr().out
    assert "4.5 m/s, 0 rad/s" in output
    assert f"by {1e3 * still['most']:.1f} mm at most" in output
    assert f"by {1e3 * without_creep['most']:.1f} mm at most" in output
    assert "75.0 % (30.0 to 95.0) of 4 episodes of 20 s end without a fall" in output
    assert len(draw_commands(results, rows, "standing").axes) == 9 + 2


def test_a_command_is_held_for_as_long_as_it_is_measured(standing, monkeypatch):
    """Check a run whose commands last 0.06 s, which is less than the time measured."""
    monkeypatch.setattr(gaits, "SECONDS", 0.2)
    config = standing.env.config
    short = dataclasses.replace(config.command, seconds=0.06)
    loaded = to_held_run(standing.to_mujoco(command=short))
    starts = reset_with_commands(loaded.env, [(1.0, 0.2, 0.5)], 1, 0)
    ((_, _, commands),) = roll_out(loaded.env, loaded.policy.act, starts, read_command)
    np.testing.assert_allclose(commands, np.tile([1.0, 0.2, 0.5], (10, 1)), rtol=1e-6)


def test_a_robot_that_moves_as_it_is_told_at_once_has_followed_at_once(standing, monkeypatch):
    """Check a trunk that moves in each step by the command that its policy sees before it."""
    at = [standing.env.sensors.names.index(f"command_{part}") for part in COMMANDED]

    def glide(env, policy, starts, change):
        first = np.asarray(starts.pipeline_state.qpos[:, :7], float)
        for number, _, commands in roll_out(env, policy, starts, seen_commands, change=change):
            poses = make_glide_poses(first[number], commands)
            yield number, True, np.concatenate([first[number, None], poses])

    def seen_commands(env, before, action, after):
        return before.obs[:, np.array(at)]

    monkeypatch.setattr(steering, "roll_out_paths", glide)
    response = measure_response(standing, (0.5, 0.0, 0.0), (2.0, 0.0, 0.0), 1, 0)
    np.testing.assert_allclose(response["curve"], 2.0, atol=1e-4)


def test_soles_of_randomized_robots_hold_too(standing):
    """Check robots that draw no more than a friction: their models are made one by one."""
    friction = standing.env.friction
    ranges = dataclasses.replace(NO_RANDOMIZATION, enabled=True, friction=(friction, friction))
    random_run = standing.to_mujoco(randomization=ranges, episode_seconds=3.0)
    usual = standing.to_mujoco(episode_seconds=3.0)
    creeping, held, alike = (
        measure_still(each, 1, 0)["most"]
        for each in (random_run, remove_creep(random_run), remove_creep(usual))
    )
    assert held == pytest.approx(alike, rel=0.05)
    assert 0.0 < held < 0.75 * creeping


def test_a_trunk_moves_as_far_as_it_gets_once_it_has_settled(standing, monkeypatch):
    away = np.zeros((401, 7))
    away[:100, 0] = 5.0  # before 2 s
    away[200, :3] = 0.3, -0.4, 9.0  # and back
    fallen = np.zeros((50, 7))
    paths = [(0, True, away), (1, True, away / 5.0), (2, False, fallen)]
    monkeypatch.setattr(steering, "roll_out_paths", lambda *_: iter(paths))
    figures = measure_still(standing, 3, 0)
    assert figures["most"] == pytest.approx(0.5)
    assert figures["moved"]["mean"] == pytest.approx(0.3)
    monkeypatch.setattr(steering, "roll_out_paths", lambda *_: iter(paths[2:]))
    assert measure_still(standing, 1, 0) == {"moved": None, "most": None}


def test_robots_are_judged_with_changing_commands_and_all_that_is_drawn(standing, monkeypatch):
    monkeypatch.setattr(steering, "LONG", 6.0)
    long = to_changing_run(standing)
    assert long.env.engine == "mujoco"
    assert long.env.config.randomization == dataclasses.replace(
        REAL_WORLD, margin=0.0, push_seconds=5.0
    )
    expected = dataclasses.replace(drive.TASK.env.command, leg=None, margin=0.0)
    assert long.env.config.command == expected
    successes = []
    for _, end, commands in roll_out(
        long.env, long.policy.act, reset_episodes(long.env, 2, 0), read_command
    ):
        assert len(np.unique(commands, axis=0)) >= 2
        successes.append(end == "time limit")
    figures = measure_changing(long, 2, 0)
    assert figures["success"] == np.mean(successes)
    assert figures["seconds"] == 6.0


def read_command(env, before, action, after):
    return before.pipeline_state.command.velocity


def test_every_command_of_a_held_configuration_is_the_same():
    """Draw 2000 commands; `drive` itself commands to stand and to turn on the spot, too."""
    config = drive.TASK.env.command.hold_at(0.7)
    velocities = jax.vmap(lambda key: sample_velocity(config, key))(
        jax.random.split(jax.random.PRNGKey(0), 2000)
    )
    np.testing.assert_allclose(velocities, np.tile([0.7, 0.0, 0.0], (2000, 1)), atol=1e-6)


@pytest.mark.parametrize("leg", [0.125, 0.5])
def test_command_ranges_have_the_same_froude_number_for_all_robots(leg):
    command = drive.TASK.env.command
    scaled_command = command.scale_to(leg, 100.0)
    for name in ("forward", "lateral"):
        scaled_range, full_range = (
            np.array(getattr(scaled_command, name)),
            np.array(getattr(command, name)),
        )
        np.testing.assert_allclose(scaled_range**2 / leg, full_range**2 / 0.5, rtol=2e-3)
    turn = scaled_command.forward[1] * scaled_command.yaw_rate[1]  # m/s^2
    assert turn == pytest.approx(command.forward[1] * command.yaw_rate[1], rel=1e-3)
    assert scaled_command.turning == command.turning
    assert scaled_command.scale_to(1.0, 1.0) == scaled_command  # once


def test_no_command_is_faster_than_the_motors_swing_a_foot(quadruped):
    command = drive.TASK.env.command
    slow = command.scale_to(0.5, 2.0)
    assert slow.forward[1] == pytest.approx(0.61 * 2.0)
    assert slow.forward[0] / slow.forward[1] == pytest.approx(-1.0 / 4.5, abs=1e-3)
    assert slow.yaw_rate == command.yaw_rate
    # 20 rad/s about a hip that is 0.37 m up: the commands are those of the task.
    assert 7.4 < quadruped.foot_speed < 7.6
    env_command = QuadrupedEnv(quadruped, drive.TASK.env).config.command
    assert env_command.forward == pytest.approx(command.forward, rel=0.01)


@pytest.mark.parametrize("forward", [(0.0, 0.0), (-1.0, 0.0), (-2.0, -1.0)])
def test_ranges_without_a_way_ahead_are_bounded_by_their_fastest(forward):
    command = dataclasses.replace(drive.TASK.env.command, forward=forward)
    assert command.scale_to(0.5, 100.0).forward == forward
    low, high = command.scale_to(0.5, 1.0).forward
    assert low == pytest.approx(max(forward[0], -0.61))
    assert low <= high <= 0.0


def test_a_robot_is_driven_at_its_own_speeds(quadruped):
    command = dataclasses.replace(drive.TASK.env.command, leg=2.0)  # four times the robot's
    env = QuadrupedEnv(quadruped, dataclasses.replace(drive.TASK.env, command=command))
    assert env.config.command.forward == (-0.5, 2.25)
    assert env.to_engine("mujoco").config.command.forward == (-0.5, 2.25)
    same = QuadrupedEnv(quadruped, drive.TASK.env).config.command
    assert same == dataclasses.replace(drive.TASK.env.command, leg=None)
