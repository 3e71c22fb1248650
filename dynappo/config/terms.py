"""Terms of your own for the velocity task, in your own file: rewards, observations, ends, commands and more.

    from dynappo import terms

    @terms.reward(weight=-1e-3)
    def motor_work(torque, joint_velocity):
        "Power that the motors give, W."
        power = torque * joint_velocity
        return (power * (power > 0)).sum()

    @terms.observation(size=1, unit="m", signs=(1,), noise=0.02)
    def base_height(qpos):
        return qpos[2:3]

A term is a function of one robot; its parameters say what it needs (docs/task.md). A decorator leaves the
function as it is and says the rest beside it. Numbers that it names are fields of the config, of the same
names: `task.weights.motor_work`, `task.noise.base_height`, and `task.own` for `numbers`.

A config names the file (`task.terms`) and what is in it (`task.terms_hash`, of its text; `task.terms_about`,
what it adds to an observation). It holds no code. Nor does a policy: `read` runs a file, and is called only
with one that the user has named, on a command line or in a config file. `of` finds what has been read, by the
hash in a config, which may be a stranger's.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import inspect
import json
import math
import os
import runpy
import textwrap
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar

from dynappo.config import fields, shell
from dynappo.config.fields import ConfigError

MARK = "dynappo_term"  # of a function: what its decorator says
CONTENT = 200  # characters of a docstring's first line that are kept


class Reward(NamedTuple):
    """A term of the reward."""

    weight: float | None  # 1/s; None: not in the program until a config says a number


class Observation(NamedTuple):
    """Numbers that the policy sees; of a `known` one, what follows from the row before."""

    size: int | None  # None: one number a joint
    unit: str
    noise: float | None  # half width; None: without noise
    signs: tuple[int, ...] | None  # of each number in the left-right mirror image
    order: tuple[int, ...] | None  # and which number it is there; None: the same
    scale: float
    shown: bool  # False: value function (ppo.critic=state) and model see it, and not the policy
    start: tuple[float, ...] | None  # of a known one, where an episode begins; None: predicted


class Termination(NamedTuple):
    """An end of an episode."""

    timeout: bool  # False: a fall


class Command(NamedTuple):
    """What draws a command."""

    draws: int  # uniform numbers from 0 to 1 that it is given


class Curriculum(NamedTuple):
    """A number that each robot keeps from one episode to the next."""

    start: float
    evaluated: float  # in an evaluation


class Term(NamedTuple):
    """A function of a file, and what its decorator says."""

    name: str
    function: Callable[..., Any]
    how: Any  # one of the classes above
    numbers: Mapping[str, float]
    file: str  # where the function is, for messages


class Terms(NamedTuple):
    """All terms of a file, by name."""

    path: str = ""
    digest: str = ""
    rewards: Mapping[str, Term] = {}
    observations: Mapping[str, Term] = {}  # those that are predicted, then the known ones
    terminations: Mapping[str, Term] = {}
    command: Term | None = None
    curricula: Mapping[str, Term] = {}

    def every(self) -> list[Term]:
        of = self.rewards, self.observations, self.terminations, self.curricula
        return [term for group in of for term in group.values()] + [*filter(None, [self.command])]


# what to do about JAX's errors of a value that it does not know yet
UNTRACED = {
    "TracerBoolConversionError": "no `if`, `and`, `or`, `not`, min() or max() on a value: x * (x > 0), or "
    "xp.where with xp = x.__array_namespace__()",
    "TracerArrayConversionError": "NumPy cannot have the value: use xp = x.__array_namespace__() in the "
    "place of np",
    "ConcretizationTypeError": "no float(), int() or math on a value: x * 1.0, or a function of "
    "xp = x.__array_namespace__()",
    "TracerIntegerConversionError": "no value as an index or a range: xp.where, with "
    "xp = x.__array_namespace__()",
    "NonConcreteBooleanIndexError": "no x[condition]: x * condition, or xp.where with "
    "xp = x.__array_namespace__()",
}
DECORATORS = "reward observation known termination command curriculum".split()
NONE = Terms()
P = ParamSpec("P")
R = TypeVar("R")
_READ: dict[str, Terms] = {}  # by digest: what this process has read


# ---- the decorators


def _in_parentheses(make: Callable[P, R]) -> Callable[P, R]:
    """`make` with a ConfigError of one line for `@terms.reward` without parentheses, or with wrong ones."""
    signature = inspect.signature(make)
    needed = [f"{p.name}=..." for p in signature.parameters.values() if p.default is p.empty]
    name = getattr(make, "__name__", "")

    @functools.wraps(make)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            signature.bind(*args, **kwargs)
        except TypeError as error:
            of = getattr(args[0], "__name__", "") if args else ""
            wrong = f"{of} has a decorator without parentheses" if of else f"@terms.{name}: {error}"
            raise ConfigError(f"{wrong}; write @terms.{name}({', '.join(needed)})") from None
        return make(*args, **kwargs)

    return called


@_in_parentheses
def reward(*, weight: float | None, numbers: Mapping[str, float] | None = None):
    """A term of the reward: one number of a robot. `weight`, 1/s, has the sign; None leaves it out."""
    return _marked(Reward(_number("weight", weight, none=True)), numbers)


@_in_parentheses
def observation(
    *,
    size: int | None,
    unit: str = "1",
    noise: float | None = None,
    signs: tuple[int, ...] | None = None,
    order: tuple[int, ...] | None = None,
    scale: float = 1.0,
    shown: bool = True,
    numbers: Mapping[str, float] | None = None,
):
    """Numbers [size] that physics decides, so the transition model predicts them; size None: one a joint.

    `noise` is the half width of its uniform noise. In the left-right mirror image (`ppo.symmetry`) number i
    is `signs[i]` (1 or -1) times number `order[i]`. `scale` is for `ppo.scale_inputs`. A value function with
    `ppo.critic=state` and the model see it, too; the policy does not where `shown` is False.
    """
    seen = Observation(size, unit, noise, signs, order, scale, shown, None)
    return _marked(_checked(seen), numbers)


@_in_parentheses
def known(
    *,
    start: tuple[float, ...],
    unit: str = "1",
    signs: tuple[int, ...] | None = None,
    order: tuple[int, ...] | None = None,
    scale: float = 1.0,
    shown: bool = True,
    numbers: Mapping[str, float] | None = None,
):
    """Numbers that follow from the row before, so the model's tail computes them, and has no noise on them.

    They are `start` where an episode begins. Then the function gives the next ones: a parameter of its own
    name is what they were.
    """
    if not isinstance(start, tuple | list) or not start:
        raise ConfigError(f"start is {start!r}, expected a tuple of finite numbers, such as (0.0,)")
    start = tuple(_number("start", number) for number in start)
    seen = Observation(len(start), unit, None, signs, order, scale, shown, start)
    return _marked(_checked(seen), numbers)


@_in_parentheses
def termination(*, timeout: bool = False, numbers: Mapping[str, float] | None = None):
    """An end of an episode: True where it ends, as a fall does; with `timeout` as the time does."""
    return _marked(Termination(_bool("timeout", timeout)), numbers)


@_in_parentheses
def command(*, draws: int, numbers: Mapping[str, float] | None = None):
    """What draws a command [3] (m/s, m/s, rad/s) from `draw`, so many numbers from 0 to 1, in the place of
    uniform ones in `task.command_x`, `command_y` and `command_yaw`."""
    if type(draws) is not int or not 0 < draws <= 1000:
        raise ConfigError(f"draws is {draws!r}, expected an integer from 1 to 1000")
    return _marked(Command(draws), numbers)


@_in_parentheses
def curriculum(
    *, start: float, evaluated: float | None = None, numbers: Mapping[str, float] | None = None
):
    """A number that each robot keeps: `start` at first, then what the function makes of it where an episode
    ends, from a parameter of its own name. An evaluation has `evaluated` (None: `start`) throughout."""
    start = _number("start", start)
    there = start if evaluated is None else _number("evaluated", evaluated)
    return _marked(Curriculum(start, there), numbers)


def _marked(how: Any, numbers: Mapping[str, float] | None):
    numbers = {name: _number(name, value) for name, value in (numbers or {}).items()}

    def mark(function):
        setattr(function, MARK, (how, numbers))
        return function

    return mark


def _number(name: str, value: Any, none: bool = False) -> Any:
    if none and value is None:
        return None
    if type(value) not in (int, float) or not math.isfinite(value):
        raise ConfigError(f"{name} is {value!r}, expected a finite number")
    return float(value)


def _bool(name: str, value: Any) -> bool:
    if type(value) is not bool:
        raise ConfigError(f"{name} is {value!r}, expected True or False")
    return value


def _checked(seen: Observation) -> Observation:
    size = seen.size
    if size is not None and (type(size) is not int or not 0 < size <= 10_000):
        raise ConfigError(f"size is {size!r}, expected an integer above 0, or None: one a joint")
    if seen.noise is not None:
        _number("noise", seen.noise)
    if not isinstance(seen.unit, str) or len(seen.unit) > CONTENT:
        raise ConfigError(f"unit is {seen.unit!r}, expected a short text, such as 'm/s'")
    _bool("shown", seen.shown)
    for name, given in (("signs", seen.signs), ("order", seen.order)):
        if given is None:
            continue
        fits = isinstance(given, tuple) and len(given) == size
        if name == "signs":
            fits, text = fits and set(given) <= {1, -1}, f"{size} times 1 or -1"
        else:
            fits = fits and sorted(given) == [*range(size or 0)]  # and its own inverse
            fits = fits and all(given[i] == k for k, i in enumerate(given))
            text = f"0 to {(size or 0) - 1}, in which each number and its image change places"
        if not fits:
            raise ConfigError(f"{name} is {given!r}, expected a tuple of {text}")
    scale = _number("scale", seen.scale)
    if abs(scale) >= 1e9:
        raise ConfigError(f"scale is {scale:g}, expected a number between -1e9 and 1e9")
    return seen._replace(scale=scale)


# ---- a file


def read(path: str | Path, names: Mapping[str, Any] | None = None) -> Terms:
    """The terms of a file, which runs as Python: only with one that the user has named.

    `names` is what is in it, where it has been run. ConfigError of one line where it cannot be run or has
    no terms.
    """
    where = os.path.abspath(path)
    if names is None:
        names = _run(path, where)
    found = declared(names)
    if not found:
        raise ConfigError(
            f"{path} has no terms: none of its functions has a decorator of dynappo.terms (docs/task.md)"
        )
    _check_names(path)
    groups: dict[type, dict[str, Term]] = {}
    for term in found:
        groups.setdefault(type(term.how), {})[term.name] = term
    commands, seen = [*groups.get(Command, {}).values()], groups.get(Observation, {})
    if len(commands) > 1:
        one, other = commands[:2]
        raise ConfigError(f"{path} has two commands, {one.name} and {other.name}; expected one")
    out = Terms(
        path=where,
        digest=_digest(where, found),
        rewards=groups.get(Reward, {}),
        observations=dict(sorted(seen.items(), key=lambda x: x[1].how.start is not None)),
        terminations=groups.get(Termination, {}),
        command=commands[0] if commands else None,
        curricula=groups.get(Curriculum, {}),
    )
    _numbers(out)
    _check_asked(out)
    known = _READ.get(out.digest)
    if known is None or known.path != out.path:  # else the same functions again
        known = _READ[out.digest] = out
    return known


def _run(path: str | Path, where: str) -> dict[str, Any]:
    if not os.path.isfile(where):
        raise ConfigError(f"task.terms: no file {str(path)!r}")
    try:
        return runpy.run_path(where)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    except (Exception, SystemExit) as error:
        text = " ".join(str(error).split())
        raise ConfigError(f"{path} cannot be run: {type(error).__name__}: {text}") from None


def declared(names: Mapping[str, Any]) -> list[Term]:
    """The terms among the names of a file, in their order."""
    out = []
    for name, value in names.items():
        if (said := getattr(value, MARK, None)) is None or not callable(value):
            continue
        code = getattr(inspect.unwrap(value), "__code__", None)
        if code is None or name.startswith("_"):
            raise ConfigError(f"the term {name} is no function with a name of its own")
        out.append(Term(name, value, said[0], said[1], code.co_filename))
    return out


def _check_names(path: str | Path) -> None:
    """ConfigError for a term that a later function of its name replaces."""
    terms: dict[str, int] = {}
    for node in ast.parse(Path(path).read_bytes()).body:
        if not isinstance(node, ast.FunctionDef):
            continue
        if node.name in terms:
            raise ConfigError(
                f"{path} has two functions {node.name}, at line {terms[node.name]} and line {node.lineno}: "
                "the second replaces the first, which is a term; expected another name"
            )
        if any(
            isinstance(each, ast.Call) and ast.unparse(each.func).rpartition(".")[2] in DECORATORS
            for each in node.decorator_list
        ):
            terms[node.name] = node.lineno


def _check_asked(terms: Terms) -> None:
    """ConfigError for a number that no term asks for."""
    asked = {name for term in terms.every() for name in parameters(term.function)}
    for term in terms.every():
        for name in sorted(term.numbers.keys() - asked):
            raise ConfigError(
                f"the term {term.name} of {place(term.function)} has a number {name}, and no term of the "
                f"file asks for it; expected a parameter {name}, or no such number"
            )


def _digest(path: str, terms: list[Term]) -> str:
    """Of the text of the file, and of those that its terms come from."""
    others = {os.path.abspath(term.file) for term in terms} - {path}
    texts = [Path(path).read_bytes()]
    texts += sorted(Path(file).read_bytes() for file in others if os.path.isfile(file))
    return hashlib.sha256(b"\0".join(texts)).hexdigest()[:16]


def _numbers(terms: Terms) -> dict[str, float]:
    """The fields of `task.own` with their values: numbers of all terms, and where curricula start."""
    out = {name: term.how.start for name, term in terms.curricula.items()}
    for term in terms.every():
        for name, value in term.numbers.items():
            if not fields.is_own(f"task.own.{name}"):
                raise ConfigError(
                    f"the term {term.name} has a number {name!r}, expected a plain name"
                )
            if out.setdefault(name, value) != value:
                raise ConfigError(
                    f"the number {name} of the term {term.name} is {value:g}, and {out[name]:g} elsewhere in "
                    f"{terms.path}; expected one value"
                )
    return out


# ---- in a config


def use(config, terms: Terms) -> None:
    """Name `terms` in a config, with the fields that these add; values that it has stay."""
    task = config.task
    own = {
        "weights": {name: term.how.weight for name, term in terms.rewards.items()},
        "noise": {
            name: term.how.noise
            for name, term in terms.observations.items()
            if term.how.noise is not None
        },
        "own": _numbers(terms),
    }
    if task.terms_hash not in ("", terms.digest):
        leave(config, own)
    for group, values in own.items():
        node = task[group]
        for name, value in values.items():
            if name not in node:
                with node.unlocked():
                    node[name] = value
    # the path is not opened again, so only its name is for others to read
    task.update(
        terms=os.path.basename(terms.path), terms_hash=terms.digest, terms_about=_about(terms)
    )


def leave(config, but: Mapping[str, Mapping[str, Any]] | None = None) -> None:
    """Remove the terms that a config names, with their fields, but for those by group in `but`."""
    for group in ("weights", "noise", "own"):
        node, kept = config.task[group], (but or {}).get(group, {})
        for name in [*node]:
            if name not in kept and fields.is_own(f"task.{group}.{name}"):
                with node.unlocked():
                    del node[name]
    config.task.update(terms="", terms_hash="", terms_about="")


def without_command(config) -> None:
    """Draw commands from the config's ranges, where it names terms with a command of their own."""
    found = of(config.task)
    if found.command is not None:
        bare = found._replace(command=None, digest=f"{found.digest}-")
        _READ[bare.digest] = bare
        use(config, bare)


