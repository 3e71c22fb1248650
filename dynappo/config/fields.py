"""Which fields a config has, and their types: those of dynappo's own configs/default.py."""

from __future__ import annotations

import copy
import functools
import runpy
from typing import Any, NamedTuple

from ml_collections import config_dict

from dynappo.config.files import find


class ConfigError(ValueError):
    """A setting that cannot be run; the message names the field, what was found and expected."""


def flat(config, prefix="") -> dict[str, Any]:
    out = {}
    for name, value in config.items():
        if hasattr(value, "items"):
            out |= flat(value, f"{prefix}{name}.")
        else:
            out[prefix + name] = value
    return out


class Field(NamedTuple):
    """What a field holds."""

    kind: type  # also of one that is None
    default: Any


@functools.cache
def _defaults() -> config_dict.ConfigDict:
    return runpy.run_path(str(find("configs", "default.py", own=True)))["defaults"]()


def defaults() -> config_dict.ConfigDict:
    """A config of every field's default."""
    return copy.deepcopy(_defaults())


@functools.cache
def every() -> dict[str, Field]:
    """The fields by their dotted names."""

    def walk(group, prefix):
        for name, value in group.items():
            if isinstance(value, config_dict.ConfigDict):
                yield from walk(value, f"{prefix}{name}.")
            else:
                yield prefix + name, Field(group.get_type(name), value)

    return dict(walk(_defaults(), ""))


def settle(field: Field, value) -> Any:
    """`value` as the field holds it: a whole number as a float, a list as a tuple; None if it cannot."""
    kind, default = field
    if kind is tuple:
        if not isinstance(value, (tuple, list)) or not value:
            return None
        part = Field(type(default[0]), default[0])
        out = tuple(settle(part, v) for v in value)
        if None in out:
            return None
        right = min(out) > 0 if sizes(field) else len(out) == len(default)
        return out if right else None
    right = isinstance(value, kind) or (kind is float and isinstance(value, int))
    if not right or (isinstance(value, bool) and kind is not bool):
        return None
    try:
        return kind(value)
    except OverflowError:  # an integer that no float can hold
        return None


def sizes(field: Field) -> bool:
    """Whether it is a tuple of sizes, of which there may be any number."""
    return field.kind is tuple and type(field.default[0]) is int


def meant(field: Field) -> str:
    """What is expected of a value, for a person."""
    text = f"tuple like {field.default}" if field.kind is tuple else field.kind.__name__
    return text + ", one or more sizes above 0" * sizes(field)


def check_names(names) -> None:
    """ConfigError where a field lacks, or where one is there that dynappo does not have."""
    for name in sorted(every().keys() - names):
        raise ConfigError(f"the config lacks {name}; start from configs/default.py")
    for name in sorted(names - every().keys()):
        raise ConfigError(f"{name} is not a field; {near(name)}")


def near(name: str) -> str:
    """What to do about a name that is no field."""
    import difflib

    close = difflib.get_close_matches(name, every(), 1, 0.4)
    return f"did you mean {close[0]}?" if close else "configs/default.py lists all fields"


def typed(config) -> config_dict.ConfigDict:
    """A copy in which every field has the type of its default; ConfigError where it cannot."""
    values = flat(config)
    check_names(values.keys())
    out = copy.deepcopy(_defaults())
    for name, field in every().items():
        if values[name] is None and field.default is None:
            continue
        value = settle(field, values[name])
        if value is None:
            raise ConfigError(f"{name} is {values[name]!r}, expected {meant(field)}")
        group, _, leaf = name.rpartition(".")
        (out[group] if group else out)[leaf] = value
    return out
