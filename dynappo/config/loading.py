"""Load a config file, and set its fields from a command line.

Why not absl's `config_flags`: for a missing file it returns an object that fails later, and for an
unknown field it prints a traceback. Every error here is a `ConfigError` of one line, raised before JAX
is imported.
"""

from __future__ import annotations

import ast
import difflib
import functools
import json
import pathlib
import re
import runpy
from collections.abc import Callable
from typing import Any

from ml_collections import config_dict

from dynappo.config import fields, files, own_code, shell, terms
from dynappo.config.fields import ConfigError, flat
from dynappo.config.files import find

OWN = (pathlib.Path(), pathlib.Path("configs"))  # a name in one of these may mean dynappo's own

# what an environment by name (config.env) reads of the groups task and physics
OF_NAMED = ("task.episode_length", "task.random_clock", "physics.impl")
# environments of other packages, which need not be installed; for who leaves the package out
OF_PACKAGES = {
    "playground": """
        ApolloJoystickFlatTerrain BarkourJoystick BerkeleyHumanoidJoystickFlatTerrain
        BerkeleyHumanoidJoystickRoughTerrain G1JoystickFlatTerrain G1JoystickRoughTerrain Go1Footstand
        Go1Getup Go1Handstand Go1JoystickFlatTerrain Go1JoystickRoughTerrain H1InplaceGaitTracking
        H1JoystickGaitTracking Op3Joystick SpotFlatTerrainJoystick SpotGetup SpotJoystickGaitTracking
        T1JoystickFlatTerrain T1JoystickRoughTerrain
    """.split(),
    "brax": """
        ant halfcheetah hopper humanoid humanoidstandup inverted_double_pendulum inverted_pendulum
        pusher reacher walker2d
    """.split(),
}
FOLLOWS = {  # fields that are written with another one, and from what
    **dict.fromkeys(
        ("task.terms_hash", "task.terms_about"), "the file that --config.task.terms names"
    ),
    "task.tiles.map_hash": "the file that --config.task.tiles.map names",
    "run.logs_hash": "the file that --logs names",
    "code": "the config's file with get_env",
}


def load(spec: str) -> config_dict.ConfigDict:
    """The config of `NAME`, `FILE.py`, `NAME:VARIANT` or `FILE.py:VARIANT`; not validated.

    `NAME` is `configs/NAME.py`. dynappo looks for that, and for `NAME.py`, in the working directory, then
    among its own configs; a path with another folder means that file alone. The file runs as Python.
    """
    return load_both(spec, flag="")[0]


def load_both(
    spec: str, flag: str = "--config"
) -> tuple[config_dict.ConfigDict, Callable[[Any], Any] | None]:
    """`load(spec)`, and the `get_env(config)` that the file may define; else None.

    Where it does, `robot` is "": what is trained is no robot of dynappo's. What `get_env` raises comes as a
    ConfigError of one line. `flag` is where `spec` was named; "": not by a flag.
    """
    of = f"{flag}: " if flag else ""
    name, _, variant = spec.partition(":")
    path = pathlib.Path(f"configs/{name}.py" if name.isidentifier() else name)
    looked_up = path.parent in OWN
    if looked_up and not path.is_file():
        path = find("configs", path.name) or path
    if not path.is_file():
        where = " here or among dynappo's own configs" if looked_up else ""
        raise ConfigError(f"{of}no file {name!r}{where}{_near(name, variant, flag)}")
    if path.suffix != ".py":  # it would be run as Python, whatever it is
        robot = path.suffix.lower() in (".xml", ".mjcf", ".urdf")
        todo = f"; for a robot's file: {shell.line('adopt', path)}" if robot else ""
        raise ConfigError(f"{of}{path} is no FILE.py, expected a config in Python{todo}")
    try:
        config, get_env = _run(path, variant)
        fields.check_names(flat(config))
    except ConfigError as error:
        own = looked_up and path == find("configs", path.name, own=True)
        told = f"{flag}={spec}".lstrip("=") if own else f"{of}{path}"
        raise ConfigError(f"{told}: {error}") from None
    except ValueError as error:  # of a variant
        raise ConfigError(f"{flag}={spec}: {_line(error)}".lstrip("=")) from None
    except (Exception, SystemExit) as error:  # a file that ends Python must not look like a success
        raise ConfigError(f"{of}{path}: get_config {_cannot_be_run(error)}") from None
    if get_env is None:
        return config, None
    config.robot, config.code = "", own_code.digest(path)

    def one_line(config):
        try:
            return get_env(config)
        except ConfigError as error:
            raise ConfigError(f"{of}{path}: {error}") from None
        except (Exception, SystemExit) as error:
            raise ConfigError(f"{of}{path}: get_env {_cannot_be_run(error)}") from None

    return config, one_line


