"""The policy and value networks of the learner.

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

from quadwalk.brax import (
    ACTIVATION,
    NestedMeanStd,
    PPONetworkParams,
    RunningStatisticsState,
    running_statistics,
    specs,
)
from quadwalk.env.reflections import Mirrors
from quadwalk.errors import UsageError
from quadwalk.robot.mirror import Mirror, NotSymmetric, join_mirrors, make_mirror
from quadwalk.settings.training import PPOConfig

# Of a number's standard deviation, as a share of its mean or, if that is less than 1, of 1.
CONSTANT = 1e-4
LEAD = 0.3  # standard deviation of a layer's lead at the start, whose inputs have one of 1
MIN_STD = 0.001  # of an action before the squashing, as in Brax
HALF = np.float32(np.sqrt(0.5))

KERNELS = ("kernel", "negated")  # a layer's, of each part; a value has no negated part
BIASES = ("bias", "lead")  # likewise

Parts = tuple[jax.Array, ...]  # (all,), or those that the mirror keeps, and those that it negates


class Basis:
    """Orthonormal coordinates of vectors (n, ...) in which a mirror image only changes signs.

    Of two numbers that change places: their sum and their difference. Without a mirror they are
    the numbers themselves, as one part.
    """

    def __init__(self, size: int, mirror: Mirror | None = None) -> None:
        self.size, self.mirror = size, mirror
        if mirror is None:
            self.matrices: tuple[np.ndarray, ...] = (np.eye(size, dtype=np.float32),)
            return
        source, sign = np.asarray(mirror.source), np.asarray(mirror.sign, np.float32)
        image = np.zeros((size, size), np.float32)
        image[np.arange(size), source] = sign
        first = np.arange(size) <= source
        alone = np.arange(size) == source
        kept = first & ~(alone & (sign < 0.0))
        negated = first & ~(alone & (sign > 0.0))
        scale = np.where(alone, np.float32(0.5), HALF)[:, None]
        unit = np.eye(size, dtype=np.float32)
        # What of a row is not 0 is at most two numbers: `split` reads no more.
        self.matrices = ((scale * (unit + image))[kept], (scale * (unit - image))[negated])

    @property
    def sizes(self) -> tuple[int, ...]:
        return tuple(len(matrix) for matrix in self.matrices)

    def split(self, x: jax.Array) -> Parts:
        """The coordinates of `x` (n, ...)."""
        return (x,) if self.mirror is None else tuple(_pairs(m, x) for m in self.matrices)

    def join(self, parts: Parts) -> jax.Array:
        """The vector (n, ...) with these coordinates."""
        if self.mirror is None:
            return parts[0]
        return _pairs(np.concatenate(self.matrices).T, jnp.concatenate(parts))


def _pairs(matrix: np.ndarray, x: jax.Array) -> jax.Array:
    """`matrix @ x`, for a matrix with at most two numbers in a row that are not 0."""
    order = np.argsort(matrix == 0.0, axis=1, kind="stable")[:, :2]
    weights = np.take_along_axis(matrix, order, axis=1).reshape(-1, 2, *[1] * (x.ndim - 1))
    return weights[:, 0] * x[order[:, 0]] + weights[:, 1] * x[order[:, 1]]


class Networks(NamedTuple):
    """Two multilayer perceptrons on normalized observations.

    With a mirror they are equivariant: each layer maps kept to kept and negated to negated numbers,
    and the activation is that of two halves that are each other's mirror image (Su et al. 2024,
    arXiv:2403.17320). That is half of a plain network's arithmetic, and it learns from fewer steps.
    One thing breaks the symmetry, `lead`: what each layer adds to the negated numbers. A mirrored
    observation gives the mirrored action, and the same value, with the lead's sign changed. Without
    it no side could lead a gallop: `run` then bounds, at 4.9 to 5.2 m/s instead of 5.5. It begins
    at random, for no gradient says which side.
    """

    hidden: tuple[int, ...]
    activation: str
    std_scale: float  # of actions before the squashing
    seen: Basis  # of what the policy sees
    whole: Basis  # of what the value network sees: that, and more behind it
    outputs: Basis  # of the policy's: means and raw standard deviations

    def init(self, key: jax.Array) -> PPONetworkParams:
        key_policy, key_value = jax.random.split(key)
        return PPONetworkParams(
            policy=_layers(key_policy, self._sizes(self.seen, self.outputs.sizes)),
            value=_layers(key_value, self._sizes(self.whole, (1,))),
        )

    def _sizes(self, inputs: Basis, outputs: tuple[int, ...]) -> list[tuple[int, ...]]:
        parts = len(inputs.sizes)
        return [inputs.sizes, *((size // parts,) * parts for size in self.hidden), outputs]

    def normalized(self, normalizer: NestedMeanStd, observation: jax.Array) -> Parts:
        """What the networks take (m, n) of observations as they are (n, size)."""
        return self.whole.split(((observation - normalizer.mean) / divisors(normalizer)).T)

    def policy(self, params: Any, parts: Parts) -> "TanhNormal":
        """The distribution of actions after `normalized` observations."""
        own = tuple(part[:size] for part, size in zip(parts, self.seen.sizes, strict=True))
        outputs = self.outputs.join(_perceptron(self.activation, params, own))
        return TanhNormal.of(outputs, self.std_scale)

    def value(self, params: Any, parts: Parts) -> jax.Array:
        """The expected return (...) after `normalized` observations (m, ...)."""
        return _perceptron(self.activation, params, parts)[0][0]

    def init_statistics(self) -> RunningStatisticsState:
        """Brax's statistics of observations, of none so far."""
        return running_statistics.init_state(specs.Array((self.whole.size,), jnp.dtype("float32")))

    def measured(
        self, normalizer: RunningStatisticsState, parts: Parts, axis: str
    ) -> RunningStatisticsState:
        """`normalizer` with these `normalized` observations (steps, m, n), and mirrored.

        As Brax's `running_statistics.update`, with the batch's own mean and variance (Chan, Golub
        and LeVeque 1983): so rounding does not spread a number that is constant. Devices along
        `axis` have as many observations each.
        """
        origin = jax.lax.pmean(parts[0][0, :, 0], axis)
        rows = (parts[0] - origin[:, None], *parts[1:])
        means = [jax.lax.pmean(jnp.mean(part, axis=(0, 2)), axis) for part in rows]
        squares = [jax.lax.pmean(jnp.mean(part**2, axis=(0, 2)), axis) for part in rows]
        kept = self.whole.matrices[0].T
        shift = kept @ means[0]
        variance = (
            sum((m.T**2) @ square for m, square in zip(self.whole.matrices, squares, strict=True))
            - shift**2
        )
        moved, scale = kept @ origin + shift, divisors(normalizer)
        number = len(rows[0]) * rows[0].shape[-1] * jax.lax.axis_size(axis)
        count = normalizer.count + jnp.int32(number)
        total = jnp.float32(count.hi) * 2.0**32 + jnp.float32(count.lo)
        before = 1.0 - number / total
        spread = normalizer.summed_variance + number * scale**2 * (variance + before * moved**2)
        std = jnp.clip(jnp.sqrt(jnp.maximum(spread, 0.0) / total), 1e-6, 1e6)
        mean = normalizer.mean + scale * moved * number / total
        return normalizer.replace(count=count, mean=mean, summed_variance=spread, std=std)

    def plain_policy(self, normalizer: NestedMeanStd, params: Any) -> tuple[NestedMeanStd, Any]:
        """The statistics of what the policy sees, and its weights as those of a plain network."""
        size = self.seen.size
        statistics = NestedMeanStd(normalizer.mean[:size], normalizer.std[:size])
        return statistics, plain(params, self.seen, self.outputs)

    @property
    def mirrors(self) -> dict[str, list[list[int]]] | None:
        """The mirrors of observations and actions as JSON data, which a checkpoint keeps."""
        if self.whole.mirror is None or self.outputs.mirror is None:
            return None
        named = {"observation": self.whole.mirror, "action": self.outputs.mirror}
        whole = {name: np.stack([own.source, own.sign]).astype(int) for name, own in named.items()}
        whole["action"] = whole["action"][:, : self.outputs.size // 2]
        return {name: own.tolist() for name, own in whole.items()}


def networks_for(
    env: Any, config: PPOConfig, warn: Callable[[str], None] = lambda _: None
) -> Networks:
    """Make the networks of a learner in `env`; `warn` says why symmetric ones are not possible."""
    try:
        mirrors = env.mirrors if config.symmetric else None
    except NotSymmetric as error:
        warn(f"plain networks: {error}")
        mirrors = None
    critic = len(env.sensors.critic_names)
    return make_networks(config, env.policy_size, env.action_size, critic, mirrors)


def check_activation(name: str) -> None:
    """Raise a `UsageError` unless Brax has an activation of that name."""
    if name not in ACTIVATION:
        raise UsageError(f"--ppo.activation is {name!r}; expected one of {', '.join(ACTIVATION)}")


def make_networks(
    config: PPOConfig,
    policy_size: int,
    action_size: int,
    critic_size: int = 0,
    mirrors: Mirrors | None = None,
) -> Networks:
    """The networks of a learner, symmetric with `mirrors`, else plain.

    The policy sees the first `policy_size` numbers of an observation, the value network
    `critic_size` more: what is known in simulation alone (Pinto et al. 2017, arXiv:1710.06542).
    """
    check_activation(config.activation)
    seen = outputs = None
    if mirrors is not None:
        if any(size % 2 for size in config.hidden):
            raise UsageError(
                f"--ppo.hidden is {config.hidden}; expected even numbers, or --ppo.no-symmetric"
            )
        whole, action = mirrors
        seen = make_mirror(whole.source[:policy_size], whole.sign[:policy_size])
        outputs = join_mirrors(action, make_mirror(action.source, np.ones(action_size)))
    return Networks(
        hidden=config.hidden,
        activation=config.activation,
        std_scale=config.std_scale,
        seen=Basis(policy_size, seen),
        whole=Basis(policy_size + critic_size, mirrors and mirrors.observation),
        outputs=Basis(2 * action_size, outputs),
    )


def _layers(key: jax.Array, sizes: list[tuple[int, ...]]) -> Any:
    """Weights at random (LeCun et al. 1998), in Brax's form, for parts of these sizes."""
    draw, layers = jax.nn.initializers.lecun_uniform(), {}
    for number, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
        keys = jax.random.split(jax.random.fold_in(key, number), len(outputs))
        layer = {name: jnp.zeros(size) for name, size in zip(BIASES, outputs, strict=False)}
        if "lead" in layer and number + 2 < len(sizes):
            own = jax.random.fold_in(key, len(sizes) + number)
            layer["lead"] = LEAD * jax.random.normal(own, layer["lead"].shape)
        for name, own, shape in zip(
            KERNELS, keys, zip(inputs, outputs, strict=False), strict=False
        ):
            layer[name] = draw(own, shape)
        layers[f"hidden_{number}"] = layer
    return {"params": layers}


def _perceptron(activation: str, params: Any, parts: Parts) -> Parts:
    """The outputs of a perceptron, (m, ...) for each part."""
    layers, several = params["params"], parts[0].shape[1:]
    # As matrices: XLA contracts several axes at once far more slowly.
    parts = tuple(part.reshape(len(part), -1) for part in parts)
    for number in range(len(layers)):
        if number:
            parts = _activated(ACTIVATION[activation], parts)
        kernels, biases = _kernels_and_biases(layers[f"hidden_{number}"])
        parts = tuple(
            kernel.T @ part + bias[:, None]
            for kernel, part, bias in zip(kernels, parts, biases, strict=False)
        )
    return tuple(part.reshape(len(part), *several) for part in parts)


def _kernels_and_biases(layer: Any) -> tuple[list[Any], list[Any]]:
    """Of a layer's parts; a value's has no negated one."""
    kernels, biases = ([layer[n] for n in names if n in layer] for names in (KERNELS, BIASES))
    return kernels, biases


def _activated(activation: Callable[[jax.Array], jax.Array], parts: Parts) -> Parts:
    """`parts` after the activation, which works on a layer's units themselves."""
    if len(parts) == 1:
        return (activation(parts[0]),)
    kept, negated = (HALF * part for part in parts)
    left, right = activation(kept + negated), activation(kept - negated)
    return HALF * (left + right), HALF * (left - right)


def _bases(layers: Any, inputs: Basis, outputs: Basis) -> list[tuple[Basis, Basis]]:
    """The bases before and after each layer of a network."""
    between = []
    for number in range(len(layers) - 1):
        kernels, _ = _kernels_and_biases(layers[f"hidden_{number}"])
        half = sum(kernel.shape[1] for kernel in kernels) // 2
        swap = make_mirror(np.roll(np.arange(2 * half), half), np.ones(2 * half))
        between.append(Basis(2 * half, swap))
    return list(zip([inputs, *between], [*between, outputs], strict=True))


def plain(params: Any, inputs: Basis, outputs: Basis) -> Any:
    """Weights of the plain network that computes the same."""
    if inputs.mirror is None:
        return params
    layers = {}
    for number, (before, after) in enumerate(_bases(params["params"], inputs, outputs)):
        kernels, biases = _kernels_and_biases(params["params"][f"hidden_{number}"])
        layers[f"hidden_{number}"] = {
            "kernel": sum(
                a.T @ kernel @ b
                for a, kernel, b in zip(before.matrices, kernels, after.matrices, strict=False)
            ),
            "bias": sum(bias @ b for bias, b in zip(biases, after.matrices, strict=False)),
        }
    return {"params": layers}


def structured(params: Any, inputs: Basis, outputs: Basis) -> Any:
    """What `plain` makes these weights of; others lose what no such network can have."""
    if inputs.mirror is None:
        return params
    layers: dict[str, dict[str, Any]] = {}
    for number, (before, after) in enumerate(_bases(params["params"], inputs, outputs)):
        layer = params["params"][f"hidden_{number}"]
        own = layers.setdefault(f"hidden_{number}", {})
        for kernel, bias, a, b in zip(
            KERNELS, BIASES, before.matrices, after.matrices, strict=False
        ):
            if len(b):  # a value has no negated part
                own[kernel] = a @ layer["kernel"] @ b.T
                own[bias] = b @ layer["bias"]
    return {"params": layers}


def divisors(normalizer: NestedMeanStd) -> jax.Array:
    """What the numbers of an observation, less their means, are divided by (n,): their spread.

    It is 1 where a number has been constant so far, but for rounding: it may vary yet, and
    nothing says by how much.
    """
    least = CONSTANT * jnp.maximum(jnp.abs(normalizer.mean), 1.0)
    return jnp.where(normalizer.std < least, 1.0, normalizer.std)


class TanhNormal(NamedTuple):
    """Independent normal distributions whose samples tanh squashes into actions; features first.

    It is Brax's `NormalTanhDistribution`, with its entropy in closed form in place of a sample: the
    normal's and the mean logarithm of the tanh's slope. That mean is expanded about the normal's
    own: log(1 - tanh(x)^2) has the second derivative -2 (1 - tanh(x)^2).
    """

    mean: jax.Array  # (12, ...)
    std: jax.Array  # (12, ...)

    @classmethod
    def of(cls, outputs: jax.Array, scale: float) -> "TanhNormal":
        """Of a network's `outputs` (24, ...)."""
        mean, raw = jnp.split(outputs, 2)
        return cls(mean, spread(raw, scale))

    def sample(self, key: jax.Array) -> jax.Array:
        """Raw actions (12, ...), before the squashing."""
        return self.mean + self.std * jax.random.normal(key, self.mean.shape)

    def log_prob(self, raw: jax.Array) -> jax.Array:
        """Logarithm of the density (...) of the actions that are these (12, ...) before tanh."""
        normal = -0.5 * ((raw - self.mean) / self.std) ** 2 - jnp.log(self.std)
        return jnp.sum(normal - 0.5 * jnp.log(2.0 * jnp.pi) - _log_slope(raw), axis=0)

    def entropy(self) -> jax.Array:
        """(...) of the actions."""
        normal = 0.5 + 0.5 * jnp.log(2.0 * jnp.pi) + jnp.log(self.std)
        slope = 1.0 - jnp.tanh(self.mean) ** 2
        return jnp.sum(normal + _log_slope(self.mean) - self.std**2 * slope, axis=0)

    def divergence(self, other: "TanhNormal") -> jax.Array:
        """Kullback-Leibler divergence (...) of `other` from these, by Brax's formula."""
        squares = other.std**2 + (other.mean - self.mean) ** 2
        terms = jnp.log(self.std / other.std + 1e-5) + squares / (2.0 * self.std**2) - 0.5
        return jnp.sum(terms, axis=0)


def spread(raw: jax.Array, scale: float) -> jax.Array:
    """Standard deviations of a policy's raw ones."""
    return (jax.nn.softplus(raw) + MIN_STD) * scale


def _log_slope(raw: jax.Array) -> jax.Array:
    """Logarithm of the derivative of tanh."""
    return 2.0 * (jnp.log(2.0) - raw - jax.nn.softplus(-2.0 * raw))
