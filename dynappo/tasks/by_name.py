"""Environments of other packages, by a name in the config: `config.env` = "playground:TASK" or "brax:NAME".

Each maker is a module of this folder. `program` calls these functions and knows no package.
"""

from __future__ import annotations

import contextlib
import difflib
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, NamedTuple

from dynappo.config import ConfigError
from dynappo.tasks import names

if TYPE_CHECKING:  # it imports JAX
    from dynappo.types import Env

PACKAGES = ("playground", "brax")


class Made(NamedTuple):
    """An environment, and how its evaluation is traced."""

    env: Env
    evaluating: AbstractContextManager = (
        contextlib.nullcontext()
    )  # in which an evaluation is traced
    engine: str = "own"  # which then steps it


def check(config) -> None:
    """ConfigError if there is no such environment, or `config` cannot train it; compiles nothing."""
    package, _, name = config.env.partition(":")
    if package == "playground":
        from dynappo.tasks.playground import loading

        if config.physics.impl == "c":
            raise ConfigError(
                f"physics.impl is c, expected jax or warp for {config.env}: a Playground task is MJX's"
            )
        loading.check(name)
    elif package == "brax":
        check_brax(name)
    else:
        raise ConfigError(f"env is {config.env!r}, expected playground:TASK or brax:NAME")


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
        from brax import envs

        from dynappo.tasks import brax_env

        bare = envs.get_environment(name, backend="spring")
        size, length = bare.observation_size, config.task.episode_length
        return Made(brax_env.from_brax(bare, size, length, random_clock=config.task.random_clock))
    env, task = _playground(config, impl)
    if impl != "jax" or platform != "cpu" or config.run.num_seeds > 1:
        return Made(env, engine=impl)
    from dynappo.tasks.playground import c_physics

    return Made(env, c_physics.physics(task), "c")


def _playground(config, impl: str) -> tuple[Env, Any]:
    """The environment, and Playground's object of the task."""
    from dynappo.tasks.playground import env, loading

    run, name = config.run, config.env.partition(":")[2]
    # of the robots of all seeds on one device, in training or in an evaluation
    worlds = max(config.rollout.num_envs, run.eval_envs) * run.num_seeds
    loaded = loading.load(name, impl, -(-worlds // (run.mesh_seed * run.mesh_env)))
    own = config.task.episode_length, config.task.random_clock, config.ppo.symmetry
    return env.make(loaded.task, *own, known_reward=config.model.known_reward), loaded.task


def check_brax(name: str) -> None:
    """ConfigError if brax has no such environment; it names the near ones."""
    known = names.registered("brax", "envs")
    if name not in known:
        shown = [each for each in known if each != "fast"]  # of brax's own tests
        near = difflib.get_close_matches(name, shown, 3, 0.5) or shown
        raise ConfigError(f"brax has no environment {name!r}; there is {', '.join(near)}")
