"""The time of each part of an iteration, measured on the program that trains.

The compiled chunk takes the number of real rows and of epochs as arguments, so the parts are
differences between calls of the same program: the times they take inside it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from dynappo.program import build
from dynappo.tasks.velocity import observe

# TFLOP/s of dense matrix products by precision, and TB/s of memory: NVIDIA's data sheets (SXM)
PEAKS = {
    "H200": {"highest": 67, "tf32": 495, "bfloat16": 989, "memory": 4.8},
    "H100": {"highest": 67, "tf32": 495, "bfloat16": 989, "memory": 3.35},
    "A100": {"highest": 19.5, "tf32": 156, "bfloat16": 312, "memory": 2.0},
}
# reads and writes of each activation, forward and backward (experiments/03_speed/ppo.md)
JOINTS = 12  # of every bundled robot
PASSES = 10
FITS = 10  # times the epochs of a fit, to measure one


def measure(config, program, state, repeats: int = 5) -> dict[str, float]:
    """Median ms of `iteration` (as the schedule ends), `physics` and `tail` (a row), `fit`, `ppo`.

    With T(rows, epochs) the time of an iteration: `fit` = (T(N_r, 10 epochs) - T(N_r, 0)) / 10 at the
    last N_r, because one fit can be less than a CPU's physics varies; without a model `physics` =
    (T(N) - T(0)) / N. With one, T(0, 0) has N tail rows: their cost is measured by itself (`tail`, one
    row), and `physics` is corrected by it. `ppo` is the rest: advantages, minibatches, gradient steps.
    `tail` and `ppo` are those of one round.
    """
    import jax
    import jax.numpy as jnp

    every, horizon = config.run.log_every, config.rollout.horizon
    last = {name: int(column[-1]) for name, column in program.columns.items()}

    def ms(n_real, epochs, rounds=1):
        columns: dict[str, Any] = {"iteration": np.arange(1, every + 1)}
        columns["n_real"] = np.full(every, n_real)
        if "model_epochs" in last:
            columns["model_epochs"] = np.full(every, epochs)
        if "rounds" in last:
            columns["rounds"] = np.full(every, rounds)
        columns = {name: jnp.asarray(column, jnp.int32) for name, column in columns.items()}
        times = []
        for _ in range(repeats):
            copy = jax.block_until_ready(jax.tree.map(jnp.copy, state))
            began = time.perf_counter()
            jax.block_until_ready(program.step(program.hyper, copy, columns))
            times.append((time.perf_counter() - began) / every * 1e3)
        return float(np.median(times))

    epochs = last.get("model_epochs", 0)
    out = {"iteration": ms(last["n_real"], epochs, last.get("rounds", 1))}
    full, none = ms(horizon, 0), ms(0, 0)
    # without real rows the same program writes a tail, also where the schedule has ended it
    out["tail"] = _tail_row(program, state) if "model_epochs" in last else 0.0
    out["physics"] = (full - none) / horizon + out["tail"]
    if epochs:
        many = ms(last["n_real"], FITS * epochs)
        out["fit"] = (many - ms(last["n_real"], 0)) / FITS
    out["ppo"] = none - horizon * out["tail"]
    return out


def _tail_row(program, state, rows: int = 64) -> float:
    """ms of one row that policy and model write, by a loop of `rows` of them."""
    import jax
    import jax.numpy as jnp

    from dynappo import algorithm, fast, rollout
    from dynappo.model import dynamics

    static, env = program.static, program.env

    def write(state, n):
        return fast.fill(
            rollout.allocate(env, rows, state.robot_index.size),
            jnp.zeros_like(n),
            n,
            dynamics.tail(static, env, state.env_state),
            rollout.row_keys(state.key, state.robot_index),
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


def last_iteration(config, program) -> Callable[[], float]:
    """A function that runs one chunk as the schedule ends, from the first state, and gives ms of an
    iteration."""
    import jax
    import jax.numpy as jnp

    every, first = config.run.log_every, program.state
    columns = {
        name: jnp.full(every, column[-1], jnp.int32) for name, column in program.columns.items()
    }

    def run():
        copy = jax.block_until_ready(jax.tree.map(jnp.copy, first))
        began = time.perf_counter()
        jax.block_until_ready(program.step(program.hyper, copy, columns))
        return (time.perf_counter() - began) / every * 1e3

    return run


def work(config, last: dict[str, int]) -> dict[str, np.ndarray]:
    """`[floating-point operations, bytes]` of the model's fit and of the PPO update in an iteration.

    `last` is a row of `schedule.columns`. Six operations a weight and row, two forward and four for the
    gradients, but for the first layer, whose input has none. Bytes are those of activations, which
    pass through memory once a kernel: `PASSES` times.
    """
    action, prop, obs = JOINTS, observe.prop_size(JOINTS), observe.size(JOINTS)
    ppo, model = config.ppo, config.model

    def of(sizes, rows, width):
        weights = [a * b for a, b in zip(sizes, sizes[1:], strict=False)]
        flops = (6.0 * sum(weights) - 2.0 * weights[0]) * rows
        return np.array([flops, PASSES * width * sum(sizes[1:-1]) * rows])

    rows = ppo.epochs * config.rollout.num_envs * config.rollout.horizon
    width = 2 if ppo.precision == "bfloat16" else 4
    actor, critic = (of((obs, *ppo.hidden, end), rows, width) for end in (action, 1))
    out = {"ppo": actor + critic}
    if last.get("model_epochs"):  # 0: the last rows are physics alone
        drawn = config.rollout.horizon // model.minibatches
        steps = -(-last["model_epochs"] * last["n_real"] // drawn)
        rows = steps * drawn * config.rollout.num_envs
        width = 2 if model.precision == "bfloat16" else 4
        end = prop + 1 + model.falls
        out["fit"] = of((obs + action, *model.hidden, end), rows, width)
    return out


def shares(config, device: str, last: dict[str, int], ms: dict[str, float]) -> dict[str, float]:
    """Of the device's limits in arithmetic and in memory, what fit and PPO reach; {} if not known."""
    peak = next((p for name, p in PEAKS.items() if name in device), None)
    out: dict[str, float] = {}
    if peak is None:
        return out
    for part, (flops, size) in work(config, last).items():
        group = config.ppo if part == "ppo" else config.model
        out[f"{part}_arithmetic"] = flops / (ms[part] * 1e-3) / (peak[group.precision] * 1e12)
        out[f"{part}_memory"] = size / (ms[part] * 1e-3) / (peak["memory"] * 1e12)
    return out


def compare(configs, programs, repeats: int) -> dict[str, Any]:
    """ms of an iteration of two configs, alternating, and the second over the first."""
    runs = [last_iteration(c, p) for c, p in zip(configs, programs, strict=True)]
    times = np.array([[run() for run in runs] for _ in range(repeats + 1)])[1:]  # the first warms
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
