"""Checks an MJCF from an unknown source, before and after MuJoCo compiles it.

A few characters can ask for a hundred thousand bodies (`replicate`), a field of 40 GB or a time
step of 1e-12 s; MuJoCo would compute for hours, or crash. Not checked: meshes, pictures and other
data that a file names, and settings of plugins, which can take any amount of time and memory; and
which files `include` and the others read, which may be any file of the machine. So trust an MJCF
only as you trust code (robots/README.md). The checks here find mistakes and cheap attacks.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
from pathlib import Path
from xml.parsers import expat

import mujoco

from dynappo.config import ConfigError

MAX_BYTES = 2**24  # of a file and all that it includes; the robots here have 10 KiB
MAX_CARRIED = 2**19  # of one in a policy.npz or a checkpoint, as JSON
MAX_NUMBERS = 2**24  # of all elements of one in a policy or checkpoint: pixels, heights, user data
MAX_ELEMENTS = 20_000  # of XML, repeated ones counted each time
MAX_BODIES, MAX_SPEEDS = 2000, 1000  # the mass matrix is as large as the square of the latter
TIMESTEP = 1e-5, 0.1  # s
REPEATS = ("replicate", "composite", "flexcomp")  # their `count` is how often, along each axis
NAN = {"nan", "+nan", "-nan"}  # MuJoCo would write a warning to a file in the working directory
NAMES = {"name", "class", "childclass", "file"}  # attributes whose value may be the word "nan"
OUTSIDE = {"include", "model", "extension", "plugin"}  # elements that load other files, or code
FOLDERS = {"assetdir", "meshdir", "texturedir"}  # attributes that name folders of files
# attribute, or TAG.attribute -> largest number in it
MOST = {
    "count": 10_000,
    "cellcount": 1000,
    "nrow": 4096,
    "ncol": 4096,
    "texture.width": 4096,
    "texture.height": 4096,
    "mesh.params": 1000,
    "numeric.size": 10**6,
    "contact.num": 1000,
    "nsample": 10**5,
    "resolution": 8192,
    "offwidth": 8192,
    "offheight": 8192,
    "offsamples": 64,
    "shadowsize": 16384,
    "iterations": 1000,
    "ls_iterations": 1000,
    "noslip_iterations": 1000,
    "ccd_iterations": 1000,
    "sdf_iterations": 1000,
    "sdf_initpoints": 1000,
    "size.memory": 2**32,
    "size.nstack": 10**8,
    "size.njmax": 10**6,
    "size.nconmax": 10**6,
    "size.nuserdata": 10**6,
    "size.nkey": 10_000,
}
SETTINGS = {
    "option",
    "size",
    "global",
    "quality",
}  # elements whose limits are on steps and buffers, not on lists
MOST_OF_SIZE = 1000  # of every other attribute of `size`
UNITS = "KMGTPE"  # of `size.memory`, each 1024 times the one before


@contextlib.contextmanager
def one_line(xml: Path, what: str = ""):
    """Turn errors about a file, MuJoCo's or ours, into a one-line ConfigError that begins with its
    path.

    `what` comes after the path: the part of the file that is meant.
    """
    try:
        yield
    except ConfigError:
        raise
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        text = " ".join(str(error).split()) or "it needs more memory than there is"
        raise ConfigError(f"{xml}: {what}{text}") from None


@contextlib.contextmanager
def reading(xml: Path):
    """As `one_line`, for code that compiles the file; checks its text first."""
    with one_line(xml):
        check_text(xml)
        yield


def model(xml: Path, text: str = "") -> mujoco.MjModel:
    """The compiled model of a file, or of the MJCF `text` in it, checked before and after."""
    if text:
        with one_line(xml):
            check_alone(text)
            return check_model(mujoco.MjModel.from_xml_string(text))
    with reading(xml):
        return check_model(mujoco.MjModel.from_xml_path(str(xml)))


def check_alone(text: str) -> None:
    """ValueError if an MJCF text names a file, or asks for more than a robot needs."""
    if not isinstance(text, str) or len(json.dumps(text)) > MAX_CARRIED:
        raise ValueError(f"expected an MJCF of at most {MAX_CARRIED} bytes")
    asked = 0
    for tag, attributes, often in _elements(text, 1, [0], ""):
        asked += often * _numbers(tag, attributes)
        if asked > MAX_NUMBERS:
            raise ValueError(f"{tag} brings it to {asked} numbers, expected at most {MAX_NUMBERS}")
        named = [name for name in attributes if name.startswith("file")]
        if named or tag in OUTSIDE:
            found = f"{tag} {named[0]}={attributes[named[0]][:40]!r}" if named else tag
            raise ValueError(f"expected an MJCF that needs no other file, found {found}")


def _numbers(tag: str, attributes: dict[str, str]) -> int:
    """How many numbers an element asks for in attributes with a limit, like a picture's pixels."""
    if tag in SETTINGS:
        return 0
    if tag == "texture" and attributes.get("type", "cube") != "2d":  # six squares
        width = attributes.get("width", "0")
        attributes = {"width": width, "height": width, "sides": "6"}
    found = [n for name, text in attributes.items() for n in _within(tag, name, text, "")]
    return math.prod(max(1, math.ceil(n)) for n in found) * (6 if "sides" in attributes else 1)


