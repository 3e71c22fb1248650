"""Reads a published robot, an MJCF or a URDF, and what its file says of motors, meshes and licence."""

from __future__ import annotations

import contextlib
import glob
import hashlib
import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import mujoco
import numpy as np

from dynappo.config import ConfigError, versions
from dynappo.description import complete, faults, mjcf, robot_contract

MESHES = {".obj", ".stl", ".msh"}  # that MuJoCo reads
LICENCES = ("LICENSE*", "LICENCE*", "COPYING*")
SUFFIXES = ".xml", ".urdf", ".mjcf"  # of files that are XML, perhaps with a mistake in it
ROOTS = ".git", "package.xml"  # what the folder of a whole repository or package has
UPWARD = 4  # folders above the file in which its meshes and its package's folder are looked for
BALL = 0.02  # m, radius
LIGHTEST = 0.05  # kg: no robot on legs with motors weighs less
ROUNDED = (
    0.05  # of the largest principal moment, by which it may be more than the sum of the others
)
EXACT = 1e-6  # of it, that MuJoCo may be off when it computes them
LIGHT = 0.05  # of the robot's mass: a link whose inertia may be a guess
EXPORTED = re.compile(r"mesh|collision|visual", re.IGNORECASE)  # in names that an exporter makes
# attributes of an MJCF's elements that decide masses
NUMBERS = "mass density diaginertia fullinertia".split()
XX = "xx xy xz yy yz zz".split()
XACRO = "make a URDF of it first: xacro FILE > ROBOT.urdf"
# what is wrong with a mesh, and what to do
UNUSABLE = {
    "not found": "get them",
    "of a kind that MuJoCo cannot read": "convert them to .obj or .stl",
}


class Source(NamedTuple):
    """A robot's file as it was published."""

    xml: Path
    spec: mujoco.MjSpec  # of the file, without meshes that are not there
    fresh: faults.Fresh  # reads `spec` anew
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


class Lost(NamedTuple):
    """A shape whose mesh cannot be used."""

    link: str
    file: str
    why: str
    collides: bool


def read(xml: Path, notes: list[str] | None = None) -> Source:
    """The robot of a file; a ConfigError begins with its path, and says what is wrong.

    `notes` gets the line on a change as soon as it is known, even if an error follows.
    """
    notes = [] if notes is None else notes
    if xml.is_dir():
        inside = sorted([*xml.glob("*.xml"), *xml.glob("*.urdf")])
        such = f", such as {inside[0]}" if inside else ""
        raise ConfigError(f"{xml}: it is a folder; name the MJCF or URDF in it{such}")
    if not xml.is_file():
        raise ConfigError(f"{xml}: there is no such file; name an MJCF or a URDF")
    with mjcf.one_line(xml):
        try:
            text = xml.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            expected = "expected an MJCF or a URDF, saved in UTF-8"
            raise ValueError(f"it is not text in UTF-8; {expected}") from None
        try:
            root = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            if xml.suffix == ".xacro" or "<xacro:" in text:
                raise ValueError(f"it is a xacro and no XML ({error}); {XACRO}") from None
            if xml.suffix.lower() not in SUFFIXES:
                raise ValueError(f"expected an MJCF or a URDF, found no XML ({error})") from None
            raise ValueError(f"XML parse error: {error}") from None
        if _is_xacro(root):
            raise ValueError(f"it is a xacro; {XACRO}")
        if root.tag not in ("robot", "mujoco"):
            raise ValueError(f"expected an MJCF or a URDF, found the element {root.tag}")
        said = list(dict.fromkeys(_no_numbers(xml, root)))
        return (_urdf if root.tag == "robot" else _mjcf)(xml, root, notes, said)


def _mjcf(xml: Path, root: ElementTree.Element, notes: list[str], said: list[str]) -> Source:
    """An MJCF without the shapes whose meshes are not there; `said` is what is known to be wrong with it."""
    fresh, more = faults.read(xml)
    if fresh is None:
        raise ValueError(robot_contract.in_words([*said, *more]))

    def without_lost(fresh: faults.Fresh):
        spec = fresh()
        complete.drop_bodies_without_limbs(spec, [])
        for kind, things in (("joint", spec.joints), ("link", spec.bodies[1:])):
            for i, thing in enumerate(things):
                thing.name = thing.name or f"{kind}{i}"
        folder = Path(spec.modelfiledir or xml.parent)
        pictures = _drop_pictures(spec, folder / spec.texturedir)
        return spec, _drop_meshes(spec, folder / spec.meshdir), pictures

    def again():
        return without_lost(told)[0]

    complete.drop_bodies_without_limbs(fresh(), notes)
    spec, lost, pictures = without_lost(fresh)
    if pictures:
        notes.append(f"pictures are left out, not found: {mjcf.listed(pictures)}")
    told = fresh if more else faults.placed(xml, fresh)
    said += [*more, *_lost(lost, notes)]
    return _source(xml, again, spec, said, notes, velocity={}, lost=len(lost))


