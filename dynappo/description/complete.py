"""Completes a robot's file, so that any MJCF of a robot can be trained: `complete(spec) -> Completed`.

Published files differ in what they leave to a scene, and in what they contain beside the robot. `complete`
makes of them what `robot_contract` expects, with a line for the user about each change. A complete file
stays untouched: the same compiled model, and no line.

The order of steps matters: masses are fixed before the shapes that they come from go, bodies are merged
before limbs are found, and feet are found before meshes become primitives that must end above them.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from dynappo.description import feet, mjcf, primitives, robot_contract
from dynappo.description.rotation import matrix, quaternion

VISUAL_GROUP, COLLISION_GROUP = 2, 3  # by the habit of MuJoCo Menagerie
MESH, PLANE, ELLIPSOID = (
    mujoco.mjtGeom.mjGEOM_MESH,
    mujoco.mjtGeom.mjGEOM_PLANE,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
)
OFF = mujoco.mjtLimited.mjLIMITED_FALSE
FREE, HINGE = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_HINGE
ON_FLOOR = 0.01  # m that the lowest foot may be from the floor in the home pose
TURN_AS_DEGREES = 2 * np.pi * np.pi / 180  # rad: a whole turn in radians that is read as degrees
# of a geom, what a primitive in its place keeps
KEPT = "name condim priority friction solref solimp solmix margin gap group rgba".split()
VIEW = np.array([1.11, -0.86, 0.29]) / 0.325  # the camera, in heights of the base
VIEW_AXES = np.array([[0.612, 0.791, 0.0], [-0.217, 0.168, 0.962]])  # right and up in its picture


class Completed(NamedTuple):
    """A spec that `robot_contract` can check, its compiled model, and a line on each change."""

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    notes: tuple[str, ...]


def complete(spec: mujoco.MjSpec) -> Completed:
    """Complete `spec`, which is changed. ValueError, in a line, for what cannot be completed."""
    try:
        return _completed(spec)
    except ValueError as error:
        if str(error).startswith("Error: Error opening file"):
            raise ValueError(f"{error}, which a shape that collides has") from None
        raise


def options(spec: mujoco.MjSpec) -> list[str]:
    """A line on options with which a robot does not move as it does on a floor on Earth in still air; they
    stay."""
    option, usual = spec.option, mujoco.MjSpec().option
    unusual = [
        f"{name} {' '.join(f'{x:g}' for x in np.atleast_1d(getattr(option, name)))}"
        for name in ("gravity", "wind", "density", "viscosity")
        if not np.array_equal(getattr(option, name), getattr(usual, name))
    ]
    flags = [
        flag for flag in mujoco.mjtDisableBit.__members__.values() if flag.name[:6] == "mjDSBL"
    ]
    unusual += [
        f"no {flag.name.removeprefix('mjDSBL_').lower()}"
        for flag in flags
        if option.disableflags & int(flag)
    ]
    return [f"the file's options are simulated: {', '.join(unusual)}"] * bool(unusual)


def _completed(spec: mujoco.MjSpec) -> Completed:
    notes: list[str] = []
    drop_bodies_without_limbs(spec, notes)
    # where bodies go, MuJoCo empties the keys until it compiles
    poses = [np.array(key.qpos) for key in spec.keys]
    _delete_sensors_and_materials(spec)
    floor = _choose_floor(spec)
    freed = _one_robot(spec, floor, notes)
    robot_contract.check_tree(spec)
    _names(spec)
    _pairs(spec, floor, notes)
    shapes = _shapes(spec, notes)
    _masses(spec, shapes, notes)
    _looks(spec, shapes)
    _merge(spec, notes)
    _floor(spec, floor, notes)
    _keys(spec, poses, freed, notes)
    model = _compiled(spec)
    # those before the meshes go need no new model: compiling one with meshes takes a second
    early = _motors, _pose, _feet, _primitives, _base_part
    if any([step(spec, model, notes) for step in early]):
        model = _compiled(spec)
    for step in _contacts, _on_the_floor, _camera:
        if step(spec, model, notes):
            model = _compiled(spec)
    return Completed(spec, model, tuple(notes))


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    return mjcf.check_model(spec.compile())


def _list(names, most: int = 6) -> str:
    """The first few `names`, in order, in words."""
    names = list(dict.fromkeys(str(name) for name in names))
    return ", ".join(names[:most]) + f" and {len(names) - most} more" * (len(names) > most)


def _on_robot(spec: mujoco.MjSpec) -> list:
    return [geom for geom in spec.geoms if geom.parent.name != "world"]


def _geoms(spec: mujoco.MjSpec) -> list[str]:
    """The names of geoms, in the order of their ids when last compiled."""
    return [geom.name for geom in sorted(spec.geoms, key=lambda geom: geom.id)]


def _name_of_shape(geom) -> str:
    return geom.name or f"a shape of {geom.parent.name}"


def _delete_sensors_and_materials(spec: mujoco.MjSpec) -> None:
    """Delete sensors, skins, materials and what looks at a body: they do not affect motion, but name files,
    bodies and shapes."""
    for shape in (*spec.geoms, *spec.sites):
        shape.material = ""
    for tendon in spec.tendons:
        tendon.material = ""
    targets = [thing for thing in (*spec.cameras, *spec.lights) if thing.targetbody]
    for thing in (*targets, *spec.sensors, *spec.skins, *spec.materials, *spec.textures):
        spec.delete(thing)
    spec.compiler.discardvisual = False


# the tree


def drop_bodies_without_limbs(spec: mujoco.MjSpec, notes: list[str]) -> None:
    """Take out moving bodies of the world that carry no joint: parked placeholders, balls. A robot beside
    them has limbs; keyframes keep its numbers."""
    moving = [body for body in spec.worldbody.bodies if body.find_all("joint")]
    bare = [body for body in moving if len(body.find_all("joint")) == len(body.joints)]
    if not bare or len(bare) == len(moving):
        return
    keep = np.concatenate(
        [
            np.full(count, top not in bare)
            for top in spec.worldbody.bodies
            for _, count in _sizes(top)
        ]
    )
    poses = [np.array(key.qpos) for key in spec.keys]
    notes.append(f"left out, for nothing moves on them: {_list(b.name or 'a body' for b in bare)}")
    for body in bare:
        spec.delete(body)
    for key, pose in zip(spec.keys, poses, strict=True):
        if len(pose) == len(keep):
            key.qpos = pose[keep]


def _choose_floor(spec: mujoco.MjSpec):
    """The plane of the world that is the floor; None if there is none."""
    planes = [g for g in spec.worldbody.geoms if g.type == PLANE]
    return next((g for g in planes if g.name == "floor"), planes[0] if planes else None)


def _one_robot(spec: mujoco.MjSpec, floor, notes: list[str]) -> bool:
    """One body with a free joint in the world, and the floor; whether it got its free joint here."""
    top = list(spec.worldbody.bodies)
    moving = [body for body in top if body.find_all("joint")]
    free = [b for b in moving if any(joint.type == FREE for joint in b.joints)]
    if len(moving) > 1:
        names = _list(body.name for body in moving)
        raise ValueError(f"expected one robot, found {names}; take the others out of the file")
    scene = [b for b in top if b not in moving] if moving else []
    others = [g for g in spec.worldbody.geoms if g != floor]
    if scene or others:
        names = [b.name or "a body" for b in scene] + [g.name or "a shape" for g in others]
        notes.append(f"the scene is left out: {_list(names)}")
    gone = {body.name for b in scene for body in (b, *b.find_all("body"))} | {
        g.name for g in others
    }
    for equality in list(spec.equalities):
        if gone & {equality.name1, equality.name2} - {""}:
            spec.delete(equality)
    for thing in (*others, *scene):
        spec.delete(thing)
    if free or not moving:
        return False
    base = moving[0]
    if base.joints:
        raise ValueError(
            f"expected a free joint on the base, found {base.joints[0].name or 'another joint'} on "
            f"{base.name}; give the base a freejoint"
        )
    base.add_freejoint()
    notes.append(f"{base.name} moves freely: a free joint is added")
    return True


def _names(spec: mujoco.MjSpec) -> None:
    """Every hinge has a name."""
    taken = {joint.name for joint in spec.joints}
    for body in spec.bodies:
        for i, joint in enumerate(body.joints):
            if joint.type != HINGE or joint.name:
                continue
            name = f"{body.name or 'body'}_joint" + f"{i}" * (len(body.joints) > 1)
            while name in taken:
                name += "_"
            joint.name = name
            taken.add(name)


def _merge(spec: mujoco.MjSpec, notes: list[str]) -> None:
    """Bodies without a joint become part of their parents."""
    fixed = [body.name for body in spec.bodies[1:] if not body.joints]
    for exclude in list(spec.excludes):  # nothing collides with the robot but the floor
        bodies = {exclude.bodyname1, exclude.bodyname2}
        if "world" not in bodies or bodies & set(fixed):
            spec.delete(exclude)
    if not fixed:
        return
    spec.fuse_static()  # but for those that an equality is about
    left = {body.name for body in spec.bodies}
    merged = [name or "a body" for name in fixed if name not in left]
    if merged:
        notes.append(f"bodies without a joint are merged into their parents: {_list(merged)}")


# poses


def _sizes(body) -> list[tuple[str, int]]:
    """`(joint, numbers in qpos)` of a body and all below, in the order of a keyframe."""
    size = {FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}
    found = [(joint.name, size.get(joint.type, 1)) for joint in body.joints]
    return found + [one for child in body.bodies for one in _sizes(child)]


def _keys(spec: mujoco.MjSpec, poses: list[np.ndarray], freed: bool, notes: list[str]) -> None:
    """Delete keyframes that do not fit; the first of the others becomes `home` if none is.

    `poses` are their `qpos`, without numbers of the base if that was not free before (`freed`).
    """
    size = sum(count for _, count in _sizes(spec.worldbody))
    for key, pose in zip(list(spec.keys), poses, strict=True):
        if not len(pose):
            pass  # joints at rest, as MuJoCo writes a pose that is `qpos0`
        elif freed and len(pose) == size - 7:
            key.qpos, key.qvel = np.concatenate([[0, 0, 0, 1, 0, 0, 0], pose]), []
        elif len(pose) != size:
            if key.name == "home":
                notes.append(
                    f"the keyframe home is left out: it has {len(pose)} numbers, not {size}"
                )
            spec.delete(key)
            continue
        if len(key.mpos):
            key.mpos, key.mquat = [], []  # of bodies of a scene
    keys = list(spec.keys)
    if keys and all(key.name != "home" for key in keys):
        notes.append(f"the home pose is the keyframe {keys[0].name or 'without a name'}")
        keys[0].name = "home"


def _pose(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """The home pose is upright, and within the joints' ranges."""
    key = next((key for key in spec.keys if key.name == "home"), None)
    home = np.array(model.qpos0 if key is None or not len(key.qpos) else key.qpos)
    if key is None:
        key = spec.add_key(name="home")
        notes.append("no keyframe fits: the home pose has all joints at rest")
    before = np.array(key.qpos)  # as compiled
    low, high = ranges(model).T
    inside = np.clip(home[7:], low, high)
    far = np.flatnonzero(home[7:] != inside)
    if len(far):
        names = _list(model.joint(1 + i).name for i in far)
        notes.append(f"in the home pose, brought into their range: {names}")
        home[7:] = inside
    if not np.allclose(home[3:7], [1, 0, 0, 0]):
        notes.append("in the home pose, the base is set upright")
        home[3:7] = [1, 0, 0, 0]
    if np.array_equal(before, home):
        return False
    key.qpos = home
    return True


