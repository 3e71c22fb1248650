"""All that keeps a robot's file from being trained, found at once: `of_file`, `of_spec`.

MuJoCo, `complete` and `robot_contract` stop at what they cannot go on from. This module reads a file that was
refused once more. In memory it mends each fault and goes on, so that a person mends the file once. How a limb
should be only that person knows: after a mend that may move one, nothing is said of the default pose.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING
from xml.etree import ElementTree
from xml.parsers import expat

import mujoco
import numpy as np

from dynappo.description import collision, complete, joints, mjcf, robot_contract

if TYPE_CHECKING:
    from pathlib import Path

MOST = 40  # errors of MuJoCo's that are mended
NAMED = 6  # elements that are named of those with the same error
MESH = mujoco.mjtGeom.mjGEOM_MESH
READ = ValueError, mujoco.FatalError  # what MuJoCo raises where it reads and compiles
# an element, and its line; of an included file, its name as well (`_named_places`)
WHERE = re.compile(r",? Element(?: name)? '([^']*)'(?:, id \d+)?, (line \d+(?: of .+)?)$")
NUMBERS = re.compile(
    r" for actuator id = \d+| in (?:geom|bodypair) \d+"
)  # of which a line says more
# what its parser says of an attribute: its name, or its value
OF_NAME, OF_VALUE = r"attribute:? '(\w+)'", r"(?:keyword|default class name):? '([^']*)'"
MASSES = "mass and inertia of moving bodies must be larger than mjMINVAL"
# of a spec, whose elements know their line
KINDS = "bodies frames geoms joints sites cameras lights pairs excludes equalities tendons actuators".split()
KINDS += "sensors keys meshes hfields textures materials skins flexes numerics texts tuples plugins".split()
Fresh = Callable[[], mujoco.MjSpec]
CURE = "; give each an inertial, or shapes that have a mass"


def of_file(xml: Path, text: str, first: Exception) -> str:
    """What is wrong with a file, or with the MJCF `text` in it, in words; it was refused for `first`."""
    said: list[str] = []
    with contextlib.suppress(*READ, OSError, RuntimeError):
        fresh, said = read(xml, text)
        if fresh is not None:
            said += of_spec(fresh if said or text else placed(xml, fresh), pose=not said)
    return robot_contract.in_words(said or _grouped([plain(first)]))


def read(xml: Path, text: str = "") -> tuple[Fresh | None, list[str]]:
    """`(fresh, errors)`: `fresh()` reads a file without the attributes and elements that MuJoCo's parser
    refuses, in the file or in those that it includes.

    None if more than that is wrong.
    """
    content, said, first = text or xml.read_bytes().decode(), [], ""
    places: list[str] = []  # of each line of `content`, if it has those of other files

    def fresh():
        if not text and not said and not places:
            return mujoco.MjSpec.from_file(str(xml))
        return _of_text(content, places, "" if text else str(xml.parent))

    while len(said) < MOST:
        try:
            fresh()
            if places and not said:  # no fault of one file
                break
            return fresh, _grouped(said)
        except READ as error:
            # of what is included MuJoCo tells no file, and no line
            if "<include" in content and not text and not places:
                content, places = _with_included(xml, first=error)
                first = plain(error)
                continue
            found = plain(error)
            said.append(_placed(found, places))
            content, before = _without(content, found), content
            if content == before:
                break
    return None, _grouped(said or [first])


def placed(xml: Path, fresh: Fresh) -> Fresh:
    """`fresh`, which reads a file; of one that includes others the same with elements that know their file
    and line, which MuJoCo does not tell of them."""
    try:
        content, places = _with_included(xml, first=ValueError())
        again = partial(_of_text, content, places, str(xml.parent))
        return again if again() and any(" of " in place for place in places) else fresh
    except READ:
        return fresh


def of_spec(fresh: Fresh, pose: bool = True) -> list[str]:
    """Every rule that the robot of a spec breaks; of its default pose if that is known.

    `fresh()` is the spec anew each time: a copy of one lacks what refers to nothing.
    """
    spec = fresh()
    said = _mend_tree(spec)
    mends: list[Callable[[mujoco.MjSpec], object]] = [_mend_tree] if said else []
    said += robot_contract.broken_options(spec)
    if robot_contract.broken_tree(spec):  # there is no robot in it
        return said
    mends.append(_mend_options)
    errors, pose = [], pose and len(mends) == 1
    while len(errors) < MOST:
        spec = fresh()
        for mend in mends:
            mend(spec)
        try:
            model = complete.complete(spec).model
            said += [*_grouped(errors), *robot_contract.broken(model, pose)]
            return list(dict.fromkeys(said))
        except READ as error:
            text = plain(error)
            if text in errors or collision.NO_FOOT in text:
                errors += [text] * (pose and text not in errors)
                break
            errors.append(text)
            mends.append(partial(_mend, error=text))
            pose &= not _mend(fresh(), text)
    return list(dict.fromkeys([*said, *_grouped(errors)]))


def plain(error: Exception) -> str:
    """The text of an error, in a line."""
    return " ".join(str(error).split())


def _grouped(said: list[str]) -> list[str]:
    """Errors that differ by their places alone are one."""
    places: dict[str, list[str]] = {}
    for text in said:
        place = WHERE.search(text)
        # MuJoCo knows no line of an included file
        line = f" ({place[2]})" if place and place[2] != "line 0" else ""
        here = f"{place[1]}{line}".strip() if place else ""
        places.setdefault(NUMBERS.sub("", WHERE.sub("", text)), []).append(here)
    return [
        text + (f": {mjcf.listed(found, NAMED)}" if any(found) else "") + CURE * (MASSES in text)
        for text, found in places.items()
    ]


# what MuJoCo's parser refuses


def _without(content: str, error: str) -> str:
    """An XML text without the attribute or the element that an error is about; as it is if that is not clear.

    Blanks take its place, so that lines keep their numbers.
    """
    place = WHERE.search(error)
    if not place:
        return content
    data = content.encode()
    found = [
        span for tag, line, span in _elements(data) if (tag, f"line {line}") == (place[1], place[2])
    ]
    if not found:
        return content
    start, inside, end = found[0]
    named, valued = re.search(OF_NAME, error), re.search(OF_VALUE, error)
    if named or valued:
        name = re.escape(named[1]) if named else r"\w+"
        value = re.escape(valued[1]) if valued else "[^\"']*"
        one = re.search(rf"\s{name}\s*=\s*([\"']){value}\1".encode(), data[start:inside])
        if not one:
            return content
        start, end = start + one.start(), start + one.end()
    blank = re.sub(rb"[^\n]", b" ", data[start:end])
    return (data[:start] + blank + data[end:]).decode()


def _elements(data: bytes) -> list[tuple[str, int, tuple[int, int, int]]]:
    """`(tag, line, (start, end of its first tag, end))` of each element, in bytes."""
    parser, open_, found = expat.ParserCreate(), [], []

    def begin(tag, _):
        start = parser.CurrentByteIndex
        # quotes may have a >
        first = re.match(rb"<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>", data[start:])
        inside = start + (first.end() if first else 1)
        open_.append((tag, parser.CurrentLineNumber, start, inside))

    def finish(_):
        tag, line, start, inside = open_.pop()
        alone = data[inside - 2 : inside] == b"/>"
        end = inside if alone else data.index(b">", parser.CurrentByteIndex) + 1
        found.append((tag, line, (start, inside, end)))

    parser.StartElementHandler, parser.EndElementHandler = begin, finish
    with contextlib.suppress(expat.ExpatError):
        parser.Parse(data, True)
    return found


# files in a file


def included(xml: Path, folder: Path, name: str) -> Path:
    """The file that `xml` includes by a name, where MuJoCo finds it: in the `folder` of the first file, else
    in that of `xml`."""
    path = folder / name
    return path if path.exists() else xml.parent / name


def _with_included(
    xml: Path, first: Exception, folder: Path | None = None
) -> tuple[str, list[str]]:
    """`(text, places)`: a file with what it includes in its place, and where each line of that is from.

    `folder` is that of the first file. `first`, which MuJoCo said, is raised where one of the files cannot be
    read, or includes itself.
    """
    main, folder = folder is None, folder or xml.parent
    try:
        data = xml.read_bytes().replace(b"\r\n", b"\n")
        text, roots = data.decode(), _elements(data)
        ElementTree.fromstring(text)  # else `_elements` has a part of them alone
        includes = sorted(
            (start, end, ElementTree.fromstring(data[start:end]).attrib["file"])
            for tag, _, (start, _, end) in roots
            if tag == "include"
        )
        root, _, (_, inside, end) = roots[-1]
        close = max(inside, data.rfind(b"</" + root.encode(), 0, end))
        begin, close = (0, len(data)) if main else (inside, close)
        pieces, places = [], []
        for start, end, name in [*includes, (close, close, "")]:
            pieces.append(data[begin:start].decode())
            line = data[:begin].count(b"\n") + 1
            lines = range(line, line + pieces[-1].count("\n") + 1)
            places += [f"line {k}" + f" of {xml.name}" * (not main) for k in lines]
            if name:
                inner, where = _with_included(included(xml, folder, name), first, folder)
                pieces.append(inner)
                places += where
            begin = end
        return "\n".join(pieces), places
    except (OSError, ValueError, KeyError, RecursionError, ElementTree.ParseError):
        raise ValueError(*_grouped([plain(first)])) from None


def _of_text(content: str, places: list[str], folder: str) -> mujoco.MjSpec:
    """The spec of an MJCF text whose other files are in `folder`; `places`: of its lines, or none."""
    spec = mujoco.MjSpec.from_string(content)
    spec.modelfiledir = folder
    _named_places(spec, places)
    return spec


def _placed(error: str, places: list[str]) -> str:
    """An error with its line, as `places` has it, in place of the line of the whole text."""
    place = WHERE.search(error)
    if not place or not places:
        return error
    return error[: place.start(2)] + places[int(place[2].split()[1]) - 1]


def _named_places(spec: mujoco.MjSpec, places: list[str]) -> None:
    """Give what MuJoCo's compiler may speak of its place, of which it knows the line of the whole text."""
    for thing in [one for kind in KINDS for one in getattr(spec, kind)]:
        line = re.fullmatch(r"line (\d+)", thing.info) if places else None
        thing.info = places[int(line[1]) - 1] if line else thing.info


