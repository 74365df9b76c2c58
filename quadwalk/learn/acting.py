"""A trained policy as a function: its mean action, or with noise where it is unsure."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.brax import ACTIVATION, NestedMeanStd
from quadwalk.env.reflections import Mirrors
from quadwalk.errors import UserError
from quadwalk.files import DAMAGE
from quadwalk.learn.distribution import SURE, compute_std
from quadwalk.learn.networks import check_activation, make_networks
from quadwalk.learn.statistics import compute_scale
from quadwalk.learn.symmetric import WEIGHTS
from quadwalk.robot.mirror import make_mirror
from quadwalk.runs import checkpoint
from quadwalk.runs.directory import Run
from quadwalk.runs.policy import collect_layers, read_policy
from quadwalk.runs.resume import restore_config
from quadwalk.settings.training import PPOConfig, TrainConfig

READS = 4  # numbers of an observation that a joint's noise depends on; few, for rounding's sake
GAIN = 10.0  # rad that its phase turns where one of them changes by its standard deviation


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
    changed: Mapping[str, Any] = field(default_factory=dict)  # settings changed at the desk


def load_policy(path: Path) -> Policy:
    """Load a policy; `UserError` in one line names a file that is missing, damaged or foreign."""
    saved = read_policy(path)
    config = saved.config
    try:
        check_activation(config.ppo.activation)
    except UserError as error:
        raise UserError(f"{path} holds a configuration that cannot be used: {error}") from None
    act = make_policy(config.ppo, saved.statistics, saved.weights)
    size = len(saved.statistics.mean)
    return Policy(act, config, saved.joints, size, saved.steps, saved.changed)


def load_checkpoint_policy(path: Path, joints: tuple[str, ...]) -> Policy:
    """Load the policy in a checkpoint of a run whose robot has these `joints`.

    Raises `UserError`.
    """
    leaves, metadata = checkpoint.load(path, "checkpoint")
    layers = collect_layers(leaves, _LAYERS)
    try:
        config = restore_config(metadata["config"], Run(path.parent.parent), str(path))
        steps, mean, std = int(metadata["steps"]), leaves[_MEAN], leaves[_STD]
        first = layers["hidden_0"]
        size = sum(len(first[kernel]) for kernel, _ in WEIGHTS if kernel in first)
        mirrors = metadata.get("mirrors")  # as `Networks.mirrors` gave them
        mirrors = mirrors and Mirrors(*(make_mirror(*mirrors[name]) for name in Mirrors._fields))
        networks = make_networks(config.ppo, size, len(joints), len(mean) - size, mirrors)
        policy = networks.to_plain(NestedMeanStd(mean, std), {"params": layers})
    except (*DAMAGE, UserError) as error:
        raise UserError(f"{path} holds no policy that can be used: {error}") from None
    return Policy(make_policy(config.ppo, *policy), config, joints, size, steps)


def make_policy(
    config: PPOConfig, statistics: NestedMeanStd, params: Any
) -> Callable[[jax.Array], jax.Array]:
    """Make the policy of plain `params`: observation (..., n) to action (..., 12).

    It reads the first numbers of an observation, those that the policy sees. It is a pytree of its
    weights, an argument of jitted functions: what was compiled for one policy serves for the next.
    """
    scale = config.std_scale if config.stochastic else None
    return jax.tree_util.Partial(_make_act(config.activation, scale), statistics, params)


@functools.cache
def _make_act(
    activation: str, scale: float | None
) -> Callable[[NestedMeanStd, Any, jax.Array], jax.Array]:
    def act(statistics: NestedMeanStd, params: Any, observation: jax.Array) -> jax.Array:
        layers = params["params"]
        size = len(layers["hidden_0"]["kernel"])
        # XLA multiplies (rows, n) at nearly twice the speed of (envs, steps, n).
        x = observation[..., :size].reshape(-1, size)
        x = inputs = (x - statistics.mean[:size]) / compute_scale(statistics)[:size]
        for number in range(len(layers)):
            if number:
                x = ACTIVATION[activation](x)
            layer = layers[f"hidden_{number}"]
            x = x @ layer["kernel"] + layer["bias"]
        raw, raw_std = jnp.split(x, 2, axis=-1)
        if scale is not None:
            std = compute_std(raw_std, scale)
            raw += jnp.where(std > SURE, std, 0.0) * compute_noise(inputs, raw.shape[-1])
        return jnp.tanh(raw).reshape(*observation.shape[:-1], -1)

    return act


def compute_noise(inputs: jax.Array, actions: int) -> jax.Array:
    """Return noise (rows, actions) of mean 0 and variance 1 for normalized `inputs` (rows, n).

    It stands for chance. Observations that differ a little, as those of two steps, have noise that
    differs altogether. But it is a function of them: every runtime computes the same.
    """
    return jnp.sqrt(2.0) * jnp.sin(inputs @ make_phases(inputs.shape[-1], actions))


def make_phases(size: int, actions: int) -> np.ndarray:
    """Make the matrix (size, actions), rad, that turns normalized observations into phases."""
    draw = np.random.RandomState(0)  # no version of NumPy changes its numbers
    read = draw.random_sample((size, actions)).argsort(axis=0) < READS
    return (GAIN * read * draw.standard_normal(read.shape)).astype(np.float32)
