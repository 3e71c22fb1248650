"""Reads a published robot, an MJCF or a URDF, and what its file says of motors, meshes and licence."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import mujoco
import numpy as np

from dynappo.config import ConfigError
from dynappo.physics import mjcf

MESHES = {".obj", ".stl", ".msh"}  # that MuJoCo reads
LICENCES = ("LICENSE*", "LICENCE*", "COPYING*")
UPWARD = 4  # folders above the file in which its meshes and its licence are looked for
BALL = 0.02  # m, radius


class Source(NamedTuple):
    """A robot's file as it was published."""

    xml: Path
    spec: mujoco.MjSpec  # of the file, without meshes that are not there
    model: mujoco.MjModel  # its spec, compiled
    velocity: dict[str, float]  # rad/s, of a URDF's joints
    lost: int  # looks that are not there, or that MuJoCo cannot read
    notes: tuple[str, ...]  # a line on each thing that was changed to read it


class Published(NamedTuple):
    """What a file says of its motors: a number for each of its joints, nan where it says nothing."""

    kp: np.ndarray  # [A] N m/rad
    kd: np.ndarray  # [A] N m s/rad, of the servo and the joint's damping
    effort: np.ndarray  # [A] N m
    velocity: np.ndarray  # [A] rad/s
    servo: np.ndarray  # [A] bool: a position servo drives the joint


def read(xml: Path) -> Source:
    """The robot of a file; a ConfigError begins with its path, and says what is wrong."""
    if not xml.is_file():
        raise ConfigError(f"{xml}: there is no such file; name an MJCF or a URDF")
    with mjcf.one_line(xml):
        text = xml.read_text(encoding="utf-8")
        try:
            root = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise ValueError(f"XML parse error: {error}") from None
        if root.tag == "robot":
            return _urdf(xml, root)
        if root.tag != "mujoco":
            raise ValueError(f"expected an MJCF or a URDF, found the element {root.tag}")
        spec, notes = mujoco.MjSpec.from_file(str(xml)), []
        folder = Path(spec.modelfiledir or xml.parent) / spec.meshdir
        before = len(spec.geoms)
        lost = _drop_meshes(spec, lambda file: (folder / file).is_file())
        notes += [f"meshes that are not there are left out: {_listed(lost)}"] if lost else []
        for kind, things in (("joint", spec.joints), ("link", spec.bodies[1:])):
            for i, thing in enumerate(things):
                thing.name = thing.name or f"{kind}{i}"
        return Source(xml, spec, spec.copy().compile(), {}, before - len(spec.geoms), tuple(notes))


def _urdf(xml: Path, root: ElementTree.Element) -> Source:
    """A URDF: its meshes found, its links kept apart, its base free; MuJoCo would weld it to the world."""
    notes, lost, velocity, gone = [], [], {}, 0
    for joint in root.iter("joint"):
        for limit in joint.iter("limit"):
            velocity[joint.get("name", "")] = float(limit.get("velocity", "nan"))
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            found = _mesh(xml.parent, mesh.get("filename", ""))
            if found is None:
                gone += shape.tag == "visual"
                lost.append(Path(mesh.get("filename", "")).name)
                link.remove(shape)
            else:
                mesh.set("filename", str(found))
    odd = [link.get("name", "") for link in root.iter("link") if _mend_inertia(link)]
    for other in root.findall("mujoco"):
        root.remove(other)
    options = dict(fusestatic="false", discardvisual="false", strippath="false", angle="radian")
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", options)
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, "unicode"))
    for geom in spec.geoms:
        geom.mass = 0.0  # a link without an inertial has no mass in a URDF
    for body in spec.worldbody.bodies:
        if not body.joints:
            body.add_freejoint()
            notes.append(f"the URDF fixes nothing to the world: {body.name} has a free joint")
    spec.fuse_static()
    notes += [f"meshes that MuJoCo cannot read are left out: {_listed(lost)}"] if lost else []
    if odd:
        notes.append(f"impossible inertias are replaced by a ball's: {_listed(odd)}")
    return Source(xml, spec, spec.copy().compile(), velocity, gone, tuple(notes))


