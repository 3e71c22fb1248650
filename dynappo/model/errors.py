"""The transition model's error on rows it has not seen, after one prediction and after several."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from dynappo.model import dynamics, examples, moments
from dynappo.types import Env, Hyper, Metrics, ModelState, Static, Transition


def unroll(static: Static, hyper: Hyper, env: Env, model: ModelState, rows: Transition, steps: int):
    """`steps` next props [K, R, P], each predicted from the one before, from row 0 with the actions
    taken; and [K, R], 1 where the robot's episode had not ended by then."""

    def advance(obs, action):
        obs = dynamics.predict(static, hyper, env, model, obs, action)[0]
        return obs, obs[:, : env.prop_size]

    start = examples.before_and_after(static, env, rows)[0][0]
    _, predicted = jax.lax.scan(advance, start, rows.action[:steps])
    alive = jnp.cumprod(rows.discount[:steps] * (1 - rows.truncation[:steps]), axis=0)
    return predicted, alive


def errors(
    static: Static, hyper: Hyper, env: Env, model: ModelState, rows: Transition, steps: int
) -> Metrics:
    """Error after 1 and after `steps` predictions, relative to predicting no change.

    Root mean square over robots and predicted numbers, each divided by its standard deviation; 1 is
    the error of predicting no change. Call it before a fit, when the rows are new to the model.
    """
    size, out = env.prop_size, {}
    std = moments.scale(model.inputs)[1][:size]
    obs, after = examples.before_and_after(static, env, rows)
    predicted, alive = unroll(static, hyper, env, model, rows, steps)
    for k in {0, steps - 1}:
        truth, still = after[k], obs[0, :, :size]
        wrong, change = (
            jnp.where(alive[k, :, None] > 0, ((x - truth) / std) ** 2, 0.0).sum()
            for x in (predicted[k], still)
        )
        out[f"model_error_{k + 1}"] = jnp.sqrt(wrong / jnp.maximum(change, 1e-12))
    return out
