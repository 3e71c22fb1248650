"""Train a robot: `python -m dynappo.train --config=configs/go1.py:quick --workdir=runs/first`.

Any field of the config is a flag: `--config.ppo.clip_epsilon=0.1`. The same command again resumes the
run of that workdir. Nothing of the method is here: this is settings, compilation, the loop over
chunks of iterations, and what is written between them.

Settings are checked before JAX is imported, so a wrong flag answers at once, in one line and with
exit status 2. `train` is the same as a Python call.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.config import ConfigError

RETURN_ROWS = 10  # the return of a run is the mean of its last rows


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
    `progress_fn(iteration, metrics of that iteration)` is called every `run.log_every` iterations.
    Raises ConfigError for settings that cannot be run, FloatingPointError if numbers blow up.
    """
    config = config_lib.validate(config)
    choose_impl(config)  # before anything is written
    workdir = None if workdir is None else open_workdir(Path(workdir), config)
    program = setup(config)
    state, metrics = loop(config, program, workdir, progress_fn)
    if workdir:
        finish(config, program, workdir, state, metrics)
    return state, metrics


def open_workdir(workdir: Path, config) -> Path:
    """Make the folder and its config.json, or check that it holds a run of this config."""
    text = config_lib.to_json(config)
    path = workdir / "config.json"
    try:
        workdir.mkdir(parents=True, exist_ok=True)
        if path.exists():
            changed = config_lib.difference(path.read_text(), text)
            if changed:
                raise ConfigError(
                    f"--workdir={workdir} holds a run of another config ({changed}); "
                    "choose another folder"
                )
        path.write_text(text + "\n")
    except OSError as error:
        raise ConfigError(
            f"--workdir={workdir}: cannot write there ({error.strerror}); choose another folder"
        ) from None
    return workdir


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
    if config.physics.impl == "auto":
        return "warp" if gpu and warp else "jax"
    return config.physics.impl


def setup(config) -> Program:
    """Build robot, environment and first state, and compile the one program a run repeats."""
    import jax
    import jax.numpy as jnp

    impl = choose_impl(config)
    from dynappo import algorithm, evaluate
    from dynappo import env as env_lib
    from dynappo import robot as robot_lib

    cache = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "dynappo" / "jax"
    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        jax.config.update("jax_compilation_cache_dir", str(cache))
    began = time.perf_counter()
    static, hyper = config_lib.split(config)
    robot, run = robot_lib.load(config.robot), config.run
    worlds = config.rollout.num_envs * run.num_seeds
    env = env_lib.make(robot, config.task, config.physics, impl=impl, num_worlds=worlds)
    init = partial(algorithm.init, env, static=static)
    step = partial(algorithm.run, env, static=static)
    assess = partial(
        evaluate.evaluate,
        env,
        static=static,
        num_envs=run.eval_envs,
        num_steps=config.task.episode_length,
    )
    key = jax.random.key(run.seed)
    if run.num_seeds > 1:  # the columns stay unbatched: they bound the loops over rows
        key = jnp.stack([jax.random.key(run.seed + s) for s in range(run.num_seeds)])
        init = jax.vmap(init, (None, 0))
        step = jax.vmap(step, (None, 0, None), (0, 1))
        assess = jax.vmap(assess, (None, 0, None))
    columns = schedule.columns(config)
    chunk = {name: jnp.asarray(column[: run.log_every]) for name, column in columns.items()}
    state = jax.jit(init)(hyper, key)
    compiled = jax.jit(step, donate_argnums=1).lower(hyper, state, chunk).compile()
    if impl == "warp":  # its kernels are built and loaded when they are first called
        once = {name: jnp.minimum(column, 1) for name, column in chunk.items()}
        jax.block_until_ready(compiled(hyper, jax.tree.map(jnp.copy, state), once))
    assess = jax.jit(assess)
    return Program(
        robot=robot,
        env=env,
        static=static,
        hyper=hyper,
        state=state,
        columns=columns,
        step=compiled,
        assess=lambda s: jax.device_get(assess(hyper.task, s.learner.params, jax.random.key(0))),
        impl=impl,
        device=f"{jax.devices()[0].device_kind}",
        compile_seconds=time.perf_counter() - began,
    )


