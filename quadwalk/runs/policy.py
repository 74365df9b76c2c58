"""A trained policy as a file: its weights, and the configuration it was trained with."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from quadwalk.brax import NestedMeanStd
from quadwalk.errors import UserError
from quadwalk.files import DAMAGE
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run
from quadwalk.runs.resume import restore_config
from quadwalk.settings.serialize import to_dict
from quadwalk.settings.training import TrainConfig

VALUE_MEAN = "value/statistics/mean"  # a file's array that tells how many inputs the network has


class SavedValue(NamedTuple):
    """The value network of a policy, with which a training goes on from it."""

    statistics: NestedMeanStd  # (m,) of the observations that it sees: the policy's, then its own
    weights: Any  # {"params": layers of a plain perceptron}


@dataclass(frozen=True)
class SavedPolicy:
    """The content of a policy's file."""

    statistics: NestedMeanStd  # (n,) of the observations
    weights: Any  # {"params": layers of a plain perceptron}
    value: SavedValue | None  # None in files of before
    config: TrainConfig
    joints: tuple[str, ...]  # of the robot it was trained on
    steps: int  # control steps of training behind it
    # settings changed at the desk: {"env.reward.energy": {"start": -0.02, "now": -0.2}}
    changed: dict[str, Any]


def save_policy(
    path: Path,
    statistics: NestedMeanStd,
    weights: Any,
    config: TrainConfig,
    joints: tuple[str, ...],
    steps: int,
    score: float,
    changed: Mapping[str, Any] | None = None,
    value: SavedValue | None = None,
) -> None:
    """Write a policy, and its value network if there is one, to `path`, atomically.

    `statistics` (n,) are those of the policy's observations, `weights` those of a plain perceptron.
    `joints` are the names of the robot's joints. `steps` are the control steps of its training.
    `score` tells which of two policies is better.
    `changed` are the settings changed at the desk, as `describe_changes` returns them.
    """
    metadata = {
        "kind": "policy",
        "config": to_dict(config),
        "joints": list(joints),
        "observation_size": len(statistics.mean),
        "steps": steps,
        "score": score,
        "desk": dict(changed or {}),
    }
    tree = {"normalizer": statistics, "policy": weights}
    if value is not None:
        tree["value"] = value._asdict()
    checkpoint.save(path, tree, metadata)


def read_policy(path: Path) -> SavedPolicy:
    """Read a policy's file; raise a `UserError` that names one missing, damaged or foreign."""
    # Without a structure, for the file says what the structure is.
    leaves, metadata = checkpoint.load(path, "policy")
    try:
        config = restore_config(metadata["config"], Run(path.parent), str(path))
        size = int(metadata["observation_size"])
        joints = tuple(map(str, metadata["joints"]))
        steps = int(metadata["steps"])
        changed = dict(metadata.get("desk", {}))  # policies of before have none
    except (*DAMAGE, UserError) as error:
        raise UserError(f"{path} holds a configuration that cannot be used: {error}") from None
    statistics, weights = describe_network(size, config.ppo.hidden, 2 * len(joints))
    like = {"normalizer": statistics, "policy": weights}
    if VALUE_MEAN in leaves:
        inputs = leaves[VALUE_MEAN].size
        like["value"] = SavedValue(*describe_network(inputs, config.ppo.hidden, 1))._asdict()
    tree = checkpoint.fill_structure(path, leaves, like)
    value = SavedValue(**tree["value"]) if "value" in tree else None
    return SavedPolicy(tree["normalizer"], tree["policy"], value, config, joints, steps, changed)


def describe_network(
    inputs: int, hidden: Sequence[int], outputs: int
) -> tuple[NestedMeanStd, dict[str, Any]]:
    """Return shapes of the statistics of a network's inputs, and of the network's weights."""
    statistics = jax.ShapeDtypeStruct((inputs,), np.float32)
    # Written out: to have Flax say it takes as long as all the rest.
    sizes = (inputs, *hidden, outputs)
    layers = {
        f"hidden_{number}": {
            "bias": jax.ShapeDtypeStruct((after,), np.float32),
            "kernel": jax.ShapeDtypeStruct((before, after), np.float32),
        }
        for number, (before, after) in enumerate(itertools.pairwise(sizes))
    }
    return NestedMeanStd(statistics, statistics), {"params": layers}


def load_score(path: Path) -> tuple[int, float]:
    """Return the control steps of training and the score of the policy in the file `path`.

    Raises `UserError` for a file without them.
    """
    _, metadata = checkpoint.load(path, "policy")
    try:
        return int(metadata["steps"]), float(metadata["score"])
    except DAMAGE:
        raise UserError(f"{path} does not say how good its policy was") from None


def collect_layers(leaves: dict[str, Any], prefix: str) -> dict[str, dict[str, Any]]:
    """Return the layers of one network: {layer: {"kernel": array, "bias": array}}.

    `leaves` are the arrays of a file by name. Each name of the network is `prefix`, then its layer,
    then "/kernel" or "/bias".
    """
    layers: dict[str, dict[str, Any]] = {}
    for name, leaf in leaves.items():
        if name.startswith(prefix):
            layer, kind = name.removeprefix(prefix).split("/")
            layers.setdefault(layer, {})[kind] = leaf
    return layers
