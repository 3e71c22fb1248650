"""The transition model's training data: rows of a rollout as inputs, targets and weights.

The model predicts the observation's `prop`, without its noise if `model.clean` is set. The rest of the
observation, the context, is known (`Env.advance`).
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dynappo.learner import networks
from dynappo.types import Env, Hyper, Static, Transition


class Examples(NamedTuple):
    """The rows that the model learns from: `t < count`, where the weight is 1.

    T is the horizon N, or the number of rows drawn from a memory (`memory.draw`).
    """

    x: Float[Array, "T R I"]  # input
    y: Float[Array, "T R K"]  # target
    weight: Float[Array, "T R"]  # 1 or 0
    count: Int[Array, ""]  # bounds loops: the same for all seeds


def inputs(env: Env, obs: Float[Array, "... O"], action) -> Float[Array, "... I"]:
    """What the model sees of a row."""
    seen = obs if env.views is None else networks.columns(obs, env.views.model)
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
    share, and, with `model.falls`, 1 where the robot fell. `Env.fall_reward` is part of the known share.

    The known share is computed from what the model sees and predicts, as in a tail: without `clean` from
    sensed props, although the reward itself was computed from exact ones.
    """
    (obs, after), reward, fell = before_and_after(static, env, rows), rows.reward, 1 - rows.discount
    if static.model.known_reward:
        known = jax.vmap(jax.vmap(partial(env.known_reward, hyper)))
        reward = reward - known(obs, rows.action, after)
    if static.model.falls and env.fall_reward is not None:
        reward = reward - fell * env.fall_reward(hyper)
    if static.model.predict_change:
        after = after - obs[..., : env.prop_size]
    columns = [after, reward[..., None] / env.dt] + [fell[..., None]] * static.model.falls
    return jnp.concatenate(columns, axis=-1)


def row_weight(static: Static, rows: Transition, n_real: Int[Array, ""]) -> Float[Array, "N R"]:
    """1 for the rows that the model learns from, else 0."""
    real = (jnp.arange(rows.reward.shape[0]) < n_real)[:, None]
    every = static.model.clean or static.model.falls
    return jnp.where(real, rows.valid if every else rows.discount * (1 - rows.truncation), 0.0)


def examples(
    static: Static, hyper: Hyper, env: Env, rows: Transition, n_real: Int[Array, ""]
) -> Examples:
    """The rows `t < n_real` of a rollout."""
    weight = row_weight(static, rows, n_real)
    x = inputs(env, before_and_after(static, env, rows)[0], rows.action)
    y = targets(static, hyper, env, rows)
    # set to zero, not only weighted by 0: 0 times a number that is not finite is NaN
    x, y = (jnp.where(weight[..., None] > 0, a, 0.0) for a in (x, y))
    return Examples(x=x, y=y, weight=weight, count=n_real)
