"""What a config means for an environment of your own; tasks/env_contract.py checks the environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ml_collections import config_dict

from dynappo import config as config_lib
from dynappo.config import ConfigError

# fields that types.Env had until 2026-11-25 -> what has taken their place
GONE = {"context": "advance", "noise": "sense", "bias": "sense"}


def config_for(config, env: Any) -> Any:
    """The validated config of a run with `env`, as config.json has it; without `env`, `config`.

    `robot` is "", there is no film and no choice of engine, and episodes have the length of
    `env`'s.
    """
    if env is None:
        return config
    _check_kind(env)
    config = config_dict.ConfigDict(config)
    config.robot = ""
    config.run.video_seconds = 0.0
    config.physics.impl = "jax"
    config.task.episode_length = int(env.episode_length)
    return config_lib.validate(config)


def from_file(get_env: Callable[[Any], Any] | None, config) -> tuple[Any, Any]:
    """`(config, environment)` of a config file: `config_for` what get_env returned; or None."""
    if get_env is None:
        return config, None
    if config.env:
        raise ConfigError(
            f"env is {config.env!r}, but the config's file defines get_env; expected ''"
        )
    if config.robot:
        raise ConfigError(
            f"robot is {config.robot!r}, but the config's file defines get_env, which says what is trained; "
            "expected no robot: leave it out"
        )
    try:
        env = get_env(config)
    except TypeError as error:
        gone = [name for name in GONE if f"keyword argument '{name}'" in str(error)]
        if not gone:
            raise
        raise ConfigError(
            f"get_env of the config's file gives types.Env the field {gone[0]}, expected {GONE[gone[0]]} "
            "in its place; docs/environment.md says what that is a function of"
        ) from None
    _check_kind(env)
    return config_for(config, env), env


def set_log(config, path: str) -> None:
    """Set the log that a run learns from, `run.logs`, and its hash; ConfigError if it cannot be read."""
    from dynappo.tasks.velocity import log_file

    config.run.update(logs=path, logs_hash=log_file.digest(path))


def check_robot(config) -> None:
    """ConfigError if `config` is for an environment of your own, which is missing here."""
    if config.env:
        raise ConfigError(
            f"env is {config.env!r}, expected a robot: only train, evaluate and play know others"
        )
    if not config.robot:
        raise ConfigError(
            "robot is '': this config is of an environment of your own, expected one of dynappo's robots; "
            "only train knows others (get_env in the config's file, or train.train(config, env=ENV))"
        )


def _check_kind(env: Any) -> None:
    from dynappo.tasks import env_contract  # it needs JAX

    env_contract.check_kind(env)
