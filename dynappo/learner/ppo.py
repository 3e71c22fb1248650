"""Proximal policy optimisation as in RSL-RL 3.0.1 (rsl_rl/algorithms/ppo.py).

It gives RSL-RL's own numbers to 1e-5 (tests/learner/test_ppo.py): one Adam (eps 1e-8) for actor,
critic and std; advantages normalised over the whole batch; clipped surrogate, and clipped value
loss without a factor 1/2; one global gradient norm; the KL changes the learning rate before each
minibatch step; one permutation for all epochs. Two differences: std stays at or above `ppo.min_std`
(theirs may reach 0), and rows are permuted inside `ppo.shuffle_blocks` blocks of robots, so that a
minibatch does not depend on how robots are spread over devices.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from dynappo.learner import networks, symmetry
from dynappo.learner import units as units_lib
from dynappo.types import Hyper, Learner, Metrics, Static

STEP_METRICS: tuple[str, ...] = ("kl", "surrogate_loss", "value_loss", "entropy")
METRICS = *STEP_METRICS, "learning_rate"


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


def init(
    static: Static,
    hyper: Hyper,
    obs_size: int,
    action_size: int,
    key: PRNGKeyArray,
    critic_size: int | None = None,
    image: symmetry.Image | None = None,
    units: units_lib.Units | None = None,
) -> Learner:
    """An untrained learner: sizes as of `networks.init_policy`, `image` and `units` as in `update`."""
    params = networks.init_policy(
        static, hyper, obs_size=obs_size, action_size=action_size, key=key, critic_size=critic_size
    )
    params = units_lib.apply(symmetry.tie(params, image), units)
    opt_state = optimizer(hyper).init(params)
    return Learner(params, opt_state, jnp.asarray(hyper.ppo.learning_rate, jnp.float32))


def optimizer(hyper: Hyper) -> optax.GradientTransformation:
    """Adam, without its learning rate, on a gradient whose norm is clipped.

    For fast.py (and checkpoints, which hold them so) its moments are one vector, `optax.flatten`: the
    numbers are those of Adam on a tree.
    """
    clip = optax.clip_by_global_norm(hyper.ppo.max_grad_norm)
    return optax.flatten(optax.chain(clip, optax.scale_by_adam()))


def update(
    static: Static,
    hyper: Hyper,
    learner: Learner,
    batch: Batch,
    key: PRNGKeyArray,
    image: symmetry.Image | None = None,
    units: units_lib.Units | None = None,
) -> tuple[Learner, Metrics]:
    """PPO on one rollout `[N, R]` with raw advantages: `epochs` x `minibatches` gradient steps.

    Metrics are means over the steps, and the last learning rate. With an `image`
    (`symmetry.policy_image`) the policy stays symmetric; with `units` (`units.policy_units`) it learns as
    one that sees its inputs in these.
    """
    step = partial(
        minibatch_step, static, hyper, old_std=learner.params["std"], image=image, units=units
    )
    learner, metrics = steps(static, learner, batch=batch, key=key, step=step)
    return learner, metrics | {"learning_rate": learner.learning_rate}


def steps(
    static: Static, learner: Learner, batch: Batch, key: PRNGKeyArray, step: Callable
) -> tuple[Learner, Any]:
    """`step(learner, minibatch) -> learner, metrics` over all epochs, and the metrics' means."""
    batch = jax.tree.map(partial(present, weight=batch.weight), batch)
    batch = batch._replace(advantages=normalize(batch.advantages, batch.weight))
    shuffled = minibatches(static, batch, key)

    def one(learner, i):
        return step(learner, jax.tree.map(lambda x: x[i % static.ppo.minibatches], shuffled))

    count = jnp.arange(static.ppo.epochs * static.ppo.minibatches)
    learner, metrics = jax.lax.scan(one, learner, count)
    return learner, jax.tree.map(lambda column: column.mean(0), metrics)


def minibatch_step(
    static: Static,
    hyper: Hyper,
    learner: Learner,
    batch: Batch,
    old_std: Float[Array, " A"],
    image: symmetry.Image | None = None,
    units: units_lib.Units | None = None,
) -> tuple[Learner, Metrics]:
    """One gradient step: loss, KL, learning rate, clipped gradient, Adam; `(learner, metrics)`."""

    def of(params):
        return loss(static, hyper, params, batch, old_std)

    grads, metrics = jax.grad(of, has_aux=True)(learner.params)
    rate = adapt(static, hyper, learner.learning_rate, metrics["kl"])
    grads = units_lib.apply(symmetry.mean(grads, image), units)
    updates, opt_state = optimizer(hyper).update(grads, learner.opt_state)
    updates = units_lib.apply(updates, units)
    params = jax.tree.map(lambda weight, change: weight - rate * change, learner.params, updates)
    params["std"] = jnp.maximum(params["std"], hyper.ppo.min_std)
    return Learner(params=params, opt_state=opt_state, learning_rate=rate), metrics


