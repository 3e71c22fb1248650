"""Proximal policy optimisation as in RSL-RL 3.0.1 (rsl_rl/algorithms/ppo.py).

It gives RSL-RL's own numbers to 1e-5 (tests/learner/test_ppo.py): one Adam (eps 1e-8) for actor,
critic and std; advantages normalised over the whole batch; clipped surrogate, and clipped value
loss without a factor 1/2; one global gradient norm; the KL changes the learning rate before each
minibatch step; one permutation for all epochs. Two differences: std stays at or above `ppo.min_std`
(theirs may reach 0), and rows are permuted inside `ppo.shuffle_blocks` blocks of robots, so that a
minibatch does not depend on how robots are spread over devices.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PRNGKeyArray

from dynappo.learner import networks, symmetry
from dynappo.types import Hyper, Learner, Metrics, Static, Transition

OF_STEP: tuple[str, ...] = ("kl", "surrogate_loss", "value_loss", "entropy")
METRICS = *OF_STEP, "learning_rate"


class Batch(NamedTuple):
    """What the loss reads; `[N, R]` or `[B]` in front of every shape."""

    obs: Float[Array, "... O"]
    action: Float[Array, "... A"]
    action_mean: Float[Array, "... A"]
    log_prob: Float[Array, "..."]
    value: Float[Array, "..."]
    advantages: Float[Array, "..."]
    returns: Float[Array, "..."]
    weight: Float[Array, "..."] | None = None  # of each row in every mean; None: all 1
    critic_obs: Float[Array, "... C"] | None = None  # None: the value function sees `obs`


def batch(rows: Transition, seen, advantages, returns, weight=None) -> Batch:
    """The `Batch` of a rollout, with what its networks saw (`networks.seen`), its advantages and returns."""
    kept: dict[str, Any] = {name: getattr(rows, name) for name in Batch._fields[1:5]}
    kept |= {"obs": seen[0], "critic_obs": None if seen[1] is seen[0] else seen[1]}
    return Batch(**kept, advantages=advantages, returns=returns, weight=weight)


def init(
    static: Static,
    hyper: Hyper,
    obs_size: int,
    action_size: int,
    key: PRNGKeyArray,
    critic_size: int | None = None,
    image: symmetry.Image | None = None,
) -> Learner:
    """An untrained learner: sizes as of `networks.init_policy`, `image` as in `update`."""
    params = networks.init_policy(static, hyper, obs_size, action_size, key, critic_size)
    params = symmetry.tie(params, image)
    opt_state = _optimizer(hyper).init(ravel_pytree(params)[0])
    return Learner(params, opt_state, jnp.asarray(hyper.ppo.learning_rate, jnp.float32))


def _optimizer(hyper: Hyper):
    return optax.chain(optax.clip_by_global_norm(hyper.ppo.max_grad_norm), optax.scale_by_adam())


def mean(x: Float[Array, "... B"], weight: Float[Array, " B"] | None) -> Float[Array, "..."]:
    """Weighted mean over rows, sum w x / sum w."""
    if weight is None:
        return x.mean(-1)
    return (x * weight).mean(-1) / jnp.maximum(weight.mean(), 1e-8)


def normalize(advantages: Float[Array, "..."], weight=None) -> Float[Array, "..."]:
    """Zero mean and unit sample standard deviation (plus 1e-8) over the whole batch; weighted,
    std^2 = sum w (A - mean)^2 / (sum w - 1)."""
    if weight is None:
        return (advantages - advantages.mean()) / (advantages.std(ddof=1) + 1e-8)
    share = jnp.maximum(weight.mean(), 1e-8)
    centred = advantages - (advantages * weight).mean() / share
    count = jnp.maximum(weight.sum() - 1, 1)
    return centred / (jnp.sqrt((weight * centred**2).sum() / count) + 1e-8)


def loss(static: Static, hyper: Hyper, params: dict, batch: Batch, old_std: Float[Array, " A"]):
    """`(scalar, metrics)`: clipped surrogate + value_coef x value loss - entropy_coef x entropy.

        surrogate = mean max(-A rho, -A clip(rho, 1 - eps, 1 + eps)),  rho = pi / pi_old
        value     = mean max((V - R)^2, (V_old + clip(V - V_old, -eps, eps) - R)^2)

    `metrics["kl"]` is the mean KL(old || new). Means are over rows with their weights.
    """
    std = params["std"]
    action_mean, value = networks.policy_and_value(static, params, batch.obs, batch.critic_obs)
    chex.assert_equal_shape([value, batch.value, batch.returns, batch.advantages])
    ratio = jnp.exp(networks.log_prob(action_mean, std, batch.action) - batch.log_prob)
    clipped = jnp.clip(ratio, 1 - hyper.ppo.clip_epsilon, 1 + hyper.ppo.clip_epsilon)
    surrogate = -jnp.minimum(batch.advantages * ratio, batch.advantages * clipped)
    error = (value - batch.returns) ** 2
    if static.ppo.clip_value:
        change = jnp.clip(value - batch.value, -hyper.ppo.clip_epsilon, hyper.ppo.clip_epsilon)
        error = jnp.maximum(error, (batch.value + change - batch.returns) ** 2)
    kl, entropy = networks.kl(batch.action_mean, old_std, action_mean, std), networks.entropy(std)
    # one mean of one array: three means would take more kernels
    surrogate, value_loss, kl = mean(jnp.stack([surrogate, error, kl]), batch.weight)
    total = surrogate + hyper.ppo.value_coef * value_loss - hyper.ppo.entropy_coef * entropy
    return total, dict(zip(OF_STEP, (kl, surrogate, value_loss, entropy), strict=True))


def adapt(static: Static, hyper: Hyper, learning_rate: Float[Array, ""], kl: Float[Array, ""]):
    """The learning rate after a minibatch's KL: / 1.5 above twice the target, x 1.5 below half."""
    if not static.ppo.adaptive:
        return learning_rate
    lower = jnp.maximum(hyper.ppo.min_learning_rate, learning_rate / 1.5)
    higher = jnp.minimum(hyper.ppo.max_learning_rate, learning_rate * 1.5)
    kept = jnp.where((kl > 0) & (kl < hyper.ppo.desired_kl / 2), higher, learning_rate)
    return jnp.where(kl > hyper.ppo.desired_kl * 2, lower, kept)


