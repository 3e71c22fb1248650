"""Running mean and variance of vectors, which scale the transition model's inputs and targets."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from dynappo.learner import symmetry
from dynappo.types import Mirror, Moments

MIN_STD = 1e-4  # some observations never change


def init(size: int) -> Moments:
    """Moments before any data: weight 0."""
    return Moments(mean=jnp.zeros(size), var=jnp.zeros(size), weight=jnp.zeros(()))


def update(
    moments: Moments,
    x: Float[Array, "... K"],
    weight: Float[Array, "..."],
    decay,
    mirror: Mirror | None = None,
) -> Moments:
    """Exponential moving mean and variance over calls, of the rows of `x` with `weight` 1.

    `weight` of the moments tends to 1 as `1 - decay^calls`; `scale` divides by it, so after the
    first call the moments are those of the batch. A call without rows of weight 1 changes nothing.
    With a `mirror` the mirror images of all rows count, too.
    """
    axes = tuple(range(weight.ndim))
    count = weight.sum()
    total = jnp.maximum(count, 1)
    mean = (x * weight[..., None]).sum(axes) / total
    if mirror is not None:
        mean = (mean + symmetry.vector(mirror, mean)) / 2
    var = ((x - mean) ** 2 * weight[..., None]).sum(axes) / total
    if mirror is not None:
        var = (var + var[mirror.index]) / 2
    decay = jnp.where(count > 0, decay, 1.0)
    new = Moments(mean=mean, var=var, weight=jnp.ones(()))
    return jax.tree.map(lambda m, b: decay * m + (1 - decay) * b, moments, new)


def scale(moments: Moments) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
    """`(mean, std)`, corrected for the bias of the first calls; std is at least 1e-4."""
    weight = jnp.maximum(moments.weight, 1e-8)
    return moments.mean / weight, jnp.sqrt(jnp.maximum(moments.var / weight, MIN_STD**2))
