"""The transition model: predicts the next observation and the reward of a control step.

    o_prop_{k+1}, r_k = f_theta(o_k, a_k)                                        (paper, eq. 2)
    L(theta) = sum over robots and real rows of Huber((o_prop_{k+1}, r_k) - f_theta(o_k, a_k))  (3)

An MLP, fitted in each iteration to its real rows, from the last weights and Adam moments. The paper
leaves two things open: here the target is the change of state, and running moments scale inputs and
targets. `predict_change = normalize = False` is the plain form. It never learns across a reset.

Options beyond the paper, fields of the group model that are off in the paper's variants:

- `clean`: f_theta reads and predicts the state without noise, and the policy in the tail sees it
  with new noise. A model that has to predict noise cannot have a smaller error than the noise.
- `known_reward`: the reward is `env.known_reward` of the prediction, plus the rest from f_theta.
- `falls`: sigmoid(f_theta) is the probability of a fall, and 1 minus it is the tail's discount. The
  model learns from rows with a fall too, without class weights.

Why an epoch runs through the rows of each robot, not through all rows in random order (`orders`):
JAX cannot permute a traced number of rows, and computing on masked rows would cost what the tail
saves. Every minibatch has equally many rows of each robot, so no row moves to another device.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PRNGKeyArray

from dynappo.learner import networks
from dynappo.model import examples, moments
from dynappo.types import Env, Hyper, Metrics, ModelState, Outcome, Static, Transition

FALL_LOGIT = -4.6  # added to the network's output: untrained, it predicts 1 %
NOISE = 4  # purpose of random numbers, the same as algorithm.STEP; no row is written by both


@struct.dataclass
class TailState:
    """The state of a tail, in place of an environment's state."""

    obs: Float[Array, "R O"]  # what the policy sees
    prop: Float[Array, "R P"]  # what the model predicts from (examples.py)


def tail(static: Static, env: Env, state) -> TailState:
    """The start of a tail, from the `obs` and `prop` of a physics state or of a row."""
    prop = state.prop if static.model.clean else state.obs[..., : env.prop_size]
    return TailState(obs=state.obs, prop=prop)


def anchors(static: Static, env: Env, rows: Transition, n_real: Int[Array, ""], key) -> TailState:
    """The start of a tail for each robot, from one of its rows `t < n_real`, drawn at random."""
    t = jax.random.randint(key, rows.reward.shape[1:], 0, n_real)[None, :, None]
    states = tail(static, env, rows)
    return jax.tree.map(lambda x: jnp.take_along_axis(x, t, axis=0)[0], states)


def network(static: Static, prop_size: int) -> networks.MLP:
    """f_theta, with outputs next prop, reward and, with `model.falls`, the logit of a fall."""
    model = static.model
    sizes = (*model.hidden, prop_size + 1 + model.falls)
    return networks.MLP(sizes, model.activation, model.precision)


def init(static: Static, env: Env, key: PRNGKeyArray) -> ModelState:
    """An untrained model; its moments have weight 0 until the first fit."""
    inputs, outputs = examples.input_size(env), env.prop_size + 1
    params = networks.init(network(static, env.prop_size), inputs, key)
    return ModelState(
        params=params,
        opt_state=optax.scale_by_adam().init(params),
        inputs=moments.init(inputs),
        targets=moments.init(outputs + static.model.falls),
    )


def _scales(static: Static, model: ModelState):
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


def fit(
    static: Static,
    hyper: Hyper,
    env: Env,
    model: ModelState,
    rows: Transition,
    n_real: Int[Array, ""],
    epochs: Int[Array, ""],
    key: PRNGKeyArray,
) -> tuple[ModelState, Metrics]:
    """`epochs` passes of Adam over the rows `t < n_real` of a `[N, R]` buffer.

    Metrics: the loss of the last minibatch, and of the first, whose rows are new to the model. With
    0 epochs nothing of the model changes, its moments neither, and the losses are NaN: there are none.
    """
    horizon, num_envs = rows.reward.shape
    drawn = horizon // static.model.minibatches  # rows of each robot in a minibatch
    x, y, weight = examples.examples(static, hyper, env, rows, n_real)
    decay, fits = hyper.model.stats_decay, epochs > 0
    inputs, targets = model.inputs, model.targets
    new = moments.update(inputs, x, weight, decay), moments.update(targets, y, weight, decay)
    inputs, targets = jax.tree.map(partial(jnp.where, fits), new, (inputs, targets))
    model = model.replace(inputs=inputs, targets=targets)
    (x_mean, x_std), (y_mean, y_std) = _scales(static, model)
    data = jnp.concatenate([(x - x_mean) / x_std, (y - y_mean) / y_std, weight[..., None]], -1)
    size, adam = x.shape[-1], optax.scale_by_adam()
    order, first = orders(static, n_real, num_envs, key)
    # as one vector each: Adam then takes one kernel, not two for every layer
    params, unflatten = ravel_pytree(model.params)
    adams = model.opt_state
    opt_state = adams._replace(mu=ravel_pytree(adams.mu)[0], nu=ravel_pytree(adams.nu)[0])

    def minibatch(i, carry):
        params, opt_state, before, _ = carry
        place = i * drawn + jnp.arange(drawn)  # counted through all epochs
        epoch = place // n_real % len(order)  # more epochs than the setting's begin again
        row = order[epoch[:, None], (place[:, None] + first[epoch]) % n_real]
        batch = jnp.take_along_axis(data, row[..., None], axis=0)
        used = batch[..., -1] * (place < epochs * n_real)[:, None]
        batch = batch[..., :size], batch[..., size:-1], used
        of = jax.value_and_grad(lambda params: loss(static, hyper, unflatten(params), *batch))
        value, grads = of(params)
        updates, opt_state = adam.update(grads, opt_state)
        params = params - hyper.model.learning_rate * updates
        return params, opt_state, jnp.where(i == 0, value, before), value

    steps = (epochs * n_real + drawn - 1) // drawn
    start = (params, opt_state, jnp.zeros(()), jnp.zeros(()))
    params, opt_state, before, after = jax.lax.fori_loop(0, steps, minibatch, start)
    opt_state = opt_state._replace(mu=unflatten(opt_state.mu), nu=unflatten(opt_state.nu))
    model = model.replace(params=unflatten(params), opt_state=opt_state)
    before, after = (jnp.where(fits, value, jnp.nan) for value in (before, after))
    return model, {"model_loss": after, "model_loss_before": before}


