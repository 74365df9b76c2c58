"""A training that begins with another run's networks."""

import dataclasses
import re
import shutil
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import toy
from brax.training.acme import running_statistics

from quadwalk.brax import NestedMeanStd
from quadwalk.env.actions import about_home
from quadwalk.env.env import QuadrupedEnv
from quadwalk.env.observations import offset
from quadwalk.errors import UsageError, UserError
from quadwalk.learn import ppo
from quadwalk.learn.acting import make_policy
from quadwalk.learn.devices import make_mesh
from quadwalk.learn.networks import Networks, make_env_networks
from quadwalk.learn.warm_start import warm_start_from
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run, create_run
from quadwalk.runs.policy import SavedValue, save_policy
from quadwalk.runs.resume import make_run
from quadwalk.settings.terms import ActionMap, Observation
from quadwalk.settings.training import TrainConfig
from quadwalk.tasks import run as task

OFFSET = {"offset": Observation(offset, {"reach": 1.0})}


def make_learner(env, config, seed):
    networks = make_env_networks(env, config.ppo)
    state = ppo.init_state(env, networks, config.ppo, make_mesh(), 8, seed)
    return networks, jax.device_get(state.learner)


def warm_start(run, config, env):
    """Return networks in `env`, the learner that starts as that of `run`, and notes."""
    networks, fresh = make_learner(env, config, 6)
    return networks, *warm_start_from(run, config, env, networks, fresh)


def compute_value(networks, learner, observation):
    """Return the output of the value network."""
    parts = networks.normalize(learner.normalizer, jnp.float32(observation))
    return networks.apply_value(learner.params.value, parts)


def sample_normal(*shape):
    return np.random.default_rng(1).normal(size=shape)


def change_config(config, part, **changes):
    """Return `config` with changes in one part, "env" or "ppo"."""
    return dataclasses.replace(
        config, **{part: dataclasses.replace(getattr(config, part), **changes)}
    )


class Source(NamedTuple):
    """A run that was saved, and its networks."""

    run: Run
    config: TrainConfig
    env: QuadrupedEnv
    networks: Networks
    learner: ppo.Learner
    policy: Any  # statistics and plain weights


@pytest.fixture(scope="module", params=["symmetric", "plain"])
def source(request, tmp_path_factory):
    runs = tmp_path_factory.mktemp("runs")
    config = dataclasses.replace(task.TASK, envs=8, name="source", runs=runs)
    config = change_config(config, "ppo", hidden=(16, 16), symmetric=request.param == "symmetric")
    quadruped = load_quadruped()
    env = QuadrupedEnv(quadruped, config.env)
    networks, learner = make_learner(env, config, 5)
    rng = np.random.default_rng(0)
    size = env.observation_size
    mean, std = np.float32(rng.normal(0, 0.1, size)), np.float32(rng.uniform(1, 2, size))
    if networks.critic_obs.mirror is not None:  # statistics are their own image
        mirror = env.mirrors.observation
        mean, std = (mean + mirror(mean)) / 2, (std + std[mirror.source]) / 2
    learner = learner._replace(normalizer=learner.normalizer.replace(mean=mean, std=std))
    run = make_run(config, quadruped)
    policy = networks.to_plain(learner.normalizer, learner.params.policy)
    value = SavedValue(NestedMeanStd(mean, std), networks.to_plain_value(learner.params.value))
    save_policy(run.policy, *policy, config, quadruped.joints, 10, 0.0, value=value)
    return Source(run, config, env, networks, learner, policy)


def act(plain, observation):
    """Return the actions of a plain policy."""
    return make_policy(task.TASK.ppo, *plain)(jnp.float32(observation))


def assert_same_actions(networks, learner, observation, policy, before, atol=1e-5, signs=1.0):
    """Assert that `learner` acts on `observation` as `policy` does on `before`, but for `signs`."""
    plain = networks.to_plain(learner.normalizer, learner.params.policy)
    np.testing.assert_allclose(act(plain, observation), act(policy, before) * signs, atol=atol)


