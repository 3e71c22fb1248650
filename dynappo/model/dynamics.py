"""The transition model: predicts the next observation and the reward of a control step.

    o_prop_{k+1}, r_k = f_theta(o_k, a_k)                                        (paper, eq. 2)
    L(theta) = sum over robots and real rows of Huber((o_prop_{k+1}, r_k) - f_theta(o_k, a_k))  (3)

An MLP, fitted in each iteration to the real rows, from the last weights and Adam moments. The paper
leaves two things open. Here the target is the change of state, and running moments scale inputs and
targets; `predict_change = normalize = False` turns both off. The model never learns across a reset.

Options beyond the paper, fields of the group model that are off in the paper's variants:

- `clean`: f_theta reads and predicts the state without noise, and the policy in the tail sees it
  with new noise. A model that has to predict noise cannot have a smaller error than the noise.
- `known_reward`: the reward is `env.known_reward` of the prediction, plus the rest from f_theta.
- `falls`: sigmoid(f_theta) is the probability p of a fall, and 1 - p is the tail's discount. The model then
  learns from rows with a fall, too, without class weights. f_theta does not predict the reward of a fall
  (`env.fall_reward`): a tail's row gets p times that reward.
- `bound`: each number of a predicted state stays within so many standard deviations of the model's input.
  Else nothing bounds a tail: without a memory, ANYmal-C's (`few`) reach 1e22 within 24 rows, and the policy
  becomes NaN. Of a real state (Go1, ANYmal-C) the farthest number is 2 away in the median row, but up to 51
  where a robot that walks well falls, since its gravity vector hardly varied before.

Why an epoch runs through the rows of each robot, not through all rows in random order (`orders`):
JAX cannot permute a traced number of rows, and computing on masked rows would cost what the tail
saves. Every minibatch has equally many rows of each robot, so no row moves to another device.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct
from jaxtyping import Array, Float, Int, PRNGKeyArray

from dynappo.learner import networks, symmetry
from dynappo.model import examples, moments
from dynappo.model.examples import Examples
from dynappo.types import Env, Hyper, Metrics, Mirror, ModelState, Outcome, Static, Transition

FALL_LOGIT = -4.6  # added to the network's output: untrained, it predicts 1 %
# purposes of random numbers, the same as algorithm.STEP and RESET; no row is written by both
NOISE, CONTEXT_NOISE = 4, 5


@struct.dataclass
class TailState:
    """The state of a tail, in place of an environment's state."""

    obs: Float[Array, "R O"]  # what the policy sees
    prop: Float[Array, "R P"]  # what the model predicts from (examples.py)


def tail(static: Static, env: Env, state) -> TailState:
    """The start of a tail, from the `obs` and `prop` of a physics state or a row."""
    prop = state.prop if static.model.clean else state.obs[..., : env.prop_size]
    return TailState(obs=state.obs, prop=prop)


def anchors(static: Static, env: Env, rows: Transition, n_real: Int[Array, ""], key) -> TailState:
    """The start of a tail for each robot of `rows`, from one of its rows `t < n_real`, drawn at random."""
    t = jax.random.randint(key, rows.reward.shape[1:], 0, n_real)[None]
    return jax.tree.map(lambda x: pick(x, t)[0], tail(static, env, rows))


def network(static: Static, prop_size: int) -> networks.MLP:
    """f_theta, with outputs next prop, reward and, with `model.falls`, the logit of a fall."""
    model = static.model
    sizes = (*model.hidden, prop_size + 1 + model.falls)
    return networks.MLP(sizes, model.activation, model.precision)


def init(static: Static, env: Env, key: PRNGKeyArray) -> ModelState:
    """An untrained model; its moments have weight 0 until the first fit."""
    inputs, outputs = examples.input_size(env), env.prop_size + 1
    params = networks.init(network(static, env.prop_size), inputs, key)
    params = symmetry.tie(params, image(mirrors(static, env)))
    return ModelState(
        params=params,
        opt_state=optimizer().init(params),
        inputs=moments.init(inputs),
        targets=moments.init(outputs + static.model.falls),
    )


