"""The transition model: what physics does to the predicted part of the observation, and the reward.

    o_prop_{k+1}, r_k = f_theta(o_k, a_k)                                        (paper, eq. 2)
    L(theta) = sum over robots and real rows of Huber((o_prop_{k+1}, r_k) - f_theta(o_k, a_k))  (3)

An MLP fitted anew in every iteration to that iteration's real rows, warm-started with its weights
and Adam moments. The paper leaves open activation, batch size, Huber delta and scaling. By default
the target is the change of state, and inputs and targets are scaled by running moments; each is a
config field, and `predict_change = normalize = False` is the plain form.

Never across a reset: rows that ended an episode, blow-ups among them, have weight 0 everywhere.

Beyond the paper, each by a field of the group model that is off by default:

- `clean`: f_theta carries s, the state without noise, instead of o_prop; the policy of the tail sees
  s + noise drawn anew. Noise is the error floor of a model that has to predict it.
- `known_reward`: r = k(o, a, s') + f_theta, with k what `env.known_reward` computes of the prediction.
- `falls`: p = sigmoid(f_theta) is the probability of a fall, and a tail's discount 1 - p. No class
  weights in its cross-entropy: p is a factor of every value and must be true. Fallen rows are trained
  on (with `clean` too: s' is from before the reset), blow-ups never. A tail is cut where the episode's
  clock says so; no advantage crosses, and the robot walks on, as the policy sees no clock.
- `ensemble` networks learn the same rows from different starts; their mean predicts, and where they
  disagree more than on real rows, s > s_real, a synthetic row has weight (s_real / s)^2 in PPO's means.
- `unroll`: the loss of so many predictions in a row, each from the one before, with the actions taken.
- `private`: the model carries what no observation shows, too: contacts, air times, the robot's own body.
- `history`: the fit also draws rows of so many earlier iterations, from each as many as from this one.
- `bounds`: every prediction stays in the range of this iteration's real rows, and 5 % beyond; values
  too (algorithm.estimate). A tail can then be wrong, but not diverge.

Why rows drawn with replacement below n_real: the number of real rows is traced, a permutation of a
traced length is not to be had, and computing on masked rows would cost what the tail saves. A
minibatch has `N / minibatches` rows of every robot, each at times of its own, so that drawing them
moves no row to another device; an epoch is as many minibatches as n_real rows make.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float, Int, PRNGKeyArray

from dynappo import model_rows, moments, networks
from dynappo.types import Env, Metrics, ModelState, Outcome, Transition

FALL_LOGIT = -4.6  # added to the network's: untrained, it says 1 %


@struct.dataclass
class TailState:
    """What the model carries instead of an environment's state."""

    obs: Float[Array, "R O"]  # what the policy sees
    prop: Float[Array, "R P"]  # what the model carries (model_rows.py)
    clock: Int[Array, " R"] | None = None  # age of the episode, with `falls`


def tail(static, env: Env, state, params_physics=None) -> TailState:
    """Where a tail begins: at the state that physics carries."""
    prop = state.obs[..., : env.prop_size]
    if static.clean:
        prop = model_rows.carried(static, env, params_physics, state)
    return TailState(obs=state.obs, prop=prop, clock=state.clock if static.falls else None)


def network(static, prop_size: int) -> networks.MLP:
    """f_theta: next prop, reward and the logit of a fall; `static` is the config's group `model`."""
    sizes = (*static.hidden, prop_size + 1 + static.falls)
    return networks.MLP(sizes, static.activation, static.precision)


def init(static, env: Env, key: PRNGKeyArray) -> ModelState:
    """An untrained model; its moments have weight 0 until the first fit."""
    carried = model_rows.carried_size(static, env)
    size = carried + env.obs_size - env.prop_size + env.action_size
    params = network(static, carried).init(key, jnp.zeros(size))
    if static.ensemble > 1:
        one = network(static, carried).init
        params = jax.vmap(one, (0, None))(jax.random.split(key, static.ensemble), jnp.zeros(size))
    unbounded = jnp.array([[-jnp.inf], [jnp.inf]]) + jnp.zeros(carried + 1)
    return ModelState(
        params=params,
        opt_state=optax.scale_by_adam().init(params),
        inputs=moments.init(size),
        targets=moments.init(carried + 1 + static.falls),
        bounds=unbounded if static.bounds else None,
        spread=jnp.zeros(()) if static.ensemble > 1 else None,
    )


def members(static, params, x: Float[Array, "... I"], prop_size: int) -> Float[Array, "E ... K"]:
    """What each network of the ensemble says of a normalised input."""
    net = network(static, prop_size)
    if static.ensemble == 1:
        return networks.apply(net, params, x)[None]
    return jax.vmap(partial(networks.apply, net), (0, None))(params, x)


