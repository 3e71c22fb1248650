"""Train a robot: `python -m dynappo.train --config=configs/go1.py:quick --workdir=runs/first`.

Any field of the config is a flag: `--config.ppo.clip_epsilon=0.1`. The same command again resumes the
run of that workdir. Nothing of the method is here: this is settings, compilation, the loop over
chunks of iterations, and what is written between them.

Settings are checked before JAX is imported, so a wrong flag answers at once, in one line and with
exit status 2. `train` is the same as a Python call.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dynappo import config as config_lib
from dynappo import distributed, files, log, results, schedule
from dynappo.config import ConfigError


class Program(NamedTuple):
    """A run that is compiled and ready to start."""

    robot: Any
    env: Any
    static: Any
    hyper: Any
    state: Any
    columns: dict[str, np.ndarray]  # [I]
    step: Callable  # (hyper, state, columns of one chunk) -> state, metrics
    assess: Callable  # (state) -> metrics of deterministic episodes
    mesh: Any  # jax.sharding.Mesh
    impl: str
    device: str
    compile_seconds: float


def train(
    config,
    workdir: str | Path | None = None,
    progress_fn: Callable[[int, dict], None] | None = None,
) -> tuple[Any, dict[str, np.ndarray]]:
    """Train as `config` says; returns `(TrainState, metrics [I])`, `[I, S]` for S seeds.

    With a `workdir`, it is filled, and a run found there is resumed; without, nothing is written.
    `progress_fn(iteration, metrics of that iteration)` is called every `run.log_every` iterations,
    while the device is at the next ones. Raises ConfigError for settings that cannot be run,
    FloatingPointError if numbers blow up.
    """
    config = config_lib.validate(config)
    check(config)  # before anything is written
    workdir = None if workdir is None else Path(workdir)
    with files.open_workdir(workdir, config) if workdir else contextlib.nullcontext():
        program = setup(config)
        state, metrics = loop(config, program, workdir, progress_fn)
        if workdir:
            results.finish(config, program, workdir, state, metrics)
    return state, metrics


def to_stderr(text: str) -> None:
    """A line to whoever sits there, where no console was given."""
    print(f"dynappo: {text}", file=sys.stderr)


def check(config) -> None:
    """ConfigError if this machine or the robot's file cannot run `config`."""
    from dynappo import memory, robot

    impl = choose_impl(config)
    log.check_wandb(config)
    robot.load(config.robot)
    memory.check(config, memory.limit(), impl)


def choose_impl(config) -> str:
    """The engine that `physics.impl` means here, "jax" or "warp"; ConfigError if it cannot run."""
    import importlib.util

    import jax

    if config.run.device == "cpu":
        jax.config.update("jax_platforms", "cpu")
    gpu = jax.default_backend() == "gpu"
    if config.run.device == "gpu" and not gpu:
        raise ConfigError(
            "run.device is gpu, but JAX sees none; install 'dynappo[cuda]' or set run.device=cpu"
        )
    warp = importlib.util.find_spec("warp") is not None
    if config.physics.impl == "warp" and not (gpu and warp):
        lack = "warp-lang is not installed" if gpu else "JAX sees no NVIDIA GPU"
        raise ConfigError(
            f"physics.impl is warp, but {lack}; install 'dynappo[cuda,warp]' or set "
            "physics.impl=jax"
        )
    devices, wanted = jax.device_count(), config.run.mesh_seed * config.run.mesh_env
    if wanted > devices or (jax.process_count() > 1 and wanted < devices):
        raise ConfigError(
            f"run.mesh_seed x run.mesh_env is {config.run.mesh_seed} x {config.run.mesh_env}, but "
            f"JAX sees {devices} devices in {jax.process_count()} processes"
        )
    if config.physics.impl == "auto":
        return "warp" if gpu and warp else "jax"
    return config.physics.impl


def remember_programs() -> None:
    """Keep compiled programs for the next process, where the user has not said otherwise."""
    import jax

    cache = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "dynappo" / "jax"
    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        jax.config.update("jax_compilation_cache_dir", str(cache))