def _about(terms: Terms) -> str:
    """What is said of terms without their code, as JSON: names, and the parts of an observation."""
    seen = [_part(name, term, **term.how._asdict()) for name, term in terms.observations.items()]
    level = dict(size=1, unit="1", noise=None, signs=(1,), order=None, scale=1.0, shown=False)
    seen += [_part(name, term, **level, start=()) for name, term in terms.curricula.items()]
    return json.dumps(
        {
            "rewards": [*terms.rewards],
            "observation": seen,
            "terminations": [*terms.terminations],
            "command": terms.command.name if terms.command else "",
            "curricula": [*terms.curricula],
        }
    )


def told(about: str) -> list[str]:
    """The names of the terms in what `_about` wrote; none where it is something else."""
    try:
        found = json.loads(about or "{}")
        seen = [each["name"] for each in found.get("observation", [])]
        names = [*found.get("rewards", []), *seen, *found.get("terminations", [])]
        return list(dict.fromkeys(map(str, [*names, *filter(None, [found.get("command")])])))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return []


def _part(name: str, term: Term, *, noise, start, **of) -> dict[str, Any]:
    content = " ".join((term.function.__doc__ or "").strip().partition("\n")[0].split())[:CONTENT]
    noisy, known = noise is not None, start is not None
    return {"name": name, "content": content, "noisy": noisy, "known": known} | of


