"""The folder of a run: opened, gone on with, saved into, and what is left there when numbers blow up."""

from __future__ import annotations

import contextlib
import errno
import itertools
import json
import os
import socket
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dynappo import config as config_lib
from dynappo import distributed, log, policy_file
from dynappo.config import ConfigError

RETURN_ROWS = 10  # the return of a run is the mean of its last rows
# what may differ when a run goes on: nothing of it changes a number of the iterations before
MAY_CHANGE = (
    "run.num_iterations run.checkpoint_every run.eval_every run.eval_envs run.video_seconds "
    "run.time_phases run.device run.mesh_seed run.mesh_env run.tensorboard run.wandb physics.impl"
).split()
NO_FLOCK = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # of some file systems


@contextlib.contextmanager
def open_workdir(workdir: Path, config, fresh: bool = False):
    """The folder of a run with its config.json, closed to other processes until the `with` ends.

    Where a run has begun in it, only fields that do not change what is computed may differ
    (`MAY_CHANGE`): a run can be made longer or filmed again. `fresh` moves a run that is there aside,
    to `WORKDIR.old-1`, and starts anew. Of several processes the first does all this.
    """
    with contextlib.ExitStack() as held:
        distributed.on_first(lambda: _open(workdir, config, fresh, held))
        yield workdir


def _open(workdir: Path, config, fresh: bool, held: contextlib.ExitStack) -> None:
    try:
        if fresh and workdir.exists():
            with _hold(workdir):
                number = next(n for n in itertools.count(1) if not _old(workdir, n).exists())
                old = workdir.rename(_old(workdir, number))
                (old / "lock").unlink(missing_ok=True)
        workdir.mkdir(parents=True, exist_ok=True)
        held.enter_context(_hold(workdir))
        text, path = config_lib.to_json(config), workdir / "config.json"
        if path.exists():
            _compare(workdir, path.read_text(), text)
        done = max(steps(workdir), default=0)
        if done > config.run.num_iterations:
            raise ConfigError(
                f"run.num_iterations is {config.run.num_iterations}, but the run in {workdir} has done "
                f"{done}; expected at least as many"
            )
        log.write_text(path, text + "\n")
    except OSError as error:
        raise ConfigError(
            f"--workdir={workdir}: cannot write there ({error.strerror}); choose another folder"
        ) from None


def _compare(workdir: Path, there: str, here: str) -> None:
    """ConfigError if the config.json of `workdir` is that of another run, which has begun."""
    if _begun(workdir):
        changed = config_lib.difference(there, here, MAY_CHANGE)
        if changed:
            raise ConfigError(
                f"--workdir={workdir} holds a run of another config ({changed}); "
                "choose another folder, or --fresh to move that run aside"
            )
        return
    try:  # somebody else's file is not overwritten
        ours = {"robot", "rollout", "run"} <= json.loads(there).keys()
    except (ValueError, AttributeError):
        ours = False
    if not ours:
        raise ConfigError(
            f"--workdir={workdir} holds a config.json that is not of a run; choose another folder"
        )


def _begun(workdir: Path) -> bool:
    """Whether a run has left results here: a checkpoint, also a damaged one, or a row of metrics."""
    if steps(workdir) or any(workdir.glob("damaged-*")):
        return True
    csv = workdir / "metrics.csv"
    if not csv.exists():
        return False
    with csv.open() as file:
        return len(list(itertools.islice(file, 2))) > 1


def steps(workdir: Path) -> list[int]:
    """Iterations of the checkpoints of `workdir` that are complete, newest first."""
    return policy_file.steps(workdir / "checkpoints")


def _old(workdir: Path, number: int) -> Path:
    return workdir.with_name(f"{workdir.name}.old-{number}")


@contextlib.contextmanager
def _hold(workdir: Path):
    """Keeps other processes from holding `workdir`; ConfigError if one does.

    It is `flock` on `workdir/lock`, which ends with the process, however that ends: a file that a
    killed run leaves behind holds nobody up. File systems without it go without.
    """
    if sys.platform == "win32":
        yield
        return
    with _locked(workdir / "lock") as file:
        try:
            yield
        finally:
            with contextlib.suppress(OSError):  # the folder may be gone, or moved aside
                if os.path.samestat(os.fstat(file.fileno()), (workdir / "lock").stat()):
                    (workdir / "lock").unlink()