def setup(config, restore: Path | None = None, say: Callable[[str], None] = to_stderr) -> Program:
    """Build robot, environment and first state, and compile the one program a run repeats.

    `restore` is the workdir of another run, whose networks the first state takes; `say` is told of
    damaged checkpoints there.
    """
    import jax
    import jax.numpy as jnp
    from jax.sharding import NamedSharding, PartitionSpec

    impl = choose_impl(config)
    from dynappo import algorithm, checkpoint, evaluate, sweep
    from dynappo import env as env_lib
    from dynappo import robot as robot_lib

    remember_programs()
    began = time.perf_counter()
    static, hyper = config_lib.split(config)
    robot, run = robot_lib.load(config.robot), config.run
    mesh = sweep.mesh(run.mesh_seed, run.mesh_env)
    env = env_lib.make(robot, config.task, config.physics, impl=impl)._replace(mesh=mesh)
    length = config.task.episode_length
    episodes = dict(static=static, num_envs=run.eval_envs, num_steps=length)
    init = partial(algorithm.init, env, static=static)
    step = partial(algorithm.run, env, static=static)
    assess = partial(evaluate.evaluate, env, **episodes)
    key = jax.random.key(run.seed)
    if run.num_seeds > 1:
        init = partial(sweep.init, env, static=static)
        step = partial(sweep.run, env, static=static)
        assess = partial(sweep.evaluate, env, **episodes)
        key = sweep.keys(run.seed, run.num_seeds)
    columns = schedule.columns(config)
    chunk = {name: jnp.asarray(column[: run.log_every]) for name, column in columns.items()}
    everywhere = NamedSharding(mesh, PartitionSpec())
    spread = sweep.shardings(mesh, jax.eval_shape(init, hyper, key), run.num_seeds)
    state = jax.jit(init, out_shardings=spread)(hyper, key)
    if restore:
        _, state = distributed.from_first(lambda s: (0, checkpoint.weights(restore, s, say)), state)
        state = jax.device_put(state, spread)
    step = jax.jit(step, donate_argnums=1, out_shardings=(spread, everywhere))
    compiled = step.lower(hyper, state, chunk).compile()
    distributed.meet()
    if impl == "warp":  # its kernels are built and loaded when they are first called
        once = {name: jnp.minimum(column, 1) for name, column in chunk.items()}
        jax.block_until_ready(compiled(hyper, jax.tree.map(jnp.copy, state), once))
    assess = jax.jit(assess, out_shardings=everywhere)

    return Program(
        robot=robot,
        env=env,
        static=static,
        hyper=hyper,
        state=state,
        columns=columns,
        step=compiled,
        assess=lambda s: jax.device_get(assess(hyper.task, s.learner.params, jax.random.key(0))),
        mesh=mesh,
        impl=impl,
        device=f"{jax.devices()[0].device_kind}",
        compile_seconds=time.perf_counter() - began,
    )


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

    from dynappo import checkpoint

    run, state, start, history = config.run, program.state, 0, []
    copy = jax.jit(partial(jax.tree.map, jnp.copy))  # one dispatch, not one an array
    writes = distributed.first()  # of several processes, only one
    checkpoints = checkpoint.manager(workdir, say) if workdir and writes else None
    sinks: list[log.Sink] = []
    try:
        if workdir:
            start, state, history = files.resume(config, workdir, checkpoints, state, say)
            sinks = log.sinks(config, workdir, start) if writes else []
        seconds = float(history[0]["seconds"][-1]) if history else 0.0
        # only the first process has the history, and only there the number is written
        sim_steps = int(history[0]["sim_steps"][-1]) if history else 0
        waiting = None
        for first in range(start, run.num_iterations, run.log_every):
            rows, done = slice(first, first + run.log_every), first + run.log_every
            columns = {name: column[rows] for name, column in program.columns.items()}
            before = copy({"env_state": state.env_state, "params_physics": state.params_physics})
            began = time.perf_counter()
            running = program.step(program.hyper, state, columns)  # returns at once
            if waiting:
                _tell(*waiting, sinks, progress_fn, say)
            state, metrics = jax.block_until_ready(running)
            took = time.perf_counter() - began
            metrics = jax.device_get(metrics)
            metrics |= _shared(config, columns, metrics, sim_steps)
            metrics["seconds"] = seconds + took * np.arange(1, run.log_every + 1) / run.log_every
            seconds, sim_steps = seconds + took, int(metrics["sim_steps"][-1])
            files.check_finite(metrics, state, before, workdir)
            if run.eval_every and done % run.eval_every == 0:
                metrics |= _at_end(program.assess(state), run.log_every)
            history.append(metrics)
            waiting = (done, metrics)
            stopping = distributed.any_of(should_stop())
            every = run.checkpoint_every and done % run.checkpoint_every == 0
            if workdir and (stopping or every or done == run.num_iterations):
                at = done, state, metrics, sim_steps
                files.save(config, program.robot, workdir, checkpoints, *at, say)
            if stopping:
                break
        if waiting:
            _tell(*waiting, sinks, progress_fn, say)
    finally:  # also where it is interrupted: a save under way is finished
        for sink in sinks:
            files.attempt(sink.name, sink.close, say)
        if checkpoints:
            files.attempt("the last checkpoint", partial(checkpoint.finish, checkpoints), say)
            checkpoints.close()
    return state, log.join(history)


def _shared(config, columns, metrics, sim_steps: int) -> dict[str, np.ndarray]:
    """Columns `[I]` that all seeds share; real rows are the schedule's, unless `metrics` has others."""
    n_real = np.asarray(metrics.get("n_real", columns["n_real"]), np.int64)
    if n_real.ndim > 1:
        n_real = n_real[:, 0]  # one for all seeds
    return {
        "iteration": columns["iteration"],
        "n_real": n_real,
        "n_synthetic": config.rollout.horizon - n_real,
        "sim_steps": sim_steps + np.cumsum(n_real) * config.rollout.num_envs,
    }


def _tell(done: int, metrics, sinks, progress_fn, say) -> None:
    """Hand a chunk's metrics to every log, and its last row to `progress_fn`."""
    table = log.rows(metrics)
    for sink in sinks:
        files.attempt(sink.name, partial(sink.write, table), say)
    if progress_fn:
        progress_fn(done, {name: value[-1] for name, value in metrics.items()})


def _at_end(evaluation: dict, rows: int) -> dict[str, np.ndarray]:
    """Columns `eval_*` `[I]` with the numbers in the last row, NaN above."""
    columns = {}
    for name, value in evaluation.items():
        value = np.asarray(value)
        columns[f"eval_{name}"] = np.full((rows, *value.shape), np.nan)
        columns[f"eval_{name}"][-1] = value
    return columns


if __name__ == "__main__":
    from dynappo import console

    console.main()
