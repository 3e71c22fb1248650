"""`static` and `hyper`: the two halves of a config that the compiled program takes.

`static` (ints, strings, bools) is hashable and part of the compiled program; `hyper` (floats) is a pytree
argument, so a new learning rate needs no compilation and a sweep is a `jax.vmap` over its leaves.
Both are nested named tuples with the config's own names: `static.ppo.epochs`, `hyper.ppo.clip_epsilon`.
`halves.py` has their types, for type checkers.
Every function that takes `static` or `hyper` takes all of it and reads its own group.
"""

from __future__ import annotations

import functools
from collections import namedtuple
from typing import TYPE_CHECKING, Any

from dynappo.config import fields as fields_lib
from dynappo.config.fields import ConfigError

if TYPE_CHECKING:
    from dynappo.config.halves import Hyper, Static


BUILT_IN = "task.armature", "task.tiles."  # numbers that are part of the program


def split(config) -> tuple[Static, Hyper]:
    """`(static, hyper)` of a validated config; floats go to `hyper`, all else to `static`.

    A float that is None, or a tuple of them, is in `hyper` too. A None there is no leaf but a part of the
    tree's structure, so whether it is None is part of the program.
    `task.armature` is in `static`: the solver's numbers follow from it when a model is made. So is the group
    `task.tiles`, from which the ground is made.
    ConfigError where a field has patterns of joints, which `per_joint.resolved` makes numbers.
    """
    return _take(config, "Static", "", False), _take(config, "Hyper", "", True)


def _take(config, half: str, group: str, floats: bool) -> Any:
    fields = {}
    for key, value in config.items():
        name = f"{group}.{key}".lstrip(".")
        if hasattr(value, "items"):
            value = _take(value, half, name, floats)
            if value._fields:
                fields[key] = value
        elif isinstance(value, tuple) and isinstance(value[0], tuple):
            raise ConfigError(
                f"{name} has a number for each kind of joint, expected one number: no robot of "
                "dynappo's is trained here"
            )
        elif floats == (_is_float(name, value) and not name.startswith(BUILT_IN)):
            fields[key] = value
    return _record(half + group.rpartition(".")[2].title(), tuple(fields))(**fields)


def _is_float(name: str, value: Any) -> bool:
    if value is None:
        field = fields_lib.field(name)
        return field is not None and float in (field.kind, *map(type, field.like))
    return type(value[0] if isinstance(value, tuple) else value) is float


@functools.cache
def _record(name: str, fields: tuple[str, ...]):
    """One class per set of fields, so that two splits of equal configs have equal tree types."""
    return namedtuple(name, fields)
