"""The time of each part of an iteration, measured on the program that trains.

The compiled chunk takes the number of real rows and of epochs as arguments. The time of a part is the
difference between two calls of that program.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from dynappo.program import build

FITS = 10  # times the epochs of a fit, to measure one


def measure(config, program, state, repeats: int = 5) -> dict[str, float]:
    """Median ms of `iteration` (as the schedule ends), `physics` and `tail` (a row), `fit`, `ppo`.

    T(rows, epochs) is the time of an iteration.

    - `fit` = (T(N_r, 10) - T(N_r, 0)) / 10 in the last iteration that has one, because one fit can be less
      than a CPU's physics varies
    - `physics` = (T(N) - T(0)) / N without a model. With one, T(0, 0) has N rows of a tail: `tail` is the
      time of one of them, measured by itself, and corrects `physics`
    - `ppo` is the rest: advantages, minibatches, gradient steps

    `tail` and `ppo` are those of one round.
    """
    horizon = config.rollout.horizon
    last = {name: int(column[-1]) for name, column in program.columns.items()}

    def ms(**row):
        times = [iteration(config, program, state, last | row) for _ in range(repeats)]
        return float(np.median(times))

    fitted = "model_epochs" in last
    none = {"model_epochs": 0} if fitted else {}
    none |= {"rounds": 1} if "rounds" in last else {}
    out = {"iteration": ms()}
    all_real, no_real = ms(n_real=horizon, **none), ms(n_real=0, **none)
    # without real rows the same program writes a tail, also where the schedule has ended it
    out["tail"] = _tail_row(program, state) if fitted else 0.0
    out["physics"] = (all_real - no_real) / horizon + out["tail"]
    if fitted and (fits := np.flatnonzero(program.columns["model_epochs"])).size:
        there = {name: int(column[fits[-1]]) for name, column in program.columns.items()}
        many = ms(**there | none | {"model_epochs": FITS * there["model_epochs"]})
        out["fit"] = (many - ms(**there | none)) / FITS
    out["ppo"] = no_real - horizon * out["tail"]
    return out


def iteration(config, program, state, row: dict[str, int]) -> float:
    """ms of an iteration in a chunk whose iterations all have this row of `program.columns`."""
    import jax
    import jax.numpy as jnp

    every = config.run.log_every
    columns = {name: np.full(every, value, np.int32) for name, value in row.items()}
    copy = jax.block_until_ready(jax.tree.map(jnp.copy, state))
    began = time.perf_counter()
    jax.block_until_ready(program.step(program.hyper, copy, columns))
    return (time.perf_counter() - began) / every * 1e3


def _tail_row(program, state, rows: int = 64) -> float:
    """ms of one row that policy and model write, by a loop of `rows` of them."""
    import jax
    import jax.numpy as jnp

    from dynappo import algorithm, fast, rollout
    from dynappo.model import dynamics, memory

    static, env = program.static, program.env

    def write(state, n):
        robots = memory.imagined_index(static, state.robot_index)
        return fast.fill(
            rollout.allocate(env, rows, robots.size),
            begin=jnp.zeros_like(n),
            end=n,
            state=memory.branches(static, dynamics.tail(static, env, state.env_state), axis=0),
            keys=rollout.row_keys(state.key, robots),
            act=algorithm.policy(static, env, state.learner.params),
            step=fast.step(static, program.hyper, env, state.model),
        )[0]

    compiled = jax.jit(write)
    times = []
    for n in (rows, 0) * 4:
        began = time.perf_counter()
        jax.block_until_ready(compiled(state, jnp.int32(n)))
        times.append(time.perf_counter() - began)
    return float(np.median(times[2::2]) - np.median(times[3::2])) / rows * 1e3


def compare(configs, programs, repeats: int) -> dict[str, Any]:
    """ms of an iteration of two configs, alternating, and the second over the first."""

    def last(config, program):
        row = {name: int(column[-1]) for name, column in program.columns.items()}
        return iteration(config, program, program.state, row)

    turns = [list(map(last, configs, programs)) for _ in range(repeats + 1)]
    times = np.array(turns[1:])  # the first warms
    ratio = times[:, 1] / times[:, 0]
    low, middle, high = (float(np.quantile(ratio, q)) for q in (0.0, 0.5, 1.0))
    return {"ms": times.tolist(), "ratio": middle, "ratio_min": low, "ratio_max": high}


def compilation(config) -> dict[str, float]:
    """Seconds of set-up without and with JAX's cache of compiled programs (Warp's kernels are kept)."""
    import tempfile

    import jax
    from jax.experimental.compilation_cache import compilation_cache

    before = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    with tempfile.TemporaryDirectory() as folder:
        jax.config.update("jax_compilation_cache_dir", folder)
        compilation_cache.reset_cache()
        try:
            return {name: build.program(config).compile_seconds for name in ("cold", "warm")}
        finally:
            jax.config.update("jax_compilation_cache_dir", before)
            compilation_cache.reset_cache()
