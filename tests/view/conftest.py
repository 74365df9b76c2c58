"""Runs whose policies have learnt nothing, and a robot, live."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.acme.running_statistics import NestedMeanStd

from quadwalk.env.env import QuadrupedEnv
from quadwalk.files import format_json
from quadwalk.learn.networks import make_networks
from quadwalk.robot.quadruped import Quadruped
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run, create_run, get_versions
from quadwalk.settings.serialize import to_dict
from quadwalk.settings.training import TrainConfig
from quadwalk.tasks import rough, walk
from quadwalk.tasks import run as run_task
from quadwalk.view.choices import LAST, open_run
from quadwalk.view.live import LiveRobot

WALK = walk.TASK


def write_run(
    root: Path, name: str, quadruped: Quadruped, policies: dict[str, int], task=WALK, **options
) -> Run:
    """A run in `root`, with a policy for each file name, drawn from its seed.

    `options` are of `write_policy`.
    """
    env = QuadrupedEnv(quadruped, task.env)
    settings = {"config": to_dict(task), "versions": get_versions()}
    files = {"robot.urdf": env.quadruped.urdf.encode(), "config.json": format_json(settings)}
    run = create_run(root, name, files=files)
    for file, seed in policies.items():
        write_policy(run.path / file, env, seed, task, **options)
    return run


def write_policy(
    path: Path, env: QuadrupedEnv, seed: int, task: TrainConfig = WALK, never_varied=()
) -> None:
    """A policy, or a checkpoint, of a network drawn from `seed`, after `seed` steps of training.

    The numbers of these indices `never_varied` in what it saw.
    """
    size, config = env.policy_size, task.ppo
    rng = np.random.default_rng(seed)
    networks = make_networks(config, size, 12, env.observation_size - size)
    weights = networks.init(jax.random.PRNGKey(seed)).policy
    mean, std = rng.normal(0.0, 0.1, size), rng.uniform(1.0, 3.0, size)
    std[list(never_varied)] = 1e-6
    statistics = NestedMeanStd(jnp.float32(mean), jnp.float32(std))
    metadata = {"config": to_dict(task), "steps": seed}
    if path.parent.name == "checkpoints":
        # Of what the value network sees too there are statistics.
        more = np.ones(env.observation_size - size, np.float32)
        whole = NestedMeanStd(*(np.r_[np.float32(x), more] for x in (mean, std)))
        learner = {"params": {"policy": weights}, "normalizer": whole}
        checkpoint.save(path, {"learner": learner}, {**metadata, "kind": "checkpoint"})
        return
    known = {"joints": list(env.quadruped.joints), "observation_size": size, "score": 0.0}
    tree = {"normalizer": statistics, "policy": weights}
    checkpoint.save(path, tree, {**metadata, **known, "kind": "policy"})


@pytest.fixture(scope="session")
def walk_env(quadruped) -> QuadrupedEnv:
    return QuadrupedEnv(quadruped, WALK.env)


@pytest.fixture(scope="session")
def runs(tmp_path_factory, quadruped) -> Path:
    """A folder of runs: two of `walk`, one of `run`, one of `rough` on a few tiles."""
    root = tmp_path_factory.mktemp("runs")
    write_run(root, "dog", quadruped, {"policy.npz": 3, "checkpoints/step_000000000003.npz": 3})
    write_run(root, "cat", quadruped, {"policy.npz": 4, "best.npz": 5})
    write_run(root, "hare", quadruped, {"policy.npz": 6}, run_task.TASK)
    few = dataclasses.replace(rough.TASK.env.ground, kinds=("stairs_up", "blocks"), levels=2)
    task = dataclasses.replace(rough.TASK, env=dataclasses.replace(rough.TASK.env, ground=few))
    write_run(root, "goat", quadruped, {"policy.npz": 7}, task)
    return root


@pytest.fixture(scope="session")
def live(runs) -> LiveRobot:
    """A robot that has not moved yet."""
    return LiveRobot(open_run(Run(runs / "dog"), LAST))


@pytest.fixture(scope="session")
def hare(runs) -> LiveRobot:
    """A robot of the task `run`, whose policy sees earlier steps too."""
    return LiveRobot(open_run(Run(runs / "hare"), LAST))


@pytest.fixture(scope="session")
def goat(runs) -> LiveRobot:
    """A robot on ground that is not flat, which it sees."""
    return LiveRobot(open_run(Run(runs / "goat"), LAST))


@pytest.fixture
def fresh(live) -> LiveRobot:
    """The same, as it was at first."""
    live.change(friction=live.env.friction, payload=0.0, strength=1.0, latency=0.0, noise=0.0)
    live.command[:] = 0.0
    live.reset()
    return live
