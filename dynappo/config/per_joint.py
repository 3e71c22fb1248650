"""Turns what a config says of its joints (`PerJoint` in configs/default.py) into a number for each joint."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from ml_collections import config_dict

from dynappo.config import fields
from dynappo.config.fields import ConfigError


def names() -> list[str]:
    """The names of these fields of the group `task`: kp, kd, ..."""
    return [name.partition(".")[2] for name, field in fields.every().items() if field.per_joint]


def resolved(config, joints: Sequence[str], robot: str) -> config_dict.FrozenConfigDict:
    """The validated config with `numbers` in each of these fields."""
    out = config.to_dict()
    for name in names():
        out["task"][name] = numbers(f"task.{name}", out["task"][name], joints, robot)
    return config_dict.FrozenConfigDict(out)


def numbers(field: str, value: Any, joints: Sequence[str], robot: str) -> Any:
    """One float, if all joints have the same, or a tuple with one for each of `joints`; None of None.

    `value` is a field's as `fields.convert` gives it. ConfigError if a joint has no number, if a pattern is
    of no use, or if the tuple has another length.
    """
    if value is None or isinstance(value, float):
        return value
    if isinstance(value[0], tuple):
        value = _matched(field, value, joints, robot)
    elif len(value) != len(joints):
        raise ConfigError(
            f"{field} has {len(value)} numbers, expected {len(joints)}: one for each joint of {robot}, "
            f"{' '.join(joints)}"
        )
    return value[0] if len(set(value)) == 1 else value


def _matched(field: str, pairs, joints: Sequence[str], robot: str) -> tuple[float, ...]:
    """The number of the first pattern that matches each joint's whole name."""
    matches = [[bool(re.fullmatch(pattern, joint)) for joint in joints] for pattern, _ in pairs]
    for i, joint in enumerate(joints):
        if not any(row[i] for row in matches):
            raise ConfigError(
                f"no pattern of {field} matches {joint}, a joint of {robot}; give it a number, or add "
                '".*" as the last pattern'
            )
    first = [[row[i] for row in matches].index(True) for i in range(len(joints))]
    for k, (pattern, _) in enumerate(pairs):
        if not any(matches[k]):
            raise ConfigError(
                f"the pattern {pattern!r} of {field} matches no joint of {robot}; its joints are "
                f"{' '.join(joints)}"
            )
        if k not in first:
            raise ConfigError(
                f"the pattern {pattern!r} of {field} is never the first that matches a joint of {robot}; "
                "the first counts, so put it before the others"
            )
    return tuple(pairs[k][1] for k in first)


def by_name(value: Any, joints: Sequence[str]) -> Any:
    """A number a joint as pairs of names and numbers, which hold in any order of the joints."""
    several = isinstance(value, (tuple, list))  # a list from JSON
    if several and not isinstance(value[0], (tuple, list)):
        return tuple(
            (re.escape(joint), number) for joint, number in zip(joints, value, strict=True)
        )
    return value