def mirrors(static: Static, env: Env) -> tuple[Mirror, Mirror] | None:
    """The mirrors of the model's input and target, or None without `model.symmetry`."""
    if not static.model.symmetry:
        return None
    assert env.mirror is not None, "model.symmetry comes with ppo.symmetry"
    obs, action = env.mirror
    seen = obs if env.views is None else symmetry.part(obs, env.views.model)
    prop = symmetry.part(obs, np.arange(env.prop_size))
    same = symmetry.unchanged(1 + static.model.falls)  # reward and fall
    return symmetry.beside(seen, action), symmetry.beside(prop, same)


def image(mirrors: tuple[Mirror, Mirror] | None) -> symmetry.Image | None:
    """Of the model's weights those that give the mirrored target for the mirrored input."""
    return None if mirrors is None else lambda params: symmetry.network_image(params, *mirrors)


def scales(static: Static, model: ModelState):
    """`((mean, std) of inputs, (mean, std) of targets)`, or the identity without normalisation."""
    if not static.model.normalize:
        zeros = jnp.zeros_like(model.inputs.mean), jnp.zeros_like(model.targets.mean)
        return tuple((zero, zero + 1) for zero in zeros)
    mean, std = moments.scale(model.targets)
    if static.model.falls:  # the target 0 or 1 is not scaled
        mean, std = mean.at[-1].set(0.0), std.at[-1].set(1.0)
    return moments.scale(model.inputs), (mean, std)


def loss(static: Static, hyper: Hyper, params, x, y, weight) -> Float[Array, ""]:
    """Mean over rows of weight 1 and outputs: Huber (eq. 3), and cross-entropy for a fall."""
    size = y.shape[-1] - static.model.falls  # predicted numbers: prop and reward
    prediction = networks.apply(network(static, size - 1), params, x)
    delta = hyper.model.huber_delta
    error = optax.losses.huber_loss(prediction[..., :size], y[..., :size], delta=delta)
    if static.model.falls:
        fall = optax.losses.sigmoid_binary_cross_entropy(prediction + FALL_LOGIT, y)[..., size:]
        error = jnp.concatenate([error, fall], -1)
    return (error.mean(-1) * weight).sum() / jnp.maximum(weight.sum(), 1)


class Minibatch(NamedTuple):
    """Examples as the network reads them; [T, R] in front of every shape, or [M, R]."""

    x: Float[Array, "... I"]  # inputs, scaled
    y: Float[Array, "... K"]  # targets, scaled
    weight: Float[Array, "..."]  # 1 or 0


def fit(
    static: Static,
    hyper: Hyper,
    model: ModelState,
    rows: Examples,
    epochs: Int[Array, ""],
    key: PRNGKeyArray,
    *,
    mirrors: tuple[Mirror, Mirror] | None = None,
    draw: Callable | None = None,
) -> tuple[ModelState, Metrics]:
    """`epochs` passes of Adam over `rows`, in minibatches. First the moments that scale them are updated.

    With `mirrors` (of a symmetric model) it learns from mirrored rows, too. `draw(key, n) -> Examples`
    gives n rows of each robot out of a memory (memory.py): `model.remembered` beside each new one.

    Metrics: the loss of the last minibatch, and of the first, whose rows are new to the model. With 0
    epochs the model stays as it is, moments included, and the losses are NaN.
    """
    model = with_moments_of(hyper, model, rows, epochs, mirrors)

    def minibatch(rows: Examples):
        x, y = scaled(static, model, rows)
        return Minibatch(x=x, y=y, weight=rows.weight)

    def step(state, minibatch, counted):
        params, opt_state = state
        weight = minibatch.weight * counted
        of = jax.value_and_grad(partial(loss, static, hyper))
        value, grads = of(params, x=minibatch.x, y=minibatch.y, weight=weight)
        grads = symmetry.mean(grads, image(mirrors))
        updates, opt_state = optimizer().update(grads, opt_state)
        rate = hyper.model.learning_rate
        params = jax.tree.map(lambda old, update: old - rate * update, params, updates)
        return (params, opt_state), value

    start = model.params, model.opt_state
    past = None if draw is None else lambda key, n: minibatch(draw(key, n))
    (params, opt_state), metrics = passes(
        static,
        start,
        minibatch(rows),
        count=rows.count,
        epochs=epochs,
        key=key,
        step=step,
        past=past,
    )
    return model.replace(params=params, opt_state=opt_state), metrics


