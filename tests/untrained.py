"""Runs whose policies have learned nothing."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from brax.training.acme.running_statistics import NestedMeanStd

from quadwalk.env.env import QuadrupedEnv
from quadwalk.files import format_json
from quadwalk.learn.networks import make_networks
from quadwalk.robot.quadruped import Quadruped
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run, create_run, get_versions
from quadwalk.settings.serialize import to_dict
from quadwalk.settings.training import TrainConfig
from quadwalk.tasks import walk

WALK = walk.TASK


def write_run(
    root: Path, name: str, quadruped: Quadruped, policies: dict[str, int], task=WALK, **options
) -> Run:
    """Write a run `name` in the folder `root`, with random policies; return it.

    `policies` gives the seed of each by its file. `options` are of `write_policy`.
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
    """Write the policy of a random network, drawn from `seed`, which counts as `seed` steps.

    In a folder "checkpoints" it is a checkpoint. Observations of the indices `never_varied` have a
    standard deviation of nearly 0.
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
    details = {"joints": list(env.quadruped.joints), "observation_size": size, "score": 0.0}
    tree = {"normalizer": statistics, "policy": weights}
    checkpoint.save(path, tree, {**metadata, **details, "kind": "policy"})