@pytest.mark.parametrize(("name", "share"), [("another", 1.0), ("run", 0.5)])
def test_it_acts_as_the_run_does_and_in_the_same_task_half_as_randomly(source, name, share):
    run, config, env, *_, policy = source
    config = dataclasses.replace(config, task=name)
    networks, learner, notes = warm_start(run, config, env)
    assert notes == []
    observation = sample_normal(9, env.observation_size)
    assert_same_actions(networks, learner, observation, policy, observation)
    parts = networks.normalize(learner.normalizer, jnp.float32(observation))
    std = networks.apply_policy(learner.params.policy, parts).std
    start = config.ppo.init_std + 0.001 * networks.std_scale
    np.testing.assert_allclose(std, share * start, rtol=1e-5)


def test_what_is_new_changes_no_action_and_what_is_seen_in_another_order_is_found(source):
    run, config, env, *_, policy = source
    terms = {**OFFSET, **dict(reversed(config.env.observation.items()))}
    del terms["heading"]
    there = change_config(config, "env", observation=terms)
    other = QuadrupedEnv(env.quadruped, there.env)
    networks, learner, notes = warm_start(run, there, other)
    assert notes == [
        "--init: offset: is new to these networks",
        "--init: heading: is no longer seen",
    ]
    rng = np.random.default_rng(1)
    values = {name: rng.normal(size=9) for name in env.sensors.names}
    values["heading"] = np.full(9, float(policy[0].mean[0]))  # weighs nothing at its mean
    before = np.stack([values[name] for name in env.sensors.names], axis=1)
    values["offset"] = rng.normal(size=9)
    after = np.stack([values[name] for name in other.sensors.names], axis=1)
    assert_same_actions(networks, learner, after, policy, before, atol=1e-4)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_statistics_of_what_is_new_soon_are_its_own_in_any_unit(source, unit):
    run, config, env, *_ = source
    there = change_config(config, "env", observation=config.env.observation | OFFSET)
    other = QuadrupedEnv(env.quadruped, there.env)
    _, learner, _ = warm_start(run, there, other)
    normalizer = jax.tree.map(jnp.asarray, learner.normalizer)
    place, number = other.sensors.names.index("offset"), int(normalizer.count.lo)
    old_columns = np.arange(other.observation_size) != place
    before = normalizer.mean[old_columns], normalizer.std[old_columns]
    rng = np.random.default_rng(3)
    observations = np.float32(
        rng.normal(normalizer.mean, normalizer.std, (number, len(old_columns)))
    )
    observations[:, place] = rng.normal(0, unit, number)
    after = running_statistics.update(normalizer, jnp.asarray(observations))
    assert 0.6 * unit < after.std[place] < 1.1 * unit
    np.testing.assert_allclose(after.std[old_columns], before[1], rtol=0.15)
    np.testing.assert_allclose(after.mean[old_columns], before[0], atol=0.2)


def replace_in_joint(urdf, joint, pattern, new):
    """Return `urdf` with `new` for the first match of `pattern` in a joint of the AlienGo."""
    before, name, after = urdf.partition(f'<joint name="{joint}_joint"')
    return before + name + re.sub(pattern, new, after, count=1)


