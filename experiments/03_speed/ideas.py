"""The PPO update with every idea for its speed as a switch; all off is the code as it was at 8de2e8e."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from dynappo.learner import networks, ppo
from dynappo.types import Learner


class Idea(NamedTuple):
    # actor and critic as one network: hidden layers "bk" [B, 2, H], "kb" [2, B, H], "kb2" so from
    # layer 2 on, or "wide" [B, 2 H] with weights that are zero across
    pair: str = ""
    flat: bool = False  # parameters and Adam's moments as one vector in the loop
    # "mean": losses and KL as the mean of one array [3, B]; "all": metrics leave as one array, too
    packed: str = ""
    once: bool = False  # one scan over all steps instead of two
    unroll: int = 1  # minibatches
    precision: Any = "highest"
    half: bool = False  # weights and activations in bfloat16, as networks.MLP with that precision
    # "exp": exp(x) - 1 in place of expm1; "out": the slope from the value, not the argument;
    # "remat": computed again for the gradient
    elu: str = ""


@jax.custom_jvp
def elu_of_output(x):
    return jnp.where(x > 0, x, jnp.expm1(x))


elu_of_output.defjvps(lambda t, y, x: t * jnp.where(y > 0, 1, y + 1))


def elu(how, x):
    if how == "remat":
        return jax.checkpoint(nn.elu)(x)
    if how == "out":
        return elu_of_output(x)
    if how == "exp":
        return jnp.where(x > 0, x, jnp.exp(jnp.minimum(x, 0)) - 1)
    return nn.elu(x)


def forward(idea, params, obs):
    actor, critic = params["actor"]["params"], params["critic"]["params"]
    act, p = partial(elu, idea.elu), idea.precision
    names = sorted(actor)
    if idea.half:
        half = partial(jax.tree.map, lambda x: x.astype(jnp.bfloat16))
        found = forward(idea._replace(half=False, precision="default"), half(params), half(obs))
        return tuple(x.astype(jnp.float32) for x in found)

    def dense(layer, x):
        return jnp.dot(x, layer["kernel"], precision=p) + layer["bias"]

    if not idea.pair:
        out = []
        for net in (actor, critic):
            x = obs
            for name in names[:-1]:
                x = act(dense(net[name], x))
            out.append(dense(net[names[-1]], x))
        return out[0], out[1][..., 0]
    if idea.pair == "wide":
        x = obs
        for name in names:
            a, c = actor[name], critic[name]
            if name == names[0]:
                kernel = jnp.concatenate([a["kernel"], c["kernel"]], -1)
            elif name == names[-1]:
                kernel = jax.scipy.linalg.block_diag(a["kernel"], c["kernel"])
            else:
                both = jnp.stack([a["kernel"], c["kernel"]])
                both = both[:, :, None] * jnp.eye(2)[:, None, :, None]
                kernel = both.reshape(2 * both.shape[1], -1)
            x = jnp.dot(x, kernel, precision=p) + jnp.concatenate([a["bias"], c["bias"]])
            if name != names[-1]:
                x = act(x)
        return x[..., :-1], x[..., -1]
    if idea.pair == "kb":
        x = jnp.broadcast_to(obs, (2, *obs.shape))
        for name in names[:-1]:
            kernel = jnp.stack([actor[name]["kernel"], critic[name]["kernel"]])
            bias = jnp.stack([actor[name]["bias"], critic[name]["bias"]])
            if name == names[0]:
                x = jnp.einsum("bi,kio->kbo", obs, kernel, precision=p)
            else:
                x = jnp.einsum("kbi,kio->kbo", x, kernel, precision=p)
            x = act(x + bias[:, None])
        return dense(actor[names[-1]], x[0]), dense(critic[names[-1]], x[1])[..., 0]
    first = names[0]
    kernel = jnp.concatenate([actor[first]["kernel"], critic[first]["kernel"]], -1)
    bias = jnp.concatenate([actor[first]["bias"], critic[first]["bias"]])
    x = act(jnp.dot(obs, kernel, precision=p) + bias)
    x = x.reshape(-1, 2, x.shape[-1] // 2)
    if idea.pair == "kb2":
        x = x.swapaxes(0, 1)
        for name in names[1:-1]:
            kernel = jnp.stack([actor[name]["kernel"], critic[name]["kernel"]])
            bias = jnp.stack([actor[name]["bias"], critic[name]["bias"]])
            x = act(jnp.einsum("kbi,kio->kbo", x, kernel, precision=p) + bias[:, None])
        return dense(actor[names[-1]], x[0]), dense(critic[names[-1]], x[1])[..., 0]
    for name in names[1:-1]:
        kernel = jnp.stack([actor[name]["kernel"], critic[name]["kernel"]])
        bias = jnp.stack([actor[name]["bias"], critic[name]["bias"]])
        x = act(jnp.einsum("bki,kio->bko", x, kernel, precision=p) + bias)
    return dense(actor[names[-1]], x[:, 0]), dense(critic[names[-1]], x[:, 1])[..., 0]


def loss(idea, static, hyper, params, batch, old_std):
    hyper = hyper.ppo
    mean, value = forward(idea, params, batch.obs)
    std = params["std"]
    ratio = jnp.exp(networks.log_prob(mean, std, batch.action) - batch.log_prob)
    clipped = jnp.clip(ratio, 1 - hyper.clip_epsilon, 1 + hyper.clip_epsilon)
    surrogate = -jnp.minimum(batch.advantages * ratio, batch.advantages * clipped)
    error = (value - batch.returns) ** 2
    change = jnp.clip(value - batch.value, -hyper.clip_epsilon, hyper.clip_epsilon)
    error = jnp.maximum(error, (batch.value + change - batch.returns) ** 2)
    kl = networks.kl(batch.action_mean, old_std, mean, std)
    if idea.packed:
        surrogate, value_loss, kl = jnp.stack([surrogate, error, kl]).mean(-1)
    else:
        surrogate, value_loss, kl = surrogate.mean(), error.mean(), kl.mean()
    entropy = networks.entropy(std)
    metrics = {
        "kl": kl,
        "surrogate_loss": surrogate,
        "value_loss": value_loss,
        "entropy": entropy,
    }
    return surrogate + hyper.value_coef * value_loss - hyper.entropy_coef * entropy, metrics


def update(idea, static, hyper, learner, batch, key):
    old_std = learner.params["std"]
    batch = batch._replace(advantages=ppo.normalize(batch.advantages))
    shuffled = ppo.minibatches(static, batch, key)
    vector, unravel = ravel_pytree(learner.params)
    is_std = jnp.arange(vector.size) >= vector.size - old_std.size
    clip, adam = learner.opt_state  # of vectors, as ppo.py keeps them
    if idea.flat:
        learner = learner.replace(params=vector)
    else:
        adam = adam._replace(mu=unravel(adam.mu), nu=unravel(adam.nu))
        learner = learner.replace(opt_state=(clip, adam))
    clipped = optax.clip_by_global_norm(hyper.ppo.max_grad_norm)
    optimizer = optax.chain(clipped, optax.scale_by_adam())

    def step(learner, rows):
        def of(params):
            params = unravel(params) if idea.flat else params
            return loss(idea, static, hyper, params, rows, old_std)

        grads, metrics = jax.grad(of, has_aux=True)(learner.params)
        rate = ppo.adapt(static, hyper, learner.learning_rate, metrics["kl"])
        updates, opt_state = optimizer.update(grads, learner.opt_state)
        params = jax.tree.map(lambda p, u: p - rate * u, learner.params, updates)
        if idea.flat:
            lowest = jnp.where(is_std, hyper.ppo.min_std, -jnp.inf)
            params = jnp.maximum(params, lowest)
        else:
            params["std"] = jnp.maximum(params["std"], hyper.ppo.min_std)
        learner = Learner(params=params, opt_state=opt_state, learning_rate=rate)
        if idea.packed == "all":
            metrics = jnp.stack(list(metrics.values()))
        return learner, metrics

    if idea.once:

        def indexed(learner, i):
            return step(learner, jax.tree.map(lambda x: x[i], shuffled))

        order = jnp.arange(static.ppo.epochs * static.ppo.minibatches) % static.ppo.minibatches
        learner, metrics = jax.lax.scan(indexed, learner, order, unroll=idea.unroll)
    else:

        def epoch(learner, _):
            return jax.lax.scan(step, learner, shuffled, unroll=idea.unroll)

        learner, metrics = jax.lax.scan(epoch, learner, None, length=static.ppo.epochs)
    if idea.packed == "all":
        names = ("kl", "surrogate_loss", "value_loss", "entropy")
        metrics = dict(zip(names, jnp.moveaxis(metrics, -1, 0), strict=True))
    metrics = jax.tree.map(jnp.mean, metrics)
    if idea.flat:
        learner = learner.replace(params=unravel(learner.params))
    else:
        clip, adam = learner.opt_state
        adam = adam._replace(mu=ravel_pytree(adam.mu)[0], nu=ravel_pytree(adam.nu)[0])
        learner = learner.replace(opt_state=(clip, adam))
    return learner, metrics | {"learning_rate": learner.learning_rate}
