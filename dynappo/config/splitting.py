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

if TYPE_CHECKING:
    from dynappo.config.halves import Hyper, Static


def split(config) -> tuple[Static, Hyper]:
    """`(static, hyper)` of a validated config; floats go to `hyper`, all else to `static`."""
    return _take(config, "Static", "", False), _take(config, "Hyper", "", True)


def _take(config, half: str, group: str, floats: bool) -> Any:
    fields = {}
    for key, value in config.items():
        if hasattr(value, "items"):
            value = _take(value, half, key, floats)
            if value._fields:
                fields[key] = value
        elif (type(value[0] if isinstance(value, tuple) else value) is float) == floats:
            fields[key] = value
    return _record(half + group.title(), tuple(fields))(**fields)


@functools.cache
def _record(name: str, fields: tuple[str, ...]):
    """One class per set of fields, so that two splits of equal configs have equal tree types."""
    return namedtuple(name, fields)