def loop(config, program: Program, workdir: Path | None, progress_fn=None):
    """All iterations that are still to do; returns `(state, metrics of every iteration)`."""
    import jax

    from dynappo import checkpoint, log

    run, state, start, seconds, history = config.run, program.state, 0, 0.0, []
    csv = workdir / "metrics.csv" if workdir else None
    checkpoints = checkpoint.manager(workdir) if workdir else None
    if checkpoints and csv:
        found = checkpoint.restore(checkpoints, state)
        if found:
            start, state = found
            if not csv.exists():
                raise ConfigError(
                    f"{workdir} has checkpoints but no metrics.csv; choose another --workdir"
                )
            log.cut_csv(csv, start)
            history = [log.read_csv(csv, run.num_seeds)]
            seconds = float(history[0]["seconds"][-1])
        else:
            csv.unlink(missing_ok=True)  # of a run that ended before its first checkpoint
    sim_steps = schedule.sim_steps(config)
    try:
        for first in range(start, run.num_iterations, run.log_every):
            rows = slice(first, first + run.log_every)
            columns = {name: column[rows] for name, column in program.columns.items()}
            began = time.perf_counter()
            state, metrics = jax.block_until_ready(program.step(program.hyper, state, columns))
            took = time.perf_counter() - began
            share = np.arange(1, run.log_every + 1) / run.log_every
            metrics = jax.device_get(metrics) | {
                "iteration": columns["iteration"],
                "sim_steps": sim_steps[rows],
                "seconds": seconds + took * share,
                "n_real": columns["n_real"],
                "n_synthetic": config.rollout.horizon - columns["n_real"],
            }
            seconds, done = seconds + took, first + run.log_every
            last = {name: value[-1] for name, value in metrics.items()}
            _check_finite(last)
            history.append(metrics)
            if csv:
                log.append_csv(csv, log.rows(metrics))
            if checkpoints and (done == run.num_iterations or _every(run.checkpoint_every, done)):
                checkpoint.save(checkpoints, done, state)
            if _every(run.eval_every, done):
                last |= {f"eval_{name}": value for name, value in program.assess(state).items()}
            if progress_fn:
                progress_fn(done, last)
    finally:  # also on ctrl-C: a save under way is finished
        if checkpoints:
            checkpoints.wait_until_finished()
            checkpoints.close()
    return state, {name: np.concatenate([h[name] for h in history]) for name in history[0]}


def _every(period: int, iteration: int) -> bool:
    return bool(period) and iteration % period == 0


def _check_finite(last: dict[str, np.ndarray]) -> None:
    for name in ("value_loss", "surrogate_loss", "model_loss", "policy_std"):
        if name in last and not np.isfinite(last[name]).all():
            raise FloatingPointError(
                f"{name} is {last[name]} after iteration {last['iteration']}: training has blown "
                "up; lower ppo.learning_rate or model.learning_rate, or shorten the tail"
            )


def finish(config, program: Program, workdir: Path, state, metrics) -> dict[str, Any]:
    """Evaluate, write policy.npz, summary.json and the film; returns the summary."""
    from dynappo import log, render

    summary = summarise(config, program, state, metrics)
    params = best_params(state, metrics)
    render.save_params(workdir / "policy.npz", params)
    if config.run.video_seconds:
        act = render.policy(params, config.ppo.activation)
        seconds = config.run.video_seconds
        episode = render.simulate(program.robot, config, act, render.tour(seconds), seconds)
        problem = render.film(program.robot, episode, workdir / "video.mp4")
        summary["video"] = problem or str(workdir / "video.mp4")
    log.write_json(workdir / "summary.json", summary)
    return summary


def summarise(config, program: Program, state, metrics) -> dict[str, Any]:
    """What a run came to: return (mean of the last 10 rows), cost, and evaluation if asked."""
    returns = metrics["episode_return"]
    summary = {
        "robot": config.robot,
        "num_envs": config.rollout.num_envs,
        "iterations": int(metrics["iteration"][-1]),
        "sim_steps": int(metrics["sim_steps"][-1]),
        "return": _numbers(returns[-RETURN_ROWS:].mean(0)),
        "return_max": _numbers(np.fmax.reduce(returns, 0)),
        "seconds": float(metrics["seconds"][-1]),
        "compile_seconds": program.compile_seconds,
        "device": program.device,
        "impl": program.impl,
        "versions": {name: _version(name) for name in ("dynappo", "jax", "mujoco-mjx")},
    }
    if config.run.eval_envs:
        evaluation = program.assess(state)
        summary["evaluation"] = {name: _numbers(v) for name, v in evaluation.items()}
    return summary


def _numbers(values):
    """A float, or a list of one a seed; None where no episode has ended yet (JSON has no NaN)."""
    numbers = [float(v) if np.isfinite(v) else None for v in np.ravel(values)]
    return numbers if np.ndim(values) else numbers[0]


def best_params(state, metrics) -> dict:
    """The networks as NumPy arrays; of the seed with the highest return, where there are several."""
    import jax

    params = jax.device_get(state.learner.params)
    worth = np.nan_to_num(metrics["episode_return"][-RETURN_ROWS:], nan=-np.inf).mean(0)
    return jax.tree.map(lambda p: p[int(worth.argmax())], params) if worth.ndim else params


def _version(package: str) -> str:
    from importlib import metadata

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "unknown"


if __name__ == "__main__":
    from dynappo import console

    console.main()