def _source(xml, fresh: faults.Fresh, spec, said: list[str], notes: list[str], **more) -> Source:
    """The source of a spec, which stays as it is; ValueError with all that is wrong: what was `said` before,
    what keeps it from being compiled or trained, a robot of next to no mass."""
    model, first = None, []
    try:
        model = spec.copy().compile()
        if not said and model.body_mass.sum() >= LIGHTEST:
            return Source(xml, spec, fresh, model, notes=tuple(notes), **more)
    except faults.READ as error:
        first = [faults.plain(error)]
    # without a keyframe a pose is found for it later
    said = [*said, *faults.of_spec(fresh, pose=not said and bool(spec.keys))] or first
    if model is not None and model.nbody > 1 and not model.body_mass.sum() >= LIGHTEST:
        heaviest = model.body(int(model.body_mass.argmax()))
        said.append(
            f"the robot has a mass of {model.body_mass.sum():g} kg, expected {LIGHTEST:g} kg or more: its "
            f"heaviest body, {heaviest.name}, has {heaviest.mass[0]:g} kg; correct the masses"
        )
    raise ValueError(robot_contract.in_words(said))


def _no_numbers(
    xml: Path, root: ElementTree.Element, body: str = "", above: tuple[Path, ...] = ()
) -> Iterator[str]:
    """Masses and inertias of an MJCF or a URDF, or of what it includes, that are no number, in words: MuJoCo
    takes `nan` for one that is not given. `above`: the files that include this one, the first one first."""
    for element in root:
        inside = element.get("name", "a body") if element.tag in ("body", "link") else body
        urdf = body and root.tag == "inertial" and element.tag in ("mass", "inertia")
        for name, text in element.attrib.items():
            if (urdf or name in NUMBERS) and not all(map(_is_finite, text.split())):
                yield (
                    f"the {element.tag} of {inside or 'a default class'} has {name}={text!r}, "
                    "expected a number"
                )
        if element.tag == "include":
            with contextlib.suppress(OSError, ElementTree.ParseError):  # MuJoCo says so
                files = (*above, xml)
                path = faults.included(xml, files[0].parent, element.get("file", ""))
                if path.resolve() not in [file.resolve() for file in files]:
                    inner = ElementTree.parse(path).getroot()
                    yield from _no_numbers(path, inner, inside, files)
        yield from _no_numbers(xml, element, inside, above)


