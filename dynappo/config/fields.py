"""Which fields a config has, and what each may hold, as configs/default.py says."""

from __future__ import annotations

import copy
import functools
import math
import re
import runpy
from collections.abc import Iterable
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from ml_collections import config_dict

from dynappo.config.files import find

# Of numbers whose type names no bounds: as the compiled program holds them
TINY = 1e-12
WHOLE = {"low": 1 - 2**31, "high": 2**31 - 1}
SIZE = {"low": -1e9, "high": 1e9}
SIZES = (128, 128, 128)  # what sizes that are None by default may be
# groups in which terms of one's own have fields of their own, floats, where `task.terms` names a file
OWN = re.compile(r"task\.(weights|noise|own)\.[A-Za-z][A-Za-z0-9_]{0,99}")
REPEATS = 3  # of a pattern: each multiplies the time that it can take by a name's length


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
    """What a field may hold; `low` and `high` hold for each number of several."""

    kind: type  # also of one that is None; of `per_joint` float
    default: Any
    choices: tuple[str, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    # one float, a float of each kind of joint, or of each joint (per_joint.py)
    per_joint: bool = False
    like: tuple[Any, ...] = ()  # of a tuple, one that it may be: the default, unless that is None


@functools.cache
def _file() -> dict[str, Any]:
    return runpy.run_path(str(find("configs", "default.py", own=True)))


@functools.cache
def _defaults() -> config_dict.ConfigDict:
    return _file()["defaults"]()


def defaults() -> config_dict.ConfigDict:
    """A config of every field's default."""
    return copy.deepcopy(_defaults())


@functools.cache
def every() -> dict[str, Field]:
    """The fields by their dotted names."""

    def walk(group, types, prefix):
        types = get_type_hints(types, include_extras=True)
        for name, value in group.items():
            if isinstance(value, config_dict.ConfigDict):
                yield from walk(value, types[name], f"{prefix}{name}.")
            else:
                of_joints = _of_joints(types[name])
                kind = float if of_joints else group.get_type(name)
                limits = _limits(types[name], kind)
                like = (value or _like(types[name])) if kind is tuple else ()
                yield prefix + name, Field(kind, value, **limits, per_joint=of_joints, like=like)

    return dict(walk(_defaults(), _file()["Config"], ""))


def is_own(name: str) -> bool:
    """Whether a dotted name can be a field of terms of one's own (config/terms.py)."""
    return name not in every() and OWN.fullmatch(name) is not None


def field(name: str) -> Field | None:
    """The field of a dotted name, also one of terms of one's own; None if there is none."""
    if not is_own(name):
        return every().get(name)
    noise = name.startswith("task.noise.")
    return Field(float, None, low=0.0 if noise else SIZE["low"], high=SIZE["high"])


def _known(name: str) -> Field:
    found = field(name)
    assert found is not None, name
    return found


def _of_joints(annotation) -> bool:
    """Whether a type is what configs/default.py calls `PerJoint`."""
    parts = get_args(annotation)
    return dict[str, float] in parts or any(map(_of_joints, parts))


def _like(annotation) -> tuple[Any, ...]:
    """What a tuple that is None by default may be: sizes, or its least and largest `low, high`."""
    parts = get_args(get_args(annotation)[0])  # of `tuple[...] | None`
    if Ellipsis in parts:
        return SIZES
    limits = _limits(parts[0], parts[0])
    return float(limits["low"]), float(limits["high"])


def _limits(annotation, kind: type) -> dict[str, Any]:
    """`choices`, or `low` and `high`, of a type as configs/default.py writes it."""
    if get_origin(annotation) in (Union, UnionType, tuple):  # `X | None` and `tuple[X, ...]`
        return _limits(get_args(annotation)[0], get_args(annotation)[0])
    if get_origin(annotation) is Literal:
        return {"choices": get_args(annotation)}
    if get_origin(annotation) is Annotated:
        between = annotation.__metadata__[0]
        return {"low": between.low, "high": between.high}
    return {int: WHOLE, float: SIZE}.get(kind, {})


def convert(field: Field, value) -> Any:
    """`value` as the field holds it: a whole number as a float, a list as a tuple, a dict as its pairs; None
    if it cannot."""
    if field.per_joint and isinstance(value, (dict, tuple, list)):
        return _convert_joints(value)
    if field.kind is tuple:
        if not isinstance(value, (tuple, list)) or not value:
            return None
        part = Field(type(field.like[0]), field.like[0])
        out = tuple(convert(part, v) for v in value)
        if None in out or not (min(out) > 0 if sizes(field) else len(out) == len(field.like)):
            return None
        return out
    right = isinstance(value, field.kind) or (field.kind is float and isinstance(value, int))
    if not right or (isinstance(value, bool) and field.kind is not bool):
        return None
    try:
        return field.kind(value)
    except OverflowError:  # an integer that no float can hold
        return None


def _convert_joints(value) -> tuple[Any, ...] | None:
    """`((pattern, float), ...)` of a dict or of such pairs; of numbers a tuple of floats; None if neither."""
    parts = tuple(value.items() if isinstance(value, dict) else value)
    pairs = all(isinstance(part, (tuple, list)) and len(part) == 2 for part in parts)
    names, numbers = zip(*parts, strict=True) if parts and pairs else ((), parts)
    floats = tuple(convert(Field(float, 0.0), number) for number in numbers)
    if not floats or None in floats or not all(isinstance(name, str) for name in names):
        return None
    return tuple(zip(names, floats, strict=True)) if names else floats


def sizes(field: Field) -> bool:
    """Whether the field is a tuple of sizes, of any length."""
    return field.kind is tuple and type(field.like[0]) is int


def expected(field: Field) -> str:
    """The type that a value must have, in words."""
    none = ", or None" * (field.default is None)
    if field.per_joint:
        return (
            "float, a dict of floats by patterns of joints' names, or a tuple of a float a joint"
            + none
        )
    text = f"tuple like {field.like}" if field.kind is tuple else field.kind.__name__
    return text + ", one or more sizes above 0" * sizes(field) + none


def check(name: str, value) -> None:
    """ConfigError if the field may not hold this value of the right type."""
    field = _known(name)
    if field.choices and value is not None:
        expect(value in field.choices, name, value, f"one of {', '.join(field.choices)}")
    if value is None or field.low == -math.inf:
        return
    if field.per_joint and isinstance(value, tuple) and isinstance(value[0], tuple):
        for pattern, number in value:
            _check_pattern(name, pattern)
            _check_numbers(field, f"{name} of {pattern!r}", number, (number,))
        return
    numbers = value if isinstance(value, tuple) else (value,)
    _check_numbers(field, name, value, numbers)
    if type(numbers[0]) is float and len(numbers) == 2 and not field.per_joint:
        expect(numbers[0] <= numbers[1], name, value, "(low, high) with low <= high")


def _check_numbers(field: Field, name: str, value, numbers) -> None:
    low = "more than 0, at most" if field.low == TINY else f"{field.low:,.10g} to"
    for number in numbers:
        expect(math.isfinite(number), name, value, "finite numbers")
        expect(field.low <= number <= field.high, name, value, f"{low} {field.high:,.10g}")
        expect(number == 0 or abs(number) >= TINY, name, value, f"0, or {TINY:g} or more in size")


def _check_pattern(name: str, pattern: str) -> None:
    """ConfigError for a pattern that Python cannot match, or not in a time that has bounds: a config may
    come in a stranger's checkpoint."""
    repeats = re.sub(r"\\.|\[[^]]*\]", "", pattern)
    short = len(pattern) <= 100 and len(re.findall(r"[*+{]", repeats)) <= REPEATS
    text = f"a pattern of at most 100 characters, {REPEATS} of them * or +, and no group repeated"
    expect(short and not re.search(r"\)[*+{]", repeats), f"a pattern of {name}", pattern, text)
    # in a comment, or with (?x), a [ begins no class, and what is between brackets above is live
    expect(
        not re.search(r"\(\?(?!:)", pattern), f"a pattern of {name}", pattern, "no (? but in (?:"
    )
    try:
        re.compile(pattern)
    except (re.error, OverflowError, RecursionError) as error:
        expect(False, f"a pattern of {name}", pattern, f"a regular expression ({error})")


def expect(ok, field: str, value, expected: str) -> None:
    """Raise the ConfigError of a field: what was found, and what was expected."""
    if not ok:
        shown = repr(value) if isinstance(value, str) else value
        raise ConfigError(f"{field} is {shown}, expected {expected}")


def check_names(values: dict[str, Any]) -> None:
    """ConfigError if one of the fields by dotted names is missing, or unknown to dynappo."""
    for name in sorted(every().keys() - values.keys()):
        raise ConfigError(f"the config lacks {name}; start from configs/default.py")
    own = bool(values["task.terms"])
    for name in sorted(values.keys() - every().keys()):
        if not (own and is_own(name)):
            raise ConfigError(f"{name} is not a field; {near(name)}")


def near(name: str, names: Iterable[str] = ()) -> str:
    """What to do about a name that is not a field, nor one of `names`, which a config may have besides."""
    import difflib

    close = difflib.get_close_matches(name, {**every(), **dict.fromkeys(names)}, 1, 0.4)
    return f"did you mean {close[0]}?" if close else "configs/default.py lists all fields"


def typed(values: dict[str, Any]) -> config_dict.ConfigDict:
    """The config of `values` by dotted name, each converted to the type of its field; ConfigError if that is
    impossible. A missing field, or None where that is the default, has the default."""
    found = {}
    for name, field in every().items():
        if name in values and not (values[name] is None and field.default is None):
            found[name] = _converted(name, field, values[name])
    out = defaults()
    out.update_from_flattened_dict(found)
    for name in filter(is_own, values if values.get("task.terms") else ()):
        value, (_, group, leaf) = values[name], name.split(".")
        value = None if value is None else _converted(name, _known(name), value)
        with out.task[group].unlocked():
            out.task[group][leaf] = value
    return out


def _converted(name: str, field: Field, value) -> Any:
    found = convert(field, value)
    if found is None:
        raise ConfigError(f"{name} is {value!r}, expected {expected(field)}")
    return found


def copied(config) -> config_dict.ConfigDict:
    """A copy in which every field has the type of its default; ConfigError where a field is missing, or where
    it is no config, but perhaps the name of one."""
    if not hasattr(config, "items"):
        load = f": config.load({config!r})" if isinstance(config, str) else ""
        raise ConfigError(
            f"the config is {config!r}, expected what dynappo.config.load returns{load}"
        )
    check_names(flat(config))
    return typed(flat(config))
