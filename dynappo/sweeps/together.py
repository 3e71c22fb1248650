"""Several runs in one program: compiled once, stepped together, each written into its own folder.

A run's seeds lie side by side with those of the others, and have their run's floats (`sweep.vary` is the
same for one field). They have the keys that the run alone gives them, so each run is what it would be
alone, to the last digits of a float. One run alone is not batched further, and the same to the bit.
"""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ml_collections import config_dict

from dynappo import config as config_lib
from dynappo.config import fields, files
from dynappo.program import build
from dynappo.program.build import Program
from dynappo.sweeps import folder, grid
from dynappo.train import checkpoint, finish, log, nonfinite, restore
from dynappo.train import run as run_lib
from dynappo.train import workdir as workdir_lib


class Run(NamedTuple):
    """One run of several."""

    config: Any
    workdir: Path
    checkpoints: Any
    sinks: list
    history: list[dict]  # of chunks; grows


def compiled(group: list[grid.Combination], log_every: int) -> Program:
    """The program of all seeds of a group, with `log_every` iterations in a chunk."""
    import jax
    import jax.numpy as jnp

    from dynappo import sweep

    whole, run = grid.whole(group), group[0].config.run
    whole = _with_log_every(whole, log_every)
    if len(group) == 1:
        return build.program(whole, group[0].env)

    def each(*values):
        if len(set(values)) == 1:
            return values[0]
        return jnp.repeat(jnp.asarray(values, jnp.float32), run.num_seeds)

    hyper = jax.tree.map(each, *(config_lib.split(one.config)[1] for one in group))
    keys = jnp.concatenate([sweep.keys(run.seed, run.num_seeds)] * len(group))
    try:
        return build.program(whole, group[0].env, (hyper, keys))
    except config_lib.ConfigError as error:  # the memory of a device
        raise grid.too_many(error, group) from None


def _with_log_every(config, log_every: int):
    config = fields.copied(config)  # a copy
    config.run.log_every = log_every
    return config_dict.FrozenConfigDict(config)


def part(tree: Any, one: int, runs: int, seeds: int, axis: int = 0) -> Any:
    """What belongs to run number `one` of `runs`, in arrays with all seeds along `axis`.

    A run with one seed has no such axis, as when it is alone; of one run it is all.
    """
    import jax

    if runs == 1:
        return tree
    at = one if seeds == 1 else slice(one * seeds, (one + 1) * seeds)
    return jax.tree.map(lambda x: x[(slice(None),) * axis + (at,)], tree)


def _side_by_side(states: list, seeds: int) -> Any:
    """The inverse of `part` over states."""
    import jax
    import jax.numpy as jnp

    if len(states) == 1:
        return states[0]
    join = jnp.stack if seeds == 1 else jnp.concatenate
    return jax.tree.map(lambda *leaves: join(leaves), *states)