def _is_finite(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _is_xacro(root: ElementTree.Element) -> bool:
    """Whether there are elements of xacro, or in a URDF values for it to compute: ${...}, $(...)."""
    every = [*root.iter()]
    values = [value for one in every if root.tag == "robot" for value in one.attrib.values()]
    elements = any("/xacro}" in str(element.tag) for element in every)
    return elements or any(re.search(r"\$[{(]", value) for value in values)


def _urdf(xml: Path, root: ElementTree.Element, notes: list[str], said: list[str]) -> Source:
    """A URDF: its meshes found, its links kept apart, its base free; MuJoCo would weld it to the world."""
    lost, velocity, elsewhere = [], {}, []
    for joint in root.iter("joint"):
        for limit in joint.iter("limit"):
            velocity[joint.get("name", "")] = _number(limit, "velocity") or math.nan
            said = [*said, *_mend_range(joint, limit)]
    compilers = [*root.findall("mujoco/compiler")]
    folders = [xml.parent / one.get("meshdir", ".") for one in compilers] + [xml.parent]
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh, collides = shape.find("geometry/mesh"), shape.tag == "collision"
            if EXPORTED.search(shape.get("name", "")):
                shape.attrib.pop("name")  # no foot's, even if it ends so
            if mesh is None:
                continue
            name = mesh.get("filename", "")
            found, why = _mesh(folders, name)
            if found is None:
                lost.append(Lost(link.get("name", ""), Path(name).name, why, collides))
                link.remove(shape)
            else:
                mesh.set("filename", str(found))
                if why:
                    elsewhere.append(f"{found.parent.name}/{found.name}")
    if elsewhere:
        notes.append(
            f"meshes are taken from a folder beside the URDF: {mjcf.listed(sorted(elsewhere))}"
        )
    said = [*said, *_lost(lost, notes), *_mend_inertias(root, notes)]
    for other in root.findall("mujoco"):
        root.remove(other)
    options = dict(fusestatic="false", discardvisual="false", strippath="false", angle="radian")
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", options)
    text = ElementTree.tostring(root, "unicode")

    def fresh(freed: list[str] | None = None):
        spec = mujoco.MjSpec.from_string(text)
        for geom in spec.geoms:
            geom.mass = 0.0  # a link without an inertial has no mass in a URDF
        for body in spec.worldbody.bodies:
            if not body.joints:
                body.add_freejoint()
                if freed is not None:
                    freed.append(body.name)
        spec.fuse_static()
        return spec

    freed: list[str] = []
    try:
        spec = fresh(freed)
    except faults.READ as error:
        raise ValueError(robot_contract.in_words([*said, faults.plain(error)])) from None
    for name in freed:
        notes.append(f"the URDF fixes nothing to the world: {name} has a free joint")
    return _source(xml, fresh, spec, said, notes, velocity=velocity, lost=len(lost))


def _mend_range(joint: ElementTree.Element, limit: ElementTree.Element) -> list[str]:
    """What is wrong with the limits of a URDF's hinge, in words: MuJoCo would take it for one without any."""
    ends = [limit.get(name) for name in ("lower", "upper")]
    if joint.get("type") != "revolute" or None in ends:
        return []
    lower, upper = (_number(limit, name) for name in ("lower", "upper"))
    if lower <= upper:  # not of nan
        return []
    limit.attrib.update(lower="-1", upper="1")  # to go on
    return [
        f"the limits of {joint.get('name', 'a joint')} are {ends[0]} to {ends[1]}, expected numbers, lower "
        "below upper"
    ]


def _mend_inertias(root: ElementTree.Element, notes: list[str]) -> list[str]:
    """Give the links of a URDF inertias that a body can have; a line on each change.

    Principal moments must be positive, and none larger than the sum of the others. Badly rounded moments
    become the nearest possible ones. Sensors and covers, which often have zeros or worse, get a ball's.
    The result is what is wrong with heavy links, in words: their inertia nobody should guess.
    """
    said = []
    links = {link.get("name", ""): link for link in root.iter("link")}
    for element in root.iter("mass"):
        if not math.isfinite(_number(element, "value")):
            element.set("value", "1")  # it was said; to go on
    masses = {n: _number(link.find("inertial/mass"), "value") for n, link in links.items()}
    for name, link in links.items():
        element, mass = link.find("inertial/inertia"), masses[name]
        if element is None or not mass > 0:
            continue
        numbers = np.array([_number(element, f"i{n}") for n in XX])
        if not np.isfinite(numbers).all():  # likewise
            numbers = np.array([1.0, 0, 0, 1, 0, 1])
            element.attrib.update({f"i{n}": f"{x}" for n, x in zip(XX, numbers, strict=True)})
        xx, xy, xz, yy, yz, zz = numbers
        moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        small, middle, large = moments
        over = large - small - middle
        if small > 1e-12 and over < -EXACT * large:
            continue
        ball = 0.4 * mass * BALL**2
        if small > 1e-12 and over <= ROUNDED * large:  # over / 3 from each: the nearest in the norm
            new, how = (
                moments + (over / 3 + EXACT * large) * np.array([1, 1, -1]),
                "the nearest that are",
            )
        elif mass <= LIGHT * sum(masses.values()):
            new, how = np.full(3, ball), f"those of a ball of {BALL * 100:g} cm"
        else:
            said.append(
                f"the link {name} of {mass:g} kg has the principal moments {_moments(moments)} kg m^2, "
                "which no body has: expected positive ones, none above the sum of the others; "
                "correct its inertia"
            )
            new, how = np.full(3, ball), ""  # to go on
        for n, value in zip(XX, (axes * new @ axes.T)[np.triu_indices(3)], strict=True):
            element.set(f"i{n}", repr(float(value)))
        if how and (small <= 1e-12 or over > EXACT * large):
            old = _moments(moments)
            notes.append(
                f"inertia of {name}: no body has the principal moments {old} kg m^2; now {how}, "
                f"{_moments(new)}"
            )
    return said


def _moments(values: np.ndarray) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


def _number(element: ElementTree.Element | None, name: str) -> float:
    """A number of a URDF's element; 0 if there is none, nan for what is no number."""
    text = "0" if element is None else element.get(name, "0")
    return float(text) if _is_finite(text) else math.nan


def _mesh(folders: list[Path], name: str) -> tuple[Path | None, str]:
    """`(file, "")` of a URDF's mesh, or `(None, what is wrong)`; `(file, "beside")` if it is elsewhere.

    The search for `package://NAME/PATH` includes the folders above `folders`; last comes a file of that name
    in a folder beside the URDF, where people put copies.
    """
    path = re.sub(r"^(package|file)://", "", name)
    inside = path.partition("/")[2] if name.startswith("package://") else path
    for folder in folders:
        for above in [folder.resolve(), *folder.resolve().parents[:UPWARD]]:
            for candidate in (above / path, above / inside):
                if candidate.is_file():
                    readable = candidate.suffix.lower() in MESHES
                    return (
                        (candidate, "") if readable else (None, "of a kind that MuJoCo cannot read")
                    )
    beside = sorted(folders[-1].glob(f"*/{glob.escape(Path(path).name)}")) if path else []
    if beside and beside[0].suffix.lower() in MESHES:
        return beside[0].resolve(), "beside"
    return None, "not found"


def _drop_meshes(spec: mujoco.MjSpec, folder: Path) -> list[Lost]:
    """Delete the meshes whose files are not there, and the shapes that have them, which are returned."""
    gone = {mesh.name or Path(mesh.file).stem: mesh for mesh in spec.meshes if mesh.file}
    gone = {name: mesh for name, mesh in gone.items() if not (folder / mesh.file).is_file()}
    lost = []
    for geom in list(spec.geoms):
        if geom.meshname in gone:
            file = Path(gone[geom.meshname].file).name
            collides = bool(geom.contype or geom.conaffinity) and geom.group != 2
            lost.append(Lost(geom.parent.name, file, "not found", collides))
            spec.delete(geom)
    for mesh in gone.values():
        spec.delete(mesh)
    return lost


def _drop_pictures(spec: mujoco.MjSpec, folder: Path) -> list[str]:
    """Delete the textures whose files are not there, which are returned, also from the materials."""
    lost = []
    for texture in list(spec.textures):
        files = [name for name in (texture.file, *texture.cubefiles) if name]
        gone = [Path(name).name for name in files if not (folder / name).is_file()]
        if not gone:
            continue
        lost += gone
        called = texture.name or Path(texture.file).stem
        for material in spec.materials:
            material.textures = ["" if name == called else name for name in material.textures]
        spec.delete(texture)
    return lost


def _lost(lost: list[Lost], notes: list[str]) -> list[str]:
    """A line for each way in which looks are lost; in words, what shapes that collide are: a robot that lies
    on that link, be it a limb or the base, would not have fallen."""
    said = []
    for why in UNUSABLE:
        if files := sorted(one.file for one in lost if one.why == why and not one.collides):
            notes.append(f"looks are left out, their meshes are {why}: {mjcf.listed(files)}")
    for why, remedy in UNUSABLE.items():
        shapes = [one for one in lost if one.why == why and one.collides]
        if shapes:
            links = mjcf.listed(sorted(one.link for one in shapes))
            files = mjcf.listed(sorted(one.file for one in shapes))
            said.append(
                f"shapes that collide are missing on {links}: their meshes are {why} ({files}); {remedy}, or "
                "give the links boxes or capsules"
            )
    return said


def published(source: Source, joints: tuple[str, ...]) -> tuple[Published, list[str]]:
    """What the file says of the motors of `joints`, and lines on what is unusual.

    A servo's torque is gain u + bias_1 q + bias_2 qd (MuJoCo's `affine` bias): with gear g,
    kp = -bias_1 g^2 and kd = -bias_2 g^2, and joint damping is its own. An actuator's effort is the
    smallest of the limits of its force and of a plain motor's control; several on a joint add up, and the
    joint's own limit holds for all.
    """
    model = source.model
    kp, kd, effort, velocity = np.full((4, len(joints)), np.nan)
    servo = np.zeros(len(joints), bool)
    on: dict[int, list[int]] = {}
    for a in range(model.nu):
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT:
            on.setdefault(int(model.actuator_trnid[a, 0]), []).append(a)
    for i, name in enumerate(joints):
        j = model.joint(name).id
        actuators = on.get(j, [])
        limits = [np.abs(model.jnt_actfrcrange[j]).max()] if model.jnt_actfrclimited[j] else []
        if actuators:
            limits.append(sum(_most(model, a) for a in actuators))  # nan if one has no limit
        pulls = [_servo(model, a) for a in actuators]
        if any(stiff > 0 for stiff, _ in pulls):
            servo[i], kp[i] = True, sum(stiff for stiff, _ in pulls)
            kd[i] = sum(damps for _, damps in pulls) + model.dof_damping[model.jnt_dofadr[j]]
        effort[i] = np.nanmin([np.nan, *limits]) if np.isfinite(limits).any() else np.nan
        velocity[i] = source.velocity.get(name, np.nan)
    effort[~(effort > 0)], velocity[~(velocity > 0)] = np.nan, np.nan
    notes = []
    several = [name for name in joints if len(on.get(model.joint(name).id, [])) > 1]
    if several:
        notes.append(f"motors: several actuators add up at {mjcf.listed(several)}")
    idle = [name for name in joints if model.joint(name).id not in on]
    if idle and on:
        notes.append(
            f"motors: nothing in the file drives {mjcf.listed(idle)}; all joints have a motor here, with "
            "effort and gains as the others"
        )
    return Published(kp, kd, effort, velocity, servo), notes


def _most(model: mujoco.MjModel, a: int) -> float:
    """The largest torque (N m) of an actuator; nan if nothing limits it."""
    limits, gear = [], abs(model.actuator_gear[a, 0])
    plain = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
    fixed = model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
    if plain and fixed and model.actuator_ctrllimited[a]:  # a servo's control is no torque
        limits.append(np.abs(model.actuator_ctrlrange[a] * model.actuator_gainprm[a, 0]).max())
    if model.actuator_forcelimited[a]:
        limits.append(np.abs(model.actuator_forcerange[a]).max())
    return min(limits) * gear if limits else np.nan


def _servo(model: mujoco.MjModel, a: int) -> tuple[float, float]:
    """`(kp, kd)` of an actuator at its joint; zeros of a plain motor."""
    if model.actuator_biastype[a] != mujoco.mjtBias.mjBIAS_AFFINE:
        return 0.0, 0.0
    gear = model.actuator_gear[a, 0]
    return -model.actuator_biasprm[a, 1] * gear**2, -model.actuator_biasprm[a, 2] * gear**2


def licence(xml: Path) -> tuple[str, str]:
    """`(where, text)` of the licence: a file beside the robot's, or in a folder above up to that of its
    package or repository, by its path from the robot's; else comments in it. Of a robot in a clone of dynappo
    ours is not."""
    folders = [xml.resolve().parent, *xml.resolve().parents[1 : UPWARD + 1]]
    tops = [i for i, folder in enumerate(folders) if any((folder / n).exists() for n in ROOTS)]
    for folder in folders[: tops[0] + 1 if tops else 1]:
        for pattern in LICENCES:
            for file in sorted(folder.glob(pattern)):
                if file.is_file() and not (file.name == "LICENSE" and _clone(folder)):
                    where = Path(os.path.relpath(file, folders[0])).as_posix()
                    return where, file.read_text(encoding="utf-8", errors="replace").strip()
    comments = re.findall(r"<!--(.*?)-->", xml.read_text(encoding="utf-8"), re.S)
    said = [c.strip() for c in comments if re.search(r"licen[sc]e|copyright", c, re.I)]
    said = [comment for comment in said if "`dynappo adopt`" not in comment]  # our own
    return (f"comments in {xml.name}", "\n\n".join(said)) if said else ("", "")


def _clone(folder: Path) -> bool:
    """Whether a folder is the root of a clone of dynappo."""
    return folder == versions.ROOT or (folder / "dynappo/algorithm.py").is_file()


def origin(xml: Path) -> str:
    """Where the file is from, in words: its sha256, and its checkout. A robot of one's own in a clone of
    dynappo is not from there."""
    said = f"sha256 {hashlib.sha256(xml.read_bytes()).hexdigest()}"
    for folder in xml.resolve().parents:
        if _clone(folder):
            break
        if not (folder / ".git").is_dir():
            continue
        with contextlib.suppress(OSError, UnicodeDecodeError):
            config = (folder / ".git/config").read_text(encoding="utf-8")
            remote = re.search(r'\[remote "[^"]*"\][^\[]*?url\s*=\s*(\S+)', config)
            where = re.sub(r"//[^/@]*@", "//", remote[1]) if remote else folder.name  # no password
            path = xml.resolve().relative_to(folder.resolve()).as_posix()
            return f"{said}; `{path}` of {where}, commit {_commit(folder / '.git')}"
        break
    return said


def _commit(git: Path) -> str:
    """The commit of a checkout."""
    head = (git / "HEAD").read_text(encoding="utf-8").strip()
    if not head.startswith("ref: "):
        return head
    name = head.removeprefix("ref: ")
    if (git / name).is_file():
        return (git / name).read_text(encoding="utf-8").strip()
    packed = (git / "packed-refs").read_text(encoding="utf-8")
    found = re.search(rf"^([0-9a-f]+) {re.escape(name)}$", packed, re.M)
    return found[1] if found else "unknown"
