"""The transition model's training data: rows of a rollout as inputs, targets and weights.

The model predicts the observation's `prop`, with `model.clean` without its noise. The rest of an
observation, the context, is known (`Env.advance`).
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dynappo.types import Env, Hyper, Static, Transition


def inputs(env: Env, obs: Float[Array, "... O"], action) -> Float[Array, "... I"]:
    """What the model sees of a row."""
    seen = obs if env.views is None else obs[..., env.views.model]
    return jnp.concatenate([seen, action], -1)


def input_size(env: Env) -> int:
    """Numbers of `inputs`."""
    return (env.obs_size if env.views is None else len(env.views.model)) + env.action_size


def before_and_after(static: Static, env: Env, rows: Transition):
    """`(obs [O], next prop [P])` of each row as the model sees them; `clean`: without noise."""
    size = env.prop_size
    if not static.model.clean:
        return rows.obs, rows.next_obs[..., :size]
    return jnp.concatenate([rows.prop, rows.obs[..., size:]], -1), rows.next_prop


def targets(static: Static, hyper: Hyper, env: Env, rows: Transition) -> Float[Array, "... K"]:
    """The model's target for each row: change of prop (or next prop), reward / dt without its known
    share, and, with `model.falls`, 1 where the robot fell.

    The known share is that of what the model sees and predicts, as it will be in a tail: without
    `clean` of sensed props, although the reward itself was paid for exact ones.
    """
    (obs, after), reward, fell = before_and_after(static, env, rows), rows.reward, 1 - rows.discount
    if static.model.known_reward:
        known = jax.vmap(jax.vmap(partial(env.known_reward, hyper)))
        reward = reward - known(obs, rows.action, after)
    if static.model.predict_change:
        after = after - obs[..., : env.prop_size]
    columns = [after, reward[..., None] / env.dt] + [fell[..., None]] * static.model.falls
    return jnp.concatenate(columns, axis=-1)


def row_weight(static: Static, rows: Transition, n_real: Int[Array, ""]) -> Float[Array, "N R"]:
    """1 for the rows that the model learns from, else 0."""
    real = (jnp.arange(rows.reward.shape[0]) < n_real)[:, None]
    every = static.model.clean or static.model.falls
    return jnp.where(real, rows.valid if every else rows.discount * (1 - rows.truncation), 0.0)


def examples(static: Static, hyper: Hyper, env: Env, rows: Transition, n_real: Int[Array, ""]):
    """`(inputs [N, R, O+A], targets [N, R, K], weight [N, R])` of a rollout's rows `t < n_real`."""
    weight = row_weight(static, rows, n_real)
    x = inputs(env, before_and_after(static, env, rows)[0], rows.action)
    y = targets(static, hyper, env, rows)
    # set to zero, not only weighted by 0: 0 times a number that is not finite is NaN
    x, y = (jnp.where(weight[..., None] > 0, a, 0.0) for a in (x, y))
    return x, y, weight