def of(task) -> Terms:
    """The terms that a config's group `task` names, which have been read; NONE where it names none.

    ConfigError where they have not: nobody has named their file here.
    """
    digest = task.get("terms_hash") or ""
    if not digest:
        return NONE
    if digest not in _READ:
        raise ConfigError(
            f"its terms are code in {task.get('terms')!r}, which is not run unasked; "
            "name the file: --terms=FILE"
        )
    return _READ[digest]


def flag(config) -> list[str]:
    """The flag by which `play`, `evaluate` and `export` are given the terms of a run; none without any."""
    path = of(config.task).path
    return [f"--terms={shell.relative(path)}"] if path else []


# ---- their functions


@functools.cache
def parameters(function: Callable[..., Any]) -> tuple[str, ...]:
    """What a term asks for: its parameters without a default."""
    every = inspect.signature(function).parameters.values()
    return tuple(p.name for p in every if p.default is p.empty)


def call(term: Term, facts: Mapping[str, Any]) -> Any:
    """The value of a term; what it raises comes as a ConfigError of one line that names the place."""
    asked = parameters(term.function)
    for name in asked:
        if name not in facts:
            raise ConfigError(
                f"the term {term.name} of {term.file} asks for {name}, which is not known here"
            )
    try:
        return term.function(**{name: facts[name] for name in asked})
    except ConfigError:
        raise
    except Exception as error:
        every = traceback.extract_tb(error.__traceback__)
        frames = [frame for frame in every if frame.filename == term.file]
        line = f", line {frames[-1].lineno}" if frames else ""
        text = _in_words(error)
        raise ConfigError(
            f"the term {term.name} of {term.file}{line} cannot be run: {text}"
        ) from None


