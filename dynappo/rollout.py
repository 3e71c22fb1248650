"""Fills a rollout's rows `begin <= t < end` with any step function: physics first, then the model.

One `fill` serves both, as in google-deepmind/mctx. A rollout is always `[N, R, ...]`, however many
of its rows are real.

Why a `fori_loop` with a traced bound: XLA compiles physics once for all N_r of the ramp, and the loop
stops after N_r rows. A `scan` with a `cond` inside, or a `switch` over lengths, becomes a `select` once its
predicate is batched, and then computes every row. The bound must never be batched: under `jax.vmap` over
seeds it has `in_axes=None`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, PRNGKeyArray

from dynappo.types import Env, Metrics, Transition


def allocate(env: Env, horizon: int, num_envs: int) -> Transition:
    """N empty rows of R robots."""

    def zeros(*size):
        return jnp.zeros((horizon, num_envs, *size))

    return Transition(
        obs=zeros(env.obs_size),
        prop=zeros(env.prop_size),
        action=zeros(env.action_size),
        action_mean=zeros(env.action_size),
        log_prob=zeros(),
        value=zeros(),
        reward=zeros(),
        discount=zeros(),
        truncation=zeros(),
        next_obs=zeros(env.obs_size),
        next_prop=zeros(env.prop_size),
        valid=zeros(),
        episode_return=zeros(),
        episode_length=zeros(),
    )


def row_keys(key: PRNGKeyArray, robot_index: Int[Array, " R"]) -> Callable[..., PRNGKeyArray]:
    """`t -> key [R]`: random numbers depend on the row and the robot's global index only."""

    def keys(t):
        return jax.vmap(jax.random.fold_in, (None, 0))(jax.random.fold_in(key, t), robot_index)

    return keys


def write(rows: Any, t: Int[Array, ""], row: Any) -> Any:
    """`rows` with `row` as its row t."""
    return jax.tree.map(lambda every, one: every.at[t].set(one), rows, row)


def fill(
    rows: Any,
    begin: Int[Array, ""],
    end: Int[Array, ""],
    state: Any,
    keys: Callable[..., PRNGKeyArray],
    *,
    act: Callable,
    step: Callable,
    metrics: tuple[str, ...] = (),
    write: Callable = write,
) -> tuple[Any, Any, Metrics]:
    """Write rows `begin <= t < end`; returns `(rows, state after the last row, sums)`.

    `act(state, keys) -> action, action_mean, log_prob, value` and `step(state, action, keys) ->
    state, Outcome` work on all R robots. Only `.obs` and `.prop` of `state` are read here. `sums`
    are the outcomes' `metrics`, summed over these rows and all robots. `write(rows, t, row) -> rows` is
    an argument for fast.py, which groups a row's fields.
    """

    def one_row(t, carry):
        rows, state, sums = carry
        key = keys(t)
        action, action_mean, log_prob, value = act(state, key)
        next_state, outcome = step(state, action, key)
        row = Transition(
            obs=state.obs,
            prop=state.prop,
            action=action,
            action_mean=action_mean,
            log_prob=log_prob,
            value=value,
            reward=outcome.reward,
            discount=outcome.discount,
            truncation=outcome.truncation,
            next_obs=outcome.next_obs,
            next_prop=outcome.next_prop,
            valid=outcome.valid,
            episode_return=outcome.episode_return,
            episode_length=outcome.episode_length,
        )
        sums = {name: sums[name] + outcome.metrics[name] for name in metrics}
        return write(rows, t, row), next_state, sums

    # sums of each robot [R]; over robots once, after the loop: on several devices that is a message
    sums = {name: jnp.zeros(len(state.obs)) for name in metrics}
    rows, state, sums = jax.lax.fori_loop(begin, end, one_row, (rows, state, sums))
    return rows, state, {name: total.sum() for name, total in sums.items()}
