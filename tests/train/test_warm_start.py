"""A training that begins with another run's networks."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.acme.running_statistics import NestedMeanStd

from quadwalk.errors import UserError
from quadwalk.robot.quadruped import load_quadruped
from quadwalk.settings.serialise import to_dict
from quadwalk.settings.terms import Observation
from quadwalk.task.env import QuadrupedEnv
from quadwalk.task.observation import offset
from quadwalk.tasks import run as task
from quadwalk.train import ppo
from quadwalk.train.networks import mean_policy, networks_for
from quadwalk.train.runs import checkpoint
from quadwalk.train.runs.directory import as_json, create_run, versions
from quadwalk.train.warm_start import begun_from

CONFIG = dataclasses.replace(
    task.TASK, envs=8, ppo=dataclasses.replace(task.TASK.ppo, hidden=(16, 16))
)
SEEN = {"reach": 1.0}


def learner_of(env, config, seed):
    networks = networks_for(env, config.ppo)
    state = ppo.init_state(env, networks, config.ppo, ppo.make_mesh(), 8, seed)
    return networks, jax.device_get(state.learner)


def changed(config, **env):
    return dataclasses.replace(config, env=dataclasses.replace(config.env, **env))


@pytest.fixture(scope="module", params=["symmetric", "plain"])
def source(request, tmp_path_factory):
    """A run, its environment, and the policy that it has."""
    config = CONFIG
    if request.param == "plain":
        config = dataclasses.replace(CONFIG, ppo=dataclasses.replace(CONFIG.ppo, symmetric=False))
    quadruped = load_quadruped()
    env = QuadrupedEnv(quadruped, config.env)
    networks, learner = learner_of(env, config, 5)
    rng = np.random.default_rng(0)
    size = env.observation_size
    mean, std = np.float32(rng.normal(0, 0.1, size)), np.float32(rng.uniform(1, 2, size))
    if networks.whole.mirror is not None:  # statistics are their own image
        mirror = env.mirrors.observation
        mean, std = (mean + mirror(mean)) / 2, (std + std[mirror.source]) / 2
    learner = learner._replace(normalizer=learner.normalizer.replace(mean=mean, std=std))
    settings = {"config": to_dict(config), "versions": versions()}
    files = {"robot.urdf": quadruped.urdf.encode(), "config.json": as_json(settings)}
    run = create_run(tmp_path_factory.mktemp("runs"), "source", files=files)
    run.checkpoints.mkdir(exist_ok=True)
    state = ppo.TrainState(learner, {"x": np.zeros(1)})
    checkpoint.save(run.checkpoint(10), state, {"kind": "checkpoint", "mirrors": None})
    return run, config, env, networks.plain_policy(learner.normalizer, learner.params.policy)


def acts(networks, learner, observation):
    return mean_policy("swish", *networks.plain_policy(learner.normalizer, learner.params.policy))(
        observation
    )


def test_it_acts_as_the_run_does_and_as_randomly_as_at_a_start(source):
    run, config, env, policy = source
    networks, fresh = learner_of(env, config, 6)
    learner, notes = begun_from(run, config, env, networks, fresh)
    assert notes == []
    seen = jnp.asarray(np.random.default_rng(1).normal(size=(9, env.observation_size)), jnp.float32)
    np.testing.assert_allclose(
        acts(networks, learner, seen), mean_policy("swish", *policy)(seen), atol=1e-5
    )
    parts = networks.normalised(
        NestedMeanStd(learner.normalizer.mean, learner.normalizer.std), seen
    )
    std = networks.policy(learner.params.policy, parts).std
    np.testing.assert_allclose(std, config.ppo.noise + 0.001 * networks.std_scale, rtol=1e-5)


def test_what_is_new_changes_no_action_and_what_is_seen_in_another_order_is_found(source):
    run, config, env, policy = source
    own = dict(reversed(config.env.observation.items()))
    own = {"offset": Observation(offset, SEEN), **own}
    del own["heading"]
    there = changed(config, observation=own)
    other = QuadrupedEnv(env.quadruped, there.env)
    networks, fresh = learner_of(other, there, 6)
    learner, notes = begun_from(run, there, other, networks, fresh)
    assert notes == [
        "--init: offset: is new to these networks",
        "--init: heading: is no longer seen",
    ]
    rng = np.random.default_rng(1)
    values = {name: rng.normal(size=9) for name in env.observation_names}
    values["heading"] = np.full(9, float(policy[0].mean[0]))  # weighs nothing at its mean
    before = np.stack([values[name] for name in env.observation_names], axis=1)
    values["offset"] = rng.normal(size=9)
    after = np.stack([values[name] for name in other.observation_names], axis=1)
    np.testing.assert_allclose(
        acts(networks, learner, jnp.float32(after)),
        mean_policy("swish", *policy)(jnp.float32(before)),
        atol=1e-4,
    )
    count = learner.normalizer.count
    np.testing.assert_allclose(
        np.sqrt(learner.normalizer.summed_variance / float(count.lo)),
        learner.normalizer.std,
        rtol=1e-5,
    )


def test_networks_of_another_shape_or_kind_are_refused(source):
    run, config, env, _ = source
    wide = dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, hidden=(32,)))
    networks, fresh = learner_of(env, wide, 6)
    with pytest.raises(UserError, match=r"--ppo.hidden \(16, 16\); here it is \(32,\)"):
        begun_from(run, wide, env, networks, fresh)
    turned = dataclasses.replace(
        config, ppo=dataclasses.replace(config.ppo, symmetric=not config.ppo.symmetric)
    )
    networks, fresh = learner_of(env, turned, 6)
    if turned.ppo.symmetric:
        with pytest.raises(UserError, match=r"--ppo\.no-symmetric"):
            begun_from(run, turned, env, networks, fresh)
    else:
        begun_from(run, turned, env, networks, fresh)


def test_a_run_without_a_checkpoint_is_refused(source, tmp_path):
    _, config, env, _ = source
    networks, fresh = learner_of(env, config, 6)
    with pytest.raises(UserError, match="has no checkpoint"):
        begun_from(create_run(tmp_path, "empty", files={}), config, env, networks, fresh)