def disagreement(static, params, x: Float[Array, "... I"], prop_size: int) -> Float[Array, "..."]:
    """Root mean square, over predicted numbers in normalised units, of the networks' deviation."""
    y = members(static, params, x, prop_size)[..., : prop_size + 1]
    return jnp.sqrt(y.var(0).mean(-1))


def _scales(static, model: ModelState):
    """`((mean, std) of inputs, (mean, std) of targets)`, or the identity without normalisation."""
    if not static.normalize:
        return [
            (jnp.zeros_like(m.mean), jnp.ones_like(m.mean)) for m in (model.inputs, model.targets)
        ]
    mean, std = moments.scale(model.targets)
    if static.falls:  # 0 or 1, as it is
        mean, std = mean.at[-1].set(0.0), std.at[-1].set(1.0)
    return moments.scale(model.inputs), (mean, std)


def loss(static, params, batches, huber_delta, ratio=1.0) -> Float[Array, ""]:
    """Mean over rows of weight 1, predicted numbers, networks and `batches`: Huber (eq. 3); of a
    fall, cross-entropy.

    A batch is `(x, y, weight)`; there is one, or `unroll` that follow each other. From the second on,
    x and y are moved by the drift of prop, in units of y: predicted minus true. `ratio` is y's unit over
    x's.
    """
    total, drift = jnp.zeros(()), 0.0
    for x, y, weight in batches:
        size = y.shape[-1] - static.falls  # predicted numbers: prop and reward
        if len(batches) > 1:
            x = x.at[..., : size - 1].add(drift * ratio)
            y = y.at[..., : size - 1].add(-drift if static.predict_change else 0.0)
        prediction = members(static, params, x, size - 1)
        error = optax.losses.huber_loss(prediction[..., :size], y[..., :size], delta=huber_delta)
        if static.falls:
            fall = optax.losses.sigmoid_binary_cross_entropy(prediction + FALL_LOGIT, y)[..., size:]
            error = jnp.concatenate([error, fall], -1)
        error = error.mean((0, -1))
        total += (error * weight).sum() / jnp.maximum(weight.sum(), 1)
        drift = (prediction.mean(0) - y)[..., : size - 1]
    return total / len(batches)