def test_a_robot_with_other_joints_acts_the_same_in_the_same_pose(source, tmp_path):
    """Check joints with other names, and left hips that turn the other way.

    One joint's name is the end of another's.
    """
    run, config, env, *_, policy = source
    text = env.quadruped.urdf
    for side in ("FL", "RL"):
        text = replace_in_joint(text, f"{side}_hip", '<axis xyz="1 0 0"/>', '<axis xyz="-1 0 0"/>')
    text = re.sub(r'"([FR])([RL])_(hip|thigh|calf)_joint"', r'"\2\1_\3"', text)
    text = text.replace('joint name="LF_hip"', 'joint name="hip"')
    urdf = tmp_path / "other.urdf"
    urdf.write_text(text)
    quadruped = load_quadruped(urdf)
    assert quadruped.joints[3:10:3] == ("hip", "RR_hip", "LR_hip")
    other = QuadrupedEnv(quadruped, config.env)
    networks, learner, notes = warm_start(run, config, other)
    assert notes == []
    terms = {**config.env.observation, "unsaid": Observation(lambda robot, state: state.qpos[2])}
    there = change_config(config, "env", observation=terms)
    with pytest.raises(UserError, match=r"'hip' turns the other way .* 'unsaid' does not say how"):
        warm_start(run, there, QuadrupedEnv(quadruped, there.env))
    observations = sample_normal(9, env.observation_size)
    there, joint_signs = observations.copy(), np.ones(12)
    joint_signs[[3, 9]] = -1.0
    hips = {
        f"{p}_{hip}" for p in ("joint_pos", "joint_vel", "last_action") for hip in ("hip", "LR_hip")
    }
    # Encoder offsets (12,) are what conditions end with.
    conditions = sum(name.startswith("conditions_") for name in other.sensors.critic_names)
    hips |= {f"conditions_{conditions - 12 + joint}" for joint in (3, 9)}
    names = other.sensors.names + other.sensors.critic_names
    flips = [name.partition("[")[0] in hips for name in names]
    # Position, speed, last action, each with four steps before; in the critic the first two, too.
    assert sum(flips) == 2 * (3 * 5 + 2 + 1)
    there *= np.where(flips, -1.0, 1.0)
    assert_same_actions(networks, learner, there, policy, observations, 1e-4, joint_signs)
    np.testing.assert_allclose(
        compute_value(networks, learner, there),
        compute_value(source.networks, source.learner, observations),
        atol=1e-4,
    )


def compute_foot_moves(env):
    """Return how the feet move with each joint about the home pose, (12, 12) m/rad, by MuJoCo."""
    data = mujoco.MjData(env.mj_model)
    data.qpos[:] = env.quadruped.home
    mujoco.mj_forward(env.mj_model, data)
    moves = np.zeros((4, 3, env.mj_model.nv))
    for jacobian, name in zip(moves, env.quadruped.feet, strict=True):
        mujoco.mj_jacGeom(env.mj_model, data, jacobian, None, env.mj_model.geom(name).id)
    return moves.reshape(12, -1)[:, 6:]


@pytest.mark.parametrize(
    "change",
    [
        (r'lower="-(\S+)" upper="-(\S+)"', r'lower="\2" upper="\1"'),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>'),
    ],
    ids=["limits", "axes"],
)
def test_legs_whose_knees_point_the_other_way_move_their_feet_alike(source, tmp_path, change):
    """Check an AlienGo with its hind knees ahead, by their calves' limits or axes."""
    run, config, env, *_, policy = source
    text = env.quadruped.urdf
    for side in ("RR", "RL"):
        text = replace_in_joint(text, f"{side}_calf", *change)
    urdf = tmp_path / "other.urdf"
    urdf.write_text(text)
    reaches = {"hip": 0.3, "thigh": 2.0, "calf": 1.2}
    config = change_config(config, "env", action=ActionMap(about_home, reaches))
    other = QuadrupedEnv(load_quadruped(urdf), config.env)
    np.testing.assert_allclose(other.robot.home_joints[[7, 10]], -env.robot.home_joints[[7, 10]])
    networks, learner, notes = warm_start(run, config, other)
    assert notes == []

    # Of joints there that move the feet as these do: angles, then actions, by their reaches.
    angles = np.linalg.solve(compute_foot_moves(env), compute_foot_moves(other))
    reach, before = (
        np.tile([scales["hip"], scales["thigh"], scales["calf"]], 4)
        for scales in (reaches, env.config.action.params)
    )
    actions = angles * reach / before[:, None]
    observations = sample_normal(9, env.observation_size)
    observations[:, -12:] = 0.0  # encoders' offsets, of joints without names
    there, rows = observations.copy(), 0
    critic = (f"critic {name}" for name in other.sensors.critic_names)
    names = np.array([*other.sensors.names, *critic])
    for name in names:
        part, hip, ago = name.partition(f"_{other.quadruped.joints[0]}")
        if hip:
            joints = [np.flatnonzero(names == f"{part}_{j}{ago}") for j in other.quadruped.joints]
            columns = np.concatenate(joints)
            there[:, columns] = (
                observations[:, columns] @ (actions if part == "last_action" else angles).T
            )
            rows += 1
    assert rows == 3 * 5 + 2
    plain = networks.to_plain(learner.normalizer, learner.params.policy)
    raw, expected = np.arctanh(act(plain, observations)), np.arctanh(act(policy, there))
    np.testing.assert_allclose(raw @ actions.T, expected, atol=1e-3)
    np.testing.assert_allclose(
        compute_value(networks, learner, observations),
        compute_value(source.networks, source.learner, there),
        atol=1e-4,
    )