def ranges(model: mujoco.MjModel) -> np.ndarray:
    """The range [A, 2] of each hinge, rad; infinite where it has no limits."""
    limited = model.jnt_limited[1:, None].astype(bool)
    return np.where(limited, model.jnt_range[1:], [-np.inf, np.inf])


def _on_the_floor(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """The lowest foot of the home pose is at the floor."""
    home = model.key("home").qpos.copy()
    lowest = feet.lowest_points(model, home, feet.named(_geoms(spec))[0]).min()
    if abs(lowest) < ON_FLOOR:
        return False
    home[2] -= lowest
    spec.key("home").qpos = home
    notes.append(f"in the home pose, the base is at {home[2]:.4g} m, with the feet on the floor")
    return True


# masses and shapes


def _shapes(spec: mujoco.MjSpec, notes: list[str]) -> list:
    """The robot's geoms that collide, in order; all others are looks."""
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    collide = [g for g in _on_robot(spec) if g.contype or g.conaffinity]
    shapes = [g for g in collide if g.group != VISUAL_GROUP] or collide
    # a foot is one by its name, whatever its numbers say
    feet_too = [g for g in collide if g.group == VISUAL_GROUP] + [
        g for g in _on_robot(spec) if g.group != VISUAL_GROUP and g.type in primitives.KINDS
    ]
    meant = [g for g in feet_too if feet.NAME.fullmatch(g.name)]
    meant += [g for g in _on_robot(spec) if g.name and g.name in paired and g not in meant]
    meant += [g for g in shapes if g not in meant]
    if not shapes:
        plain = [
            g for g in _on_robot(spec) if g.group == COLLISION_GROUP and g.type in primitives.KINDS
        ]
        plain = [g for g in plain if g not in meant]
        if plain:
            notes.append(f"nothing collides: shapes of group {COLLISION_GROUP} now touch the floor")
        meant += plain
    flat = [g for g in meant if g.type not in (*primitives.KINDS, MESH, ELLIPSOID)]
    if flat:
        kinds = _list(f"{_name_of_shape(g)} ({_kind(g)})" for g in flat)
        notes.append(f"shapes of a kind that a robot cannot have are left out: {kinds}")
    return [g for g in meant if g not in flat]


def _kind(geom) -> str:
    return mujoco.mjtGeom(geom.type).name.removeprefix("mjGEOM_").lower()


def _masses(spec: mujoco.MjSpec, shapes: list, notes: list[str]) -> None:
    """Masses that come from shapes are written down, because looks and meshes go."""
    always = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    bodies = [b for b in spec.bodies[1:] if always or not b.explicitinertial]
    bodies = [b for b in bodies if b.geoms]
    if not bodies:
        return
    for geom in _on_robot(spec):  # a mesh that is not there must not be in the way
        if geom not in shapes and (geom.parent not in bodies or geom.mass == 0):
            spec.delete(geom)
    _unused(spec)
    try:
        for body in bodies:
            spec.adopt_inertial(body)
    except ValueError as error:
        raise ValueError(
            f"expected an inertial in {_list(b.name for b in bodies)}: the mass would come from the shapes, "
            f"but {' '.join(str(error).split())}"
        ) from None
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    notes.append(f"masses are those of the shapes: {_list(b.name for b in bodies)}")


def _looks(spec: mujoco.MjSpec, shapes: list) -> None:
    for geom in list(spec.geoms):
        if geom.parent.name != "world" and geom not in shapes:
            spec.delete(geom)
    _unused(spec)


def _unused(spec: mujoco.MjSpec) -> None:
    """Meshes and height fields that no shape has."""
    used = {geom.meshname for geom in spec.geoms} | {geom.hfieldname for geom in spec.geoms}
    for asset in (*spec.meshes, *spec.hfields):
        if asset.name not in used:
            spec.delete(asset)


def _pairs(spec: mujoco.MjSpec, floor, notes: list[str]) -> None:
    """Pairs of the robot with itself stay; one with the floor makes its shape touch it, with its friction."""
    geoms, inside = {geom.name: geom for geom in _on_robot(spec) if geom.name}, 0
    for pair in list(spec.pairs):
        own = [geoms[n] for n in (pair.geomname1, pair.geomname2) if n in geoms]
        for geom in own:
            geom.conaffinity = 1  # it is no look
        if len(own) == 1:
            geom = own[0]
            geom.condim = int(np.clip(pair.condim, 1, 3))
            geom.friction = np.array(pair.friction)[[0, 2, 3]]
            geom.solref, geom.solimp = pair.solref, pair.solimp
            geom.priority = max(geom.priority, 1 + (floor.priority if floor is not None else 0))
        if len(own) == 2 and all(geom.type in primitives.KINDS for geom in own):
            continue
        inside += len(own) == 2
        spec.delete(pair)
    if inside:
        notes.append(f"contact pairs of meshes on the robot are left out: {inside}")


# what the trainer needs


def _motors(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """One plain motor for each joint; an actuator's share of a joint's inertia and damping stays."""
    try:
        robot_contract.check_motors(model)
        return False
    except ValueError:
        pass
    had = len(spec.actuators)
    for i, actuator in enumerate(model.actuator_trnid[:, 0]):
        if model.actuator_trntype[i] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        joint, gear = spec.joint(model.joint(actuator).name), model.actuator_gear[i, 0]
        joint.armature += gear**2 * model.actuator_armature[i]
        damping = [model.actuator_damping[i], *model.actuator_dampingpoly[i]]
        joint.damping = joint.damping + gear**2 * np.array(damping)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for key in spec.keys:
        key.ctrl, key.act = [], []
    for i in range(1, model.njnt):
        name = model.joint(i).name
        joint = spec.joint(name)
        joint.actfrclimited, joint.actfrcrange = OFF, [0, 0]
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.gear, motor.armature, motor.damping = [1, 0, 0, 0, 0, 0], 0, [0, 0, 0]
        # of the file's defaults
        motor.ctrllimited = motor.forcelimited = motor.actlimited = OFF
        motor.ctrlrange, motor.forcerange, motor.actrange = [0, 0], [0, 0], [0, 0]
        motor.delay, motor.nsample, motor.group = 0, 0, 0
    spec.option.disableactuator = 0
    what = f"{had} actuators are replaced by" if had else "there are no actuators, but now"
    notes.append(f"{what} one motor a joint; gains and limits are the config's")
    return True


def _floor(spec: mujoco.MjSpec, floor, notes: list[str]) -> None:
    """A level plane `floor` at height 0 that shapes of the robot touch."""
    if floor is None:
        floor = spec.worldbody.add_geom(name="floor", type=PLANE, size=[0, 0, 0.05])
        floor.contype, floor.conaffinity = 1, 0
        floor.condim, floor.priority, floor.margin, floor.gap, floor.material = 3, 0, 0, 0, ""
        notes.append("there is no plane in the world: a floor is added")
        return
    moved = floor.pos[2] != 0 or np.any(floor.quat[1:3] != 0)
    if floor.name != "floor":
        notes.append(f"the plane {floor.name or 'without a name'} is the floor")
    if moved:
        notes.append("the floor is made level, at height 0")
    if (floor.contype, floor.conaffinity) != (1, 0):
        notes.append("the floor touches shapes of contype 0 (contype 1, conaffinity 0)")
    if moved:
        floor.pos, floor.quat = [*floor.pos[:2], 0], [1, 0, 0, 0]
    floor.name, floor.contype, floor.conaffinity = "floor", 1, 0


def _feet(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """The feet's shapes have names that say so."""
    if feet.named(_geoms(spec))[2]:
        return False
    found = feet.by_shape(model, np.array(spec.key("home").qpos))
    if not found:
        raise ValueError(
            "expected a foot: no limb without wheels ends near the robot's lowest point in the home pose; "
            "name the shapes of each foot NAME_foot, NAME_foot1, ..."
        )
    geoms, renamed = {geom.id: geom for geom in spec.geoms}, {}
    for name, ids in found.items():
        for i, geom in enumerate(ids, 1):
            new = f"{name}_foot" + f"{i}" * (len(ids) > 1)
            renamed[geoms[geom].name], geoms[geom].name = new, new
    for pair in spec.pairs:
        pair.geomname1 = renamed.get(pair.geomname1, pair.geomname1)
        pair.geomname2 = renamed.get(pair.geomname2, pair.geomname2)
    each = [f"{n} ({len(ids)} shapes)" if len(ids) > 1 else n for n, ids in found.items()]
    notes.append(f"feet, by where they are: {_list(each, 8)}")
    return True


def _primitives(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """Meshes and ellipsoids collide as the smallest primitive around them."""
    shapes = feet.named(_geoms(spec))[0]
    data = mujoco.MjData(model)
    data.qpos[:] = spec.key("home").qpos
    mujoco.mj_kinematics(model, data)
    geoms, found = {geom.id: geom for geom in spec.geoms}, {}
    for i, geom in geoms.items():
        body = model.geom_bodyid[i]
        if geom.type not in (MESH, ELLIPSOID) or not body:
            continue
        turn, pos = matrix(model.geom_quat[i]), model.geom_pos[i]
        if geom.type == ELLIPSOID:
            one = primitives.around_ellipsoid(model.geom_size[i], turn, pos)
        else:
            points = feet.vertices(model, i)
            if i not in shapes:
                points = _above_foot(
                    model, data, i, points, shapes[model.geom_bodyid[shapes] == body]
                )
            level = data.xmat[body].reshape(3, 3).T
            one = primitives.around(points @ turn.T + pos, [turn, np.eye(3), level])
        kept = {name: getattr(geom, name) for name in KEPT}
        found.setdefault(one.text(), []).append(geom.name or geom.parent.name or "a body")
        parent = geom.parent
        spec.delete(geom)
        _add(parent, type=one.kind, size=one.size, pos=one.pos, quat=one.quat, **kept)
    if found:
        _unused(spec)
        each = "; ".join(f"{_list(names)}: {text}" for text, names in found.items())
        notes.append(f"meshes and ellipsoids collide as primitives around them: {each}")
    return bool(found)


def _add(body, **fields) -> None:
    """A shape that touches the floor, without mass. What else a body's default class says is dropped."""
    geom = body.add_geom(mass=0, contype=0, conaffinity=1, material="", meshname="", **fields)
    geom.fromto = [np.nan] * 6


def _above_foot(model, data, geom: int, points: np.ndarray, foot: np.ndarray) -> np.ndarray:
    """Those of a mesh's `points` that are above the foot at its end, so the foot touches the floor first.

    All points if too few are above.
    """
    if not len(foot):
        return points
    home = data.qpos
    top = max(
        2 * data.geom_xpos[i, 2] - feet.lowest_points(model, home, np.array([i]))[0] for i in foot
    )
    heights = data.geom_xpos[geom, 2] + points @ data.geom_xmat[geom].reshape(3, 3)[2]
    above = heights > top
    if above.sum() < 4 or heights.max() - top < (heights.max() - heights.min()) / 2:
        return points
    return points[above]


def _base_part(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """A base without a shape gets a box with its inertia: a robot that lies on it has fallen."""
    base = int(model.jnt_bodyid[0])
    if (model.geom_bodyid == base).any():
        return False
    mass, inertia = model.body_mass[base], model.body_inertia[base]
    half = np.sqrt(np.maximum(inertia.sum() - 2 * inertia, 0) * 1.5 / mass)
    half = np.maximum(half, 0.01)
    pos, quat = model.body_ipos[base], model.body_iquat[base]
    box = dict(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=pos, quat=quat)
    _add(spec.bodies[1], **box, condim=1, group=COLLISION_GROUP)
    text = " x ".join(f"{2 * x:.3g}" for x in half)
    notes.append(f"the base has no shape: a box of its mass and inertia is added, {text} m")
    return True


def _contacts(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """All shapes of the robot touch the floor and nothing else, and the feet's friction holds."""
    crossed, raised, sliding = [], [], []
    over = model.geom("floor").priority[0] + 1
    shapes = {model.geom(i).name for i in feet.named(_geoms(spec))[0]}
    for geom in _on_robot(spec):
        if (geom.contype, geom.conaffinity & 1) != (0, 1):
            geom.contype, geom.conaffinity = 0, 1
            crossed.append(geom)
        condim = 1 if geom.condim == 1 else 3
        if geom.name in shapes and geom.priority < over:
            geom.priority, condim = over, 3
            raised.append(geom)
        if condim != geom.condim:
            geom.condim = condim
            sliding.append(_name_of_shape(geom))
    if crossed:
        notes.append("shapes touch the floor only, not one another")
    if raised:
        notes.append(f"the feet's friction holds, not the floor's (priority {over})")
    if sliding:
        notes.append(f"contacts slide, but neither twist nor roll (condim 3): {_list(sliding)}")
    return bool(crossed or raised or sliding)


def _camera(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """A camera `track` that follows the base from the front right."""
    if any(camera.name == "track" for camera in spec.cameras):
        return False
    axes = np.vstack([VIEW_AXES, np.cross(*VIEW_AXES)]).T
    spec.bodies[1].add_camera(
        name="track",
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM,
        pos=VIEW * model.key("home").qpos[2],
        quat=quaternion(axes),
        fovy=35,
    )
    notes.append("a camera track is added")
    return True
