"""The training sequence: check, open, build, resume, loop, finish. Start reading here.

`train_together` trains runs that share one program, most often one run. `train`, the command `dynappo train`
and each group of a sweep call it. The method is in `algorithm.py`. Settings are checked before JAX is
imported, so a wrong one fails at once. Only commands change settings of the process
(`devices.own_process`).
"""

from __future__ import annotations

import contextlib
import functools
import math
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dynappo import config as config_lib
from dynappo.config import ConfigError
from dynappo.config.stop import Stop
from dynappo.program import build, distributed, environment
from dynappo.program.build import Program
from dynappo.run import finish, log, merged
from dynappo.run import loop as loop_lib
from dynappo.run import workdir as workdir_lib
from dynappo.run.workdir import OpenRun

WAITS = "stopping after this block of iterations; again to stop now"


class Run(NamedTuple):
    """A run to be trained."""

    config: Any  # validated
    workdir: Path | None = None  # None: nothing is written
    env: Any = None  # a `types.Env` of your own, in place of the robot's velocity task
    source: Path | None = None  # another run, whose networks it starts from (`--restore`)


class Trained(NamedTuple):
    """The results of a training."""

    runs: list[OpenRun]  # with the metrics of their iterations; the files are closed
    state: Any  # of all runs, as `merged.join` makes it
    good: list[int]  # numbers of the runs that did not blow up
    ended: bool  # all iterations are done, and nobody asked to stop


def to_stderr(text: str) -> None:
    """Print a line on stderr."""
    print(f"dynappo: {text}", file=sys.stderr)


def raise_it(run: OpenRun, iteration: int, error: FloatingPointError) -> None:
    """The default of `Callbacks.blown_up`."""
    raise error


def nothing(*_) -> None:
    """The default of a callback."""


class Callbacks(NamedTuple):
    """What the sequence calls; `say` and `blown_up` at any time, the others in this order."""

    say: Callable[[str], None] = to_stderr  # with a line on something unusual
    opened: Callable[[], None] = nothing  # the folders are locked; compiling begins
    compiled: Callable[[Program], None] = nothing
    progress: Callable[[int, list[dict]], None] = (
        nothing  # with the iteration, and its metrics of each run
    )
    finishing: Callable[[], None] = nothing  # all iterations are done; evaluating and filming begin
    finished: Callable[[Any, Path, dict], None] = (
        nothing  # with config, workdir and summary of a run
    )
    blown_up: Callable[[OpenRun, int, FloatingPointError], None] = raise_it


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
    run = Run(config, None if workdir is None else Path(workdir), env)
    check(run)
    callbacks = Callbacks()
    if progress_fn:
        callbacks = Callbacks(progress=lambda iteration, last: progress_fn(iteration, last[0]))
    trained = train_together([run], callbacks)
    return trained.state, trained.runs[0].metrics()


def check(run: Run, fresh: bool = False) -> None:
    """ConfigError if this machine, the robot's file, an environment of one's own, the logs or the networks to
    start from cannot be used. Nothing is written or compiled."""
    log.check_wandb(run.config)
    build.check(run.config, run.env)
    check_source(run, fresh)


def check_source(run: Run, fresh: bool = False) -> None:
    """ConfigError if a run cannot start from the networks of its source, or `fresh` would move that."""
    if (source := run.source) is None:
        return
    from dynappo.run import restore  # not above: it starts JAX

    distributed.on_first(lambda: restore.check(source, run.config))
    if fresh and run.workdir and source.resolve() == run.workdir.resolve():
        raise ConfigError(
            f"--restore={source}: --fresh moves that run aside; name the folder of another one"
        )


def train_together(
    runs: list[Run],
    callbacks: Callbacks | None = None,
    stop: Stop | None = None,
    fresh: bool = False,
) -> Trained:
    """The training sequence, from `open` on, of runs that have been checked (`check`) and share one program.

    Their configs differ in floats alone, and all or none have a workdir. A run with a checkpoint resumes;
    `fresh` moves it aside and starts anew. If `stop.status` is set while they train, the runs are saved and
    not finished. If a damaged checkpoint sets one of several runs back, nothing is trained: they no longer
    have the same number of iterations done.
    """
    callbacks = callbacks or Callbacks()
    say = functools.cache(callbacks.say)  # each line once, not once a run
    with contextlib.ExitStack() as held:
        for run in runs:
            if run.workdir:
                opened = workdir_lib.open_workdir(run.workdir, run.config, fresh, say)
                held.enter_context(opened)
        callbacks.opened()
        chunks = [workdir_lib.chunk_length(run.config, run.workdir) for run in runs]
        runs = [_prepared(run, math.gcd(*chunks)) for run in runs]
        program = merged.program([run.config for run in runs], runs[0].env, import_savers)
        callbacks.compiled(program)
        trained = resume_and_loop(runs, program, callbacks, stop)
        if trained.ended and runs[0].workdir:
            _finish(trained, program, callbacks)
    return trained


