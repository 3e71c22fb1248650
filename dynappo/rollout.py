"""Fills a rollout's rows [lo, hi) with any step function: physics first, then the model.

One `fill` serves both, as in google-deepmind/mctx. The buffer is always `[N, R, ...]`, however many
of its rows are real.

Why a `fori_loop` with a traced bound: physics is compiled once for every N_r of the ramp, and the
loop stops after N_r rows. A `scan` with a `cond` inside, or a `switch` over lengths, becomes a
`select` once its predicate is batched, and then computes every row. So the bound must never be
batched: under `jax.vmap` over seeds it has `in_axes=None`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, PRNGKeyArray

from dynappo.types import Env, Metrics, Outcome, Transition

MADE = "action", "action_mean", "log_prob", "value"  # of a row, by `act`
# a row's fields of one number a robot, which are written together
NUMBERS = "log_prob value reward discount truncation valid episode_return episode_length".split()
# the fields of an Outcome that a row keeps
TOLD = [field.name for field in dataclasses.fields(Outcome) if field.name != "metrics"]


def allocate(env: Env, horizon: int, num_envs: int) -> Transition:
    """An empty buffer of N rows of R robots."""
    sizes = 0, env.obs_size, env.prop_size, env.action_size
    one, obs, prop, action = (jnp.zeros((horizon, num_envs, *[n] * (n > 0))) for n in sizes)
    told = dict.fromkeys(TOLD, one) | {"next_obs": obs, "next_prop": prop}
    made = dict(zip(MADE, (action, action, one, one), strict=True))
    return Transition(obs=obs, prop=prop, **told, **made)


def row_keys(key: PRNGKeyArray, robot_index: Int[Array, " R"]) -> Callable[..., PRNGKeyArray]:
    """`t -> key [R]`: random numbers depend on the row and the robot's global index only."""

    def keys(t):
        return jax.vmap(jax.random.fold_in, (None, 0))(jax.random.fold_in(key, t), robot_index)

    return keys


def fill(
    buffer: Transition,
    lo: Int[Array, ""],
    hi: Int[Array, ""],
    state: Any,
    keys: Callable[..., PRNGKeyArray],
    *,
    act: Callable,
    step: Callable,
    metrics: tuple[str, ...] = (),
) -> tuple[Transition, Any, Metrics]:
    """Write rows `lo <= t < hi`; returns `(buffer, state after the last row, sums)`.

    `act(state, keys) -> action, action_mean, log_prob, value` and `step(state, action, keys) ->
    state, Outcome` work on all R robots. Only `.obs` and `.prop` of `state` are read here. `sums`
    are the outcomes' `metrics`, summed over these rows and all robots.
    """

    def row(t, carry):
        buffer, state, sums = carry
        key = keys(t)
        made = dict(zip(MADE, act(state, key), strict=True))
        next_state, outcome = step(state, made["action"], key)
        told = {name: getattr(outcome, name) for name in TOLD}
        transition = Transition(obs=state.obs, prop=state.prop, **made, **told)
        write = "promise_in_bounds"  # t is a row, so XLA need not ask
        buffer = jax.tree.map(lambda b, x: b.at[t].set(x, mode=write), buffer, grouped(transition))
        sums = {name: sums[name] + outcome.metrics[name] for name in metrics}
        return buffer, next_state, sums

    # summed over robots once, after the loop: on several devices each sum is a message
    sums = {name: jnp.zeros(buffer.reward.shape[1]) for name in metrics}
    written, state, sums = jax.lax.fori_loop(lo, hi, row, (grouped(buffer), state, sums))
    numbers = dict(zip(NUMBERS, jnp.moveaxis(written[0], 1, 0), strict=True))
    buffer = Transition(**numbers, **written[1])
    return buffer, state, {name: total.sum() for name, total in sums.items()}


def grouped(rows: Transition) -> tuple[Array, dict[str, Array]]:
    """The one-number fields as one array `[..., 8, R]`, and the others: a row is 7 writes, not 14."""
    fields = {name: getattr(rows, name) for name in Transition.__dataclass_fields__}
    return jnp.stack([fields.pop(name) for name in NUMBERS], -2), fields
