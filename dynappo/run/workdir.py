"""The folder of a run: open it, resume it, save into it."""

from __future__ import annotations

import contextlib
import difflib
import errno
import itertools
import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.config import ConfigError, files, versions
from dynappo.policy import checkpoint_file, policy_file, policy_source
from dynappo.program import distributed
from dynappo.run import log, worth

# what may differ when a run goes on: nothing of it changes a number that training computes
MAY_CHANGE = (
    "run.num_iterations run.log_every run.checkpoint_every run.eval_every run.eval_envs run.eval_steps "
    "run.video_seconds run.device run.mesh_seed run.mesh_env run.tensorboard run.wandb run.logs "
    "physics.impl physics.threads task.terms"
).split()
# what runs write into their folder, `evaluate` too, and what people film or export into it
WRITTEN = (
    "config.json* lock metrics.csv* checkpoints damaged-* events* policy.npz* summary.json* curves.png* "
    "video.mp4* nonfinite.* restored_from* wandb* evaluation* *.html *.mp4 *.gif *.png *.onnx"
).split()
# what summary.json needs of every row
SUMMED = ("episode_return", "episodes", "episode_return_sum")


# open folders that were not there before: these and those above them, and what their config.json says
_MADE: dict[Path, tuple[list[Path], str]] = {}


class OpenRun(NamedTuple):
    """A run that trains: its config, its open folder, and the metrics of its iterations so far."""

    config: Any
    workdir: Any  # its Path; None: nothing is written
    checkpoints: Any  # `checkpoint.Checkpoints`; None where another process writes, or none does
    sinks: list[log.Sink]
    history: list[dict[str, np.ndarray]]  # a chunk each, the first of what was done before; grows
    # what computed its iterations (`made_by`), the newest last; several where it was resumed elsewhere
    origins: tuple[dict[str, str], ...] = ()

    def metrics(self) -> dict[str, np.ndarray]:
        """The metrics of all iterations that are done, as columns."""
        return log.join(self.history)

    def iterations(self) -> int:
        """How many iterations are done."""
        return int(self.history[-1]["iteration"][-1]) if self.history else 0


def source(text: str) -> Path:
    """What `--restore=text` means: a bundled policy by its name (`./go1_deploy` is a folder), or a path."""
    with contextlib.suppress(ConfigError):  # a robot that has no policy
        return policy_source.meant(text)
    return Path(text)


@contextlib.contextmanager
def open_workdir(workdir: Path, config, fresh: bool = False, say=lambda text: None):
    """The folder of a run with its config.json, closed to other processes until the `with` ends.

    If a run has begun in it, only fields that do not change what is computed may differ (`MAY_CHANGE`): a run
    can be made longer or filmed again. `say` reports a run of another version of dynappo. `fresh` moves the
    run that is there to `WORKDIR.old-1`, and starts anew. A new folder is removed if the `with` fails before
    anything is computed. Of several processes the first does all this.
    """
    with contextlib.ExitStack() as held:
        distributed.on_first(lambda: _open(workdir, config, fresh, held, say))
        yield workdir


def _open(workdir: Path, config, fresh: bool, held: contextlib.ExitStack, say) -> None:
    try:
        if problem := in_checkpoint(workdir):
            raise ConfigError(problem)
        if fresh and _movable(workdir):
            say(f"the run that was there is {move_aside(workdir)} now")
        missing = [folder for folder in (workdir, *workdir.parents) if not folder.exists()]
        workdir.mkdir(parents=True, exist_ok=True)
        held.enter_context(hold(workdir))
        if missing:
            _MADE[workdir] = missing, config_lib.to_json(config) + "\n"
            held.enter_context(_removed_if_unused(workdir))
        for name in ("config.json", "metrics.csv", "restored_from"):
            files.check_regular(workdir / name)
        text, path = config_lib.to_json(config), workdir / "config.json"
        _compare(workdir, text)
        there = path.read_bytes().decode(errors="replace") if path.exists() else ""
        apart = config_lib.versions_apart(there, config) if begun(workdir) else ""
        if apart:
            say(apart)
        policy_source.check_same_robot(workdir, _about_newest(workdir), config.robot)
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


def new_folders() -> list[Path]:
    """The open folders that were not there before."""
    return [*_MADE]


