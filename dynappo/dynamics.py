"""The transition model: what physics does to the predicted part of the observation, and the reward.

    o_prop_{k+1}, r_k = f_theta(o_k, a_k)                                        (paper, eq. 2)
    L(theta) = sum over robots and real rows of Huber((o_prop_{k+1}, r_k) - f_theta(o_k, a_k))  (3)

An MLP fitted anew in every iteration to that iteration's real rows, warm-started with its weights
and Adam moments. The paper leaves open activation, batch size, Huber delta and scaling. By default
the target is the change of state, and inputs and targets are scaled by running moments; each is a
config field, and `predict_change = normalize = False` is the plain form.

Never across a reset: rows that ended an episode have weight 0, in the loss and in the moments.
That excludes every row whose physics blew up.

Why rows drawn with replacement below n_real: the number of real rows is traced, a permutation of a
traced length is not to be had, and computing on masked rows would cost what the tail saves. A
minibatch has `N / minibatches` rows of every robot, each at times of its own, so that drawing them
moves no row to another device; an epoch is as many minibatches as n_real rows make.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float, Int, PRNGKeyArray

from dynappo import networks
from dynappo.types import Env, Metrics, ModelState, Moments, Outcome, Transition

MIN_STD = 1e-4  # of a normalised number; some observations never change


@struct.dataclass
class TailState:
    """What the model carries instead of an environment's state."""

    obs: Float[Array, "R O"]


def network(static, prop_size: int) -> networks.MLP:
    """f_theta; `static` is the config's group `model`."""
    return networks.MLP((*static.hidden, prop_size + 1), static.activation, static.precision)


def init(static, env: Env, key: PRNGKeyArray) -> ModelState:
    """An untrained model; its moments have weight 0 until the first fit."""
    size = env.obs_size + env.action_size
    params = network(static, env.prop_size).init(key, jnp.zeros(size))
    return ModelState(
        params=params,
        opt_state=optax.scale_by_adam().init(params),
        inputs=_moments(size),
        targets=_moments(env.prop_size + 1),
    )


def _moments(size):
    return Moments(mean=jnp.zeros(size), var=jnp.zeros(size), weight=jnp.zeros(()))


def update_moments(
    moments: Moments, x: Float[Array, "... K"], weight: Float[Array, "..."], decay
) -> Moments:
    """Exponential moving mean and variance over calls, of the rows of `x` with `weight` 1.

    `weight` of the moments tends to 1 as `1 - decay^calls`; `scale` divides by it, so the first
    call's moments are the batch's own. A call without valid rows changes nothing.
    """
    axes = tuple(range(weight.ndim))
    count = weight.sum()
    total = jnp.maximum(count, 1)
    mean = (x * weight[..., None]).sum(axes) / total
    var = ((x - mean) ** 2 * weight[..., None]).sum(axes) / total
    decay = jnp.where(count > 0, decay, 1.0)
    new = Moments(mean=mean, var=var, weight=jnp.ones(()))
    return jax.tree.map(lambda m, b: decay * m + (1 - decay) * b, moments, new)


def scale(moments: Moments) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
    """`(mean, std)` free of the bias of the first calls; std at least 1e-4."""
    weight = jnp.maximum(moments.weight, 1e-8)
    return moments.mean / weight, jnp.sqrt(jnp.maximum(moments.var / weight, MIN_STD**2))


def _scales(static, model: ModelState):
    """`((mean, std) of inputs, (mean, std) of targets)`, or the identity without normalisation."""
    if static.normalize:
        return scale(model.inputs), scale(model.targets)
    return (0.0, 1.0), (0.0, 1.0)


def targets(static, env: Env, rows: Transition) -> Float[Array, "... P+1"]:
    """What the model is to predict of each row: change of (or next) prop, and reward / dt."""
    size = env.prop_size
    prop = rows.next_obs[..., :size]
    if static.predict_change:
        prop = prop - rows.obs[..., :size]
    return jnp.concatenate([prop, rows.reward[..., None] / env.dt], axis=-1)


def loss(static, params, x, y, weight, huber_delta) -> Float[Array, ""]:
    """Mean Huber loss (eq. 3) over rows of weight 1 and over the predicted numbers."""
    prediction = networks.apply(network(static, y.shape[-1] - 1), params, x)
    error = optax.losses.huber_loss(prediction, y, delta=huber_delta).mean(-1)
    return (error * weight).sum() / jnp.maximum(weight.sum(), 1)


