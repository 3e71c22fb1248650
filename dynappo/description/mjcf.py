"""Compiles an MJCF, with errors in one line; the MJCF inside a policy may read no file.

An MJCF file is trusted as code is: it may name any file of the machine, and take any time and memory
(robots/README.md). The MJCF inside a policy.npz or a checkpoint comes from whoever sent that, so it must need
no other file (`check_alone`).
"""

from __future__ import annotations

import contextlib
import warnings
from typing import TYPE_CHECKING
from xml.parsers import expat

import mujoco
import numpy as np

from dynappo.config import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

MAX_CARRIED = 2**19  # bytes of an MJCF in a policy or a checkpoint; the robots here have 10 KiB
TIMESTEP = 1e-5, 0.1  # s
ALL = 2**31 - 1  # of the bits of contype
OUTSIDE = {"include", "model", "extension", "plugin"}  # elements that load other files, or code


@contextlib.contextmanager
def one_line(xml: Path, what: str = ""):
    """Turn errors about a file, MuJoCo's or ours, into a one-line ConfigError that begins with its
    path.

    `what` comes after the path: the part of the file that is meant. MuJoCo's warnings are dropped
    meanwhile: it would write them to a file in the working directory; and those of its Python package, as on
    an attribute that later versions do not have.
    """
    try:
        with without_warnings(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except ConfigError:
        raise
    except (OSError, ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        text = getattr(error, "strerror", None) or str(error)
        other = getattr(error, "filename", None)
        if other and str(other) != str(xml):
            what += f"{other}: "
        text = " ".join(text.split()) or "it needs more memory than there is"
        raise ConfigError(f"{xml}: {what}{text}") from None


@contextlib.contextmanager
def without_warnings():
    """MuJoCo's warnings are dropped meanwhile: it would write each to stderr, or to a file in the working
    directory."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def model(xml: Path, text: str = "") -> mujoco.MjModel:
    """The compiled model of a file, or of the MJCF `text` in it; ConfigError says what is wrong.

    Robots are published without a scene: a file without anything to stand on gets a floor at height 0.
    """
    with one_line(xml):
        if text:
            check_alone(text)
            found = check_model(mujoco.MjModel.from_xml_string(text))
        else:
            found = check_model(mujoco.MjModel.from_xml_path(str(xml)))
        return found if _has_floor(found) else _with_floor(xml, text)


def _has_floor(model: mujoco.MjModel) -> bool:
    """Whether anything in the world can be touched, also by a contact pair alone."""
    ground = model.body_weldid[model.geom_bodyid] == 0
    return bool((ground & touches(model)).any())


def floor_added(model: mujoco.MjModel) -> bool:
    """Whether the floor of a `model` is not its file's own."""
    return bool((model.geom_contype == ALL).any())


def touches(model: mujoco.MjModel) -> np.ndarray:
    """[ngeom] bool: what can have contacts."""
    paired = np.isin(np.arange(model.ngeom), [model.pair_geom1, model.pair_geom2])
    return (model.geom_contype > 0) | (model.geom_conaffinity > 0) | paired


def _with_floor(xml: Path, text: str) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(text) if text else mujoco.MjSpec.from_file(str(xml))
    floor = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05])
    # plain, whatever the file's defaults; it meets all that can be touched
    floor.contype = floor.conaffinity = ALL
    floor.condim, floor.priority, floor.margin, floor.gap = 3, 0, 0, 0
    floor.material, floor.rgba = "", [0.74, 0.76, 0.78, 1]
    return spec.compile()


def listed(names, most: int = 6) -> str:
    """The first few `names`, in order, in words."""
    names = list(dict.fromkeys(str(name) for name in names))
    return ", ".join(names[:most]) + f" and {len(names) - most} more" * (len(names) > most)


def check_alone(text: str) -> None:
    """ValueError if an MJCF text is no XML, too long, or names a file: MuJoCo would read it."""
    if not isinstance(text, str) or len(text.encode()) > MAX_CARRIED:
        raise ValueError(f"expected an MJCF of at most {MAX_CARRIED} bytes")

    def start(tag, attributes):
        named = [name for name in attributes if name.startswith("file")]
        if named or tag in OUTSIDE:
            found = f"{tag} {named[0]}={attributes[named[0]][:40]!r}" if named else tag
            raise ValueError(f"expected an MJCF that needs no other file, found {found}")

    def refuse(*_):  # MuJoCo's parser would end it elsewhere, and see other elements
        raise ValueError("a DOCTYPE, which MJCF does not have")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.StartDoctypeDeclHandler = start, refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise ValueError(f"XML parse error: {error}") from None


def check_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """The compiled model; ValueError if its time step is none that a robot is simulated with."""
    low, high = TIMESTEP
    if not low <= model.opt.timestep <= high:
        raise ValueError(
            f"expected a timestep of {low:g} to {high:g} s, found {model.opt.timestep:g}"
        )
    return model