def check_text(xml: Path) -> None:
    """ValueError if a file, or one it includes, is not XML or asks for more than a robot needs."""
    left, counted, seen = MAX_BYTES, [0], set()
    todo, folders = [(Path(xml), 1)], {""}
    while todo:
        path, times = todo.pop()
        if path.resolve() in seen:  # MuJoCo refuses it
            continue
        seen.add(path.resolve())
        try:
            with path.open("rb") as file:
                content = file.read(left + 1)
        except OSError as error:
            raise ValueError(f"{_of(path, xml)}cannot be read ({error.strerror})") from None
        left -= len(content)
        if left < 0:
            raise ValueError(f"expected at most {MAX_BYTES} bytes, with all that it includes")
        text = content.decode(errors="replace")
        for tag, attributes, often in _elements(text, times, counted, _of(path, xml)):
            folders |= {attributes[name] for name in FOLDERS & set(attributes)}
            if not (named := attributes.get("file")):
                continue
            places = {p / f / named for p in (xml.parent, path.parent) for f in folders}
            for place in (place for place in places if os.path.exists(place)):
                if not os.path.isfile(place) and not os.path.isdir(place):  # it would wait for ever
                    raise ValueError(f"{_of(path, xml)}{place} is a device, expected a file")
                if tag in ("include", "model") and os.path.isfile(place):
                    todo.append((place, often))


def _of(path: Path, xml: Path) -> str:
    """The beginning of an error about an included file; "" for the file itself."""
    return "" if path == xml else f"{path}: "


def _elements(text: str, times: int, counted: list[int], of: str) -> list[tuple[str, dict, int]]:
    """`(tag, attributes, how often)` of every element in a text that is included `times` times.

    `counted[0]` counts all elements so far; errors begin with `of`.
    """
    found, stack = [], [times]

    def start(tag, attributes):
        often = stack[-1]
        for name, value in attributes.items():
            if name not in NAMES and NAN & set(value.lower().split()):
                raise ValueError(f"{of}{tag} has {name}={value[:40]!r}, expected numbers")
            numbers = _within(tag, name, value, of)
            if tag in REPEATS and name == "count":
                often *= math.prod(max(1, math.ceil(n)) for n in numbers)
        counted[0] += often
        if counted[0] > MAX_ELEMENTS:
            raise ValueError(f"{of}more than {MAX_ELEMENTS} elements, expected a robot")
        stack.append(often)
        found.append((tag, attributes, often))

    def refuse(*_):
        raise ValueError(f"{of}a DOCTYPE, which MJCF does not have")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, lambda _: stack.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise ValueError(f"{of}XML parse error: {error}") from None
    return found


def _within(tag: str, name: str, value: str, of: str) -> list[float]:
    """The numbers of an attribute that has a limit; ValueError if one is above it."""
    most = MOST.get(f"{tag}.{name}", MOST.get(name, MOST_OF_SIZE if tag == "size" else math.inf))
    numbers = []
    for text in value.split() if most < math.inf else ():
        power = UNITS.find(text[-1].upper()) + 1
        try:
            number = float(text[:-1] if power else text) * 1024**power
        except ValueError:
            number = math.inf
        if not number <= most:
            raise ValueError(f"{of}{tag} has {name}={value[:40]!r}, expected at most {most}")
        numbers.append(number)
    return numbers


def check_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """The compiled model; ValueError if a step of it would take far too long."""
    low, high = TIMESTEP
    step = model.opt.timestep
    for ok, text in (
        (low <= step <= high, f"a timestep of {low:g} to {high:g} s, found {step:g}"),
        (model.nbody <= MAX_BODIES, f"at most {MAX_BODIES} bodies, found {model.nbody}"),
        (model.nv <= MAX_SPEEDS, f"at most {MAX_SPEEDS} degrees of freedom, found {model.nv}"),
    ):
        if not ok:
            raise ValueError(f"expected {text}")
    return model
