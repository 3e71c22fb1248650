"""Writes a completed robot as an MJCF that needs no other file: `self_contained(spec)`.

MuJoCo's own writer keeps default classes as they were read. They may name materials that are no longer
there, and then it cannot read its own text. Here each element has its own numbers.
"""

from __future__ import annotations

from xml.etree import ElementTree

import mujoco
import numpy as np

from dynappo.description.rotation import matrix, quaternion


def self_contained(spec: mujoco.MjSpec) -> str:
    """The MJCF of a compiled spec, without default classes (but tendons') and frames.

    The spec's elements lose their classes, which changes none of their numbers.
    """
    for element in _elements(spec):
        element.classname = spec.default
    for body in spec.bodies[1:]:
        body.childclass = ""
    spec.comment = ""  # it may have "--", which is no XML to other parsers
    try:
        root = ElementTree.fromstring(spec.to_xml())
    except UnicodeDecodeError as error:
        raise ValueError(f"expected a text in UTF-8: {error}") from None
    except ElementTree.ParseError:  # MuJoCo's parser takes more
        raise ValueError("a name in it has a character that no XML has; rename it") from None
    materials = {one.name for one in spec.materials}
    left = {one.get("class") for one in root.iter() if one.tag != "default"}
    for default in root.findall("default"):
        for one in default.iter():
            if one.get("material") not in materials:
                one.attrib.pop("material", None)
        for nested in default.findall("default"):
            if not left & {one.get("class") for one in nested.iter("default")}:
                default.remove(nested)
        if not len(default):
            root.remove(default)
    for size in root.findall("size"):
        root.remove(size)
    for body in [*root.iter("worldbody"), *root.iter("body")]:
        _without_frames(body)
    return ElementTree.tostring(root, "unicode")


def _elements(spec: mujoco.MjSpec):
    """What can be taken out of its default class: all but tendons."""
    yield from (*spec.geoms, *spec.joints, *spec.actuators, *spec.meshes, *spec.materials)
    yield from (*spec.sites, *spec.cameras, *spec.lights)
    yield from (*spec.equalities, *spec.pairs)


def _without_frames(parent: ElementTree.Element) -> None:
    """Give what is in a `<frame>` (which MuJoCo makes of bodies without a joint) its place in the body."""
    for child in list(parent):
        if child.tag != "frame":
            continue
        place = _numbers(child, "pos", "0 0 0")
        turn = matrix(_numbers(child, "quat", "1 0 0 0"))
        _without_frames(child)
        at = list(parent).index(child)
        parent.remove(child)
        for i, one in enumerate(child):
            one.set("pos", _written(place + turn @ _numbers(one, "pos", "0 0 0")))
            if one.tag == "joint":
                one.set("axis", _written(turn @ _numbers(one, "axis", "0 0 1")))
            elif one.tag == "light":
                one.set("dir", _written(turn @ _numbers(one, "dir", "0 0 -1")))
            else:
                inner = matrix(_numbers(one, "quat", "1 0 0 0"))
                one.set("quat", _written(quaternion(turn @ inner)))
            parent.insert(at + i, one)


def _numbers(element: ElementTree.Element, name: str, default: str) -> np.ndarray:
    return np.array(element.get(name, default).split(), float)


def _written(values: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)
