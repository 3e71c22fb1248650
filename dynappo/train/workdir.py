"""The folder of a run: open it, resume it, save into it."""

from __future__ import annotations

import contextlib
import errno
import itertools
import json
import math
import sys
from fnmatch import fnmatch
from functools import partial
from pathlib import Path

import numpy as np
from ml_collections import config_dict

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.config import ConfigError, files
from dynappo.policy import checkpoint_file, policy_file, source
from dynappo.program import distributed
from dynappo.train import log

# what may differ when a run goes on: nothing of it changes a number that training computes
MAY_CHANGE = (
    "run.num_iterations run.log_every run.checkpoint_every run.eval_every run.eval_envs run.eval_steps "
    "run.video_seconds run.device run.mesh_seed run.mesh_env run.tensorboard run.wandb "
    "physics.impl physics.threads"
).split()
# what runs write into their folder, `evaluate` too, and what people film or export into it
WRITTEN = (
    "config.json* lock metrics.csv* checkpoints damaged-* events* policy.npz* summary.json* curves.png "
    "video.mp4* nonfinite.* restored_from* wandb* evaluation* *.html *.mp4 *.gif *.png *.onnx"
).split()
# what summary.json needs of every row
SUMMED = ("episode_return", "episodes", "episode_return_sum")


@contextlib.contextmanager
def open_workdir(workdir: Path, config, fresh: bool = False, say=lambda text: None):
    """The folder of a run with its config.json, closed to other processes until the `with` ends.

    Where a run has begun in it, only fields that do not change what is computed may differ
    (`MAY_CHANGE`): a run can be made longer or filmed again. `fresh` moves a run that is there aside,
    to `WORKDIR.old-1`, and starts anew. Of several processes the first does all this.
    """
    with contextlib.ExitStack() as held:
        distributed.on_first(lambda: _open(workdir, config, fresh, held, say))
        yield workdir


def _open(workdir: Path, config, fresh: bool, held: contextlib.ExitStack, say) -> None:
    try:
        if fresh and _movable(workdir):
            with hold(workdir) as lock:
                number = next(n for n in itertools.count(1) if not _old(workdir, n).exists())
                if sys.platform == "win32":  # which moves no folder with an open file in it
                    lock.release()
                old = workdir.rename(_old(workdir, number))
                (old / "lock").unlink(missing_ok=True)
                say(f"the run that was there is {old} now")
        workdir.mkdir(parents=True, exist_ok=True)
        held.enter_context(hold(workdir))
        for name in ("config.json", "metrics.csv", "restored_from"):
            files.check_regular(workdir / name)
        text, path = config_lib.to_json(config), workdir / "config.json"
        _compare(workdir, text)
        source.check_same_robot(workdir, _newest(workdir), config.robot)
        done = max(saved(workdir), default=0)
        if done > config.run.num_iterations:
            raise ConfigError(
                f"run.num_iterations is {config.run.num_iterations}, but the run in {workdir} has done "
                f"{done}; expected at least as many"
            )
        files.write_text(path, text + "\n")
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):  # the machine's, not the name's
            raise
        raise ConfigError(
            f"--workdir={workdir}: cannot write there ({error.strerror}); choose another folder"
        ) from None


def _compare(workdir: Path, here: str) -> None:
    """ConfigError if `workdir` holds the config.json of another run that has begun, or of something else.

    The config in the newest good checkpoint counts as much, and stands for that file where it is lost.
    """
    path = workdir / "config.json"
    there = path.read_bytes().decode(errors="replace") if path.exists() else "{}"
    try:
        ours = {"robot", "rollout", "run"} <= json.loads(there).keys()
    except (ValueError, AttributeError, RecursionError):
        ours = False
    if not begun(workdir):
        if path.exists() and not ours:  # somebody else's file is not overwritten
            raise ConfigError(
                f"--workdir={workdir} holds a config.json that is not of a run; choose another folder"
            )
        return
    kept = _newest(workdir).get("config")
    for text in [there] * ours + [json.dumps(kept)] * (bool(kept) or not ours):
        changed = config_lib.difference(text, here, MAY_CHANGE)
        if changed:
            raise ConfigError(
                f"--workdir={workdir} holds a run of another config ({changed}); "
                "choose another folder, or --fresh to move that run aside"
            )