def optimizer() -> optax.GradientTransformation:
    """Adam without its learning rate, which the step applies. Of weight decay nothing is shown with few data,
    where it might help (experiments/27_few/parts.md)."""
    return optax.scale_by_adam()


def with_moments_of(
    hyper: Hyper, model: ModelState, rows: Examples, epochs, mirrors=None
) -> ModelState:
    """The model with its moments updated by `rows`, and by mirrored rows where it has `mirrors`; with 0
    epochs, as it was."""
    decay, fits = hyper.model.stats_decay, epochs > 0
    of_x, of_y = (None, None) if mirrors is None else mirrors
    inputs = moments.update(model.inputs, rows.x, rows.weight, decay, of_x)
    targets = moments.update(model.targets, rows.y, rows.weight, decay, of_y)
    inputs, targets = jax.tree.map(
        partial(jnp.where, fits), (inputs, targets), (model.inputs, model.targets)
    )
    return model.replace(inputs=inputs, targets=targets)


def scaled(static: Static, model: ModelState, rows: Examples):
    """`(inputs, targets)` of `rows`, of mean 0 and standard deviation 1 by the model's moments."""
    (x_mean, x_std), (y_mean, y_std) = scales(static, model)
    return (rows.x - x_mean) / x_std, (rows.y - y_mean) / y_std


def passes(
    static: Static,
    state: Any,
    data: Any,
    *,
    count: Int[Array, ""],
    epochs: Int[Array, ""],
    key: PRNGKeyArray,
    step: Callable,
    past: Callable | None = None,
) -> tuple[Any, Metrics]:
    """`step(state, minibatch, counted) -> state, loss` for each minibatch of `epochs` passes over `data`.

    `data` is a tree of arrays [T, R, ...], of which the rows `t < count` are used, each once an epoch. A
    minibatch is [M, R, ...] with M = T / `model.minibatches`. The last one may be incomplete: `counted`
    [M, 1] is False for rows beyond the end. `past(key, n)` gives n more rows of each robot, which follow
    those of `data` in each minibatch, `model.remembered` for each. Returns the last state, and the metrics of
    `fit`.
    """
    length, num_envs = jax.tree.leaves(data)[0].shape[:2]
    size = length // static.model.minibatches  # rows of each robot in a minibatch
    order, first = orders(static, length, num_envs, count, key)

    def minibatch(i, carry):
        state, before, _ = carry
        place = i * size + jnp.arange(size)  # counted through all epochs
        epoch = place // count % len(order)  # more epochs than the setting's begin again
        t = order[epoch[:, None], (place[:, None] + first[epoch]) % count]
        rows, counted = jax.tree.map(lambda x: pick(x, t), data), (place < epochs * count)[:, None]
        if past is not None:
            n = size * static.model.remembered
            # `orders` folds smaller numbers
            more = past(jax.random.fold_in(key, len(order) + i), n)
            rows = jax.tree.map(lambda *parts: jnp.concatenate(parts), rows, more)
            counted = jnp.concatenate([counted, jnp.ones((n, 1), bool)])
        state, value = step(state, rows, counted)
        return state, jnp.where(i == 0, value, before), value

    steps = (epochs * count + size - 1) // size
    start = state, jnp.zeros(()), jnp.zeros(())
    state, before, after = jax.lax.fori_loop(0, steps, minibatch, start)
    before, after = (jnp.where(epochs > 0, value, jnp.nan) for value in (before, after))
    return state, {"model_loss": after, "model_loss_before": before}


def orders(static: Static, length: int, num_envs: int, count: Int[Array, ""], key: PRNGKeyArray):
    """`(order [E, T], first [E, R])`: in each of E epochs one random order of the rows `t < count` for
    all robots, and where in it each robot begins."""

    def order(epoch):
        order_key, first_key = jax.random.split(jax.random.fold_in(key, epoch))
        rank = jax.random.uniform(order_key, (length,))
        rank = jnp.where(jnp.arange(length) < count, rank, 1.0)  # these rows come first
        return jnp.argsort(rank), jax.random.randint(first_key, (num_envs,), 0, count)

    return jax.vmap(order)(jnp.arange(max(static.model.epochs, static.model.late_epochs or 0)))