def test_networks_of_another_shape_or_kind_are_refused(source):
    run, config, env, *_ = source
    with pytest.raises(UserError, match=r"--ppo.hidden \(16, 16\); here it is \(32,\)"):
        warm_start(run, change_config(config, "ppo", hidden=(32,)), env)
    other_config = change_config(config, "ppo", symmetric=not config.ppo.symmetric)
    if other_config.ppo.symmetric:
        with pytest.raises(UserError, match=r"--ppo\.no-symmetric"):
            warm_start(run, other_config, env)
    else:
        warm_start(run, other_config, env)


def test_a_run_that_was_not_saved_is_refused(source, tmp_path):
    _, config, env, *_ = source
    with pytest.raises(UserError, match="has no policy"):
        warm_start(create_run(tmp_path, "empty", files={}), config, env)


def test_a_run_with_a_policy_alone_gives_that(source, tmp_path):
    run, config, env, *_, policy = source
    alone = Run(tmp_path)
    shutil.copyfile(run.urdf, alone.urdf)
    save_policy(alone.policy, *policy, config, env.quadruped.joints, 10, 0.0)
    networks, fresh = make_learner(env, config, 6)
    learner, notes = warm_start_from(alone, config, env, networks, fresh)
    assert notes == [f"--init: {alone.policy} has no value network: a new one is trained"]
    observations = sample_normal(9, env.observation_size)
    assert_same_actions(networks, learner, observations, policy, observations)
    jax.tree.map(np.testing.assert_array_equal, learner.params.value, fresh.params.value)


class Other(toy.Toy):
    """The toy with an observation that the source does not have."""

    sensors = SimpleNamespace(names=("position", "other", "speed"), critic_names=())


def test_a_training_begins_so_and_goes_on_without_its_source(
    tmp_path, flags, train, same_result, capsys, monkeypatch
):
    def load_kernel(name, steps, network):
        leaves, _ = checkpoint.load(Run(tmp_path / name).locate_checkpoint(steps), "checkpoint")
        return leaves[f"learner/params/{network}/params/hidden_0/kernel"]

    train(*flags(tmp_path, "source", 2))
    monkeypatch.setattr("quadwalk.learn.prepare.QuadrupedEnv", Other)
    train(*flags(tmp_path, "begun", 3, "--init=source", "--checkpoint-steps=64"))
    output = capsys.readouterr().out
    assert f"begins with the networks of {tmp_path / 'source'}" in output
    assert "--init: other: is new to these networks" in output
    # The first iteration measures what is seen; what is new is learnt after that.
    for network in ("policy", "value"):
        source, begun = load_kernel("source", 128, network), load_kernel("begun", 64, network)
        np.testing.assert_array_equal(begun, source * [[1], [0], [1]])
        assert np.all(load_kernel("begun", 192, network)[1] != 0.0)

    # One that was killed before its first checkpoint begins so again.
    other = tmp_path / "other"
    shutil.copytree(tmp_path / "begun", other / "begun")
    for path in (*Run(other / "begun").checkpoints.iterdir(), *(other / "begun").glob("*.jsonl")):
        path.unlink()
    train(f"--runs={other}", "--resume=begun")
    same_result(other / "begun", tmp_path / "begun")
    shutil.rmtree(tmp_path / "source")
    train(f"--runs={other}", "--resume=begun", "--steps=256")
    with pytest.raises(UsageError, match="--init with --resume: the run has its own"):
        train(f"--runs={other}", "--resume=begun", "--init=begun")