# what keeps a robot from being completed


def _mend_tree(spec: mujoco.MjSpec) -> list[str]:
    """Make one robot of hinges on a free base of a spec; what was wrong with that."""
    said: list[str] = []
    complete.drop_bodies_without_limbs(spec, [])
    for _ in range(3):
        try:
            complete.one_robot(spec, complete.choose_floor(spec), [])
            break
        except ValueError as error:
            said.append(str(error))
            _mend_base(spec)
    said += robot_contract.broken_tree(spec)
    for i, joint in enumerate(spec.joints):
        if joint.type == joints.FREE and i:
            spec.delete(joint)
        elif joint.type != joints.FREE:
            joint.type = joints.HINGE
    return said


def _mend_base(spec: mujoco.MjSpec) -> None:
    """Keep the robot of most joints; if there is one alone, nothing but `complete` joins it to the world."""
    for key in list(spec.keys):  # else MuJoCo refuses to delete what they have numbers of
        spec.delete(key)
    moving = [body for body in spec.worldbody.bodies if body.find_all("joint")]
    moving.sort(key=lambda body: len(body.find_all("joint")))
    for other in moving[:-1] if len(moving) > 1 else moving[0].joints:
        spec.delete(other)


def _mend_options(spec: mujoco.MjSpec) -> None:
    """Options, flexes and plugins with which no robot is trained go."""
    usual = mujoco.MjSpec().option
    spec.option.disableflags, spec.option.gravity = usual.disableflags, usual.gravity
    spec.option.timestep = usual.timestep
    for thing in (*spec.bodies, *spec.geoms, *spec.actuators, *spec.sensors, *spec.meshes):
        thing.plugin.active = False
    for thing in (*spec.flexes, *spec.plugins):
        spec.delete(thing)


