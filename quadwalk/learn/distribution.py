"""The distribution of actions: normal, and squashed by tanh."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

MIN_STD = 0.001  # of an action before the squashing, as in Brax
SURE = 0.15  # standard deviation, before the tanh, up to which a policy acts without noise


class TanhNormal(NamedTuple):
    """Independent normal distributions whose samples tanh squashes into actions; features first.

    It is Brax's `NormalTanhDistribution`, with its entropy in closed form in place of a sample: the
    normal's and the mean logarithm of the tanh's slope. That mean is expanded about the normal's
    own: log(1 - tanh(x)^2) has the second derivative -2 (1 - tanh(x)^2).
    """

    mean: jax.Array  # (12, ...)
    std: jax.Array  # (12, ...)

    @classmethod
    def from_outputs(cls, outputs: jax.Array, scale: float) -> "TanhNormal":
        """Return the distribution that a policy's `outputs` (24, ...) describe."""
        mean, raw_std = jnp.split(outputs, 2)
        return cls(mean, compute_std(raw_std, scale))

    def sample(self, key: jax.Array) -> jax.Array:
        """Sample raw actions (12, ...), before the squashing."""
        return self.mean + self.std * jax.random.normal(key, self.mean.shape)

    def compute_log_prob(self, raw_action: jax.Array) -> jax.Array:
        """Return the logarithm of the density (...) of squashed `raw_action` (12, ...)."""
        normal = -0.5 * ((raw_action - self.mean) / self.std) ** 2 - jnp.log(self.std)
        slope = _compute_log_slope(raw_action)
        return jnp.sum(normal - 0.5 * jnp.log(2.0 * jnp.pi) - slope, axis=0)

    def compute_entropy(self) -> jax.Array:
        """Return the entropy (...) of the actions, in closed form; the class says how."""
        normal = 0.5 + 0.5 * jnp.log(2.0 * jnp.pi) + jnp.log(self.std)
        slope = 1.0 - jnp.tanh(self.mean) ** 2
        return jnp.sum(normal + _compute_log_slope(self.mean) - self.std**2 * slope, axis=0)

    def compute_divergence(self, other: "TanhNormal") -> jax.Array:
        """Return the Kullback-Leibler divergence (...) of `other` from this, as Brax does."""
        squares = other.std**2 + (other.mean - self.mean) ** 2
        terms = jnp.log(self.std / other.std + 1e-5) + squares / (2.0 * self.std**2) - 0.5
        return jnp.sum(terms, axis=0)


def compute_std(raw_std: jax.Array, scale: float) -> jax.Array:
    """Return the standard deviations that a policy's raw ones stand for."""
    return (jax.nn.softplus(raw_std) + MIN_STD) * scale


def compute_raw_std(share: float) -> float:
    """Return the raw standard deviation that stands for `share` of what 0 stands for."""
    return math.log(math.expm1(share * (math.log(2.0) + MIN_STD) - MIN_STD))


def _compute_log_slope(raw_action: jax.Array) -> jax.Array:
    """Return the logarithm of the derivative of tanh."""
    return 2.0 * (jnp.log(2.0) - raw_action - jax.nn.softplus(-2.0 * raw_action))