def train(
    group: list[grid.Combination],
    workdir: Path,
    source: Path | None,
    begin: Callable[[Program], Callable[[int, dict], None]],
    should_stop: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Train the runs of a group in the folders of `workdir`, and finish those that end.

    `begin(program)` is told what was compiled, and returns what is told the metrics `[S]` of each chunk's
    last iteration. A run whose numbers blow up leaves `nonfinite.json`, and the others go on. Where a damaged
    checkpoint sets one of them back, nothing is trained: they are no group any more.
    """
    end = group[0].config.run.num_iterations
    with contextlib.ExitStack() as stack:  # also where it is interrupted: a save is finished
        for one in group:
            stack.enter_context(workdir_lib.open_workdir(workdir / one.name, one.config))
        steps = [workdir_lib.in_step(one.config, workdir / one.name) for one in group]
        log_every = int(np.gcd.reduce([config.run.log_every for config in steps]))
        sources = [restore.source(workdir / one.name, source) for one in group]
        program = compiled(group, log_every)
        tell = begin(program)
        with contextlib.ExitStack() as open_files:
            runs, states, start = [], [], []
            for i, one in enumerate(group):
                run, state, done = _opened(
                    _with_log_every(one.config, log_every),
                    workdir / one.name,
                    program._replace(
                        state=part(program.state, i, len(group), one.config.run.num_seeds),
                        place=lambda state: state,
                    ),
                    sources[i],
                    open_files,
                    say,
                )
                runs, states, start = [*runs, run], [*states, state], [*start, done]
            if len(set(start)) > 1:
                return
            state = program.place(_side_by_side(states, group[0].config.run.num_seeds))
            del states
            done, state, good = _loop(runs, program, state, start[0], tell, should_stop, say)
        if done == end and not should_stop():
            _finish(runs, good, program, state, say)


def _opened(config, folder: Path, alone: Program, source, stack, say) -> tuple[Run, Any, int]:
    """A run that begins, or goes on: `(run, its state, iterations done)`."""
    checkpoints = stack.enter_context(checkpoint.opened(folder, say))
    if source:
        alone = restore.start_from(source, alone, folder, say)
    start, state, history = workdir_lib.resume(config, folder, checkpoints, alone.state, say)
    sinks = stack.enter_context(log.opened(config, folder, start, say))
    return Run(config, folder, checkpoints, sinks, history), state, start


def _loop(
    runs: list[Run], program: Program, state, start: int, tell, should_stop, say
) -> tuple[int, Any, list[int]]:
    """`run.loop` of several runs: `(iterations done, state of all, numbers of the runs that are good)`."""
    import jax
    import jax.numpy as jnp

    run, good, done, waiting = runs[0].config.run, list(range(len(runs))), start, []
    copy = jax.jit(partial(jax.tree.map, jnp.copy))
    seconds = max(run_lib.reached(one.history)[0] for one in runs)
    counted = workdir_lib.counted(runs[0].config, run.num_iterations)
    for first in range(start, run.num_iterations, run.log_every):
        rows, done = slice(first, first + run.log_every), first + run.log_every
        columns = {name: column[rows] for name, column in program.columns.items()}
        before = copy({"env_state": state.env_state, "params_physics": state.params_physics})
        began = time.perf_counter()
        running = program.step(program.hyper, state, columns)  # returns at once
        _write(waiting, say)
        state, metrics = jax.block_until_ready(running)
        took = time.perf_counter() - began
        # copies: else each chunk would keep its buffers of JAX, and the columns of the whole run
        metrics = jax.tree.map(np.array, jax.device_get(metrics))
        shared = {name: column[rows].copy() for name, column in counted.items()}
        shared["seconds"] = seconds + took * np.arange(1, run.log_every + 1) / run.log_every
        seconds += took
        due = run.eval_every and done % run.eval_every == 0
        evaluation = program.evaluate(state) if due else {}
        stopping = should_stop()
        every = run.checkpoint_every and done % run.checkpoint_every == 0
        saves = stopping or every or done == run.num_iterations
        waiting = []
        for i in list(good):
            of = partial(part, one=i, runs=len(runs), seeds=run.num_seeds)
            own, chunk = of(state), of(metrics, axis=1) | shared
            if not _good(runs[i], chunk, columns, own, of(before), done, say):
                good.remove(i)
                continue
            if evaluation:
                chunk |= run_lib.at_end(of(evaluation), run.log_every)
            runs[i].history.append(chunk)
            waiting.append((runs[i], chunk))
            if saves:
                _save(runs[i], program.robot, done, own, say)
        if good:
            told = [{name: value[-1] for name, value in chunk.items()} for _, chunk in waiting]
            tell(done, {name: np.stack([one[name] for one in told]) for name in told[0]})
        if stopping or not good:
            break
    _write(waiting, say)
    return done, state, good


def _write(chunks: list[tuple[Run, dict]], say) -> None:
    """Hand every run's chunk to its own logs."""
    for run, chunk in chunks:
        run_lib.tell(0, chunk, run.sinks, None, say)


def _good(run: Run, chunk, columns, state, before, done: int, say) -> bool:
    """Whether all numbers of a run's chunk are finite; else its folder and `say` are told."""
    try:
        nonfinite.check(chunk, columns, state, before, run.workdir)
    except FloatingPointError as error:
        say(f"{run.workdir.name}: {error}; the other combinations go on")
        about = {"iteration": done, "problem": str(error)}
        files.write_json(run.workdir / folder.BLOWN_UP, about)
        return False
    return True


def _save(run: Run, robot, done: int, state, say) -> None:
    """A checkpoint, and the policy of the best seed in the last evaluation."""
    found = map(log.last_evaluation, reversed(run.history))
    evaluated = next((returns for returns in found if returns is not None), None)
    at = done, state, run.history[-1], evaluated
    workdir_lib.save(run.config, robot, run.workdir, run.checkpoints, *at, say)


def _finish(runs: list[Run], good: list[int], program: Program, state, say) -> None:
    """What every good run leaves at its end; all are evaluated at once."""
    count, seeds = len(runs), runs[0].config.run.num_seeds
    evaluated = functools.cache(lambda: program.evaluate(state))
    for i in good:
        run, own = runs[i], part(state, i, count, seeds)
        alone = program._replace(
            hyper=config_lib.split(run.config)[1],
            evaluate=lambda _, i=i: part(evaluated(), i, count, seeds),
        )
        at = run.config, alone, run.workdir, own, log.join(run.history), say
        finish.finish(*at)
        finish.check_saved(*at)
