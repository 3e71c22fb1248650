"""Metrics of an iteration: finished episodes, the tail, means over its real rows."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from dynappo.types import Metrics, TrainState, Transition

RETURNS = 100  # finished episodes in the mean return, as in rsl_rl's on_policy_runner


def finished(state: TrainState, rows: Transition, n_real):
    """`(returns, lengths)` of the last `RETURNS` episodes that physics finished, newest last."""
    ended = _ended(rows, n_real).reshape(-1)
    # the place of each finished episode among old and new ones; the last RETURNS are kept
    slot = RETURNS + jnp.cumsum(ended) - 1 - ended.sum()
    slot = jnp.where(ended & (slot >= 0), slot, RETURNS)  # out of bounds: dropped

    def push(ring, values):
        padded = jnp.concatenate([ring, jnp.full_like(ring, jnp.nan)])
        start = jnp.minimum(ended.sum(), RETURNS)
        kept = jax.lax.dynamic_slice(padded, (start,), (RETURNS,))
        return kept.at[slot].set(values.reshape(-1), mode="drop")

    return push(state.returns, rows.episode_return), push(state.lengths, rows.episode_length)


def of_episodes(rows: Transition, n_real) -> Metrics:
    """`episodes` that physics finished in this iteration, and the sum of their returns.

    Why this and not `finished` alone: after the falls of the first iterations all episodes start at
    about the same time, and most end together, one episode length later. Until then the last 100
    are the few that fell. The mean over all episodes that end within one episode length
    (run/finish.py) has no such bias.
    """
    ended = _ended(rows, n_real)
    total = jnp.where(ended, rows.episode_return, 0.0).sum()
    return {"episodes": ended.sum(), "episode_return_sum": total}


def _ended(rows: Transition, n_real):
    real = (jnp.arange(rows.reward.shape[0]) < n_real)[:, None]
    return real & ((rows.discount == 0) | (rows.truncation == 1))


def nonfinite_robot(rows: Transition, real) -> Int[Array, ""]:
    """Index of the first robot with a `real` row whose reward or observation is not finite; or -1.

    The host stops a run when a loss is not finite, and reports this robot. Rows of the tail come
    from the model and say nothing about a robot.
    """
    good = ~real | (jnp.isfinite(rows.reward) & jnp.isfinite(rows.next_obs).all(-1))
    bad = ~good.all(axis=0)
    return jnp.where(bad.any(), jnp.argmax(bad), -1)


def of_tail(rows: Transition, real, dt) -> Metrics:
    """`tail_bias`, mean reward of synthetic minus real rows (1/s); `tail_falls`, as predicted."""
    tail, num_envs = 1.0 - real, rows.reward.shape[1]
    mean = [
        (rows.reward * part).sum() / jnp.maximum(part.sum() * num_envs, 1) for part in (tail, real)
    ]
    bias = jnp.where(tail.any(), (mean[0] - mean[1]) / dt, 0.0)
    return {"tail_bias": bias, "tail_falls": ((1 - rows.discount) * tail).sum()}


def of_rows(sums: Metrics, count) -> Metrics:
    """Sums over `count` real rows -> means; squared errors -> root mean squares; events stay counts."""
    out = {}
    for name, total in sums.items():
        if name in ("falls", "timeouts", "blowups", "crossings"):
            out[name] = total
        elif name.endswith("_error_sq"):
            out[name.removesuffix("_sq")] = jnp.sqrt(total / count)
        else:
            out[name] = total / count
    return out
