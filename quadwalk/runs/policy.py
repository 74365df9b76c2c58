"""A trained policy as a file: its weights, and the configuration it was trained with."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from quadwalk.brax import NestedMeanStd
from quadwalk.env.reflections import Mirrors
from quadwalk.errors import UserError
from quadwalk.files import DAMAGE
from quadwalk.learn.acting import make_policy
from quadwalk.learn.networks import KERNELS, check_activation, make_networks
from quadwalk.robot.mirror import make_mirror
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run
from quadwalk.runs.resume import config_of
from quadwalk.settings.serialize import to_dict
from quadwalk.settings.training import TrainConfig

# Where a checkpoint has the policy's layers and the observation's statistics.
_LAYERS = "learner/params/policy/params/"
_MEAN, _STD = "learner/normalizer/mean", "learner/normalizer/std"


@dataclass(frozen=True)
class Policy:
    """A policy as a function, and what it belongs to."""

    act: Callable[[jax.Array], jax.Array]  # observation (..., n) to action (..., 12)
    config: TrainConfig
    joints: tuple[str, ...]  # of the robot it was trained on
    observation_size: int
    steps: int  # control steps of training behind it


def save_policy(
    path: Path,
    statistics: NestedMeanStd,
    weights: Any,
    config: TrainConfig,
    joints: tuple[str, ...],
    steps: int,
    score: float,
) -> None:
    """Write a plain policy to `path`, whole or not at all; `statistics` (n,) of what it sees."""
    metadata = {
        "kind": "policy",
        "config": to_dict(config),
        "joints": list(joints),
        "observation_size": len(statistics.mean),
        "steps": steps,
        "score": score,
    }
    checkpoint.save(path, {"normalizer": statistics, "policy": weights}, metadata)


def load_score(path: Path) -> tuple[int, float]:
    """Control steps and score of the policy at `path`; `UserError` if it has none to tell."""
    _, metadata = checkpoint.load(path, "policy")
    try:
        return int(metadata["steps"]), float(metadata["score"])
    except DAMAGE:
        raise UserError(f"{path} does not say how good its policy was") from None


def load_checkpoint_policy(path: Path, joints: tuple[str, ...]) -> Policy:
    """The policy in a checkpoint, of a run whose robot has these `joints`; raises `UserError`."""
    leaves, metadata = checkpoint.load(path, "checkpoint")
    layers = layers_of(leaves, _LAYERS)
    try:
        config = config_of(metadata["config"], Run(path.parent.parent), str(path), "0.1")
        steps, mean, std = int(metadata["steps"]), leaves[_MEAN], leaves[_STD]
        first = layers["hidden_0"]
        size = sum(len(first[name]) for name in KERNELS if name in first)
        mirrors = metadata.get("mirrors")  # as `Networks.mirrors` gave them
        mirrors = mirrors and Mirrors(*(make_mirror(*mirrors[name]) for name in Mirrors._fields))
        networks = make_networks(config.ppo, size, len(joints), len(mean) - size, mirrors)
        policy = networks.plain_policy(NestedMeanStd(mean, std), {"params": layers})
    except (*DAMAGE, UserError) as error:
        raise UserError(f"{path} holds no policy that can be used: {error}") from None
    return Policy(make_policy(config.ppo, *policy), config, joints, size, steps)


def layers_of(leaves: dict[str, Any], prefix: str) -> dict[str, dict[str, Any]]:
    """The layers of the network whose leaves in a file have names with this prefix."""
    layers: dict[str, dict[str, Any]] = {}
    for name, leaf in leaves.items():
        if name.startswith(prefix):
            layer, kind = name.removeprefix(prefix).split("/")
            layers.setdefault(layer, {})[kind] = leaf
    return layers


def load_policy(path: Path) -> Policy:
    """Read a policy; `UserError` in one line names a file that is missing, damaged or foreign."""
    # First without a structure, for the metadata that says what the structure is.
    _, metadata = checkpoint.load(path, "policy")
    try:
        config = config_of(metadata["config"], Run(path.parent), str(path), "0.1")
        size = int(metadata["observation_size"])
        joints = tuple(map(str, metadata["joints"]))
        steps = int(metadata["steps"])
        check_activation(config.ppo.activation)
    except (*DAMAGE, UserError) as error:
        raise UserError(f"{path} holds a configuration that cannot be used: {error}") from None
    statistics = jax.ShapeDtypeStruct((size,), np.float32)
    # Written out: to have Flax say it takes as long as all the rest.
    sizes = (size, *config.ppo.hidden, 2 * len(joints))
    layers = {
        f"hidden_{i}": {
            "bias": jax.ShapeDtypeStruct((wide,), np.float32),
            "kernel": jax.ShapeDtypeStruct((before, wide), np.float32),
        }
        for i, (before, wide) in enumerate(itertools.pairwise(sizes))
    }
    like = {"normalizer": NestedMeanStd(statistics, statistics), "policy": {"params": layers}}
    tree, _ = checkpoint.load(path, "policy", like)
    act = make_policy(config.ppo, tree["normalizer"], tree["policy"])
    return Policy(act, config, joints, size, steps)
