"""The tasks of robots: which one a config trains, its check and its environment.

There is one, `velocity`, with the config's group `task`. A second one, such as a climb, brings a folder with
`check(config, robot)` and `make(...)`, and a field of the config that chooses; both functions below then ask
that field. `program` calls these and knows no task. An environment of your own, brax's among them, does not
come here: get_env makes it (program/environment.py).

What names the velocity task on its own: evaluate/episodes.py, policy/episode.py and what is played with it,
and the bytes that program/memory.py counts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynappo.config import ConfigError
from dynappo.description import robot as robot_lib
from dynappo.tasks.velocity import checks, log_file, observe, own

if TYPE_CHECKING:  # it imports JAX
    from dynappo.types import Env


def check(config, robot: robot_lib.Robot) -> None:
    """ConfigError if `robot` cannot learn the task of `config`; compiles nothing."""
    checks.check(config, robot)


def check_start(config, robot: robot_lib.Robot, state) -> None:
    """ConfigError if a term of one's own is not finite in the first state of a run, of any robot."""
    if config.task.terms:
        dt = config.physics.substeps * config.physics.timestep
        own.check_finite(own.make(config.task, len(robot.joint_names), dt), state.obs)


def about_log(config, robot: robot_lib.Robot) -> str:
    """A line on the log that `robot` is to learn from; ConfigError if it is of another robot, or damaged.

    The config's numbers a joint are resolved (`motors.fitted`).
    """
    return log_file.in_words(_log(config, robot), config)


def logged(config, robot: robot_lib.Robot, env: Env) -> Env:
    """`env` with the rows of the log in place of simulated ones; ConfigError as `about_log`."""
    from dynappo.tasks.velocity import logged

    return logged.make(env, _log(config, robot), robot, config.task)


def _log(config, robot: robot_lib.Robot) -> log_file.Log:
    mine = observe.own(config.task.terms_about)
    if mine:  # the log's observation would be shorter than what networks see
        raise ConfigError(
            f"run.logs is {config.run.logs!r}, expected '' where task.terms = {config.task.terms} adds "
            f"{', '.join(each.name for each in mine)} to the observation, which no log tells; train from the "
            "log without these terms"
        )
    return log_file.load(config.run.logs, robot, config, config.run.logs_hash)


def make(config, robot: robot_lib.Robot, *, impl: str) -> Env:
    """The environment of the task of `config` with `robot`, stepped by the engine `impl`."""
    from dynappo.tasks.velocity import env  # it takes seconds, and a check answers without

    return env.make(robot, config.task, config.physics, impl=impl)