def fit(
    static,
    hyper,
    env: Env,
    model: ModelState,
    rows: Transition,
    n_real: Int[Array, ""],
    epochs: Int[Array, ""],
    key: PRNGKeyArray,
    task=None,
    past=None,
) -> tuple[ModelState, Metrics]:
    """`epochs` passes of Adam over the rows `t < n_real` of a `[N, R]` buffer.

    `static` and `hyper` are the config's group `model`, `task` is `hyper.task`; of `past` rows
    (model_rows.remember) as many are drawn an iteration. Metrics: the loss of the first minibatch
    before any step (without `past`, rows the model has never seen), and of the last.
    """
    horizon = rows.reward.shape[0]
    drawn = horizon // static.minibatches  # rows of each robot in a minibatch
    size = model_rows.carried_size(static, env)
    x, y, weight = model_rows.examples(static, env, rows, n_real, task)
    bounds = model_rows.range_of(model.bounds, env, static, rows, weight) if static.bounds else None
    model = model.replace(
        inputs=moments.update(model.inputs, x, weight, hyper.stats_decay),
        targets=moments.update(model.targets, y, weight, hyper.stats_decay),
        bounds=bounds,
    )
    (x_mean, x_std), (y_mean, y_std) = _scales(static, model)
    data = jnp.concatenate([(x - x_mean) / x_std, (y - y_mean) / y_std, weight[..., None]], -1)
    inputs, adam, ahead = x.shape[-1], optax.scale_by_adam(), static.unroll - 1
    if past is not None:
        mean, std = jnp.r_[x_mean, y_mean, 0], jnp.r_[x_std, y_std, 1]
        data = jnp.concatenate([data, jnp.moveaxis((past - mean) / std, 1, 0)])
    ratio = y_std[:size] / x_std[:size]
    goes_on = rows.discount * (1 - rows.truncation) * rows.valid
    shape = (drawn, *weight.shape[1:], 1)

    def draw(key):
        times = jax.random.randint(key, shape, 0, n_real - ahead)
        if past is None:
            return times
        which, when = jax.random.split(jax.random.fold_in(key, 1))
        earlier = jax.random.randint(when, shape, horizon, len(data))
        now = jax.random.uniform(which, shape) < 1 / (1 + static.history)
        return jnp.where(now, times, earlier)

    def minibatch(i, carry):
        params, opt_state, before, _ = carry
        times, batches, alive = draw(jax.random.fold_in(key, i)), [], 1.0
        for k in range(static.unroll):
            batch = jnp.take_along_axis(data, times + k, axis=0)
            batches.append((batch[..., :inputs], batch[..., inputs:-1], batch[..., -1] * alive))
            alive = alive * jnp.take_along_axis(goes_on, times[..., 0] + k, axis=0)
        ask = jax.value_and_grad(loss, argnums=1)
        value, grads = ask(static, params, batches, hyper.huber_delta, ratio)
        updates, opt_state = adam.update(grads, opt_state)
        params = jax.tree.map(lambda p, u: p - hyper.learning_rate * u, params, updates)
        return params, opt_state, jnp.where(i == 0, value, before), value

    steps = epochs * (n_real // drawn)
    start = (model.params, model.opt_state, jnp.zeros(()), jnp.zeros(()))
    params, opt_state, before, after = jax.lax.fori_loop(0, steps, minibatch, start)
    metrics = {"model_loss": after, "model_loss_before": before}
    model = model.replace(params=params, opt_state=opt_state)
    if static.ensemble > 1:
        spread = disagreement(static, params, data[0, :, :inputs], size)
        spread = jnp.sqrt((spread**2 * weight[0]).sum() / jnp.maximum(weight[0].sum(), 1))
        model = model.replace(spread=spread)
    return model, metrics


def predict(
    static, env: Env, model: ModelState, obs: Float[Array, "R M"], action, task=None
) -> tuple[Float[Array, "R M"], Float[Array, " R"], Float[Array, " R"]]:
    """`(next observation, reward, discount)` of the model's own observation (model_rows.py): what it
    carries predicted, the context copied by `env.context`."""
    size, shown = model_rows.carried_size(static, env), model_rows.seen(static, env, obs)
    (x_mean, x_std), (y_mean, y_std) = _scales(static, model)
    x = (jnp.concatenate([obs, action], -1) - x_mean) / x_std
    y = members(static, model.params, x, size).mean(0) * y_std + y_mean
    prop, reward = y[..., :size], y[..., size] * env.dt
    if static.predict_change:
        prop = prop + obs[..., :size]
    if model.bounds is not None:
        prop = jnp.clip(prop, model.bounds[0, :size], model.bounds[1, :size])
    if static.known_reward:
        reward += jax.vmap(partial(env.known_reward, task))(shown, action, prop[:, : env.prop_size])
    if model.bounds is not None:
        reward = jnp.clip(reward, model.bounds[0, size], model.bounds[1, size])
    lives = 1 - jax.nn.sigmoid(y[..., -1] + FALL_LOGIT) if static.falls else jnp.ones_like(reward)
    return jnp.concatenate([prop, env.context(shown, action)], -1), reward, lives


def trust(static, model: ModelState, obs, action, prop_size: int) -> Float[Array, " R"]:
    """Of a synthetic row in PPO's means: min(1, s_real / s)^2 of an ensemble's disagreement s."""
    if model.spread is None:
        return jnp.ones(obs.shape[:-1])
    x_mean, x_std = _scales(static, model)[0]
    x = (jnp.concatenate([obs, action], -1) - x_mean) / x_std
    spread = disagreement(static, model.params, x, prop_size)
    return jnp.minimum(1.0, model.spread / jnp.maximum(spread, 1e-8)) ** 2


def step(static, env: Env, model: ModelState, state: TailState, action, keys=None, task=None):
    """The contract of an environment's step, with the model in place of physics.

    The model is deterministic: `keys` are read for the noise of `clean` only. Without `falls` no row
    falls or times out: the paper's model predicts no terminations, clocks advance in physics only.
    """
    size = model_rows.carried_size(static, env)
    obs = jnp.concatenate([state.prop, state.obs[..., env.prop_size :]], -1)
    valid = trust(static, model, obs, action, size)
    obs, reward, discount = predict(static, env, model, obs, action, task)
    prop, clock, truncation = obs[..., :size], None, jnp.zeros_like(reward)
    obs = model_rows.seen(static, env, obs)
    if static.clean:
        obs = obs.at[..., : env.prop_size].add(jax.vmap(env.noise, (None, 0))(task, keys))
    if state.clock is not None:
        clock = state.clock + 1
        truncation = (clock == env.episode_length) * 1.0
    outcome = Outcome(
        reward=reward,
        discount=discount,
        truncation=truncation,
        next_obs=obs,
        next_prop=prop,
        valid=valid,
        episode_return=jnp.zeros_like(reward),
        episode_length=jnp.zeros_like(reward),
        metrics={},
    )
    return TailState(obs=obs, prop=prop, clock=clock), outcome
