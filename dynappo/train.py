"""Train a robot: `python -m dynappo.train --config=configs/go1.py:quick --workdir=runs/first`.

Any field of the config is a flag: `--config.ppo.clip_epsilon=0.1`. The same command again resumes the
run of that workdir. Nothing of the method is here: this is settings, compilation, the loop over
chunks of iterations, and what is written between them.

Settings are checked before JAX is imported, so a wrong flag answers at once, in one line and with
exit status 2. `train` is the same as a Python call.
"""

from __future__ import annotations

import itertools
import os
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dynappo import config as config_lib
from dynappo import log, schedule
from dynappo.config import ConfigError

RETURN_ROWS = 10  # the return of a run is the mean of its last rows
# what may differ when a run goes on: nothing of it changes a number of the iterations before
MAY_CHANGE = (
    "run.num_iterations run.checkpoint_every run.eval_every run.eval_envs run.video_seconds "
    "run.device run.tensorboard run.wandb physics.impl"
).split()


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
    `progress_fn(iteration, metrics of that iteration)` is called every `run.log_every` iterations,
    while the device is at the next ones. Raises ConfigError for settings that cannot be run,
    FloatingPointError if numbers blow up.
    """
    config = config_lib.validate(config)
    check(config)  # before anything is written
    workdir = None if workdir is None else open_workdir(Path(workdir), config)
    program = setup(config)
    state, metrics = loop(config, program, workdir, progress_fn)
    if workdir:
        finish(config, program, workdir, state, metrics)
    return state, metrics


def open_workdir(workdir: Path, config, fresh: bool = False) -> Path:
    """Make the folder and its config.json, or check that it holds a run of this config.

    Fields that do not change what is computed may differ (`MAY_CHANGE`): a run can be made longer or
    filmed again. `fresh` moves a run that is there aside, to `WORKDIR.old-1`, and starts anew.
    """
    text = config_lib.to_json(config)
    path = workdir / "config.json"
    try:
        if fresh and workdir.exists():
            number = next(n for n in itertools.count(1) if not _old(workdir, n).exists())
            workdir.rename(_old(workdir, number))
        workdir.mkdir(parents=True, exist_ok=True)
        if path.exists():
            changed = config_lib.difference(path.read_text(), text, MAY_CHANGE)
            if changed:
                raise ConfigError(
                    f"--workdir={workdir} holds a run of another config ({changed}); "
                    "choose another folder, or --fresh to move that run aside"
                )
        log.write_text(path, text + "\n")
    except OSError as error:
        raise ConfigError(
            f"--workdir={workdir}: cannot write there ({error.strerror}); choose another folder"
        ) from None
    return workdir


def _old(workdir: Path, number: int) -> Path:
    return workdir.with_name(f"{workdir.name}.old-{number}")


def check(config) -> None:
    """ConfigError if this machine or the robot's file cannot run `config`."""
    from dynappo import robot

    choose_impl(config)
    log.check_wandb(config)
    robot.load(config.robot)


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


def setup(config, restore: Path | None = None) -> Program:
    """Build robot, environment and first state, and compile the one program a run repeats.

    `restore` is the workdir of another run, whose networks the first state takes.
    """
    import jax
    import jax.numpy as jnp

    impl = choose_impl(config)
    from dynappo import algorithm, checkpoint, evaluate
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
    if restore:
        state = checkpoint.weights(restore, state)
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


