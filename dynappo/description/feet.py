"""Which shapes of a robot are its feet: by their names, or by where they are. NumPy and C MuJoCo only."""

from __future__ import annotations

import re

import mujoco
import numpy as np

from dynappo.description import contacts, kinematics
from dynappo.description.rotation import matrix

NAME = re.compile(r"(.+?)_foot(?:_?\d+)?")  # FL_foot; left_foot1, left_foot_2
# shares of the base's height above the lowest point, in the home pose
NEAR = 0.1  # a limb that stands on the floor may end so much higher than the robot's lowest point
SOLE = 0.03  # a shape of its foot, than the limb's
SHANK = 0.25  # no shape of a foot reaches further up
# a wheel reaches as far to all sides of its axis: the shortest way out, of the longest
ROUND = 0.82  # its middle may be off by a tenth of the radius, and a mesh may have six corners
SIDES = 24  # to which its reach is measured


def named(geoms: list[str]) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """`(shapes [S], foot_of [S], names [F])` of the geoms `NAME_foot`, `NAME_foot1`, ..., foot by foot.

    `geoms` are the names of all, by their ids.
    """
    found: dict[str, list[int]] = {}
    for i, name in enumerate(geoms):
        match = NAME.fullmatch(name)
        if match:
            found.setdefault(match[1], []).append(i)
    shapes = [i for ids in found.values() for i in ids]
    foot_of = [foot for foot, ids in enumerate(found.values()) for _ in ids]
    return np.array(shapes, int), np.array(foot_of, int), tuple(found)


def geom_names(spec: mujoco.MjSpec) -> list[str]:
    """The names of geoms, in the order of their ids when last compiled."""
    return [geom.name for geom in sorted(spec.geoms, key=lambda geom: geom.id)]


def lowest_points(
    model: mujoco.MjModel, qpos: np.ndarray, geoms: np.ndarray | list[int]
) -> np.ndarray:
    """Heights (m) of the lowest points of `geoms` [G] in a pose; meshes and ellipsoids too."""
    return _reach(model, qpos, geoms)[0]


def _reach(model, qpos, geoms) -> tuple[np.ndarray, np.ndarray]:
    """Heights of the lowest and the highest points of `geoms`."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    geoms = np.asarray(geoms, int)
    row, middle = data.geom_xmat[geoms].reshape(-1, 3, 3)[:, 2], data.geom_xpos[geoms, 2]
    away = _half_width(model, geoms, row)
    low, high = middle - away, middle + away
    for i in np.flatnonzero(model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_MESH):
        heights = middle[i] + vertices(model, geoms[i]) @ row[i]
        low[i], high[i] = heights.min(), heights.max()
    return low, high


def _half_width(model, geoms: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """How far each of `geoms` [G] reaches from its middle along a unit vector [G, 3] of its frame; not of
    meshes."""
    fixed, linear, ring = contacts.floor_distance(model, geoms)
    around = np.sqrt(np.maximum(1 - directions[:, 2] ** 2, 0))
    away = fixed + (linear * abs(directions)).sum(-1) + ring * around
    ellipsoid = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_ELLIPSOID
    return np.where(ellipsoid, np.linalg.norm(model.geom_size[geoms] * directions, axis=1), away)


def vertices(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """The corners [V, 3] of a geom's mesh, in the geom's frame."""
    mesh = model.geom_dataid[geom]
    first = model.mesh_vertadr[mesh]
    return model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(float)


def by_shape(model: mujoco.MjModel, home: np.ndarray) -> dict[str, list[int]]:
    """The shapes of each foot, by the foot's name.

    A limb stands if it ends close to the lowest point of the robot in the pose `home`, and not in a
    wheel. Its foot is those shapes of its last body that reach down there, but for a shank that goes on
    upwards. The foot's name is what the names of the limb's joints have in common.
    """
    geoms = np.flatnonzero(model.geom_bodyid > 0)
    if not len(geoms):
        return {}
    low, high = _reach(model, home, geoms)
    base = home[2] - low.min()
    ends = np.setdiff1d(np.arange(2, model.nbody), model.body_parentid)
    limbs = []
    for body in ends:
        own = np.flatnonzero(model.geom_bodyid[geoms] == body)
        if not len(own) or low[own].min() > low.min() + NEAR * base:
            continue
        sole = own[low[own] <= low[own].min() + SOLE * base]
        short = sole[high[sole] <= low[own].min() + SHANK * base]
        ids = geoms[short if len(short) else sole]
        if not all(_rolls(model, geom) for geom in ids):
            limbs.append((int(body), [int(i) for i in ids]))
    titles = _titles(model, [body for body, _ in limbs])
    return {title: ids for title, (_, ids) in zip(titles, limbs, strict=True)}


def _rolls(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a shape is a wheel: round about a joint without limits, whatever its frame is."""
    body = model.geom_bodyid[geom]
    if not model.body_jntnum[body]:
        return False
    joint = model.body_jntadr[body] + model.body_jntnum[body] - 1
    if model.jnt_limited[joint]:
        return False
    side = np.linalg.svd(model.jnt_axis[joint][None])[2][1:]  # two vectors across the axis
    angles = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    across = np.column_stack([np.cos(angles), np.sin(angles)]) @ side
    own = across @ matrix(model.geom_quat[geom])  # in the shape's frame
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        away = (own @ vertices(model, geom).T).max(1)
    else:
        away = _half_width(model, np.full(SIDES, geom), own)
    reach = across @ (model.geom_pos[geom] - model.jnt_pos[joint]) + away
    return bool(reach.min() > ROUND * reach.max())


def _titles(model: mujoco.MjModel, bodies: list[int]) -> list[str]:
    """A name for the foot of each of `bodies`, all different."""
    limbs = [kinematics.joints_to(model, body) for body in bodies]
    owned = [[j for j in limb if sum(j in other for other in limbs) == 1] for limb in limbs]
    by_joints = [_common([model.joint(1 + j).name for j in own]) for own in owned]
    by_body = [model.body(body).name for body in bodies]
    for titles in (by_joints, by_body):
        if all(titles) and len(set(titles)) == len(titles):
            return titles
    return [f"foot{i}" for i in range(1, len(bodies) + 1)]


def _common(names: list[str]) -> str:
    """What names begin with, or end with, as whole words: FL of FL_hip and FL_knee."""
    words = [[w for w in re.split(r"[_\-. /]", name) if w.lower() != "joint"] for name in names]
    longest = min(map(len, words), default=1) - 1  # a joint has a word of its own
    for turn in (1, -1):
        same: list[str] = []
        for each in zip(*(w[::turn] for w in words), strict=False):
            if len(set(each)) > 1 or len(same) == longest:
                break
            same.append(each[0])
        if same:
            return "_".join(same[::turn])
    return ""
