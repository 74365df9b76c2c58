"""The policy and value networks: two multilayer perceptrons on normalized observations.

Arrays have features first: an observation is (n, ...), so that every operation of a layer runs
along contiguous rows of environments. XLA's product for the gradient of weights is half as fast
the other way round (docs/physics.md).
"""

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from quadwalk.brax import ACTIVATION, NestedMeanStd
from quadwalk.env.reflections import Mirrors
from quadwalk.errors import UsageError
from quadwalk.learn.distribution import TanhNormal
from quadwalk.learn.episodes import TrainingEnv
from quadwalk.learn.statistics import normalize
from quadwalk.learn.symmetric import WEIGHTS, Basis, Parts, apply_activation, to_plain
from quadwalk.robot.mirror import NotSymmetric, join_mirrors, make_mirror
from quadwalk.settings.training import PPOConfig

LEAD = 0.3  # standard deviation of a layer's lead at the start, whose inputs have one of 1


class NetworkParams(NamedTuple):
    """The weights of both networks, in Brax's form: {"params": {"hidden_0": {"kernel": ...}}}."""

    policy: Any
    value: Any


class Networks(NamedTuple):
    """Both networks, as functions of their weights; symmetric where the bases have a mirror."""

    hidden: tuple[int, ...]
    activation: str
    std_scale: float  # of actions before the squashing
    policy_obs: Basis  # of the numbers that the policy sees
    critic_obs: Basis  # of those that the value network sees: the policy's, and more behind them
    outputs: Basis  # of the policy's outputs: means and raw standard deviations

    def init(self, key: jax.Array) -> NetworkParams:
        """Sample the weights with which training starts."""
        key_policy, key_value = jax.random.split(key)
        return NetworkParams(
            policy=self._init_layers(key_policy, self.policy_obs, self.outputs.sizes),
            value=self._init_layers(key_value, self.critic_obs, (1,)),
        )

    def _init_layers(self, key: jax.Array, inputs: Basis, outputs: tuple[int, ...]) -> Any:
        """Sample the weights of one network (LeCun et al. 1998)."""
        parts = len(inputs.sizes)
        sizes = [inputs.sizes, *((size // parts,) * parts for size in self.hidden), outputs]
        draw = jax.nn.initializers.lecun_uniform()
        layers: dict[str, dict[str, jax.Array]] = {}
        for number, shapes in enumerate(itertools.pairwise(sizes)):
            keys = jax.random.split(jax.random.fold_in(key, number), len(shapes[1]))
            layer = layers[f"hidden_{number}"] = {}
            for (kernel, bias), part_key, *shape in zip(WEIGHTS, keys, *shapes, strict=False):
                layer[kernel] = draw(part_key, tuple(shape))
                layer[bias] = jnp.zeros(shape[1])
            if "lead" in layer and number < len(self.hidden):
                lead_key = jax.random.fold_in(key, len(sizes) + number)
                layer["lead"] = LEAD * jax.random.normal(lead_key, layer["lead"].shape)
        return {"params": layers}

    def normalize(self, statistics: NestedMeanStd, observation: jax.Array) -> Parts:
        """Return the inputs, each (m, n), of both networks for observations (n, size)."""
        return self.critic_obs.split(normalize(statistics, observation).T)

    def apply_policy(self, params: Any, inputs: Parts) -> TanhNormal:
        """Return the distribution of actions (12, ...) after normalized `inputs` (m, ...)."""
        sizes = self.policy_obs.sizes
        inputs = tuple(part[:size] for part, size in zip(inputs, sizes, strict=True))
        outputs = self.outputs.join(_apply_layers(self.activation, params, inputs))
        return TanhNormal.from_outputs(outputs, self.std_scale)

    def apply_value(self, params: Any, inputs: Parts) -> jax.Array:
        """Return the expected return (...) after normalized `inputs` (m, ...)."""
        return _apply_layers(self.activation, params, inputs)[0][0]

    def to_plain(self, statistics: NestedMeanStd, params: Any) -> tuple[NestedMeanStd, Any]:
        """Return the policy's part of `statistics`, and its weights as those of a plain network."""
        size = self.policy_obs.size
        policy_statistics = NestedMeanStd(statistics.mean[:size], statistics.std[:size])
        return policy_statistics, to_plain(params, self.policy_obs, self.outputs)

    def to_plain_value(self, params: Any) -> Any:
        """Return the weights of the value network as those of a plain network."""
        return to_plain(params, self.critic_obs, self.value_output)

    @property
    def value_output(self) -> Basis:
        """The basis of the value network's output: a number that a mirror does not change."""
        return Basis(1, None if self.critic_obs.mirror is None else make_mirror([0], [1]))

    @property
    def mirrors(self) -> dict[str, list[list[int]]] | None:
        """Mirrors of observations and actions as JSON data, which a checkpoint keeps.

        Each mirror is two rows, `source` and `sign`; None if the networks are not symmetric.
        """
        observation, outputs = self.critic_obs.mirror, self.outputs.mirror
        if observation is None or outputs is None:
            return None
        numbers = {"observation": np.stack(observation), "action": np.stack(outputs)}
        numbers["action"] = numbers["action"][:, : self.outputs.size // 2]
        return {name: mirror.astype(int).tolist() for name, mirror in numbers.items()}


def _apply_layers(activation: str, params: Any, inputs: Parts) -> Parts:
    """Return the outputs of a perceptron, (m, ...) for each part."""
    layers, batch = params["params"], inputs[0].shape[1:]
    # As matrices: XLA contracts several axes at once far more slowly.
    parts = tuple(part.reshape(len(part), -1) for part in inputs)
    for number in range(len(layers)):
        if number:
            parts = apply_activation(ACTIVATION[activation], parts)
        layer = layers[f"hidden_{number}"]
        parts = tuple(
            layer[kernel].T @ part + layer[bias][:, None]
            for (kernel, bias), part in zip(WEIGHTS, parts, strict=False)
            if kernel in layer
        )
    return tuple(part.reshape(len(part), *batch) for part in parts)


def make_env_networks(
    env: TrainingEnv, config: PPOConfig, warn: Callable[[str], None] = lambda text: None
) -> Networks:
    """Make the networks of a learner in `env`; `warn` says why symmetric ones are not possible."""
    mirrors = None
    if config.symmetric:
        try:
            mirrors = env.mirrors
        except NotSymmetric as error:
            warn(f"plain networks: {error}")
    critic_size = env.observation_size - env.policy_size
    return make_networks(config, env.policy_size, env.action_size, critic_size, mirrors)


def make_networks(
    config: PPOConfig,
    policy_size: int,
    action_size: int,
    critic_size: int = 0,
    mirrors: Mirrors | None = None,
) -> Networks:
    """Make the networks of a learner, symmetric with `mirrors`, else plain.

    The policy sees the first `policy_size` numbers of an observation, the value network
    `critic_size` more, which only simulation knows (Pinto et al. 2017, arXiv:1710.06542).
    """
    check_activation(config.activation)
    observation = policy = outputs = None
    if mirrors is not None:
        if any(size % 2 for size in config.hidden):
            raise UsageError(
                f"--ppo.hidden is {config.hidden}; expected even numbers, or --ppo.no-symmetric"
            )
        observation, action = mirrors
        policy = make_mirror(observation.source[:policy_size], observation.sign[:policy_size])
        outputs = join_mirrors(action, make_mirror(action.source, np.ones(action_size)))
    return Networks(
        hidden=config.hidden,
        activation=config.activation,
        std_scale=config.std_scale,
        policy_obs=Basis(policy_size, policy),
        critic_obs=Basis(policy_size + critic_size, observation),
        outputs=Basis(2 * action_size, outputs),
    )


def check_activation(name: str) -> None:
    """Raise a `UsageError` unless Brax has an activation of that name."""
    if name not in ACTIVATION:
        raise UsageError(f"--ppo.activation is {name!r}; expected one of {', '.join(ACTIVATION)}")