def _near(name: str, variant: str, flag: str) -> str:
    """Words on the config that is meant by the `name` of none; else on which there are."""
    if not re.fullmatch(r"[A-Za-z_][\w-]*", name):
        return ""
    robots = [robot for robot in files.robots() if find("configs", f"{robot}.py")]
    every = robots + [f"{package}:{one}" for package, names in OF_PACKAGES.items() for one in names]
    for spec in every:
        if spec.rpartition(":")[2].lower() == name.lower():
            return _did_you_mean(f"{spec}:{variant}".rstrip(":"), flag)
    # the policy go1_deploy, as `play` names it, is of go1:deploy
    kinds = {f"{robot}_{kind}": f"{robot}:{kind}" for robot in robots for kind in files.MORE}
    known = {name: name for name in robots} | {n: kinds[n] for n in files.bundled() if n in kinds}
    plain = name.lower().replace("-", "_")
    if near := difflib.get_close_matches(plain, known, 1, 0.75):
        spec = known[near[0]]
        return _did_you_mean(spec if ":" in spec else f"{spec}:{variant}".rstrip(":"), flag)
    return f"; robots that have one are {', '.join(robots)}"


def _did_you_mean(spec: str, flag: str) -> str:
    return f"; did you mean {f'{flag}={spec}'.lstrip('=')}?"


def _cannot_be_run(error: BaseException) -> str:
    return f"cannot be run: {type(error).__name__}: {_line(error)}"


def _run(path: pathlib.Path, variant: str) -> tuple[config_dict.ConfigDict, Any]:
    """What get_config of a file returns, if it is a config, and its get_env."""
    names = runpy.run_path(str(path))
    get_config = names.get("get_config")
    if get_config is None:
        raise ConfigError("defines no function get_config(variant)")
    config = get_config(variant)
    if not isinstance(config, config_dict.ConfigDict):
        kind = type(config).__name__
        raise ConfigError(
            f"get_config returns {kind}, expected a ConfigDict; see configs/default.py"
        )
    config = config_dict.ConfigDict(config)  # a frozen one can be changed again
    _use_terms(config, path, names)
    if near := _near_get_env(names):
        raise ConfigError(
            f"has a function {near}, but no get_env, so a robot would be trained; did you mean get_env? Else "
            "give it another name"
        )
    return config, names.get("get_env")


def _near_get_env(names: dict[str, Any]) -> str:
    """A function that the file itself defines whose name looks like a slip for get_env; "" if it has none."""
    own = [n for n, x in names.items() if getattr(x, "__module__", "") == names["__name__"]]
    near = [
        *difflib.get_close_matches("get_env", own, 1, 0.85),
        *(n for n in own if n[:7] == "get_env"),
    ]
    return near[0] if near and "get_env" not in names else ""


def _use_terms(config: config_dict.ConfigDict, path: pathlib.Path, names: dict[str, Any]) -> None:
    """Use the terms of a config file, whose `names` these are, or of the file that it names, beside it."""
    if fields.every().keys() - flat(config).keys():
        return  # `check_names` says what is missing
    given, own = config.task.terms, terms.declared(names)
    if own and given and not config.task.terms_hash:
        raise ConfigError(
            f"task.terms is {given!r}, but the file has terms itself ({own[0].name}, ...); expected one of "
            "them: import the others into it"
        )
    if own:
        terms.use(config, terms.read(path, names))
    elif given and not config.task.terms_hash:
        terms.use(config, terms.read(path.parent / given))


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())


