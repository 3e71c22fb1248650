"""A config file as a config, and its fields set from the text of a command line.

Why not absl's `config_flags`: it answers a missing file with an object that fails later, and an
unknown field with a traceback. Every error here is a `ConfigError` of one line, raised before JAX
is imported.
"""

from __future__ import annotations

import ast
import functools
import json
import pathlib
import runpy

from ml_collections import config_dict

from dynappo.config.files import find
from dynappo.config.validation import ConfigError, flat, settle


def load(spec: str) -> config_dict.ConfigDict:
    """The config of `FILE.py` or `FILE.py:VARIANT`, looked up in the working directory first."""
    name, _, variant = spec.partition(":")
    path = pathlib.Path(name)
    if not path.is_file():
        path = find("configs", path.name) or path
    if not path.is_file():
        raise ConfigError(f"--config: no file {name!r} here or among dynappo's own configs")
    try:
        get_config = runpy.run_path(str(path)).get("get_config")
        if get_config is None:
            raise ConfigError("defines no function get_config(variant)")
        config = get_config(variant)
        missing = sorted(set(flat(_default())) - set(flat(config)))
    except ConfigError as error:
        raise ConfigError(f"--config: {path} {error}") from None
    except ValueError as error:  # of a variant
        raise ConfigError(f"--config={spec}: {error}") from None
    except Exception as error:
        reason = " ".join(str(error).split())
        raise ConfigError(
            f"--config: {path}: get_config cannot be run: {type(error).__name__}: {reason}"
        ) from None
    if missing:
        raise ConfigError(f"--config: {path} lacks {missing[0]}; start from configs/default.py")
    return config


@functools.cache
def _default():
    return runpy.run_path(str(find("configs", "default.py")))["get_config"]()


def override(config: config_dict.ConfigDict, field: str, text: str) -> None:
    """Set `field` (dotted) from the text of a command line, with the type of its default."""
    group, _, leaf = field.rpartition(".")
    try:
        node = functools.reduce(lambda c, k: c[k], filter(None, group.split(".")), config)
        old = node[leaf]
    except (KeyError, TypeError, AttributeError):
        raise ConfigError(f"--config.{field}: no such field; {_near(config, field)}") from None
    if isinstance(old, config_dict.ConfigDict):
        raise ConfigError(f"--config.{field} is a group, expected one of {', '.join(old)}")
    kind = node.get_type(leaf)
    try:
        value = text if kind is str else ast.literal_eval(text.strip())
    except (ValueError, SyntaxError):
        raise ConfigError(_wrong(field, text, old, kind)) from None
    if isinstance(old, tuple):
        value = settle(old, value)
    elif kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise ConfigError(_wrong(field, text, old, kind))
    node[leaf] = value


def _wrong(field, text, old, kind):
    what = f"tuple like {old}" if isinstance(old, tuple) else kind.__name__
    return f"--config.{field}={text!r}: expected {what}"


def _near(config, field):
    import difflib

    close = difflib.get_close_matches(field, flat(config), 1, 0.4)
    return f"did you mean {close[0]}?" if close else "configs/default.py lists all fields"


def to_json(config) -> str:
    """The config as indented JSON, as `config.json` holds it."""
    return json.dumps(config.to_dict(), indent=2)


def difference(old: str, new: str, except_for=()) -> str:
    """The first field in which two `to_json` texts differ, as "ppo.epochs 5 there, 4 here"; or "".

    A field that only one of them has, because another version of dynappo wrote the text, is no difference.
    """
    try:
        before = flat(json.loads(old))
    except (ValueError, AttributeError):
        return "its config.json cannot be read"
    after = flat(json.loads(new))
    for name in (name for name in before if name in after and name not in except_for):
        if before[name] != after[name]:
            return f"{name} {before[name]} there, {after[name]} here"
    return ""