def _prepared(run: Run, log_every: int) -> Run:
    """The run with chunks of `log_every` iterations, and no `source` if it resumes."""
    from dynappo.run import restore

    config = merged.with_log_every(run.config, log_every)
    source = restore.source(run.workdir, run.source) if run.workdir else None
    return run._replace(config=config, source=source)


def import_savers() -> None:
    """Import what saves a run: half a second, which costs nothing while XLA compiles."""
    from dynappo.run import checkpoint, nonfinite  # noqa: F401


def resume_and_loop(
    runs: list[Run],
    program: Program,
    callbacks: Callbacks | None = None,
    stop: Stop | None = None,
) -> Trained:
    """Begin each run, or resume it, and do all iterations still to do.

    `program` is that of all runs; the buffers of its first state are donated.
    """
    callbacks, stop, run = callbacks or Callbacks(), stop or Stop(), runs[0].config.run
    part = partial(merged.part, runs=len(runs), seeds=run.num_seeds)
    open_runs, states, starts = [], [], []
    stop.patient, stop.waits = True, WAITS if distributed.first() else ""
    try:
        with contextlib.ExitStack() as files:  # also where it is interrupted: a save is finished
            for i, one in enumerate(runs):
                own = part(program.state, i)
                opened, state, start = _resumed(one, program, own, files, callbacks.say)
                open_runs.append(opened)
                states.append(state)
                starts.append(start)
            if len(set(starts)) > 1:
                return Trained(open_runs, None, [], False)
            state = merged.join(states, run.num_seeds)
            del states
            if len(runs) > 1 or runs[0].source:
                state = program.place(state)
            state, good = loop_lib.loop(
                open_runs,
                program,
                state,
                starts[0],
                stop=stop,
                progress=callbacks.progress,
                blown_up=callbacks.blown_up,
                say=callbacks.say,
            )
    finally:
        stop.patient = False
    stopped = distributed.any_of(bool(stop.status))
    done = [open_runs[i].iterations() for i in good]
    return Trained(open_runs, state, good, not stopped and set(done) == {run.num_iterations})


def _resumed(
    run: Run, program: Program, state, files: contextlib.ExitStack, say
) -> tuple[OpenRun, Any, int]:
    """`(run with its files open, its state, iterations done)`."""
    config, workdir = run.config, run.workdir
    if workdir is None:
        return OpenRun(config, None, None, [], []), state, 0
    from dynappo.run import checkpoint, restore

    checkpoints, sinks, writes = None, [], distributed.first()  # of several processes, only one
    made = workdir_lib.origins(workdir, workdir_lib.made_by(program, config)) if writes else ()
    if run.source:  # before anything else is in a new folder: it is removed where they do not fit
        state = restore.start_from(run.source, config, state, workdir, say)
        if writes and (text := restore.apart(run.source, config)):
            say(text)
    if writes:
        checkpoints = files.enter_context(checkpoint.opened(workdir, say))
    start, state, history = workdir_lib.resume(config, workdir, checkpoints, state, say, made)
    if writes:
        sinks = files.enter_context(log.opened(config, workdir, start, say))
    return OpenRun(config, workdir, checkpoints, sinks, history, made), state, start


def _finish(trained: Trained, program: Program, callbacks: Callbacks) -> None:
    """What every good run leaves at its end; all are evaluated at once."""
    callbacks.finishing()
    run = trained.runs[0].config.run
    part = partial(merged.part, runs=len(trained.runs), seeds=run.num_seeds)
    began = time.perf_counter()
    evaluation = program.evaluate(trained.state) if run.eval_envs else {}
    seconds = time.perf_counter() - began if run.eval_envs else None
    for i in trained.good:
        one, state = trained.runs[i], part(trained.state, i)
        own = part(evaluation, i)
        try:
            summary = finish.finish(one, program, state, own, callbacks.say, seconds)
        except OSError:
            # a full disk: that the checkpoint is lost, too, weighs more
            finish.check_saved(one, program.robot, state, callbacks.say)
            raise
        if distributed.first():
            callbacks.finished(one.config, one.workdir, summary)
        finish.check_saved(one, program.robot, state, callbacks.say)
