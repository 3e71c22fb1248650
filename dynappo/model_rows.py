"""What the transition model learns from: rows of a rollout as inputs, targets and weights.

The model's own observation is `[carried, context]`: what it predicts, and what is copied (observe.py).
Carried is the observation's `prop`; with `model.clean` without its noise; with `model.private` also what
no observation shows (`Env.private`).
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dynappo.types import Env, Transition

MARGIN = 0.05  # of the range of real rows, by which a prediction may leave it


def carried_size(static, env: Env) -> int:
    """Numbers that the model carries and predicts; `static` is the config's group `model`.

    ValueError with `model.private` where the environment has nothing private.
    """
    if static.private and not env.private_size:
        raise ValueError("model.private is True, but this environment has no private numbers")
    return env.prop_size + (env.private_size if static.private else 0)


def carried(static, env: Env, params_physics, state) -> Float[Array, "R P"]:
    """What the model carries of the robots that physics has brought to `state`."""
    if not static.private:
        return state.prop
    return jnp.concatenate([state.prop, jax.vmap(env.private)(params_physics, state)], -1)


def seen(static, env: Env, obs: Float[Array, "... M"]) -> Float[Array, "... O"]:
    """The policy's part of the model's observation: all but what is private."""
    if not static.private:
        return obs
    size, every = env.prop_size, carried_size(static, env)
    return jnp.concatenate([obs[..., :size], obs[..., every:]], -1)


def before_and_after(static, env: Env, rows: Transition):
    """`(obs [M], next carried [P])` of each row as the model sees them: without noise if `clean`."""
    size = env.prop_size
    if not static.clean:
        return rows.obs, rows.next_obs[..., :size]
    return jnp.concatenate([rows.prop, rows.obs[..., size:]], -1), rows.next_prop


def targets(static, env: Env, rows: Transition, task=None) -> Float[Array, "... P+1"]:
    """What the model is to predict of each row: change of (or next) carried numbers, reward / dt, and,
    with `falls`, 1 where the episode fell. Of the reward, what is not known."""
    (obs, after), reward, fell = before_and_after(static, env, rows), rows.reward, 1 - rows.discount
    if static.known_reward:
        known = jax.vmap(jax.vmap(partial(env.known_reward, task)))
        reward = reward - known(rows.obs, rows.action, rows.next_prop[..., : env.prop_size])
    if static.predict_change:
        after = after - obs[..., : after.shape[-1]]
    columns = [after, reward[..., None] / env.dt] + [fell[..., None]] * static.falls
    return jnp.concatenate(columns, axis=-1)


def row_weight(static, rows: Transition, n_real: Int[Array, ""]) -> Float[Array, "N R"]:
    """1 for the rows that the model learns from, else 0."""
    real = (jnp.arange(rows.reward.shape[0]) < n_real)[:, None]
    every = static.clean or static.falls
    return jnp.where(real, rows.valid if every else rows.discount * (1 - rows.truncation), 0.0)


def examples(static, env: Env, rows: Transition, n_real: Int[Array, ""], task=None):
    """`(inputs [N, R, M+A], targets [N, R, K], weight [N, R])` of a rollout's rows `t < n_real`."""
    weight = row_weight(static, rows, n_real)
    x = jnp.concatenate([before_and_after(static, env, rows)[0], rows.action], -1)
    y = targets(static, env, rows, task)
    # zeroed, not only weighted: nothing times 0 is 0 for a number that is not finite
    x, y = (jnp.where(weight[..., None] > 0, a, 0.0) for a in (x, y))
    return x, y, weight


def forget(static, env: Env, num_envs: int, kept: int) -> Float[Array, "R H D"] | None:
    """Room for the first `kept` rows of the last `model.history` iterations, none of weight yet."""
    if not static.history:
        return None
    size = carried_size(static, env)
    inputs = size + env.obs_size - env.prop_size + env.action_size
    return jnp.zeros((num_envs, static.history * kept, inputs + size + 1 + static.falls + 1))


def remember(static, env: Env, past, rows: Transition, n_real, task=None):
    """`past` [R, H, D] with the first rows of this rollout in place of the oldest iteration's."""
    if past is None:
        return None
    kept = past.shape[1] // static.history
    x, y, weight = examples(static, env, rows, n_real, task)
    new = jnp.concatenate([x, y, weight[..., None]], -1)[:kept]
    return jnp.concatenate([jnp.moveaxis(new, 0, 1), past[:, :-kept]], 1)


def range_of(old, env: Env, static, rows: Transition, weight) -> Float[Array, "2 P+1"]:
    """`(low, high)` of next carried numbers and reward over rows of weight 1, and a margin; or `old`."""
    used, after = weight[..., None] > 0, before_and_after(static, env, rows)[1]
    numbers = jnp.concatenate([after, rows.reward[..., None]], -1)
    low = jnp.where(used, numbers, jnp.inf).min((0, 1))
    high = jnp.where(used, numbers, -jnp.inf).max((0, 1))
    margin = MARGIN * (high - low)
    return jnp.where(used.any(), jnp.stack([low - margin, high + margin]), old)