def _locked(path: Path):
    """The file `path`, opened and locked, with the name of this process in it."""
    import fcntl

    while True:
        file = path.open("a+")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # what was locked may have been removed, by a run that ended after it was opened here
            there = path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat())
        except BlockingIOError:
            file.seek(0)
            who = file.read().strip()
            file.close()
            raise ConfigError(
                f"--workdir={path.parent}: another run is writing in this folder ({who}); "
                "wait for it, or take another --workdir"
            ) from None
        except OSError as error:
            if error.errno not in NO_FLOCK:
                file.close()
                raise
            there = True
        if there:
            break
        file.close()
    file.truncate(0)
    file.write(f"pid {os.getpid()} on {socket.gethostname()}\n")
    file.flush()
    return file


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
    return start, state, history


def _resume(config, workdir: Path, checkpoints, state, say):
    from dynappo import checkpoint

    csv = workdir / "metrics.csv"
    found = checkpoint.restore(checkpoints, state, say)
    if not found:
        csv.unlink(missing_ok=True)  # of a run that ended before its first checkpoint
        return 0, state, []
    start, state = found
    if not csv.exists():
        raise ConfigError(f"{workdir} has checkpoints but no metrics.csv; choose another --workdir")
    log.cut_csv(csv, start)
    if start < config.run.num_iterations:
        say(f"goes on from iteration {start} of {workdir}")
    else:
        again = ["evaluated"] * bool(config.run.eval_envs) + ["filmed"] * (
            config.run.video_seconds > 0
        )
        again = " and ".join(again) or "summed up"
        say(f"the run in {workdir} is complete ({start} iterations); it is only {again} again")
    return start, state, [log.read_csv(csv, config.run.num_seeds)]


def save(
    config, robot, workdir, checkpoints, done: int, state, metrics, sim_steps: int, say
) -> None:
    """A checkpoint, and the policy as it is now in a file that can be played at once."""
    from dynappo import checkpoint

    state = distributed.whole(state)
    if not distributed.first():
        return
    about = {"sim_steps": sim_steps, "config": config.to_dict()}
    worth = float(np.mean(metrics["episode_return"][-1]))
    attempt("the checkpoint before", partial(checkpoint.finish, checkpoints), say)
    save = partial(checkpoint.save, checkpoints, done, state, worth, **about)
    attempt(f"checkpoint {done}", save, say)
    params = best_params(state.learner.params, metrics)
    attempt(
        "policy.npz", partial(policy_file.save, workdir / "policy.npz", params, config, robot), say
    )


def attempt(what: str, action: Callable[[], Any], say) -> None:
    """Do `action`; where it fails, `say` so in one line and go on."""
    try:
        action()
    except Exception as error:  # OSError, or what orbax makes of it
        reason = getattr(error, "strerror", None) or str(error).strip().split("\n")[0][:160]
        say(f"{what} could not be written ({reason}); training goes on")


def best_params(params, metrics) -> dict:
    """The networks as NumPy arrays; of the seed with the highest return, where there are several."""
    import jax

    params = jax.device_get(params)
    worth = np.nan_to_num(metrics["episode_return"][-RETURN_ROWS:], nan=-np.inf).mean(0)
    return jax.tree.map(lambda p: p[int(worth.argmax())], params) if worth.ndim else params


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
        before = distributed.whole(before)
        seed = int((robots[i] >= 0).argmax())
        index = (int(robots[i]),) if robots.ndim == 1 else (seed, int(robots[i][seed]))
        arrays = {k: np.asarray(leaf[index]) for k, leaf in log.paths(before).items()}
        arrays |= {"iteration": np.array(metrics["iteration"][0]), "robot": np.array(index[-1])}
        if distributed.first():
            np.savez(workdir / "nonfinite.npz", allow_pickle=False, **arrays)
        where = f"robot {index[-1]}, as it was before, is in {workdir / 'nonfinite.npz'}"
    raise FloatingPointError(
        f"{name} is not finite in iteration {iteration}: training has blown up ({where}). Lower "
        "ppo.learning_rate or model.learning_rate, or shorten the tail; the last checkpoint is good"
    )
