"""A Playground task by its name: the object that Playground's registry makes, without its network access."""

from __future__ import annotations

import difflib
import importlib
import os.path
import pathlib
from typing import Any, NamedTuple

import mujoco

from dynappo.config import ConfigError
from dynappo.tasks import names as names_lib
from dynappo.tasks.playground import assets, room

PLAYGROUND_ROBOTS = 8192  # for which the tasks' own naconmax is
# times the room of contacts and constraints (`_room`); if it runs out, a run ends (run/overflow.py)
ROOM = 1.0
FEW = 4096  # contacts: few robots may all lie on the ground at once, and have up to four times their share


class Loaded(NamedTuple):
    """A task and where its robot's files came from."""

    name: str
    task: Any  # Playground's MjxEnv
    assets: str  # a line


def names() -> list[str]:
    """The tasks that can be loaded; ConfigError where Playground is not installed."""
    names_lib.check_playground()
    return names_lib.registered(names_lib.PLAYGROUND, "_src.locomotion")


def check_name(name: str) -> None:
    """ConfigError if there is no such task; it names the near ones."""
    known = names()
    if name not in known:
        near = difflib.get_close_matches(name, known, 5, 0.4) or known
        # the robot's name comes first, and the ends of tasks' names are alike
        near = sorted(near, key=lambda other: -len(os.path.commonprefix([name, other])))
        raise ConfigError(f"playground has no locomotion task {name!r}; there is {', '.join(near)}")


def check(name: str) -> str:
    """A line on where the files of the task's robot come from; ConfigError where it cannot be loaded."""
    check_name(name)
    return _found(name)[1]


def _found(name: str) -> tuple[pathlib.Path, str]:
    make = _locomotion()._envs[name]
    family = getattr(make, "func", make).__module__.split(".")[-2]
    return assets.find(family, pathlib.Path(str(_module("mjx_env").ROOT_PATH)).parent)


def load(name: str, impl: str = "jax", worlds: int = 1) -> Loaded:
    """The task `name` on the engine `impl`, "jax" or "warp".

    `worlds` is how many robots one call of physics steps, of all seeds: MJX-Warp's room for contacts
    (`naconmax`) is for all of them together.
    """
    task, text = made(name, impl)
    with task._config.unlocked():
        task._config.njmax, task._config.naconmax = _room(task, worlds)
    if impl == "warp":
        from dynappo.tasks.playground import warp_kernels  # it needs Warp

        task._mjx_model = warp_kernels.quiet(task._mjx_model)
        warp_kernels.build(task)
    return Loaded(name, task, text)


def made(name: str, impl: str = "jax") -> tuple[Any, str]:
    """The task as Playground's registry makes it, and where its robot's files came from."""
    check_name(name)
    locomotion, mjx_env = _locomotion(), _module("mjx_env")
    folder, text = _found(name)
    mjx_env.MENAGERIE_PATH = mjx_env.epath.Path(str(folder))
    mjx_env.ensure_menagerie_exists = lambda: None  # it would clone Menagerie
    return locomotion.load(name, config_overrides={"impl": impl}), text


def own_room(task: Any) -> tuple[int, float]:
    """`(constraints, contacts)` a robot for which Playground's task asks; its contacts are 8192 robots'."""
    return task._config.njmax, task._config.naconmax / PLAYGROUND_ROBOTS


def _room(task: Any, worlds: int) -> tuple[int, int]:
    """`(njmax, naconmax)`: the task's own, or what its robot needs if that is more."""
    rows, each = map(max, own_room(task), room.needed(task.mj_model))
    return round(ROOM * rows), round(ROOM * max(each * worlds, min(4 * each * worlds, FEW)))


def drawn(loaded: Loaded) -> mujoco.MjModel:
    """The task's model as films and pages show it."""
    model = loaded.task.mj_model
    return assets.shown(model) if loaded.assets.startswith(assets.STAND_INS) else model


def ppo_config(name: str) -> Any:
    """Playground's settings of brax's PPO for a task."""
    _locomotion()
    params = importlib.import_module(f"{names_lib.PLAYGROUND}.config.locomotion_params")
    return params.brax_ppo_config(name)


def _locomotion() -> Any:
    return _module("locomotion")


def _module(name: str) -> Any:
    names_lib.check_playground()
    return importlib.import_module(f"{names_lib.PLAYGROUND}._src.{name}")
