"""A training run: `train(config, workdir)`, the loop over chunks of iterations that writes after each.

The method is not here (see `algorithm.py`). Settings are checked before JAX is imported, so a wrong one
fails at once. `train` changes no setting of the process; the commands do, in `devices.own_process`.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dynappo import config as config_lib
from dynappo.program import build, distributed, environment
from dynappo.program.build import Program
from dynappo.train import finish, log
from dynappo.train import workdir as workdir_lib


def train(
    config,
    workdir: str | Path | None = None,
    progress_fn: Callable[[int, dict], None] | None = None,
    env: Any = None,
) -> tuple[Any, dict[str, np.ndarray]]:
    """Train as `config` says; returns `(TrainState, metrics [I])`, `[I, S]` for S seeds.

    With a `workdir`, it is filled, and a run found there is resumed; without, nothing is written.
    `progress_fn(iteration, metrics of that iteration)` is called every `run.log_every` iterations,
    while the device is at the next ones. `env`, a `types.Env` of your own, is trained in place of the
    robot's velocity task (docs/environment.md). Raises ConfigError for settings or an environment that
    cannot be run, FloatingPointError if numbers blow up, OSError where the last checkpoint could not be
    saved.
    """
    config = environment.config_for(config_lib.validate(config), env)
    check(config, env)  # before anything is written
    workdir = None if workdir is None else Path(workdir)
    with workdir_lib.open_workdir(workdir, config) if workdir else contextlib.nullcontext():
        config = workdir_lib.in_step(config, workdir)
        program = build.program(config, env, meanwhile=import_savers)
        state, metrics = loop(config, program, workdir, progress_fn)
        if workdir:
            finish.finish(config, program, workdir, state, metrics, to_stderr)
            finish.check_saved(config, program, workdir, state, metrics, to_stderr)
    return state, metrics


def import_savers() -> None:
    """Import what saves a run: half a second, which costs nothing while XLA compiles."""
    from dynappo.train import checkpoint, nonfinite  # noqa: F401


def to_stderr(text: str) -> None:
    """A line to whoever sits there, where no console was given."""
    print(f"dynappo: {text}", file=sys.stderr)


def check(config, env: Any = None) -> None:
    """ConfigError if this machine, the robot's file, an `env` of one's own or the logs cannot run."""
    log.check_wandb(config)
    build.check(config, env)


def loop(
    config,
    program: Program,
    workdir: Path | None,
    progress_fn=None,
    *,
    should_stop: Callable[[], bool] = lambda: False,
    say: Callable[[str], None] = to_stderr,
):
    """All iterations that are still to do; returns `(state, metrics of every iteration)`.

    Between two chunks it asks `should_stop()`; if so, it saves and returns early. What is written of
    a chunk is written while the device computes the next. Files that cannot be written (a full disk)
    are told to `say`, and training goes on.
    """
    import jax
    import jax.numpy as jnp

    from dynappo.train import checkpoint, nonfinite

    run, state, start, history = config.run, program.state, 0, []
    copy = jax.jit(partial(jax.tree.map, jnp.copy))  # one dispatch, not one an array
    writes = workdir if distributed.first() else None  # of several processes, only one
    with contextlib.ExitStack() as stack:  # also where it is interrupted: a save is finished
        checkpoints, sinks = None, []
        if writes:
            checkpoints = stack.enter_context(checkpoint.opened(writes, say))
        if workdir:
            start, state, history = workdir_lib.resume(config, workdir, checkpoints, state, say)
        if writes:
            sinks = stack.enter_context(log.opened(config, writes, start, say))
        # only the first process has the history, and only there these numbers are written
        (seconds, evaluated), waiting = reached(history), None
        counted = workdir_lib.counted(config, run.num_iterations)
        for first in range(start, run.num_iterations, run.log_every):
            rows, done = slice(first, first + run.log_every), first + run.log_every
            columns = {name: column[rows] for name, column in program.columns.items()}
            before = copy({"env_state": state.env_state, "params_physics": state.params_physics})
            began = time.perf_counter()
            running = program.step(program.hyper, state, columns)  # returns at once
            if waiting:
                tell(*waiting, sinks, progress_fn, say)
            state, metrics = jax.block_until_ready(running)
            took = time.perf_counter() - began
            # copies: else each chunk would keep its buffers of JAX, and the columns of the whole run
            metrics = jax.tree.map(np.array, jax.device_get(metrics))
            metrics |= {name: column[rows].copy() for name, column in counted.items()}
            metrics["seconds"] = seconds + took * np.arange(1, run.log_every + 1) / run.log_every
            seconds += took
            nonfinite.check(metrics, columns, state, before, workdir)
            if run.eval_every and done % run.eval_every == 0:
                metrics |= at_end(program.evaluate(state), run.log_every)
                evaluated = metrics["eval_return"][-1]
            history.append(metrics)
            waiting = (done, metrics)
            stopping = distributed.any_of(should_stop())
            every = run.checkpoint_every and done % run.checkpoint_every == 0
            if workdir and (stopping or every or done == run.num_iterations):
                at = done, state, metrics, evaluated
                workdir_lib.save(config, program.robot, workdir, checkpoints, *at, say)
            if stopping:
                break
        if waiting:
            tell(*waiting, sinks, progress_fn, say)
    return state, log.join(history)


def reached(history) -> tuple[float, Any]:
    """Seconds of the iterations that are done, and their last evaluated return."""
    if not history:
        return 0.0, None
    seconds = history[0].get("seconds", np.zeros(1))
    return float(np.nanmax(seconds, initial=0.0)), log.last_evaluation(history[0])


def tell(done: int, metrics, sinks, progress_fn, say) -> None:
    """Hand a chunk's metrics to every log, and its last row to `progress_fn`."""
    table = log.rows(metrics)
    for sink in sinks:
        log.attempt(sink.name, partial(sink.write, table), say)
    if progress_fn:
        progress_fn(done, {name: value[-1] for name, value in metrics.items()})


def at_end(evaluation: dict, rows: int) -> dict[str, np.ndarray]:
    """Columns `eval_*` `[I]` with the numbers in the last row, NaN above."""
    columns = {}
    for name, value in evaluation.items():
        value = np.asarray(value)
        columns[f"eval_{name}"] = np.full((rows, *value.shape), np.nan)
        columns[f"eval_{name}"][-1] = value
    return columns
