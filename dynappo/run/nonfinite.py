"""Finds the first number of a run that is not finite, and saves the robot that it came from."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dynappo.config import shell, terms
from dynappo.policy import checkpoint_file
from dynappo.program import distributed
from dynappo.run import checkpoint

OF_A_FIT = "model_loss", "model_loss_before"  # NaN in iterations without a fit


def check(
    metrics,
    columns,
    networks,
    before: Callable[[], Any],
    workdir: Path | None,
    own: terms.Terms = terms.NONE,
) -> None:
    """FloatingPointError naming the first number of a chunk that is not finite.

    `columns` are the chunk's rows of the schedule, `networks` all parameters after it, `own` the terms of
    one's own, which the line names first. An iteration's numbers are checked in the order in which they are
    computed: rewards, model, losses. If a robot's row was the first to be wrong, `workdir/nonfinite.npz`
    keeps that robot as it was before the chunk, to be replayed; `before()` returns the environment states and
    bodies before the chunk.
    """
    robots = np.asarray(metrics.pop("nonfinite_robot"))  # [I], or [I, S]
    problem = first_metric(metrics, columns.get("model_epochs"))
    if problem is None:
        bad = first_leaf(networks)
        if bad is None:
            return
        problem = (bad, int(metrics["iteration"][-1]))
    name, iteration = problem
    where = "no robot's row was"
    i = list(metrics["iteration"]).index(iteration)
    bad_robot = (robots[i] >= 0).any()
    if bad_robot:
        seed = int((robots[i] >= 0).argmax())
        index = (int(robots[i]),) if robots.ndim == 1 else (seed, int(robots[i][seed]))
        where = f"first a reward or an observation of robot {index[-1]}"
    if workdir and bad_robot:
        there = checkpoint.paths(distributed.whole(before()))
        arrays = {k: np.asarray(leaf[index]) for k, leaf in there.items()}
        arrays |= {"iteration": np.array(metrics["iteration"][0]), "robot": np.array(index[-1])}
        if distributed.first():
            np.savez(workdir / "nonfinite.npz", allow_pickle=False, **arrays)
        where += f"; robot {index[-1]}, as it was before, is in {workdir / 'nonfinite.npz'}"
    kept = workdir and checkpoint_file.iterations(workdir / "checkpoints")
    if bad_robot and iteration == 1 and not own.path:
        raise FloatingPointError(
            f"{name} is not finite in iteration 1 ({where}). Nothing had been learned before, so it is the "
            "environment's own: see what its reset and step compute (a division by 0, a root or logarithm?); "
            "of a robot's task, its numbers in the config"
        )
    raise FloatingPointError(
        f"{name} is not finite in iteration {iteration}: training has blown up ({where}). "
        f"{_of_terms(name, own)} ppo.desired_kl (where ppo.adaptive is False, ppo.learning_rate) or "
        "model.learning_rate, shorten the tail, or set model.bound; "
        + ("the last checkpoint is good" if kept else "nothing has been saved yet")
    )


def _of_terms(name: str, own: terms.Terms) -> str:
    """How the advice begins, where the metric `name` is not finite."""
    if not own.path:
        return "Lower"
    term = name.removeprefix("reward_")
    what = f"The reward term {term}" if term in own.rewards else "A term"
    path = shell.relative(own.path)
    return f"{what} of {path} may not be finite (a division by 0?): see there first. Else lower"


def first_metric(metrics: dict[str, np.ndarray], epochs=None) -> tuple[str, int] | None:
    """`(name, iteration)` of the first number that is not finite, in the order of computation.

    The mean return and length are undefined before the first episode has ended, the losses of a fit
    where the model has 0 `epochs` [I].
    """

    def stage(name):
        stages = ("reward_", "velocity_", "yaw_", "model_", "value_", "surrogate_")
        return next((i for i, s in enumerate(stages) if name.startswith(s)), len(stages))

    undefined = ("episode_return", "episode_length")
    names = sorted((n for n in metrics if n not in undefined and n[:5] != "eval_"), key=stage)
    for i, iteration in enumerate(metrics["iteration"]):
        fits = epochs is None or epochs[i] > 0
        for name in names if fits else [name for name in names if name not in OF_A_FIT]:
            if not np.isfinite(metrics[name][i]).all():
                return name, int(iteration)
    return None


def first_leaf(tree: Any) -> str | None:
    """Path of the first array of a tree of parameters with a number that is not finite."""
    named = checkpoint.paths(tree)
    finite = np.asarray(_finite()(list(named.values())))  # a bool a leaf is all that is transferred
    return next((name for name, ok in zip(named, finite, strict=True) if not ok), None)


@functools.cache
def _finite():
    """The compiled check of `first_leaf`: a list of arrays to one bool each."""
    import jax
    import jax.numpy as jnp

    return jax.jit(lambda leaves: jnp.array([jnp.isfinite(leaf).all() for leaf in leaves], bool))
