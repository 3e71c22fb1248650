"""The names of another package's environments, read from its source: to refuse a wrong name need not wait for
the imports of that package, 3 to 40 s."""

from __future__ import annotations

import ast
import difflib
import importlib
import importlib.util
import sys
from pathlib import Path

from dynappo.config import ConfigError, shell

PLAYGROUND = "mujoco_playground"
UNSHOWN = {
    "fast",
    "swimmer",
}  # of brax's own tests; not on the physics that are used (brax_named.py)


def check(env: str) -> None:
    """ConfigError where `env` names no environment, as far as that can be told without its package."""
    package, _, name = env.partition(":")
    if package == "playground":
        check_playground()
    elif package == "brax":
        check_brax(name)
    else:
        raise ConfigError(f"env is {env!r}, expected playground:TASK or brax:NAME")


def check_brax(name: str) -> None:
    """ConfigError if brax has no such environment; it names the near ones."""
    known = registered("brax", "envs")
    if name not in known:
        shown = [each for each in known if each not in UNSHOWN]
        near = difflib.get_close_matches(name, shown, 3, 0.5) or shown
        raise ConfigError(f"brax has no environment {name!r}; there is {', '.join(near)}")


def check_playground() -> None:
    """ConfigError, with what installs it, if MuJoCo Playground is not there."""
    if importlib.util.find_spec(PLAYGROUND) is None:
        raise ConfigError(f"MuJoCo Playground is not installed; {shell.install('playground')}")


def registered(package: str, module: str) -> list[str]:
    """The keys of `_envs` in `PACKAGE.MODULE`, sorted; [] where the package is not installed.

    That is where brax and Playground register environments. Once the module is imported it is asked
    itself: who uses it may have registered more.
    """
    name = f"{package}.{module}"
    found = importlib.util.find_spec(package)
    if found is None or not found.submodule_search_locations:
        return []
    file = Path(found.submodule_search_locations[0], *module.split("."), "__init__.py")
    if name not in sys.modules and file.is_file():
        for line in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "_envs":
                assert isinstance(line.value, ast.Dict)
                return sorted(ast.literal_eval(key) for key in line.value.keys if key)
    return sorted(importlib.import_module(name)._envs)