def _mend_inertia(link: ElementTree.Element) -> bool:
    """Whether a link's inertia is one that no body can have; it is then that of a ball of `BALL`.

    Sensors and covers in URDFs often have such: principal moments must be positive, and none larger than
    the sum of the others.
    """
    element, mass = link.find("inertial/inertia"), link.find("inertial/mass")
    if element is None or mass is None:
        return False
    xx, xy, xz, yy, yz, zz = (float(element.get(f"i{n}", 0)) for n in "xx xy xz yy yz zz".split())
    small, middle, large = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if small > 1e-12 and small + middle >= large:
        return False
    moment = 0.4 * float(mass.get("value", 0)) * BALL**2
    for name in "xx xy xz yy yz zz".split():
        element.set(f"i{name}", str(moment if name[0] == name[1] else 0.0))
    return True


def _mesh(folder: Path, name: str) -> Path | None:
    """The file of a URDF's mesh; `package://NAME/PATH` is looked for in the folders above, too."""
    path = re.sub(r"^(package|file)://", "", name)
    if Path(path).suffix.lower() not in MESHES:
        return None
    inside = path.partition("/")[2] if name.startswith("package://") else path
    for above in [folder.resolve(), *folder.resolve().parents[:UPWARD]]:
        for candidate in (above / path, above / inside):
            if candidate.is_file():
                return candidate
    return None


def _drop_meshes(spec: mujoco.MjSpec, exists) -> list[str]:
    """Delete the meshes and pictures whose files are not there, and what uses them; their names."""
    lost = {mesh.name or Path(mesh.file).stem: mesh for mesh in spec.meshes if mesh.file}
    lost = {name: mesh for name, mesh in lost.items() if not exists(mesh.file)}
    for geom in list(spec.geoms):
        if geom.meshname in lost:
            spec.delete(geom)
    for mesh in lost.values():
        spec.delete(mesh)
    return [*lost]


def _listed(names: list[str], most: int = 4) -> str:
    """A few names, and how many more there are."""
    some = sorted(set(names))
    more = f" and {len(some) - most} more" if len(some) > most else ""
    return ", ".join(some[:most]) + more


def published(source: Source, joints: tuple[str, ...]) -> Published:
    """What the file says of the motors of `joints`.

    A servo's torque is gain u + bias_1 q + bias_2 qd (MuJoCo's `affine` bias): with gear g,
    kp = -bias_1 g^2 and kd = -bias_2 g^2, and joint damping is its own. The effort is the smallest
    limit on the way: of the joint, of the actuator's force, of a plain motor's control.
    """
    model = source.model
    kp, kd, effort, velocity = np.full((4, len(joints)), np.nan)
    servo = np.zeros(len(joints), bool)
    on = {int(model.actuator_trnid[a, 0]): a for a in range(model.nu) if _drives_joint(model, a)}
    for i, name in enumerate(joints):
        j = model.joint(name).id
        limits = [model.jnt_actfrcrange[j]] if model.jnt_actfrclimited[j] else []
        if (a := on.get(j)) is not None:
            gear = model.actuator_gear[a, 0]
            bias = model.actuator_biasprm[a]
            if model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE and bias[1] < 0:
                servo[i], kp[i] = True, -bias[1] * gear**2
                kd[i] = -bias[2] * gear**2 + model.dof_damping[model.jnt_dofadr[j]]
            elif model.actuator_ctrllimited[a]:
                gain = model.actuator_gainprm[a, 0]
                limits.append(model.actuator_ctrlrange[a] * gain * gear)
            if model.actuator_forcelimited[a]:
                limits.append(model.actuator_forcerange[a] * gear)
        if limits:
            effort[i] = min(np.abs(limit).max() for limit in limits)
        velocity[i] = source.velocity.get(name, np.nan)
    effort[effort <= 0], velocity[velocity <= 0] = np.nan, np.nan
    return Published(kp, kd, effort, velocity, servo)


def _drives_joint(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator acts on one joint."""
    return model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT


def licence(xml: Path) -> tuple[str, str]:
    """`(where, text)` of the licence: a file beside the robot's or above it, or comments in it."""
    for folder in [xml.resolve().parent, *xml.resolve().parents[1:UPWARD]]:
        for pattern in LICENCES:
            for file in sorted(folder.glob(pattern)):
                if file.is_file():
                    return str(file), file.read_text(encoding="utf-8", errors="replace").strip()
        if (folder / ".git").exists() or (folder / "package.xml").exists():
            break
    comments = re.findall(r"<!--(.*?)-->", xml.read_text(encoding="utf-8"), re.S)
    said = [c.strip() for c in comments if re.search(r"licen[sc]e|copyright", c, re.I)]
    return (f"comments in {xml.name}", "\n\n".join(said)) if said else ("", "")
