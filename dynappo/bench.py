"""Where the time of an iteration goes: `phases` measures each part on the run's own program.

The compiled chunk takes the number of real rows and of epochs as arguments, so the parts come out as
differences between calls of one and the same program, as they run inside it.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np


def phases(config, program, state, repeats: int = 5) -> dict[str, float]:
    """Median ms of `iteration` (as the schedule ends), `physics` and `tail` (a row), `fit`, `ppo`.

    With T(rows, epochs) the time of an iteration: `fit` = T(N_r, epochs) - T(N_r, 0) at the last
    N_r; without a model `physics` = (T(N) - T(0)) / N. With one, T(0, 0) has N tail rows: their
    cost is measured by itself (`tail`, one row), and `physics` is corrected by it. `ppo` is the
    rest: advantages, minibatches, 5 x 4 gradient steps.
    """
    import jax
    import jax.numpy as jnp

    every, horizon = config.run.log_every, config.rollout.horizon
    last = {name: int(column[-1]) for name, column in program.columns.items()}

    def ms(n_real, epochs):
        columns: dict[str, Any] = {"iteration": np.arange(1, every + 1)}
        columns["n_real"] = np.full(every, n_real)
        if "model_epochs" in last:
            columns["model_epochs"] = np.full(every, epochs)
        columns = {name: jnp.asarray(column, jnp.int32) for name, column in columns.items()}
        times = []
        for _ in range(repeats):
            copy = jax.block_until_ready(jax.tree.map(jnp.copy, state))
            began = time.perf_counter()
            jax.block_until_ready(program.step(program.hyper, copy, columns))
            times.append((time.perf_counter() - began) / every * 1e3)
        return float(np.median(times))

    epochs = last.get("model_epochs", 0)
    out = {"iteration": ms(last["n_real"], epochs)}
    full, none = ms(horizon, 0), ms(0, 0)
    out["tail"] = _tail_row(program, state) if epochs else 0.0
    out["physics"] = (full - none) / horizon + out["tail"]
    if epochs:
        out["fit"] = out["iteration"] - ms(last["n_real"], 0)
    out["ppo"] = none - horizon * out["tail"]
    return out


def _tail_row(program, state, rows: int = 64) -> float:
    """ms of one row that policy and model write, by a loop of `rows` of them."""
    import jax
    import jax.numpy as jnp

    from dynappo import algorithm, dynamics, rollout

    static, env = program.static, program.env

    def write(state, n):
        return rollout.fill(
            rollout.allocate(env, rows, state.robot_index.size),
            jnp.zeros_like(n),
            n,
            dynamics.TailState(obs=state.env_state.obs),
            rollout.row_keys(state.key, state.robot_index),
            act=algorithm.policy(static.ppo, state.learner.params),
            step=partial(dynamics.step, static.model, env, state.model),
        )[0]

    compiled = jax.jit(write)
    times = []
    for n in (rows, 0) * 4:
        began = time.perf_counter()
        jax.block_until_ready(compiled(state, jnp.int32(n)))
        times.append(time.perf_counter() - began)
    return float(np.median(times[2::2]) - np.median(times[3::2])) / rows * 1e3