def _newest(workdir: Path) -> dict:
    """What the newest good checkpoint says of itself; {} if there is none."""
    for step in saved(workdir):
        with contextlib.suppress(checkpoint_file.Damaged):
            about = checkpoint_file.about(workdir / "checkpoints" / str(step))
            if "config" in about:
                return about
    return {}


def begun(workdir: Path) -> bool:
    """Whether a run has left results here: a checkpoint, also a damaged one, or a row of metrics."""
    if saved(workdir) or any(workdir.glob("damaged-*")):
        return True
    csv = workdir / "metrics.csv"
    if not csv.exists():
        return False
    with csv.open("rb") as file:
        return len(list(itertools.islice(file, 2))) > 1


def saved(workdir: Path) -> list[int]:
    """Iterations of the checkpoints of `workdir` that are complete, newest first."""
    return checkpoint_file.iterations(workdir / "checkpoints")


def in_step(config, workdir: Path | None):
    """`config`, with chunks so short that one ends at every checkpoint the run may go on from.

    They are `run.log_every` long, but where a run began with another `run.log_every`, or was shorter than
    one chunk.
    """
    done = distributed.on_first(lambda: saved(workdir)) if workdir else []
    every = math.gcd(config.run.log_every, *done)
    if every == config.run.log_every:
        return config
    config = config_dict.ConfigDict(config)
    config.run.log_every = every
    return config_dict.FrozenConfigDict(config)


def _movable(workdir: Path) -> bool:
    """Whether `fresh` has a run to move; ConfigError where the folder is more than that."""
    names = sorted(path.name for path in workdir.iterdir()) if workdir.is_dir() else []
    if not set(names) - {"lock"}:
        return False
    if Path.cwd().is_relative_to(workdir.resolve()):
        raise ConfigError(
            f"--workdir={workdir}: --fresh cannot move the folder that you are in; call it from outside"
        )
    others = [name for name in names if not any(fnmatch(name, ours) for ours in WRITTEN)]
    if not {"config.json", "checkpoints", "metrics.csv"} & set(names):
        others = others or names
    if others:
        raise ConfigError(
            f"--workdir={workdir} holds {others[0]}, which no run writes: --fresh moves runs, and nothing "
            "else; move it yourself, or choose another folder"
        )
    if "config.json" in names and not begun(workdir):
        _compare(workdir, "{}")  # somebody else's
    return True


def _old(workdir: Path, number: int) -> Path:
    return workdir.with_name(f"{workdir.name}.old-{number}")


@contextlib.contextmanager
def hold(workdir: Path):
    """Keeps other processes from holding `workdir`, by `workdir/lock`; ConfigError if one does."""
    try:
        with files.locked(workdir / "lock") as lock:
            yield lock
    except files.Locked as error:
        raise ConfigError(
            f"--workdir={workdir}: another run is writing in this folder ({error}); "
            "wait for it, or take another --workdir"
        ) from None


def resume(config, workdir: Path, checkpoints, state, say):
    """`(iterations done, state, [their metrics])` of the newest good checkpoint of `workdir`.

    Of several processes the first reads it, and the others get state and iteration from there; a
    state may come back on other devices than those it was saved from.
    """
    history = []

    def read(state):
        start, state, found = _resume(config, workdir, checkpoints, state, say)
        history.extend(found)
        return start, state

    start, state = distributed.from_first(read, state)
    if start and not history:  # of several processes, only the first reads the rest
        history.append(counted(config, start))
    return start, state, history


