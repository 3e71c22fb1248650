"""Environments of other packages, by a name in the config: `config.env` = "playground:TASK" or "brax:NAME".

Each maker is a module of this folder. `program` calls these functions and knows no package.
"""

from __future__ import annotations

import contextlib
import functools
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, NamedTuple

from dynappo.config import ConfigError
from dynappo.tasks import names

if TYPE_CHECKING:  # they import JAX
    from dynappo.tasks.single import Single
    from dynappo.types import Env


class Made(NamedTuple):
    """An environment, and how its evaluation is traced."""

    env: Env
    evaluating: AbstractContextManager = (
        contextlib.nullcontext()
    )  # in which an evaluation is traced
    engine: str = "own"  # which then steps it


def check(config) -> None:
    """ConfigError if there is no such environment, or `config` cannot train it; compiles nothing.

    Whether a Playground task has the mirror image that `ppo.symmetry` asks for, `make` tells.
    """
    names.check(config.env)
    package, _, name = config.env.partition(":")
    engines = {"playground": ("auto", "jax", "warp"), "brax": ("auto", "jax")}[package]
    if (impl := config.physics.impl) not in engines:
        expected, whose = " or ".join(engines[1:]), "a Playground task is MJX's"
        whose = whose if package == "playground" else "brax has physics of its own"
        raise ConfigError(f"physics.impl is {impl}, expected {expected} for {config.env}: {whose}")
    if config.ppo.scale_inputs:
        raise ConfigError(
            f"ppo.scale_inputs is True, expected False: {config.env} has no scale of its inputs; "
            "ppo.normalize=True learns one"
        )
    if package == "playground":
        from dynappo.tasks.playground import loading

        loading.check(name)
        return
    if config.ppo.symmetry:
        raise ConfigError(
            f"ppo.symmetry is True, expected False: no mirror image of {config.env} is known"
        )
    from dynappo.tasks import brax_named

    brax_named.bare(name)


def about(config) -> str:
    """A line on where the environment comes from, or ""."""
    package, _, name = config.env.partition(":")
    if package != "playground":
        return ""
    from dynappo.tasks.playground import loading

    return loading.check(name)


def make(config, *, impl: str, platform: str) -> Made:
    """The environment of `config`, which was checked, stepped by the engine `impl` on JAX's `platform`.

    With "jax" on a "cpu" a Playground task is evaluated with C MuJoCo's physics, which compile and run faster
    there than MJX; of one run and one seed, for these physics have one axis of robots.
    """
    package, _, name = config.env.partition(":")
    if package == "brax":
        from dynappo.tasks import brax_named

        task = config.task
        return Made(brax_named.make(name, task.episode_length, task.random_clock))
    env, task = _playground(config, impl)
    if impl != "jax" or platform != "cpu" or config.run.num_seeds > 1:
        return Made(env, engine=impl)
    from dynappo.tasks.playground import c_physics

    return Made(env, c_physics.physics(task), "c")


def _playground(config, impl: str) -> tuple[Env, Any]:
    """The environment, and Playground's object of the task."""
    run, name = config.run, config.env.partition(":")[2]
    # of the robots of all seeds on one device, in training or in an evaluation
    worlds = max(config.rollout.num_envs, run.eval_envs) * run.num_seeds
    worlds = -(-worlds // (run.mesh_seed * run.mesh_env))
    own = config.task.episode_length, config.task.random_clock, config.ppo.symmetry
    return _playground_task(name, impl, worlds, *own, config.model.known_reward)


@functools.lru_cache(maxsize=1)
def _playground_task(name: str, impl: str, worlds: int, *own) -> tuple[Env, Any]:
    """Kept, because a check may make what is trained next: to probe a task takes some seconds."""
    from dynappo.tasks.playground import env, loading

    task = loading.load(name, impl, worlds).task
    return env.make(task, *own), task


def single(name: str) -> Single:
    """One robot of the environment `name`, to be looked at; ConfigError where there is none to see."""
    names.check(name)
    package, _, name = name.partition(":")
    if package == "brax":
        from dynappo.tasks import brax_named

        return brax_named.single(name)
    from dynappo.tasks.playground import single

    return single.make(name)


def facts(name: str) -> dict[str, Any]:
    """What a controller needs to know of the environment `name`, beside a policy; ConfigError as `single`."""
    names.check(name)
    package, _, task = name.partition(":")
    if package == "brax":
        from dynappo.tasks import brax_named

        found = brax_named.facts(task)
    else:
        from dynappo.tasks.playground import single

        found = single.facts(task)
    return {"task": name, "package": package} | found
