"""The folder of a run: opened, gone on with, saved into, and what is left there when numbers blow up."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dynappo import config as config_lib
from dynappo import distributed, log
from dynappo.config import ConfigError

RETURN_ROWS = 10  # the return of a run is the mean of its last rows
# what may differ when a run goes on: nothing of it changes a number of the iterations before
MAY_CHANGE = (
    "run.num_iterations run.checkpoint_every run.eval_every run.eval_envs run.video_seconds "
    "run.time_phases run.device run.mesh_seed run.mesh_env run.tensorboard run.wandb physics.impl"
).split()


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
    if start > config.run.num_iterations:
        raise ConfigError(
            f"run.num_iterations is {config.run.num_iterations}, but the run in {workdir} has done "
            f"{start}; expected at least as many"
        )
    log.cut_csv(csv, start)
    return start, state, [log.read_csv(csv, config.run.num_seeds)]


def save(
    config, robot, workdir, checkpoints, done: int, state, metrics, sim_steps: int, say
) -> None:
    """A checkpoint, and the policy as it is now in a file that can be played at once."""
    from dynappo import checkpoint, policy_file

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