def _resume(config, workdir: Path, checkpoints, state, say):
    from dynappo.train import checkpoint

    csv = workdir / "metrics.csv"
    found = checkpoint.newest(checkpoints, state, say)
    if not found:
        log.put_aside(csv, say)  # of a run that ended before its first checkpoint
        return 0, state, []
    start, state = found
    known, seeds = counted(config, start), config.run.num_seeds
    history = log.go_on_csv(csv, known, seeds, say) | known
    blank = np.full((start, seeds) if seeds > 1 else start, np.nan)
    history = dict.fromkeys(SUMMED, blank) | {"seconds": np.full(start, np.nan)} | history
    if start < config.run.num_iterations:
        before = (
            _newest(workdir).get("config", {}).get("physics", {}).get("impl", config.physics.impl)
        )
        other = f", now with physics.impl={config.physics.impl}, {before} before"
        other = "" if before == config.physics.impl else other
        say(f"goes on from iteration {start} of {workdir}{other}")
    else:
        again = ["evaluated"] * bool(config.run.eval_envs) + ["filmed"] * (
            config.run.video_seconds > 0
        )
        again = " and ".join(again) or "summed up"
        say(f"the run in {workdir} is complete ({start} iterations); it is only {again} again")
    return start, state, [history]


def counted(config, end: int) -> dict[str, np.ndarray]:
    """Columns `[I]` of the iterations up to `end` that follow from the schedule alone."""
    n_real = np.asarray(schedule.columns(config)["n_real"], np.int64)
    columns = {
        "iteration": np.arange(1, len(n_real) + 1),
        "n_real": n_real,
        "n_synthetic": config.rollout.horizon - n_real,
        "sim_steps": np.cumsum(n_real) * config.rollout.num_envs,
    }
    return {name: column[:end] for name, column in columns.items()}


def save(config, robot, workdir, checkpoints, done: int, state, metrics, evaluated, say) -> None:
    """A checkpoint, and the policy as it is now in a file that can be played at once.

    `evaluated` is the return of the last evaluation, of each seed if there are several; None before one.
    ConfigError if the run's first checkpoint cannot be saved, or read back, for a reason that is not the
    machine's: the run ends now, not after all its iterations.
    """
    from dynappo.train import checkpoint

    state = distributed.whole(state)
    if not distributed.first():
        return
    log.attempt("the checkpoint before", partial(checkpoint.wait, checkpoints), say)
    first = not saved(workdir)
    try:
        keep(config, robot, checkpoints, done, state, metrics, evaluated)
        if first:
            checkpoint.wait(checkpoints)
            checkpoint.read_back(workdir / "checkpoints" / str(done), state)
    except Exception as error:
        if first and done < config.run.num_iterations and not log.of_the_machine(error):
            reason = str(error) if isinstance(error, ConfigError) else log.reason(error)
            raise ConfigError(
                f"{workdir}: its first checkpoint cannot be saved, and the run could never be resumed "
                f"({reason}); run.checkpoint_every=0 trains to the end all the same"
            ) from None
        say(f"checkpoint {done} could not be written ({log.reason(error)}); training goes on")
    params = best_params(config, state.learner.params, evaluated)
    best = best_seed(config, evaluated)
    write = partial(policy_file.save, workdir / "policy.npz", params, config, robot, best)
    log.attempt("policy.npz", write, say)


def keep(config, robot, checkpoints, done: int, state, metrics, evaluated) -> None:
    """Start saving a checkpoint; raises what is in the way."""
    from dynappo.train import checkpoint

    about = {"sim_steps": int(metrics["sim_steps"][-1]), "config": config.to_dict()}
    about |= {"mjcf": robot.alone if robot else "", "best_seed": best_seed(config, evaluated) or 0}
    now = "eval_return" in metrics and np.isfinite(metrics["eval_return"][-1]).all()
    worth = float(np.mean(evaluated)) if now else None
    checkpoint.save(checkpoints, done, state, worth, **about)


def best_seed(config, evaluated) -> int | None:
    """The number of the best of several seeds in the evaluation `evaluated`; None where there is one.

    The first where nothing was evaluated: an exploring policy's returns would favour a seed whose
    robots have just fallen (experiments/20_tail).
    """
    if config.run.num_seeds == 1:
        return None
    return 0 if evaluated is None else int(np.nan_to_num(evaluated, nan=-np.inf).argmax())


def best_params(config, params, evaluated) -> dict:
    """The networks as NumPy arrays; of several seeds, those of `best_seed`."""
    import jax

    best = best_seed(config, evaluated)
    return jax.tree.map(lambda p: p if best is None else p[best], jax.device_get(params))
