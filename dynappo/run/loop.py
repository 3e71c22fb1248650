"""The one loop over chunks of iterations, of one run or of several that share a program.

The device computes a chunk (`run.log_every` iterations) in one call. The host writes a chunk's rows of
metrics.csv while the device computes the next chunk; where a checkpoint is due, it writes them before that.
So no checkpoint covers an iteration whose row is not in metrics.csv, and a run that is killed between the
two lacks no row.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from dynappo.config import terms
from dynappo.program import distributed
from dynappo.program.build import Program
from dynappo.run import blowups, log, merged, overflow
from dynappo.run import workdir as workdir_lib
from dynappo.run.workdir import OpenRun


def loop(
    runs: list[OpenRun],
    program: Program,
    state: Any,
    start: int,
    *,
    stop: Any,
    progress: Callable[[int, list[dict]], None],
    blown_up: Callable[[OpenRun, int, FloatingPointError], None],
    say: Callable[[str], None],
) -> tuple[Any, list[int]]:
    """All iterations after `start`; returns `(state, numbers of the runs that are still good)`.

    `state` holds all runs, as `merged.join` makes it; its buffers are donated. Each run's metrics are
    appended to its `history`. `progress(iteration, last metrics of each good run)` is called after each
    chunk, while the device computes the next. If `stop.status` is set after a chunk, in any process, the runs
    are saved and the loop ends. A run whose numbers are not finite is passed to `blown_up`, and left out from
    then on. Files that cannot be written (a full disk) are reported to `say`, and training goes on.
    """
    import jax
    import jax.numpy as jnp

    from dynappo.run import nonfinite

    run, good = runs[0].config.run, list(range(len(runs)))
    part = partial(merged.part, runs=len(runs), seeds=run.num_seeds)
    copy = jax.jit(partial(jax.tree.map, jnp.copy))  # one dispatch, not one an array
    seconds = max(seconds_so_far(one) for one in runs)
    scheduled = workdir_lib.scheduled_columns(runs[0].config, run.num_iterations)
    told = set()  # runs whose physics blow up now and then
    later: list[Callable[[], None]] = []  # what is done while the device computes
    for first in range(start, run.num_iterations, run.log_every):
        rows, done = slice(first, first + run.log_every), first + run.log_every
        columns = {name: column[rows] for name, column in program.columns.items()}
        before = copy({"env_state": state.env_state, "params_physics": state.params_physics})
        began = time.perf_counter()
        running = program.step(program.hyper, state, columns)  # returns at once
        for action in later:
            action()
        state, metrics = jax.block_until_ready(running)
        took = time.perf_counter() - began
        # copies: else each chunk would keep its buffers of JAX, and the columns of the whole run
        metrics = jax.tree.map(np.array, jax.device_get(metrics))
        shared = {name: column[rows].copy() for name, column in scheduled.items()}
        shared["seconds"] = seconds + took * np.arange(1, run.log_every + 1) / run.log_every
        seconds += took
        chunks = {i: part(metrics, i, axis=1) | shared for i in good}
        networks = {"learner": state.learner, "model": state.model}
        for i in good:
            try:
                was = partial(part, before, i)
                own = terms.of(runs[i].config.task)
                nonfinite.check(chunks[i], columns, part(networks, i), was, runs[i].workdir, own)
                overflow.check(chunks[i])
                line = blowups.check(chunks[i], runs[i].config.rollout.num_envs)
                if line and i not in told:  # once a run
                    told.add(i)
                    say(line)
                for line in of_own_terms(chunks[i], runs[i].config) if first == 0 else ():
                    say(line)
            except FloatingPointError as error:
                blown_up(runs[i], done, error)
                del chunks[i]
        good = list(chunks)
        if not good:
            break
        if run.eval_every and done % run.eval_every == 0:
            evaluation = program.evaluate(state)
            for i, chunk in chunks.items():
                chunk |= in_last_row(part(evaluation, i), run.log_every)
        for i, chunk in chunks.items():
            runs[i].history.append(chunk)
        write = partial(write_rows, [(runs[i], chunk) for i, chunk in chunks.items()], say)
        report = partial(progress, done, [last_row(chunk) for chunk in chunks.values()])
        later = [write, report]
        stopping = distributed.any_of(bool(stop.status))
        every = run.checkpoint_every and done % run.checkpoint_every == 0
        if stopping or every or done == run.num_iterations:
            write()
            later = [report]
            for i in good:
                if runs[i].workdir:
                    workdir_lib.save(runs[i], program.robot, part(state, i), say)
        if stopping:
            break
    for action in later:
        action()
    return state, good


def of_own_terms(chunk: dict[str, np.ndarray], config) -> list[str]:
    """Lines on terms of one's own that did what nobody asks for in a run's first chunk."""
    return [line for line in (unpaid(chunk, config), always_ending(chunk, config)) if line]


def always_ending(chunk: dict[str, np.ndarray], config) -> str:
    """A line on terminations of one's own that ended every row of a run's first chunk; "" without any."""
    own, none = [f"ended_{name}" for name in terms.of(config.task).terminations], np.zeros(1)
    every = [name for name in own if (chunk.get(name, none) >= 1 - 1e-6).all()]
    if not every:
        return ""
    return (
        f"{', '.join(every)} is 1 in every row so far: each episode ends with its first row, and nothing "
        "can be learned; docs/task.md has unit and zero of what terms ask for"
    )


def unpaid(chunk: dict[str, np.ndarray], config) -> str:
    """A line on reward terms of one's own that were 0 in every row of a run's first chunk; "" without any."""
    weights, none = config.task.weights, np.ones(1)
    own = [f"reward_{name}" for name in terms.of(config.task).rewards if weights[name]]
    zero = [name for name in own if not chunk.get(name, none).any()]
    if not zero:
        return ""
    return f"{', '.join(zero)} is 0 in every row so far; docs/task.md has unit and zero of what terms ask for"


def seconds_so_far(run: OpenRun) -> float:
    """Seconds of training in the iterations that are done."""
    if not run.history:
        return 0.0
    # only the first process has read them, and only there they are written
    return float(np.nanmax(run.history[0].get("seconds", np.zeros(1)), initial=0.0))


def write_rows(chunks: list[tuple[OpenRun, dict]], say: Callable[[str], None]) -> None:
    """Hand each run's chunk to all of its logs."""
    for run, chunk in chunks:
        if run.sinks:
            workdir_lib.check_held(run.workdir)
        table = log.rows(chunk) if run.sinks else []
        for sink in run.sinks:
            log.attempt(sink.name, partial(sink.write, table), say)


def last_row(chunk: dict[str, np.ndarray]) -> dict[str, Any]:
    """The metrics of a chunk's last iteration."""
    return {name: column[-1] for name, column in chunk.items()}


def in_last_row(evaluation: dict, rows: int) -> dict[str, np.ndarray]:
    """Columns `eval_*` `[I]` with the numbers in the last row, NaN above."""
    columns = {}
    for name, value in evaluation.items():
        value = np.asarray(value)
        columns[f"eval_{name}"] = np.full((rows, *value.shape), np.nan)
        columns[f"eval_{name}"][-1] = value
    return columns
