"""Loading a run to be evaluated: its policy, its ranges, its ground and its commands."""

import dataclasses
import hashlib

import jax
import numpy as np
import pytest

from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.terminations import TRUNK_FALLS
from quadwalk.errors import UserError
from quadwalk.evaluation import load as loading
from quadwalk.evaluation.load import load_run, make_unseen_ground
from quadwalk.evaluation.rollout import reset_episodes, simulate_episodes
from quadwalk.learn.acting import Policy, load_policy
from quadwalk.paths import PRETRAINED
from quadwalk.runs.directory import Run
from quadwalk.runs.resume import restore_config
from quadwalk.settings.environment import CommandConfig
from quadwalk.settings.serialize import to_dict
from quadwalk.task_files import load_task
from quadwalk.tasks import list_tasks, rough, walk
from quadwalk.terrain.terrain import FLAT, UNSEEN


def test_the_ground_of_an_evaluation_is_not_that_of_training():
    trained = rough.TASK.env.ground
    ground = make_unseen_ground(trained, seed=3, levels=4)
    assert ground.seed == UNSEEN + 3
    assert (ground.levels, ground.curriculum) == (4, False)
    assert sorted(ground.kinds) == sorted(set(trained.kinds))  # each once
    assert make_unseen_ground(FLAT, 3) == FLAT


def test_an_episode_has_one_command_which_its_policy_sees(quadruped, monkeypatch, tmp_path):
    command = CommandConfig(
        forward=(0.5, 1.0), lateral=(0.0, 0.0), yaw_rate=(-1.0, 0.0), standing=0.0, seconds=0.04
    )
    act = jax.tree_util.Partial(lambda observation: 0.0 * observation[..., :12])
    config = dataclasses.replace(walk.TASK, env=dataclasses.replace(walk.TASK.env, command=command))
    size = QuadrupedEnv(quadruped, config.env).policy_size
    policy = Policy(act, config, quadruped.joints, size, 0)
    monkeypatch.setattr(loading, "load_policy", lambda path: policy)
    monkeypatch.setattr(loading, "load_robot", lambda *_: quadruped)
    (tmp_path / "policy.npz").write_bytes(b"weights")
    env = loading.load_run(Run(tmp_path), 0.2, engine="mujoco").env
    rollouts = list(simulate_episodes(env, act, 2, seed=0))
    for rollout in rollouts:
        assert rollout.command.shape == (10, 3)
        assert (rollout.command == rollout.command[0]).all()
        assert 0.5 <= rollout.command[0, 0] <= 1.0
        first = rollout.observation_names.index("command_forward")
        np.testing.assert_array_equal(rollout.observation[:, first : first + 3], rollout.command)
    assert (rollouts[0].command[0] != rollouts[1].command[0]).any()


@pytest.fixture
def policy(monkeypatch) -> Policy:
    """Return a trained policy, which `load_policy` then gives for every file."""
    policy = load_policy(PRETRAINED / "run" / "policy.npz")
    monkeypatch.setattr(loading, "load_policy", lambda _: policy)
    return policy


@pytest.fixture
def folder(tmp_path) -> Run:
    """Return a run whose files hold no policy."""
    for name in ("policy.npz", "best.npz"):
        (tmp_path / name).write_bytes(b"weights of " + name.encode())
    return Run(tmp_path)


def test_an_evaluation_pushes_once_in_five_seconds_within_the_ranges_however_training_did(
    policy, folder, monkeypatch
):
    trained = dataclasses.replace(
        policy.config.env.randomization, push_seconds=2.0, margin=0.3, ideal=0.5
    )
    env = dataclasses.replace(policy.config.env, randomization=trained)
    harder = dataclasses.replace(policy, config=dataclasses.replace(policy.config, env=env))
    monkeypatch.setattr(loading, "load_policy", lambda _: harder)
    config = load_run(folder, 20.0, engine="fast", randomized=True).env.config
    assert config.steps_per_push == 250
    expected = dataclasses.replace(trained, push_seconds=5.0, margin=0.0, ideal=0.0)
    assert config.randomization == expected


def test_the_last_policy_is_loaded_or_the_best(policy, folder):
    for which, file in [("last", folder.policy), ("best", folder.best)]:
        loaded = load_run(folder, 1.0, which, "fast")
        assert (loaded.file, loaded.config) == (file, None)
        assert loaded.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    assert jax.tree.leaves(loaded.policy.act)  # its weights are arguments, not constants


def test_a_policy_of_a_flat_floor_falls_on_other_ground_by_its_trunk_alone(policy, folder):
    tile = {"levels": 1, "difficulty": (1.0, 1.0), "tile": (4.0, 4.0), "roughness": 0.03}
    rough = dataclasses.replace(FLAT, kinds=("rough",), **tile)
    env = load_run(folder, 1.0, engine="fast", ground=rough).env
    assert env.ends == ("running", "time limit", *TRUNK_FALLS, "nan")
    heights = env.terrain.field.heights
    # The tile, a border of level ground around it.
    assert 0.02 < np.ptp(heights) <= 2 * 0.03 + 1e-6
    assert load_run(folder, 1.0, engine="fast").env.ends == (
        "running",
        "time limit",
        *policy.config.env.termination,
        "nan",
    )


def test_a_command_is_held_as_it_is_given(folder, monkeypatch):
    drive = load_policy(PRETRAINED / "drive" / "policy.npz")
    monkeypatch.setattr(loading, "load_policy", lambda _: drive)
    env = load_run(folder, 1.0, engine="fast", command=(1.0, 0.25, -0.5)).env
    state = reset_episodes(env, 4, 0).pipeline_state
    np.testing.assert_allclose(state.command.velocity, [[1.0, 0.25, -0.5]] * 4)


def test_a_policy_without_commands_has_none_to_hold(policy, folder):
    with pytest.raises(UserError, match="follows no velocity command"):
        load_run(folder, 1.0, engine="fast", command=(1.0, 0.0, 0.0))


def test_a_configuration_that_cannot_be_read_is_one_line(policy, folder):
    folder.config.mkdir()
    with pytest.raises(UserError) as caught:
        load_run(folder, 1.0)
    assert str(caught.value) == f"cannot read {folder.config}: Is a directory"


def test_a_policy_of_another_robot_is_one_line(policy, folder, monkeypatch):
    joints = tuple(f"{name}_of_another" for name in policy.joints)
    for change in ({"joints": joints}, {"observation_size": 48}):
        other = dataclasses.replace(policy, **change)
        monkeypatch.setattr(loading, "load_policy", lambda _, other=other: other)
        with pytest.raises(UserError, match="was trained on another robot than"):
            load_run(folder, 1.0, engine="fast")


@pytest.mark.parametrize("task", list_tasks())
def test_runs_of_before_tasks_named_a_suite_have_that_of_their_task(task, tmp_path):
    config = load_task(task)
    data = to_dict(config)
    assert data.pop("suite") == config.suite
    assert restore_config(data, Run(tmp_path), "config.json").suite == config.suite


def test_a_policy_of_many_bodies_falls_by_its_trunk_alone_and_one_that_gets_up_never():
    env = load_run(Run(PRETRAINED / "universal"), 1.0, engine="fast").env
    assert env.ends == ("running", "time limit", *TRUNK_FALLS, "nan")
    env = load_run(Run(PRETRAINED / "universal_getup"), 1.0, engine="fast").env
    assert env.ends == ("running", "time limit", "nan")