def place(function: Callable[..., Any]) -> str:
    """The file and line of a term, for messages."""
    code = inspect.unwrap(function).__code__
    return f"{code.co_filename}, line {code.co_firstlineno}"


def fault(kind: type, value: Any, shape: tuple[int, ...]) -> str:
    """What is wrong with the value that a term of a kind (`Reward`, ...) returned, in words.

    "" for a number, or an array of JAX or NumPy, of this shape; of a `Termination` it is bool.
    """
    ends = kind is Termination
    expected = f"an array of the shape {shape}" if shape else "one number of one robot"
    expected = "True or False" if ends else expected
    if value is None:
        return f"returns None, expected {expected}: no return statement?"
    dtype = getattr(value, "dtype", None)
    if getattr(dtype, "kind", "O") in "OSUc" and not isinstance(value, bool | int | float):
        stack = "xp.stack([...]) makes an array of it, with xp = x.__array_namespace__()"
        hint = f": {stack}" if shape and isinstance(value, list | tuple) else ""
        return f"returns a {type(value).__name__}, expected {expected}{hint}"
    if (found := getattr(value, "shape", ())) != shape:
        hint = (
            "; sum it" if kind is Reward else "; .any() or .all() makes one of it" if ends else ""
        )
        return f"has the shape {found}, expected {shape or expected}{hint}"
    if ends and not isinstance(value, bool) and str(dtype) != "bool":
        return f"returns numbers, expected {expected}: compare it, such as height < 0.2"
    return ""


def _in_words(error: Exception) -> str:
    """What a term has raised: for what JAX cannot trace what to do, else the error, cut between words."""
    name = type(error).__name__  # JAX is not imported here
    if name in UNTRACED:
        return f"{UNTRACED[name]} (docs/task.md)"
    return textwrap.shorten(f"{name}: {error}", 300, placeholder=" ...")


def guarded(term: Term) -> Callable[..., Any]:
    """The function of a term, with the errors of `call`."""
    return functools.wraps(term.function)(lambda **facts: call(term, facts))