def loop(
    config,
    program: Program,
    workdir: Path | None,
    progress_fn=None,
    *,
    should_stop: Callable[[], bool] = lambda: False,
    say: Callable[[str], None] = lambda text: print(f"dynappo: {text}", file=sys.stderr),
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
    checkpoints = checkpoint.manager(workdir, say) if workdir else None
    sinks: list[log.Sink] = []
    try:
        if workdir:
            start, state, history = resume(config, workdir, checkpoints, state, say)
            sinks = log.sinks(config, workdir, start)
        seconds = float(history[0]["seconds"][-1]) if history else 0.0
        sim_steps, waiting = schedule.sim_steps(config), None
        for first in range(start, run.num_iterations, run.log_every):
            rows, done = slice(first, first + run.log_every), first + run.log_every
            columns = {name: column[rows] for name, column in program.columns.items()}
            before = jax.tree.map(
                jnp.copy, {"env_state": state.env_state, "params_physics": state.params_physics}
            )
            began = time.perf_counter()
            running = program.step(program.hyper, state, columns)  # returns at once
            if waiting:
                _tell(*waiting, sinks, progress_fn, say)
            state, metrics = jax.block_until_ready(running)
            took = time.perf_counter() - began
            metrics = jax.device_get(metrics) | {
                "iteration": columns["iteration"],
                "sim_steps": sim_steps[rows],
                "seconds": seconds + took * np.arange(1, run.log_every + 1) / run.log_every,
                "n_real": columns["n_real"],
                "n_synthetic": config.rollout.horizon - columns["n_real"],
            }
            seconds += took
            check_finite(metrics, state, before, workdir)
            if run.eval_every and done % run.eval_every == 0:
                metrics |= _at_end(program.assess(state), run.log_every)
            history.append(metrics)
            waiting = (done, metrics)
            stopping = should_stop()
            every = run.checkpoint_every and done % run.checkpoint_every == 0
            if workdir and (stopping or every or done == run.num_iterations):
                about = {"sim_steps": int(sim_steps[done - 1]), "config": config.to_dict()}
                _save(config, program, workdir, checkpoints, done, state, metrics, about, say)
            if stopping:
                break
        if waiting:
            _tell(*waiting, sinks, progress_fn, say)
    finally:  # also where it is interrupted: a save under way is finished
        for sink in sinks:
            _attempt(sink.name, sink.close, say)
        if checkpoints:
            _attempt("the last checkpoint", partial(checkpoint.finish, checkpoints), say)
            checkpoints.close()
    return state, log.join(history)


def resume(config, workdir: Path, checkpoints, state, say):
    """`(iterations done, state, [their metrics])` of the newest good checkpoint of `workdir`."""
    from dynappo import checkpoint

    csv = workdir / "metrics.csv"
    found = checkpoint.restore(checkpoints, state, say)
    if not found:
        csv.unlink(missing_ok=True)  # of a run that ended before its first checkpoint
        return 0, state, []
    start, state = found
    if not csv.exists():
        raise ConfigError(f"{workdir} has checkpoints but no metrics.csv; choose another --workdir")
    if start > config.run.num_iterations:
        raise ConfigError(
            f"run.num_iterations is {config.run.num_iterations}, but the run in {workdir} has done "
            f"{start}; expected at least as many"
        )
    log.cut_csv(csv, start)
    return start, state, [log.read_csv(csv, config.run.num_seeds)]


def _tell(done: int, metrics, sinks, progress_fn, say) -> None:
    """Hand a chunk's metrics to every log, and its last row to `progress_fn`."""
    table = log.rows(metrics)
    for sink in sinks:
        _attempt(sink.name, partial(sink.write, table), say)
    if progress_fn:
        progress_fn(done, {name: value[-1] for name, value in metrics.items()})


def _save(config, program, workdir, checkpoints, done, state, metrics, about, say) -> None:
    """A checkpoint, and the policy as it is now in a file that can be played at once."""
    from dynappo import checkpoint, render

    worth = float(np.mean(metrics["episode_return"][-1]))
    _attempt("the checkpoint before", partial(checkpoint.finish, checkpoints), say)
    save = partial(checkpoint.save, checkpoints, done, state, worth, **about)
    _attempt(f"checkpoint {done}", save, say)
    params = best_params(state, metrics)
    _attempt("policy.npz", partial(render.save_params, workdir / "policy.npz", params), say)


def _attempt(what: str, action: Callable[[], Any], say) -> None:
    try:
        action()
    except Exception as error:  # OSError, or what orbax makes of it
        reason = getattr(error, "strerror", None) or str(error).strip().split("\n")[0][:160]
        say(f"{what} could not be written ({reason}); training goes on")


def _at_end(evaluation: dict, rows: int) -> dict[str, np.ndarray]:
    """Columns `eval_*` `[I]` with the numbers in the last row, NaN above."""
    columns = {}
    for name, value in evaluation.items():
        value = np.asarray(value)
        columns[f"eval_{name}"] = np.full((rows, *value.shape), np.nan)
        columns[f"eval_{name}"][-1] = value
    return columns


def check_finite(metrics, state, before, workdir: Path | None) -> None:
    """FloatingPointError naming the first number of a chunk that is not finite.

    An iteration's numbers are looked at in the order in which they are computed: rewards, model,
    losses. Where a robot's row was the first to be wrong, `workdir/nonfinite.npz` holds that robot
    as it was `before` the chunk, to be replayed.
    """
    robots = np.asarray(metrics.pop("nonfinite_robot"))  # [I], or [I, S]
    problem = log.first_nonfinite(metrics)
    if problem is None:
        bad = log.nonfinite_leaf({"learner": state.learner, "model": state.model})
        if bad is None:
            return
        problem = (bad, int(metrics["iteration"][-1]))
    name, iteration = problem
    where = "no robot's row was"
    i = list(metrics["iteration"]).index(iteration)
    if workdir and (robots[i] >= 0).any():
        seed = int((robots[i] >= 0).argmax())
        index = (int(robots[i]),) if robots.ndim == 1 else (seed, int(robots[i][seed]))
        arrays = {k: np.asarray(leaf[index]) for k, leaf in log.paths(before).items()}
        arrays |= {"iteration": np.array(metrics["iteration"][0]), "robot": np.array(index[-1])}
        np.savez(workdir / "nonfinite.npz", allow_pickle=False, **arrays)
        where = f"robot {index[-1]}, as it was before, is in {workdir / 'nonfinite.npz'}"
    raise FloatingPointError(
        f"{name} is not finite in iteration {iteration}: training has blown up ({where}). Lower "
        "ppo.learning_rate or model.learning_rate, or shorten the tail; the last checkpoint is good"
    )


def finish(config, program: Program, workdir: Path, state, metrics) -> dict[str, Any]:
    """Evaluate, write policy.npz, summary.json and the film; returns the summary."""
    from dynappo import render

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
