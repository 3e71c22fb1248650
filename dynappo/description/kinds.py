"""Kinds of joints: what a name says without its leg or side, and a pattern that matches the kind's names."""

from __future__ import annotations

import re

SIDES = set("l r left right front rear hind back".split())
SIDES |= set("fl fr rl rr lf rf lh rh hl hr bl br lb rb ll lr".split())


def kind(name: str) -> str:
    """A joint's name without the words for its leg or side: `hip_joint` of `FL_hip_joint`.

    The last word is kept where nothing else would be: `LL_HR` (Berkeley's hip rotation) is `HR`.
    """
    words = [word for word in name.split("_") if word]
    rest = [word for word in words if word.lower() not in SIDES]
    return "_".join(rest or words[-1:]) or name


def kinds(names: tuple[str, ...]) -> dict[str, list[int]]:
    """Numbers of the joints of each kind, in the joints' order."""
    out: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        out.setdefault(kind(name), []).append(i)
    return out


def patterns(names: tuple[str, ...], values) -> dict[str, float] | float:
    """`values` [A] as the config has them: one number, or a number for each pattern of joint names.

    A pattern is a regular expression for the whole name. The number that most joints have comes last,
    as `.*`. A kind whose joints differ has the names of its joints.
    """
    values = [float(value) for value in values]
    if len({*values}) == 1:
        return values[0]
    most = max({*values}, key=lambda value: (values.count(value), -values.index(value)))
    out = {}
    for of_kind, joints in kinds(names).items():
        for value in dict.fromkeys(values[i] for i in joints):
            if value != most:
                chosen = [names[i] for i in joints if values[i] == value]
                out[_pattern(of_kind, chosen, names)] = value
    return out | {".*": most}


def _pattern(of_kind: str, chosen: list[str], names: tuple[str, ...]) -> str:
    """The shortest pattern that matches the joints `chosen` and no other of `names`."""
    words = [re.escape(word) for word in of_kind.split("_")]
    for middle in ("_".join(words), ".*".join(words)):
        for pattern in (middle, f".*_{middle}", f"{middle}_.*", f".*{middle}.*"):
            if [name for name in names if re.fullmatch(pattern, name)] == chosen:
                return pattern
    return "|".join(map(re.escape, chosen))
