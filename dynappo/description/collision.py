"""A robot's shapes in a file that `complete` completes: which collide, as what, and which are feet.

Published files have looks beside what collides, meshes where primitives must be, and masses that come from
either. Here looks go after their masses are written down, feet get names, meshes and ellipsoids become
primitives, and all touch the floor and nothing else.
"""

from __future__ import annotations

import mujoco
import numpy as np

from dynappo.description import feet as feet_lib
from dynappo.description import mjcf
from dynappo.description import primitives as primitives_lib
from dynappo.description.rotation import matrix

VISUAL_GROUP, COLLISION_GROUP = 2, 3  # by the habit of MuJoCo Menagerie
MESH, ELLIPSOID = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_ELLIPSOID
NO_FOOT = "expected a foot"
# of a geom, what a primitive in its place keeps
KEPT = "name condim priority friction solref solimp solmix margin gap group rgba".split()


def _on_robot(spec: mujoco.MjSpec) -> list:
    return [geom for geom in spec.geoms if geom.parent.name != "world"]


def _name_of_shape(geom) -> str:
    return geom.name or f"a shape of {geom.parent.name}"


def shapes(spec: mujoco.MjSpec, notes: list[str]) -> list:
    """The robot's geoms that collide, in order; all others are looks."""
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    collide = [g for g in _on_robot(spec) if g.contype or g.conaffinity]
    shapes = [g for g in collide if g.group != VISUAL_GROUP] or collide
    # a foot is one by its name, whatever its numbers say
    feet_too = [g for g in collide if g.group == VISUAL_GROUP] + [
        g for g in _on_robot(spec) if g.group != VISUAL_GROUP and g.type in primitives_lib.KINDS
    ]
    meant = [g for g in feet_too if feet_lib.NAME.fullmatch(g.name)]
    meant += [g for g in _on_robot(spec) if g.name and g.name in paired and g not in meant]
    meant += [g for g in shapes if g not in meant]
    if not shapes:
        plain = [
            g
            for g in _on_robot(spec)
            if g.group == COLLISION_GROUP and g.type in primitives_lib.KINDS
        ]
        plain = [g for g in plain if g not in meant]
        if plain:
            notes.append(f"nothing collides: shapes of group {COLLISION_GROUP} now touch the floor")
        meant += plain
    flat = [g for g in meant if g.type not in (*primitives_lib.KINDS, MESH, ELLIPSOID)]
    if flat:
        kinds = mjcf.listed(f"{_name_of_shape(g)} ({_kind(g)})" for g in flat)
        notes.append(f"shapes of a kind that a robot cannot have are left out: {kinds}")
    return [g for g in meant if g not in flat]


def _kind(geom) -> str:
    return mujoco.mjtGeom(geom.type).name.removeprefix("mjGEOM_").lower()


def masses(spec: mujoco.MjSpec, shapes: list, notes: list[str]) -> None:
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
            f"expected an inertial in {mjcf.listed(b.name for b in bodies)}: the mass would come from the "
            f"shapes, but {' '.join(str(error).split())}"
        ) from None
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    notes.append(f"masses are those of the shapes: {mjcf.listed(b.name for b in bodies)}")


def looks(spec: mujoco.MjSpec, shapes: list) -> None:
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


def pairs(spec: mujoco.MjSpec, floor, notes: list[str]) -> None:
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
        if len(own) == 2 and all(geom.type in primitives_lib.KINDS for geom in own):
            continue
        inside += len(own) == 2
        spec.delete(pair)
    if inside:
        notes.append(f"contact pairs of meshes on the robot are left out: {inside}")


def feet(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """The feet's shapes have names that say so."""
    if feet_lib.named(feet_lib.geom_names(spec))[2]:
        return False
    found = feet_lib.by_shape(model, np.array(spec.key("home").qpos))
    if not found:
        raise ValueError(
            f"{NO_FOOT}: no limb without wheels ends near the robot's lowest point in the home pose; "
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
    notes.append(f"feet, by where they are: {mjcf.listed(each, 8)}")
    return True


def primitives(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """Meshes and ellipsoids collide as the smallest primitive around them."""
    shapes = feet_lib.named(feet_lib.geom_names(spec))[0]
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
            one = primitives_lib.around_ellipsoid(model.geom_size[i], turn, pos)
        else:
            points = feet_lib.vertices(model, i)
            if i not in shapes:
                points = _above_foot(
                    model, data, i, points, shapes[model.geom_bodyid[shapes] == body]
                )
            level = data.xmat[body].reshape(3, 3).T
            one = primitives_lib.around(points @ turn.T + pos, [turn, np.eye(3), level])
        kept = {name: getattr(geom, name) for name in KEPT}
        found.setdefault(one.text(), []).append(geom.name or geom.parent.name or "a body")
        parent = geom.parent
        spec.delete(geom)
        _add(parent, type=one.kind, size=one.size, pos=one.pos, quat=one.quat, **kept)
    if found:
        _unused(spec)
        each = "; ".join(f"{mjcf.listed(names)}: {text}" for text, names in found.items())
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
        2 * data.geom_xpos[i, 2] - feet_lib.lowest_points(model, home, np.array([i]))[0]
        for i in foot
    )
    heights = data.geom_xpos[geom, 2] + points @ data.geom_xmat[geom].reshape(3, 3)[2]
    above = heights > top
    if above.sum() < 4 or heights.max() - top < (heights.max() - heights.min()) / 2:
        return points
    return points[above]


def base_part(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
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


def contacts(spec: mujoco.MjSpec, model: mujoco.MjModel, notes: list[str]) -> bool:
    """All shapes of the robot touch the floor and nothing else, and the feet's friction holds."""
    crossed, raised, sliding = [], [], []
    over = model.geom("floor").priority[0] + 1
    shapes = {model.geom(i).name for i in feet_lib.named(feet_lib.geom_names(spec))[0]}
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
        notes.append(
            f"contacts slide, but neither twist nor roll (condim 3): {mjcf.listed(sliding)}"
        )
    return bool(crossed or raised or sliding)