def orders(static: Static, n_real: Int[Array, ""], num_envs: int, key: PRNGKeyArray):
    """`(order [E, N], first [E, R])` of epochs: every real row once, in one random order for all
    robots; each starts elsewhere in it. In the loop over minibatches they would take 7 kernels."""

    def order(epoch):
        order_key, first_key = jax.random.split(jax.random.fold_in(key, epoch))
        rank = jax.random.uniform(order_key, (static.rollout.horizon,))
        rank = jnp.where(jnp.arange(len(rank)) < n_real, rank, 1.0)  # real rows come first
        return jnp.argsort(rank), jax.random.randint(first_key, (num_envs,), 0, n_real)

    return jax.vmap(order)(jnp.arange(max(static.model.epochs, static.model.late_epochs or 0)))


def predict(
    static: Static, hyper: Hyper, env: Env, model: ModelState, obs: Float[Array, "R O"], action
) -> tuple[Float[Array, "R O"], Float[Array, " R"], Float[Array, " R"]]:
    """`(next observation, reward, discount)`: prop is predicted, the context computed."""
    size = env.prop_size
    (x_mean, x_std), (y_mean, y_std) = _scales(static, model)
    x = (examples.inputs(env, obs, action) - x_mean) / x_std
    y = networks.apply(network(static, size), model.params, x) * y_std + y_mean
    prop, reward = y[..., :size], y[..., size] * env.dt
    if static.model.predict_change:
        prop = prop + obs[..., :size]
    if static.model.known_reward:
        reward += jax.vmap(partial(env.known_reward, hyper))(obs, action, prop)
    lives = jnp.ones_like(reward)
    if static.model.falls:
        lives = 1 - jax.nn.sigmoid(y[..., -1] + FALL_LOGIT)
    return jnp.concatenate([prop, known(hyper, env, obs, action, prop)], -1), reward, lives


def known(hyper: Hyper, env: Env, obs, action, next_prop) -> Float[Array, "... O-P"]:
    """The context after `action` in `obs`: what follows from a row need not be predicted."""
    size, row = env.prop_size, "(c),(p),(a),(p)->(c)"
    advance = jnp.vectorize(partial(env.advance, hyper), signature=row)
    return advance(obs[..., size:], obs[..., :size], action, next_prop)


def step(static: Static, hyper: Hyper, env: Env, model: ModelState):
    """`step(state, action, keys) -> state, Outcome` of all robots, for `rollout.fill`.

    Without `falls` no row falls: the paper's model predicts no terminations. No row is truncated.
    """
    model = model.replace(params=networks.cast(static.model.precision, model.params))

    def row(state: TailState, action, keys):
        seen = jnp.concatenate([state.prop, state.obs[..., env.prop_size :]], -1)
        after, reward, discount = predict(static, hyper, env, model, seen, action)
        prop = sensed = after[..., : env.prop_size]
        context = known(hyper, env, state.obs, action, prop)  # with what was sensed before
        if static.model.clean:
            keys = jax.vmap(jax.random.fold_in, (0, None))(keys, NOISE)
            sensed = jax.vmap(partial(env.sense, hyper))(prop, context, keys)
        obs, zero = jnp.concatenate([sensed, context], -1), jnp.zeros_like(reward)
        told: dict = {"reward": reward, "discount": discount, "next_obs": obs, "next_prop": prop}
        told |= dict.fromkeys(("truncation", "episode_return", "episode_length"), zero)
        return TailState(obs, prop), Outcome(**told, valid=jnp.ones_like(reward))

    return row
