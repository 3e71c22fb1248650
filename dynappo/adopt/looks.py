"""Puts the looks of a published file back on its completed robot: meshes, materials, pictures.

Physics never sees them (group 2). `complete` may have merged bodies and turned frames. Each look therefore
goes to its place in the world, with the base at the origin and the joints of both models at the same angles.
"""

from __future__ import annotations

import contextlib
import hashlib
import shutil
from pathlib import Path

import mujoco
import numpy as np

from dynappo.adopt.source import Source
from dynappo.description.rotation import matrix, quaternion

LOOKS, SHAPES, DRAWN = 2, 3, 0  # groups
SUMS = "SHA256SUMS"  # which files are from here; `sha256sum -c` reads it
MESH = mujoco.mjtGeom.mjGEOM_MESH
SHOWN = [  # height fields and the like are left out
    getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")
    for kind in "MESH SPHERE CAPSULE ELLIPSOID CYLINDER BOX".split()
]
# what a mesh without a file has
INLINE = "uservert usernormal usertexcoord userface userfacenormal userfacetexcoord".split()


def draw(spec: mujoco.MjSpec, source: Source, base: str, assets: Path) -> tuple[int, int]:
    """Add the file's looks to `spec`, whose files go to the folder `assets`: `(looks, files)`.

    Without looks, or if most of them are not there, the shapes that touch the floor are drawn instead.
    """
    robot = spec.copy()
    model = robot.compile()
    theirs = source.spec.copy()
    whole = theirs.compile()
    one, other = _at_zero(whole), _at_zero(model, whole)
    shown = [geom for geom in theirs.geoms if _drawn(geom)]
    looks = [geom for geom in shown if not (geom.contype or geom.conaffinity)]
    if not looks and any(geom.type == MESH for geom in shown):
        looks = shown  # meshes that collide, in the file: primitives do so here
    looks = looks if len(looks) > source.lost else []
    for geom in spec.geoms:
        if geom.parent.name != "world":
            geom.group = SHAPES if looks else DRAWN
    copied = _Copied(spec, theirs, assets)
    for geom in looks:
        body = _body(whole, model, int(whole.geom_bodyid[geom.id]), base)
        position, rotation = _frame(whole, one, geom.id)
        inside = other.xmat[body].reshape(3, 3).T
        new = spec.body(model.body(body).name).add_geom()
        new.type, new.group, new.contype, new.conaffinity, new.mass = geom.type, LOOKS, 0, 0, 0
        new.pos, new.quat = inside @ (position - other.xpos[body]), quaternion(inside @ rotation)
        new.rgba = geom.rgba
        if geom.type == MESH:
            new.meshname = copied.mesh(geom.meshname)
        else:
            new.size = whole.geom_size[geom.id]
        if geom.material:
            new.material = copied.material(geom.material)
    spec.meshdir = spec.texturedir = assets.name
    if copied.files:
        lines = [f"{_digest(assets / name)}  {name}\n" for name in sorted(copied.files.values())]
        (assets / SUMS).write_text("".join(lines), encoding="utf-8", newline="\n")
    return len(looks), len(copied.files)


def written(assets: Path) -> list[Path]:
    """The files of the folder `assets` that an adoption wrote and nobody has changed, with their list."""
    if not (assets / SUMS).is_file():
        return []
    lines = (assets / SUMS).read_text(encoding="utf-8", errors="replace").splitlines()
    sums = [line.partition("  ")[::2] for line in lines]
    paths = [(assets / name, digest) for digest, name in sums if name == Path(name).name]
    same = [path for path, digest in paths if path.is_file() and _digest(path) == digest]
    return [*same, assets / SUMS]


def remove(files: list[Path]) -> None:
    """Remove files, and their folder if nothing else is in it."""
    for path in files:
        path.unlink()
    with contextlib.suppress(OSError):  # somebody has files there
        for folder in {path.parent for path in files}:
            folder.rmdir()


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _drawn(geom) -> bool:
    """Whether viewers show a geom of the robot."""
    return geom.parent.name != "world" and geom.group <= LOOKS and geom.type in SHOWN


def _at_zero(model, like=None) -> mujoco.MjData:
    """The model with its base at the origin, and the joints where `like` has them at rest."""
    data = mujoco.MjData(model)
    for i in range(model.njnt):
        address = model.jnt_qposadr[i]
        if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE:
            data.qpos[address : address + 7] = [0, 0, 0, 1, 0, 0, 0]
        elif like is not None:
            data.qpos[address] = like.qpos0[like.jnt_qposadr[like.joint(model.joint(i).name).id]]
    mujoco.mj_kinematics(model, data)
    return data


def _body(whole, model, body: int, base: str) -> int:
    """The body of `model` that a body of the file has become: itself, or the one that it was fixed to."""
    names = {model.body(i).name: i for i in range(1, model.nbody)}
    while body > 0 and whole.body(body).name not in names:
        body = int(whole.body_parentid[body])
    return names[whole.body(body).name if body > 0 else base]


def _frame(model, data, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """`(position [3], rotation [3, 3])` of a geom as a file has it: MuJoCo centres meshes."""
    position, rotation = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    mesh = int(model.geom_dataid[geom])
    if model.geom_type[geom] == MESH and mesh >= 0:
        rotation = rotation @ matrix(model.mesh_quat[mesh]).T
        position = position - rotation @ model.mesh_pos[mesh]
    return position, rotation


class _Copied:
    """What has been taken from one spec to another, with the files copied to `assets`."""

    def __init__(self, spec, theirs, assets: Path):
        self.spec, self.theirs, self.assets = spec, theirs, assets
        self.folder = Path(theirs.modelfiledir or ".")
        self.files: dict[Path, str] = {}
        self.named: dict[str, str] = {}

    def _file(self, folder: str, name: str) -> str:
        """Copy a file; the name that it has in `assets`."""
        path = self.folder / folder / name
        if path not in self.files:
            short = path.name
            while short in self.files.values():
                short = f"{path.parent.name}_{short}"
            self.assets.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, self.assets / short)
            self.files[path] = short
        return self.files[path]

    def mesh(self, name: str) -> str:
        if name not in self.named:
            old = next(mesh for mesh in self.theirs.meshes if mesh.name == name)
            new = self.spec.add_mesh(name=f"look_{name}", scale=old.scale)
            new.refpos, new.refquat, new.inertia = old.refpos, old.refquat, old.inertia
            new.smoothnormal = old.smoothnormal
            if old.file:
                new.file = self._file(self.theirs.meshdir, old.file)
            for field in () if old.file else INLINE:
                setattr(new, field, getattr(old, field))
            self.named[name] = new.name
        return self.named[name]

    def material(self, name: str) -> str:
        key = f"material {name}"
        if key not in self.named:
            old = next(one for one in self.theirs.materials if one.name == name)
            new = self.spec.add_material(name=f"look_{name}", rgba=old.rgba)
            for field in "specular shininess reflectance emission metallic roughness".split():
                setattr(new, field, getattr(old, field))
            pictures = [self._texture(texture) for texture in old.textures]
            if any(pictures):
                new.textures = pictures
            self.named[key] = new.name
        return self.named[key]

    def _texture(self, name: str) -> str:
        key = f"texture {name}"
        if name and key not in self.named:
            old = next((one for one in self.theirs.textures if one.name == name), None)
            if old is None or not old.file:
                return ""
            new = self.spec.add_texture(name=f"look_{name}", type=old.type)
            new.file = self._file(self.theirs.texturedir, old.file)
            self.named[key] = new.name
        return self.named.get(key, "")
