"""Running statistics of observations, by which networks' inputs are normalized.

They are Brax's, and the mirror images of observations count in them as well.
"""

import jax
import jax.numpy as jnp

from quadwalk.brax import NestedMeanStd, RunningStatisticsState, UInt64
from quadwalk.learn.symmetric import Basis, Parts

# A number is constant where its standard deviation is below this share of its mean, or of 1 if the
# mean is smaller.
CONSTANT = 1e-4


def init_statistics(size: int) -> RunningStatisticsState:
    """Return the statistics of `size` numbers before any observation."""
    return RunningStatisticsState(
        mean=jnp.zeros(size),
        std=jnp.ones(size),
        count=UInt64(hi=0, lo=0),
        summed_variance=jnp.zeros(size),
    )


def compute_scale(statistics: NestedMeanStd) -> jax.Array:
    """Return what centered observations are divided by (n,): their standard deviation.

    It is 1 where a number has been constant so far, but for rounding: it may vary yet, and
    nothing says by how much.
    """
    least = CONSTANT * jnp.maximum(jnp.abs(statistics.mean), 1.0)
    return jnp.where(statistics.std < least, 1.0, statistics.std)


def normalize(statistics: NestedMeanStd, observation: jax.Array) -> jax.Array:
    """Return observations (..., n) with mean 0 and standard deviation 1 in each number."""
    return (observation - statistics.mean) / compute_scale(statistics)


def update_statistics(
    statistics: RunningStatisticsState, inputs: Parts, basis: Basis, axis: str
) -> RunningStatisticsState:
    """Return `statistics` with one iteration's observations and their mirror images added.

    `inputs` are the observations, normalized by `statistics`, as coordinates in `basis`: arrays
    (steps, m, envs), one per part of the basis. Each device along the mesh's `axis` has as many.

    The mean and variance of the batch are computed first (Chan, Golub and LeVeque 1983). So a
    number that is constant keeps a variance of 0, in spite of rounding.
    """
    origin = jax.lax.pmean(inputs[0][0, :, 0], axis)
    rows = (inputs[0] - origin[:, None], *inputs[1:])
    means = [jax.lax.pmean(jnp.mean(part, axis=(0, 2)), axis) for part in rows]
    squares = [jax.lax.pmean(jnp.mean(part**2, axis=(0, 2)), axis) for part in rows]
    # An observation and its image together have no mean in the odd part.
    even = basis.matrices[0].T
    shift = even @ means[0]
    variance = (
        sum((m.T**2) @ square for m, square in zip(basis.matrices, squares, strict=True)) - shift**2
    )
    batch_mean, scale = even @ origin + shift, compute_scale(statistics)
    number = len(rows[0]) * rows[0].shape[-1] * jax.lax.axis_size(axis)
    count = statistics.count + jnp.int32(number)
    total = jnp.float32(count.hi) * 2.0**32 + jnp.float32(count.lo)
    before = 1.0 - number / total
    summed_variance = statistics.summed_variance + number * scale**2 * (
        variance + before * batch_mean**2
    )
    std = jnp.clip(jnp.sqrt(jnp.maximum(summed_variance, 0.0) / total), 1e-6, 1e6)
    mean = statistics.mean + scale * batch_mean * number / total
    return statistics.replace(count=count, mean=mean, summed_variance=summed_variance, std=std)