def fit(
    static,
    hyper,
    env: Env,
    model: ModelState,
    rows: Transition,
    n_real: Int[Array, ""],
    epochs: Int[Array, ""],
    key: PRNGKeyArray,
) -> tuple[ModelState, Metrics]:
    """`epochs` passes of Adam over the rows `t < n_real` of a `[N, R]` buffer.

    `static` and `hyper` are the config's group `model`. Metrics: `model_loss_before`, of the first
    minibatch before any step (rows the model has never seen), and `model_loss`, of the last.
    """
    horizon, num_envs = rows.reward.shape
    drawn = horizon // static.minibatches  # rows of each robot in a minibatch
    real = (jnp.arange(horizon) < n_real)[:, None]
    weight = jnp.where(real, rows.discount * (1 - rows.truncation), 0.0)
    x, y = jnp.concatenate([rows.obs, rows.action], -1), targets(static, env, rows)
    # zeroed, not only weighted: nothing times 0 is 0 for a number that is not finite
    x, y = (jnp.where(weight[..., None] > 0, a, 0.0) for a in (x, y))
    model = model.replace(
        inputs=update_moments(model.inputs, x, weight, hyper.stats_decay),
        targets=update_moments(model.targets, y, weight, hyper.stats_decay),
    )
    (x_mean, x_std), (y_mean, y_std) = _scales(static, model)
    data = jnp.concatenate([(x - x_mean) / x_std, (y - y_mean) / y_std, weight[..., None]], -1)
    inputs, adam = x.shape[-1], optax.scale_by_adam()

    def minibatch(i, carry):
        params, opt_state, before, _ = carry
        times = jax.random.randint(jax.random.fold_in(key, i), (drawn, num_envs, 1), 0, n_real)
        batch = jnp.take_along_axis(data, times, axis=0)
        bx, by, bw = batch[..., :inputs], batch[..., inputs:-1], batch[..., -1]
        value, grads = jax.value_and_grad(loss, argnums=1)(
            static, params, bx, by, bw, hyper.huber_delta
        )
        updates, opt_state = adam.update(grads, opt_state)
        params = jax.tree.map(lambda p, u: p - hyper.learning_rate * u, params, updates)
        return params, opt_state, jnp.where(i == 0, value, before), value

    steps = epochs * (n_real // drawn)
    start = (model.params, model.opt_state, jnp.zeros(()), jnp.zeros(()))
    params, opt_state, before, after = jax.lax.fori_loop(0, steps, minibatch, start)
    metrics = {"model_loss": after, "model_loss_before": before}
    return model.replace(params=params, opt_state=opt_state), metrics


def predict(
    static, env: Env, model: ModelState, obs: Float[Array, "R O"], action: Float[Array, "R A"]
) -> tuple[Float[Array, "R O"], Float[Array, " R"]]:
    """`(next observation, reward)`: prop predicted, ctx copied by `env.context`."""
    (x_mean, x_std), (y_mean, y_std) = _scales(static, model)
    x = (jnp.concatenate([obs, action], -1) - x_mean) / x_std
    y = networks.apply(network(static, env.prop_size), model.params, x) * y_std + y_mean
    prop = y[..., :-1]
    if static.predict_change:
        prop = prop + obs[..., : env.prop_size]
    return jnp.concatenate([prop, env.context(obs, action)], -1), y[..., -1] * env.dt


def unroll(
    static, env: Env, model: ModelState, rows: Transition, steps: int
) -> tuple[Float[Array, "K R P"], Float[Array, "K R"]]:
    """`steps` predictions in a row, from row 0 with the actions that were taken.

    Returns them, to be compared with `rows.next_obs[:K]`, and 1 where the robot's episode had not
    ended by then.
    """
    obs, predicted = rows.obs[0], []
    for k in range(steps):
        obs, _ = predict(static, env, model, obs, rows.action[k])
        predicted.append(obs[:, : env.prop_size])
    alive = jnp.cumprod(rows.discount[:steps] * (1 - rows.truncation[:steps]), axis=0)
    return jnp.stack(predicted), alive


def errors(static, env: Env, model: ModelState, rows: Transition, steps: int) -> Metrics:
    """Error of 1 and of `steps` predictions in a row, as a share of that of repeating the state.

    Root mean square over robots and predicted numbers, each in units of its spread; 1 is no better
    than the trivial predictor. Before a fit, the rows are new to the model.
    """
    size, out = env.prop_size, {}
    std = scale(model.inputs)[1][:size]
    predicted, alive = unroll(static, env, model, rows, steps)
    for k in {0, steps - 1}:
        truth, still = rows.next_obs[k, :, :size], rows.obs[0, :, :size]
        wrong, change = (
            jnp.where(alive[k, :, None] > 0, ((x - truth) / std) ** 2, 0.0).sum()
            for x in (predicted[k], still)
        )
        out[f"model_error_{k + 1}"] = jnp.sqrt(wrong / jnp.maximum(change, 1e-12))
    return out


def step(static, env: Env, model: ModelState, state: TailState, action, keys=None) -> tuple:
    """The contract of an environment's step, with the model in place of physics.

    The model is deterministic: `keys` is not read. No row of a tail falls or times out, because
    the paper's model predicts no terminations and clocks advance in physics only.
    """
    obs, reward = predict(static, env, model, state.obs, action)
    outcome = Outcome(
        reward=reward,
        discount=jnp.ones_like(reward),
        truncation=jnp.zeros_like(reward),
        next_obs=obs,
        episode_return=jnp.zeros_like(reward),
        episode_length=jnp.zeros_like(reward),
        metrics={},
    )
    return TailState(obs=obs), outcome