def minibatch_step(
    static: Static, hyper: Hyper, unflatten, learner: Learner, batch: Batch, old_std, turned=None
) -> tuple[Learner, Metrics]:
    """One gradient step: loss, KL, learning rate, clipped gradient, Adam; `(learner, metrics)`.

    Parameters and Adam's moments are vectors, with `std` last; `unflatten` gives the tree. Clipping
    and Adam then take 4 kernels, not 33. With an image's `places`, mirrored rows count in the gradient too.
    """

    def of_vector(params):
        return loss(static, hyper, unflatten(params), batch, old_std)

    grads, metrics = jax.grad(of_vector, has_aux=True)(learner.params)
    # a barrier: else XLA joins the layers' gradients again in each kernel that reads them
    grads = jax.lax.optimization_barrier(symmetry.mean(grads, turned))
    rate = adapt(static, hyper, learner.learning_rate, metrics["kl"])
    updates, opt_state = _optimizer(hyper).update(grads, learner.opt_state)
    params = learner.params - rate * updates
    is_std = jnp.arange(params.size) >= params.size - old_std.size
    params = jnp.where(is_std, jnp.maximum(params, hyper.ppo.min_std), params)
    return Learner(params=params, opt_state=opt_state, learning_rate=rate), metrics


def minibatches(static: Static, batch: Batch, key: PRNGKeyArray) -> Batch:
    """`[N, R, ...]` rows as `[minibatches, B, ...]`, permuted inside each block of robots."""
    blocks, count = static.ppo.shuffle_blocks, static.ppo.minibatches
    horizon, num_envs = batch.value.shape
    robots = num_envs // blocks
    keys = jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.arange(blocks))
    order = jax.vmap(lambda k: jax.random.permutation(k, horizon * robots))(keys)
    order = order.reshape(blocks, count, -1)

    def take(block, order):  # [N, robots of the block, ...] at [minibatches, rows of the block]
        return block[order // robots, order % robots]

    def shuffle(x):
        x = x.reshape(horizon, blocks, robots, *x.shape[2:])
        return jax.vmap(take, (1, 0), 1)(x, order).reshape(count, -1, *x.shape[3:])

    return jax.tree.map(shuffle, batch)


def update(
    static: Static, hyper: Hyper, learner: Learner, batch: Batch, key: PRNGKeyArray, image=None
) -> tuple[Learner, Metrics]:
    """`epochs` x `minibatches` steps on one rollout `[N, R]` with raw advantages. Metrics are means
    over the steps, and the last learning rate. `image` is `symmetry.policy_image`."""
    old_std = learner.params["std"]
    batch = batch._replace(advantages=normalize(batch.advantages, batch.weight))
    shuffled = minibatches(static, batch, key)
    params, unflatten = ravel_pytree(learner.params)
    turned = symmetry.places(learner.params, image)

    def step(learner, i):
        rows = jax.tree.map(lambda x: x[i % static.ppo.minibatches], shuffled)
        learner, metrics = minibatch_step(static, hyper, unflatten, learner, rows, old_std, turned)
        return learner, jnp.stack([metrics[name] for name in OF_STEP])  # one array: one kernel

    steps = jnp.arange(static.ppo.epochs * static.ppo.minibatches)
    learner, table = jax.lax.scan(step, learner.replace(params=params), steps)
    metrics = dict(zip(OF_STEP, table.mean(0), strict=True))
    metrics["learning_rate"] = learner.learning_rate
    return learner.replace(params=unflatten(learner.params)), metrics