def loss(
    static: Static,
    hyper: Hyper,
    params: dict,
    batch: Batch,
    old_std: Float[Array, " A"],
    actor_critic: Callable[..., networks.ActorCritic] = networks.actor_critic,
) -> tuple[Float[Array, ""], Metrics]:
    """`(scalar, metrics)`: clipped surrogate + value_coef x value loss - entropy_coef x entropy.

        surrogate = mean max(-A rho, -A clip(rho, 1 - eps, 1 + eps)),  rho = pi / pi_old
        value     = mean max((V - R)^2, (V_old + clip(V - V_old, -eps, eps) - R)^2)

    The entropy is the policy's, or with `ppo.squashed` that of tanh of its actions, with the noise of the
    rows. `metrics["kl"]` is the mean KL(old || new). Means are over rows with their weights; in a row
    of weight 0 `log_prob`, `value`, `advantages` and `returns` may be any number. For fast.py `actor_critic`
    is an argument, and three means are one of a stack: one kernel on a GPU, not three.
    """
    std = params["std"]
    action_mean, value = actor_critic(static, params)(batch.obs, batch.critic_obs)
    chex.assert_equal_shape([value, batch.value, batch.returns, batch.advantages])
    here = partial(present, weight=batch.weight)
    ratio = jnp.exp(here(networks.log_prob(action_mean, std, batch.action) - batch.log_prob))
    clipped = jnp.clip(ratio, 1 - hyper.ppo.clip_epsilon, 1 + hyper.ppo.clip_epsilon)
    surrogate = -jnp.minimum(batch.advantages * ratio, batch.advantages * clipped)
    error = here(value - batch.returns) ** 2
    if static.ppo.clip_value:
        change = jnp.clip(value - batch.value, -hyper.ppo.clip_epsilon, hyper.ppo.clip_epsilon)
        error = jnp.maximum(error, here(batch.value + change - batch.returns) ** 2)
    kl = networks.kl(batch.action_mean, old_std, action_mean, std)
    if static.ppo.squashed:
        noise = (batch.action - batch.action_mean) / old_std
        entropy = networks.squashed_entropy(action_mean, std, noise)
        means = mean(jnp.stack([surrogate, error, kl, entropy]), batch.weight)
        surrogate, value_loss, kl, entropy = means
    else:
        entropy = networks.entropy(std)
        surrogate, value_loss, kl = mean(jnp.stack([surrogate, error, kl]), batch.weight)
    total = surrogate + hyper.ppo.value_coef * value_loss - hyper.ppo.entropy_coef * entropy
    metrics = {"kl": kl, "surrogate_loss": surrogate, "value_loss": value_loss, "entropy": entropy}
    return total, metrics


def adapt(static: Static, hyper: Hyper, learning_rate: Float[Array, ""], kl: Float[Array, ""]):
    """The learning rate after a minibatch's KL: / 1.5 above twice the target, x 1.5 below half."""
    if not static.ppo.adaptive:
        return learning_rate
    lower = jnp.maximum(hyper.ppo.min_learning_rate, learning_rate / 1.5)
    higher = jnp.minimum(hyper.ppo.max_learning_rate, learning_rate * 1.5)
    kept = jnp.where((kl > 0) & (kl < hyper.ppo.desired_kl / 2), higher, learning_rate)
    return jnp.where(kl > hyper.ppo.desired_kl * 2, lower, kept)


def mean(x: Float[Array, "... B"], weight: Float[Array, " B"] | None) -> Float[Array, "..."]:
    """Weighted mean over rows, sum w x / sum w."""
    if weight is None:
        return x.mean(-1)
    return jnp.where(weight > 0, x * weight, 0.0).mean(-1) / jnp.maximum(weight.mean(), 1e-8)


def present(x, weight):
    """`x` [..., K], 0 in rows of weight 0.

    Such a row (recorded, or past a fall in a tail) may hold any number, and weight 0 alone does not silence
    it: 0 times infinity is NaN. So it becomes 0 before what overflows, and the gradient is finite, too.
    """
    if weight is None:
        return x
    return jnp.where(weight.reshape(*weight.shape, *[1] * (x.ndim - weight.ndim)) > 0, x, 0.0)


def normalize(advantages: Float[Array, "..."], weight=None) -> Float[Array, "..."]:
    """Zero mean and unit sample standard deviation (plus 1e-8) over the whole batch; weighted,
    std^2 = sum w (A - mean)^2 / (sum w - 1)."""
    if weight is None:
        return (advantages - advantages.mean()) / (advantages.std(ddof=1) + 1e-8)
    advantages, share = present(advantages, weight), jnp.maximum(weight.mean(), 1e-8)
    centred = advantages - (advantages * weight).mean() / share
    count = jnp.maximum(weight.sum() - 1, 1)
    return centred / (jnp.sqrt((weight * centred**2).sum() / count) + 1e-8)


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