def pick(x: Float[Array, "T R ..."], t: Int[Array, "M R"]) -> Float[Array, "M R ..."]:
    """Row `t[m, r]` of each robot r."""
    return jnp.take_along_axis(x, t.reshape(*t.shape, *[1] * (x.ndim - 2)), axis=0)


def predict(
    static: Static, hyper: Hyper, env: Env, model: ModelState, obs: Float[Array, "R O"], action
) -> tuple[Float[Array, "R O"], Float[Array, " R"], Float[Array, " R"]]:
    """`(next observation, reward, discount)`: prop is predicted, the context computed."""
    size = env.prop_size
    (x_mean, x_std), (y_mean, y_std) = scales(static, model)
    x = (examples.inputs(env, obs, action) - x_mean) / x_std
    y = networks.apply(network(static, size), model.params, x) * y_std + y_mean
    prop, reward = y[..., :size], y[..., size] * env.dt
    if static.model.predict_change:
        prop = prop + obs[..., :size]
    if (bound := hyper.model.bound) is not None:
        prop = jnp.clip(prop, *limits(model, bound, size))
    if static.model.known_reward:
        reward += jax.vmap(partial(env.known_reward, hyper))(obs, action, prop)
    lives = jnp.ones_like(reward)
    if static.model.falls:
        lives = 1 - jax.nn.sigmoid(y[..., -1] + FALL_LOGIT)
        if env.fall_reward is not None:
            reward += (1 - lives) * env.fall_reward(hyper)
    return jnp.concatenate([prop, known(hyper, env, obs, action, prop)], -1), reward, lives


def limits(model: ModelState, bound: float, size: int) -> tuple[Array, Array]:
    """The least and the largest prop [P] that is predicted with `model.bound`: mean -+ so many standard
    deviations of the model's input by its running moments. Prop is the first `size` numbers of it."""
    mean, std = (x[:size] for x in moments.scale(model.inputs))
    return mean - bound * std, mean + bound * std


def known(hyper: Hyper, env: Env, obs, action, next_prop) -> Float[Array, "... O-P"]:
    """The context after `action` in `obs`: what follows from a row need not be predicted."""
    size, row = env.prop_size, "(c),(p),(a),(p)->(c)"
    advance = jnp.vectorize(partial(env.advance, hyper), signature=row)
    return advance(obs[..., size:], obs[..., :size], action, next_prop)


def step(static: Static, hyper: Hyper, env: Env, model: ModelState):
    """`step(state, action, keys) -> state, Outcome` of all robots, for `rollout.fill`.

    Without `falls` no row falls: the paper's model predicts no terminations. No row is truncated.
    """

    def row(state: TailState, action, keys):
        seen = jnp.concatenate([state.prop, state.obs[..., env.prop_size :]], -1)
        after, reward, discount = predict(static, hyper, env, model, seen, action)
        prop = sensed = after[..., : env.prop_size]
        # with what was sensed before, unlike the context in `after`, which XLA therefore never computes
        context = known(hyper, env, state.obs, action, prop)
        if env.known_end is not None:
            ends = jax.vmap(partial(env.known_end, hyper))(prop, context)
            if static.model.falls and env.fall_reward is not None:
                reward += ends * discount * env.fall_reward(hyper)  # `predict` paid the rest
            discount *= 1 - ends
        if static.model.clean:
            noise_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, NOISE)
            sensed = jax.vmap(partial(env.sense, hyper))(prop, context, noise_keys)
        if env.sense_context is not None:
            noise_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, CONTEXT_NOISE)
            context = jax.vmap(partial(env.sense_context, hyper))(context, noise_keys)
        obs, zero = jnp.concatenate([sensed, context], -1), jnp.zeros_like(reward)
        outcome = Outcome(
            reward=reward,
            discount=discount,
            truncation=zero,
            next_obs=obs,
            next_prop=prop,
            episode_return=zero,
            episode_length=zero,
            valid=jnp.ones_like(reward),
        )
        return TailState(obs=obs, prop=prop), outcome

    return row
