"""Completes a robot's file, so that any MJCF of a robot can be trained: `complete(spec) -> Completed`.

Published files differ in what they leave to a scene, and in what they contain beside the robot. `complete`
makes of them what `robot_contract` expects, with a line for the user about each change. A complete file
stays untouched: the same compiled model, and no line.

The order of steps matters: masses are fixed before the shapes that they come from go, bodies are merged
before limbs are found, and feet are found before meshes become primitives that must end above them.

Here are that order, and the steps for what is no part of the robot, for its bodies, floor and camera. Those
for shapes are in `collision`, for joints in `joints`, for keyframes in `home_pose`.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from dynappo.description import collision, home_pose, joints, mjcf, robot_contract
from dynappo.description.rotation import quaternion

PLANE = mujoco.mjtGeom.mjGEOM_PLANE
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
    floor = choose_floor(spec)
    freed = one_robot(spec, floor, notes)
    robot_contract.check_tree(spec)
    joints.names(spec)
    collision.pairs(spec, floor, notes)
    shapes = collision.shapes(spec, notes)
    collision.masses(spec, shapes, notes)
    collision.looks(spec, shapes)
    _merge(spec, notes)
    _floor(spec, floor, notes)
    home_pose.keys(spec, poses, freed, notes)
    model = _compiled(spec)
    # those before the meshes go need no new model: compiling one with meshes takes a second
    early = joints.motors, home_pose.pose, collision.feet, collision.primitives, collision.base_part
    if any([step(spec, model, notes) for step in early]):
        model = _compiled(spec)
    for step in collision.contacts, home_pose.on_the_floor, _camera:
        if step(spec, model, notes):
            model = _compiled(spec)
    return Completed(spec, model, tuple(notes))


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    return mjcf.check_model(spec.compile())


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
            for _, count in joints.sizes(top)
        ]
    )
    poses = [np.array(key.qpos) for key in spec.keys]
    notes.append(
        f"left out, for nothing moves on them: {mjcf.listed(b.name or 'a body' for b in bare)}"
    )
    for body in bare:
        spec.delete(body)
    for key, pose in zip(spec.keys, poses, strict=True):
        if len(pose) == len(keep):
            key.qpos = pose[keep]


def one_robot(spec: mujoco.MjSpec, floor, notes: list[str]) -> bool:
    """One body with a free joint in the world, and the floor; whether it got its free joint here."""
    top = list(spec.worldbody.bodies)
    moving = [body for body in top if body.find_all("joint")]
    free = [b for b in moving if any(joint.type == joints.FREE for joint in b.joints)]
    if len(moving) > 1:
        names = mjcf.listed(body.name for body in moving)
        raise ValueError(f"expected one robot, found {names}; take the others out of the file")
    scene = [b for b in top if b not in moving] if moving else []
    others = [g for g in spec.worldbody.geoms if g != floor]
    if scene or others:
        names = [b.name or "a body" for b in scene] + [g.name or "a shape" for g in others]
        notes.append(f"the scene is left out: {mjcf.listed(names)}")
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
        notes.append(f"bodies without a joint are merged into their parents: {mjcf.listed(merged)}")


# the floor and the camera


def choose_floor(spec: mujoco.MjSpec):
    """The plane of the world that is the floor; None if there is none."""
    planes = [g for g in spec.worldbody.geoms if g.type == PLANE]
    return next((g for g in planes if g.name == "floor"), planes[0] if planes else None)


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