def _mend(spec: mujoco.MjSpec, error: str) -> bool:
    """Mend what an error of MuJoCo's compiler is about; whether a limb may then be elsewhere."""
    place = WHERE.search(error)
    here = place[2] if place else ""
    bodies = [body for body in spec.bodies[1:] if body.info == here]
    _mend_masses(bodies)
    geoms = [geom for geom in spec.geoms if geom.info == here]
    meshes = [geom for geom in spec.geoms if geom.type == MESH]
    _mend_shapes(geoms if place else meshes)
    hinges = [joint for joint in spec.joints if joint.info == here and joint.type == joints.HINGE]
    for joint in hinges:
        joint.axis, joint.limited, joint.range = [0, 0, 1], joints.OFF, [0, 0]
    ties = spec.actuators, spec.sensors, spec.equalities, spec.tendons, spec.pairs, spec.excludes
    for tie in [tie for kind in ties for tie in kind if tie.info == here]:
        spec.delete(tie)
    return bool(geoms or hinges or not place)


def _mend_masses(bodies: list) -> None:
    for body in bodies:
        body.explicitinertial, body.mass, body.inertia = True, 1.0, np.ones(3)
        body.fullinertia, body.ipos, body.iquat = np.full(6, np.nan), np.zeros(3), [1, 0, 0, 0]


def _mend_shapes(geoms: list) -> None:
    """Small balls in place of shapes."""
    for geom in geoms:
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, 0.01)
        geom.meshname, geom.hfieldname, geom.material = "", "", ""
        geom.fromto = np.full(6, np.nan)