@contextlib.contextmanager
def _removed_if_unused(workdir: Path):
    """`remove_made` where the `with` fails."""
    try:
        yield
    except BaseException:
        remove_made(workdir)
        raise
    finally:
        del _MADE[workdir]


def remove_made(workdir: Path) -> None:
    """Remove a folder that this process has made, if it holds only what `open_workdir` wrote into it."""
    if workdir not in _MADE:
        return
    missing, text = _MADE[workdir]
    ours = {"config.json": text, "lock": files.holder()}
    with contextlib.suppress(OSError, ValueError):
        there = [*workdir.iterdir()]
        own = all(path.name in ours and path.read_text() == ours[path.name] for path in there)
        for path in there if own else ():
            path.unlink()
        for folder in missing if own else ():
            folder.rmdir()  # those above may hold another run by now


def _compare(workdir: Path, here: str) -> None:
    """ConfigError if a run with another config has begun in `workdir`, or config.json is of something else.

    The config in the newest good checkpoint must agree too, and replaces a config.json that is lost.
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
    kept = _about_newest(workdir).get("config")
    for text in [there] * ours + [json.dumps(kept)] * (bool(kept) or not ours):
        changed = config_lib.difference(text, here, _may_change(text))
        if changed:
            raise ConfigError(
                f"--workdir={workdir} holds a run of another config ({changed}); "
                "choose another folder, or --fresh to move that run aside"
            )


def in_checkpoint(workdir: Path) -> str:
    """The line on a folder that is a checkpoint, in one, or among those of a run; "" of any other.

    A run in there would be played in the checkpoint's place, and lost with it.
    """
    path = Path(os.path.realpath(workdir))
    above = [path, *path.parents]
    steps = [folder for folder in above if checkpoint_file.is_one(folder)]
    runs = [folder.parent for folder in above if folder.name == "checkpoints"]
    runs = [
        run
        for run in runs
        if any(checkpoint_file.is_one(run / "checkpoints" / str(step)) for step in saved(run))
    ]
    if not steps and not runs:
        return ""
    where = "is a checkpoint, or lies in one; "
    if runs:
        where = (
            f"lies among the checkpoints of {runs[0]}; --workdir={runs[0]} goes on with that run, "
        )
    source = (steps or runs)[0]
    return f"--workdir={workdir}: {where}--restore={source} with another --workdir starts a new one from it"


def no_run(workdir: Path) -> str:
    """The line on a folder that holds no run to go on with, and the run beside it whose name is like its."""
    if problem := in_checkpoint(workdir):
        return problem
    beside = [path.parent.name for path in workdir.parent.glob("*/config.json")]
    near = difflib.get_close_matches(workdir.name, beside, 1)
    meant = f"did you mean --workdir={workdir.parent / near[0]}? " if near else ""
    return f"--workdir={workdir}: no run there to go on with; {meant}--config=NAME, as go1:laptop, starts one"


def _may_change(text: str) -> Sequence[str]:
    """`MAY_CHANGE` of a run with the config `text`; returns of longer episodes are not those that it has."""
    with contextlib.suppress(KeyError, TypeError):
        if json.loads(text)["run"]["eval_every"]:
            return [name for name in MAY_CHANGE if name != "run.eval_steps"]
    return MAY_CHANGE


def _about_newest(workdir: Path) -> dict:
    """The `about` of the newest good checkpoint; {} if there is none."""
    for step in saved(workdir):
        with contextlib.suppress(checkpoint_file.Damaged):
            about = checkpoint_file.about(workdir / "checkpoints" / str(step))
            if "config" in about:
                return about
    return {}


def kept_config(workdir: Path) -> str:
    """The config in the newest good checkpoint of a run whose config.json is lost, as JSON; "" of no run.

    ConfigError where the run has no such checkpoint.
    """
    if not os.path.isdir(workdir) or not begun(workdir):
        return ""
    if kept := _about_newest(workdir).get("config"):
        return json.dumps(kept)
    raise ConfigError(
        f"--workdir={workdir}: its config.json is lost, and there is no good checkpoint that has it; put it "
        "back, or start over with --config=NAME --fresh, which moves that run aside"
    )


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


def chunk_length(config, workdir: Path | None) -> int:
    """`run.log_every`, shortened so that every checkpoint in `workdir` lies on a chunk boundary.

    It is shorter where the run began with another `run.log_every`, or was shorter than one chunk.
    """
    done = distributed.on_first(lambda: saved(workdir)) if workdir else []
    return math.gcd(config.run.log_every, *done)


def _movable(workdir: Path) -> bool:
    """Whether there is a run that `fresh` must move; ConfigError if the folder holds anything else."""
    names = sorted(path.name for path in workdir.iterdir()) if workdir.is_dir() else []
    if not set(names) - {"lock"}:
        return False
    check_outside(workdir)
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


def check_outside(workdir: Path) -> None:
    """ConfigError if this process is in the folder that `fresh` would move."""
    if Path.cwd().is_relative_to(workdir.resolve()):
        raise ConfigError(
            f"--workdir={workdir}: --fresh cannot move the folder that you are in; call it from outside"
        )


def move_aside(workdir: Path) -> Path:
    """Rename the folder of a run, or of a sweep, to the first free `WORKDIR.old-1`, `-2`, ...; return it."""
    with hold(workdir) as lock:
        names = (workdir.with_name(f"{workdir.name}.old-{n}") for n in itertools.count(1))
        free = next(path for path in names if not path.exists())
        if sys.platform == "win32":  # which moves no folder with an open file in it
            lock.release()
        old = workdir.rename(free)
        (old / "lock").unlink(missing_ok=True)
    return old


@contextlib.contextmanager
def hold(workdir: Path):
    """Lock `workdir` for this process, by `workdir/lock`; ConfigError if another process holds it."""
    try:
        with files.locked(workdir / "lock") as lock:
            yield lock
    except files.Locked as error:
        raise ConfigError(
            f"--workdir={workdir}: another run is writing in this folder ({error}); "
            "wait for it, or take another --workdir"
        ) from None


def made_by(program, config) -> dict[str, str]:
    """What decides, beside the config, which numbers a program computes."""
    names = ["jax", "mujoco", *filter(None, [config.env.partition(":")[0]])]
    packages = {name: versions.of(name) for name in names}
    commit = versions.commit() or "unknown"
    return {"commit": commit, "engine": program.impl, "device": program.device} | packages


def origins(workdir: Path, here: dict[str, str]) -> tuple[dict[str, str], ...]:
    """What has computed the run in `workdir` so far, by its newest checkpoint; then `here`, which goes on."""
    kept = [one for one in _about_newest(workdir).get("origins", []) if isinstance(one, dict)]
    return (*kept, here) if kept[-1:] != [here] else tuple(kept)


def _elsewhere(found: tuple[dict[str, str], ...]) -> str:
    """Words on how the newest of `origins` differs from the one before; "" where there is none."""
    was, now = [*found[:1], *found][-2:] if found else ({}, {})
    apart = [f"{n} {now[n]} ({was[n]} before)" for n in now if was.get(n, now[n]) != now[n]]
    return f", now with {', '.join(apart)}" if apart else ""


def check_held(workdir: Path) -> None:
    """OSError where another run has begun in `workdir`: its lock was deleted, or the disk has no locks."""
    found = ""
    with contextlib.suppress(OSError):
        found = (workdir / "lock").read_text()
    if found and found != files.holder():
        raise OSError(
            f"{workdir}: another run has begun in this folder ({found.strip()}); this one ends, before "
            "rows of both are mixed"
        )


def resume(config, workdir: Path, checkpoints, state, say, made: tuple[dict[str, str], ...] = ()):
    """`(iterations done, state, [their metrics])` of the newest good checkpoint of `workdir`.

    `made` are its `origins`. Of several processes the first reads it and sends state and iteration to the
    others. The devices may be others than those it was saved from.
    """
    history = []

    def read(state):
        start, state, found = _resume(config, workdir, checkpoints, state, say, made)
        history.extend(found)
        return start, state

    start, state = distributed.from_first(read, state)
    if start and not history:  # of several processes, only the first reads the rest
        history.append(scheduled_columns(config, start))
    return start, state, history


def _resume(config, workdir: Path, checkpoints, state, say, made):
    from dynappo.run import checkpoint

    csv = workdir / "metrics.csv"
    found = checkpoint.newest(checkpoints, state, say)
    if not found:
        log.put_aside(csv, say)  # of a run that ended before its first checkpoint
        return 0, state, []
    start, state = found
    known, seeds = scheduled_columns(config, start), config.run.num_seeds
    history = log.resume_csv(csv, known, seeds, say) | known
    blank = np.full((start, seeds) if seeds > 1 else start, np.nan)
    history = dict.fromkeys(SUMMED, blank) | {"seconds": np.full(start, np.nan)} | history
    if start < config.run.num_iterations:
        say(f"goes on from iteration {start} of {workdir}{_elsewhere(made)}")
    else:
        again = ["evaluated"] * bool(config.run.eval_envs)
        again += ["filmed"] * (config.run.video_seconds > 0)
        again = " and ".join(again) or "summed up"
        say(f"the run in {workdir} is complete ({start} iterations); it is only {again} again")
    return start, state, [history]


def scheduled_columns(config, end: int) -> dict[str, np.ndarray]:
    """Columns `[I]` of the iterations up to `end` that follow from the schedule alone."""
    n_real = np.asarray(schedule.columns(config)["n_real"], np.int64)
    columns = {
        "iteration": np.arange(1, len(n_real) + 1),
        "n_real": n_real,
        "n_synthetic": config.rollout.horizon - n_real,
        "sim_steps": np.cumsum(n_real) * config.rollout.num_envs,
    }
    return {name: column[:end] for name, column in columns.items()}


def save(run: OpenRun, robot, state, say) -> None:
    """Save a checkpoint of the last iteration of `run.history`, and policy.npz, which can be played at once.

    ConfigError if the run's first checkpoint cannot be saved, or read back, and the machine is not the
    cause: the run then ends now, not after all its iterations.
    """
    from dynappo.run import checkpoint

    state = distributed.whole(state)
    if not distributed.first():
        return
    workdir, done = run.workdir, run.iterations()
    log.attempt("the checkpoint before", partial(checkpoint.wait, run.checkpoints), say)
    first = not saved(workdir)
    try:
        begin_save(run, robot, state)
        if first:
            checkpoint.wait(run.checkpoints)
            checkpoint.read_back(workdir / "checkpoints" / str(done), state)
    except Exception as error:
        if first and done < run.config.run.num_iterations and not log.of_the_machine(error):
            reason = str(error) if isinstance(error, ConfigError) else log.reason(error)
            raise ConfigError(
                f"{workdir}: its first checkpoint cannot be saved, and the run could never be resumed "
                f"({reason}); run.checkpoint_every=0 trains to the end all the same"
            ) from None
        say(f"checkpoint {done} could not be written ({log.reason(error)}); training goes on")
    evaluated = last_evaluation(run)
    params = best_params(run.config, state.learner.params, evaluated)
    best = best_seed(run.config, evaluated)
    path, steps = workdir / "policy.npz", int(run.history[-1]["sim_steps"][-1])
    write = partial(policy_file.save, path, params, run.config, robot, best, done, steps)
    log.attempt("policy.npz", write, say)


def begin_save(run: OpenRun, robot, state) -> None:
    """Start saving a checkpoint of the last iteration of `run.history`; errors are raised."""
    from dynappo.run import checkpoint

    last = run.history[-1]
    evaluated = last_evaluation(run)
    now = "eval_return" in last and np.isfinite(last["eval_return"][-1]).all()
    mean = {name: float(np.mean(value)) for name, value in evaluated.items()}
    checkpoint.save(
        run.checkpoints,
        run.iterations(),
        state,
        evaluation=mean if now else None,
        sim_steps=int(last["sim_steps"][-1]),
        config=run.config.to_dict(),
        mjcf=robot.alone if robot else "",
        best_seed=best_seed(run.config, evaluated) or 0,
        origins=list(run.origins),
    )


def last_evaluation(run: OpenRun) -> dict[str, Any]:
    """`log.last_evaluation` of the run; {} before one."""
    return next(filter(None, map(log.last_evaluation, reversed(run.history))), {})


def best_seed(config, evaluated: Mapping[str, Any]) -> int | None:
    """The best seed (`worth.best`) in `evaluated`, the last evaluation; None if the run has one seed.

    The first if nothing was evaluated: an exploring policy's returns would favour a seed whose
    robots have just fallen (experiments/20_tail).
    """
    if config.run.num_seeds == 1:
        return None
    return worth.best(evaluated) if evaluated else 0


def best_params(config, params, evaluated: Mapping[str, Any]) -> dict:
    """The networks as NumPy arrays; of several seeds, those of `best_seed`."""
    import jax

    best = best_seed(config, evaluated)
    return jax.tree.map(lambda p: p if best is None else p[best], jax.device_get(params))
