"""Observations of mean 0 and variance 1 for the networks: `ppo.normalize`, as brax's PPO has it.

The mean and the variance of all real rows so far are part of the networks' parameters, under "inputs". No
gradient reaches them. Each iteration adds its rows after its update, so that the policy that an update starts
from is the one that acted.

    count' = count + n,   mean' = mean + (sum x - n mean) / count',
    M2' = M2 + sum (x - mean)(x - mean')                              (Welford, for a batch)

Until the first rows are there, nothing is scaled. A policy's file has the numbers multiplied into the first
layer (policy/policy_file.py), so whoever plays it need not know of them.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from dynappo.learner.symmetry import vector
from dynappo.types import Learner, Mirror

MIN_STD = 1e-3  # of a number that hardly changes; policy/policy_file.py has it too


def init(size: int) -> dict[str, Array]:
    """The numbers of a network with `size` inputs, before any row."""
    return {"count": jnp.zeros(()), "mean": jnp.zeros(size), "m2": jnp.zeros(size)}


def updated(
    learner: Learner,
    seen: dict[str, Float[Array, "N R K"]],
    weight: Float[Array, "N R"],
    mirrors: dict[str, Mirror] | None = None,
) -> Learner:
    """The learner with the rows of weight 1 added, of what each network saw; with `mirrors` of a symmetric
    policy, also their mirror images, so that scaled inputs have the same mirror."""
    old = learner.params["inputs"]
    if mirrors is not None:
        seen = {n: jnp.concatenate([x, vector(mirrors[n], x)], 1) for n, x in seen.items()}
        weight = jnp.concatenate([weight, weight], 1)
    new = {name: _add(old[name], x, weight) for name, x in seen.items()}
    return learner.replace(params=learner.params | {"inputs": new})


def _add(old: dict[str, Array], x: Float[Array, "N R K"], weight: Float[Array, "N R"]):
    count = old["count"] + weight.sum()
    apart = jnp.where(weight[..., None] > 0, x - old["mean"], 0.0)
    mean = old["mean"] + apart.sum((0, 1)) / jnp.maximum(count, 1.0)
    after = jnp.where(weight[..., None] > 0, x - mean, 0.0)
    # rounding makes the sum of a number that never changes as good as 0, on either side
    m2 = jnp.maximum(old["m2"] + (apart * after).sum((0, 1)), 0.0)
    return {"count": count, "mean": mean, "m2": m2}


def scaled(params: dict, network: str, x: Float[Array, "... K"]) -> Float[Array, "... K"]:
    """What the `network` sees of its input `x`."""
    if "inputs" not in params:
        return x
    of = jax.lax.stop_gradient(params["inputs"][network])
    std = jnp.sqrt(of["m2"] / jnp.maximum(of["count"], 1.0))
    return jnp.where(of["count"] > 0, (x - of["mean"]) / jnp.maximum(std, MIN_STD), x)
