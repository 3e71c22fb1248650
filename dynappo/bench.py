"""Where the time of an iteration goes: `python -m dynappo.bench --config=configs/go1.py:fast`.

`phases` measures each part on the run's own program; `--vs=CONFIG` lets two configs take turns in one
process, so that what else the machine does meets both, and gives the ratio of their iterations.

The compiled chunk takes the number of real rows and of epochs as arguments, so the parts come out as
differences between calls of one and the same program, as they run inside it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dynappo import config as config_lib
from dynappo import flags, log, observe, versions
from dynappo.config import ConfigError

# TFLOP/s of dense matrix products by precision, and TB/s of memory: NVIDIA's data sheets (SXM)
PEAKS = {
    "H200": {"highest": 67, "tf32": 495, "bfloat16": 989, "memory": 4.8},
    "H100": {"highest": 67, "tf32": 495, "bfloat16": 989, "memory": 3.35},
    "A100": {"highest": 19.5, "tf32": 156, "bfloat16": 312, "memory": 2.0},
}
# reads and writes of each activation, forward and backward (experiments/03_speed/ppo.md)
PASSES = 10


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

    from dynappo import algorithm, dynamics, model_rows, rollout

    static, env = program.static, program.env
    carried = model_rows.carried_size(static.model, env)

    def write(state, n):
        return rollout.fill(
            rollout.allocate(env, rows, state.robot_index.size, carried),
            jnp.zeros_like(n),
            n,
            dynamics.tail(static.model, env, state.env_state, state.params_physics),
            rollout.row_keys(state.key, state.robot_index),
            act=algorithm.policy(static.ppo, state.learner.params),
            step=algorithm.model_step(env, program.hyper.task, state.model, static=static),
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


def report(config, program, repeats: int) -> dict[str, Any]:
    """Phases (ms), rates (1/s), bytes in use at most, and seconds of set-up of one config."""
    import jax

    ms = phases(config, program, program.state, repeats)
    real = int(program.columns["n_real"][-1]) * config.rollout.num_envs
    stats = jax.devices()[0].memory_stats() or {}
    return {
        "ms": ms,
        "iterations_per_second": 1e3 / ms["iteration"],
        "control_steps_per_second": real * 1e3 / ms["iteration"],
        "physics_steps_per_second": real * config.physics.substeps * 1e3 / ms["iteration"],
        "peak_bytes": stats.get("peak_bytes_in_use"),
        "shares": shares(
            config, program.device, {n: int(c[-1]) for n, c in program.columns.items()}, ms
        ),
        "setup_seconds": program.compile_seconds,
        "device": program.device,
        "impl": program.impl,
        "commit": versions.commit(),
    }


def work(config, last: dict[str, int]) -> dict[str, np.ndarray]:
    """`[floating-point operations, bytes]` of the model's fit and of the PPO update in an iteration.

    `last` is a row of `schedule.columns`. Six operations a weight and row, two forward and four for the
    gradients, but for the first layer, whose input has none. Bytes are those of activations, which
    pass through memory once a kernel: `PASSES` times.
    """
    action, prop = observe.CONTEXT_SIZE - 3, observe.PROP_SIZE
    obs, ppo, model = prop + observe.CONTEXT_SIZE, config.ppo, config.model

    def of(sizes, rows, width):
        weights = [a * b for a, b in zip(sizes, sizes[1:], strict=False)]
        flops = (6.0 * sum(weights) - 2.0 * weights[0]) * rows
        return np.array([flops, PASSES * width * sum(sizes[1:-1]) * rows])

    rows = ppo.epochs * config.rollout.num_envs * config.rollout.horizon
    width = 2 if ppo.precision == "bfloat16" else 4
    actor, critic = (of((obs, *ppo.hidden, end), rows, width) for end in (action, 1))
    out = {"ppo": actor + critic}
    if "model_epochs" in last:
        drawn = config.rollout.horizon // model.minibatches
        rows = last["model_epochs"] * (last["n_real"] // drawn) * drawn * config.rollout.num_envs
        width = 2 if model.precision == "bfloat16" else 4
        end = prop + 1 + model.falls
        out["fit"] = model.ensemble * of((obs + action, *model.hidden, end), rows, width)
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


def compilation(config) -> dict[str, float]:
    """Seconds of set-up without and with JAX's cache of compiled programs (Warp's kernels are kept)."""
    import tempfile

    import jax
    from jax.experimental.compilation_cache import compilation_cache

    from dynappo import train

    before, out = os.environ.get("JAX_COMPILATION_CACHE_DIR"), {}
    with tempfile.TemporaryDirectory() as folder:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = folder  # train.setup then leaves it alone
        jax.config.update("jax_compilation_cache_dir", folder)
        compilation_cache.reset_cache()
        try:
            out = {name: train.setup(config).compile_seconds for name in ("cold", "warm")}
        finally:
            compilation_cache.reset_cache()
            jax.config.update("jax_compilation_cache_dir", before)
            os.environ.pop("JAX_COMPILATION_CACHE_DIR")
            if before is not None:
                os.environ["JAX_COMPILATION_CACHE_DIR"] = before
    return out


def compare(configs, programs, repeats: int) -> dict[str, Any]:
    """ms of an iteration of two configs that take turns, and the second over the first."""
    runs = [last_iteration(c, p) for c, p in zip(configs, programs, strict=True)]
    times = np.array([[run() for run in runs] for _ in range(repeats + 1)])[1:]  # the first warms
    ratio = times[:, 1] / times[:, 0]
    low, middle, high = (float(np.quantile(ratio, q)) for q in (0.0, 0.5, 1.0))
    return {"ms": times.tolist(), "ratio": middle, "ratio_min": low, "ratio_max": high}


def parse(argv: list[str] | None):
    """`(configs, names, repeats, out, compile)` of a command line."""
    parser = flags.parser(
        "bench",
        "Time of each phase of a training iteration, on the program that trains.",
        "--config.GROUP.FIELD=VALUE sets a field of both configs, as in dynappo.train",
    )
    parser.add_argument("--config", metavar="FILE.py[:VARIANT]")
    parser.add_argument("--vs", metavar="FILE.py[:VARIANT]", help="take turns with this one")
    parser.add_argument("--repeats", type=int, default=5, help="medians of so many; default: 5")
    parser.add_argument(
        "--compile", action="store_true", help="time the set-up too, with cold and warm caches"
    )
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="write all numbers there")
    known, rest = flags.read_known(parser, argv)
    if known.repeats < 1:
        raise ConfigError(f"--repeats is {known.repeats}, expected 1 or more")
    if known.out:  # before minutes of measuring
        flags.check_writable(known.out)
    names = [known.config, known.vs] if known.vs else [known.config]
    configs = []
    for name in names:
        config = flags.load(name, rest)
        config.run.update(num_seeds=1, mesh_seed=1)
        config.schedule.by_error = False  # it would choose other numbers of rows than are asked for
        configs.append(config_lib.validate(config))
    return configs, names, known.repeats, known.out, known.compile


def show(names, reports, versus) -> None:
    """Print a column a config."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0))
    for title in ("", *names):
        table.add_column(title, justify="right" if title else "left")
    rows = {}
    for name in ("iteration", "physics", "tail", "fit", "ppo"):
        unit = "ms a row" if name in ("physics", "tail") else "ms"
        rows[f"{name}, {unit}"] = [
            f"{r['ms'][name]:.2f}" if name in r["ms"] else "" for r in reports
        ]
    for name, scale, digits, label in (
        ("iterations_per_second", 1, 2, "iterations/s"),
        ("control_steps_per_second", 1, 0, "control steps/s"),
        ("physics_steps_per_second", 1, 0, "physics steps/s"),
        ("peak_bytes", 2**-30, 2, "memory at most, GiB"),
        ("setup_seconds", 1, 1, "set-up, s"),
    ):
        rows[label] = [f"{r[name] * scale:,.{digits}f}" if r[name] else "" for r in reports]
    for part in ("fit", "ppo"):
        for kind in ("arithmetic", "memory"):
            cells = [r["shares"].get(f"{part}_{kind}") for r in reports]
            if any(cells):
                label = f"{part}, share of the limit in {kind}"
                rows[label] = [f"{100 * share:.0f} %" if share else "" for share in cells]
    for name in ("cold", "warm"):
        if "compilation" in reports[0]:
            rows[f"set-up, {name} cache, s"] = [f"{r['compilation'][name]:.1f}" for r in reports]
    for label, cells in rows.items():
        table.add_row(label, *cells)
    out = Console(highlight=False)
    out.print(f"{reports[0]['device']}, MJX-{reports[0]['impl']}")
    out.print(table)
    if versus:
        out.print(
            f"an iteration of {names[1]} takes {versus['ratio']:.3f} of one of {names[0]} "
            f"({versus['ratio_min']:.3f} to {versus['ratio_max']:.3f}, taking turns)"
        )


def run(configs, names, repeats: int, out: Path | None, compile: bool) -> None:
    """Measure each config, show what came out, and write it if asked."""
    from dynappo import train

    for config in configs:
        train.check(config)
    programs = [train.setup(config) for config in configs]
    reports = [report(c, p, repeats) for c, p in zip(configs, programs, strict=True)]
    for config, found in zip(configs, reports, strict=True):
        if compile:
            found["compilation"] = compilation(config)
    versus = compare(configs, programs, repeats) if len(configs) == 2 else None
    show(names, reports, versus)
    if out:
        log.write_json(out, {"configs": dict(zip(names, reports, strict=True)), "versus": versus})
        print(out)


def main(argv: list[str] | None = None) -> None:
    """The command; its exit statuses are those of `flags.answer`."""
    flags.answer(lambda: run(*parse(argv)))


if __name__ == "__main__":
    main()