def override(config: config_dict.ConfigDict, field: str, text: Any) -> None:
    """Set `field` (dotted) from the text of a command line, with the type of its default.

    What is no text is the value itself, from Python."""
    group, _, leaf = field.rpartition(".")
    try:
        node = functools.reduce(lambda c, k: c[k], filter(None, group.split(".")), config)
        old = node[leaf]
    except (KeyError, TypeError, AttributeError):
        raise ConfigError(
            f"--config.{field}: no such field; {fields.near(field, flat(config))}"
        ) from None
    own = field.partition(".")[0] in ("task", "physics") and field not in OF_NAMED
    if config.get("env") and own:
        raise ConfigError(
            f"--config.{field}: {config.env} has its own weights, noise, commands and physics; of these "
            f"groups it reads {', '.join(OF_NAMED)}"
        )
    if field in FOLLOWS:
        raise ConfigError(f"--config.{field}: follows from {FOLLOWS[field]}; leave it out")
    if isinstance(old, config_dict.ConfigDict):
        raise ConfigError(f"--config.{field} is a group, expected one of {', '.join(old)}")
    kind = fields.field(field)
    assert kind is not None
    is_text = isinstance(text, str)
    try:
        value = ast.literal_eval(text.strip()) if is_text and kind.kind is not str else text
    except (ValueError, SyntaxError, TypeError, RecursionError, MemoryError):  # of deep nesting too
        value = None
    value = fields.convert(kind, value)
    none = kind.default is None and str(text).strip() == "None"  # that is a value, too
    if value is None and not none:
        raise ConfigError(f"--config.{field}={text!r}: expected {fields.expected(kind)}")
    with node.ignore_type():
        node[leaf] = value
    if field == "task.terms":
        terms.use(config, terms.read(value)) if value else terms.leave(config)


def to_json(config) -> str:
    """The config as indented JSON, as `config.json` holds it."""
    return json.dumps(config.to_dict(), indent=2)


def from_json(text: str) -> config_dict.ConfigDict:
    """The config that `to_json` wrote, perhaps of another version: what it lacks has its default, and what
    this version lacks is left out (`versions_apart` tells both). ConfigError where it is no config.
    """
    try:
        found = flat(json.loads(text))
    except (ValueError, AttributeError, RecursionError):
        raise ConfigError("it is not the JSON of a config") from None
    return fields.typed(found)


def versions_apart(old: str, config) -> str:
    """A line on the fields that only one of a run's `to_json` text and `config` has; "" if there are none."""
    try:
        before, here = flat(json.loads(old)), flat(config)
    except (ValueError, AttributeError, RecursionError):
        return ""
    new = [f"{name} is new, and {value!r}" for name, value in here.items() if name not in before]
    gone = [f"{name} is gone" for name in before if name not in here]
    return (
        "the run is of another version of dynappo: " + "; ".join(new + gone) if new + gone else ""
    )


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
        if name == "code" and before[name] != after[name]:
            return "the file with get_env, or one that it imports, has changed; comments and get_config may"
        if before[name] != after[name] and name in ("task.terms_hash", "task.terms_about"):
            return _terms_apart(before, after)
        if name == "run.logs_hash" and before[name] and not after[name]:
            log = before.get("run.logs", "")
            return f"it learns from the log {log}: give {shell.quoted(f'--logs={log}')}"
        if name == "run.logs_hash" and after[name] and not before[name]:
            return "it learns from no log: leave --logs out"
        if before[name] != after[name]:
            there, here = ("none" if each == "" else each for each in (before[name], after[name]))
            return f"{name} {there} there, {here} here"
    return ""


def _terms_apart(before: dict[str, Any], after: dict[str, Any]) -> str:
    """In words, how the terms of two configs differ."""
    there, here = (terms.told(each.get("task.terms_about") or "") for each in (before, after))
    if there == here:
        return f"the code of its terms, {before.get('task.terms') or 'none'}, is another now"
    there, here = (", ".join(names) or "none" for names in (there, here))
    return f"with terms {there} there, {here} here"
