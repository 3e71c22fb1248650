"""How a robot's primitives touch the ground: how far each reaches down, with which points it comes first to
ground that is not flat, how many contacts it can have.

Contacts are counted as in MuJoCo Warp, which must allocate room for all of them
(mujoco_warp/_src/collision_primitive_core.py).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

BOX, SPHERE, CAPSULE, CYLINDER = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("BOX", "SPHERE", "CAPSULE", "CYLINDER")
)
MOST = {SPHERE: 1, CAPSULE: 2, CYLINDER: 4, BOX: 8}  # against the floor
MOST_ON_HFIELD = 4  # of any of them, against a height field
MOST_OF_PAIR = 8, 50  # of two primitives; of a mesh with anything (mjMAXCONPAIR)
ROWS_PER_CONTACT = 4  # constraint rows of a pyramidal cone with sliding friction
ROWS_PER_EQUALITY = 6  # of a weld, which has the most


def most(model) -> tuple[int, int]:
    """`(contacts, constraint rows)` that one robot of a compiled model can have at most."""
    kinds = model.geom_type[model.geom_conaffinity > 0]
    most = MOST_ON_HFIELD if model.nhfield else None
    contacts = sum(most or MOST[int(kind)] for kind in kinds)
    rows = contacts * ROWS_PER_CONTACT + model.neq * ROWS_PER_EQUALITY
    plain = np.isin(model.geom_type, [*MOST, mujoco.mjtGeom.mjGEOM_PLANE])
    pairs = np.where(plain[model.pair_geom1] & plain[model.pair_geom2], *MOST_OF_PAIR)
    rows += int((pairs * np.maximum(2 * (model.pair_dim - 1), 1)).sum())
    rows += int(model.jnt_limited.sum() + (model.dof_frictionloss > 0).sum())
    rows += int(model.tendon_limited.sum() + (model.tendon_frictionloss > 0).sum())
    return contacts + int(pairs.sum()), rows


def floor_distance(model: mujoco.MjModel, geoms: np.ndarray):
    """Constants `(fixed [G], linear [G, 3], ring [G])` of how far each geom reaches down.

    With r the third row of a geom's rotation matrix, its lowest point lies below its centre by

        fixed + linear . |r| + ring sqrt(1 - r_z^2)

    (sphere: radius; capsule: radius + half |r_z|; box: half sizes . |r|; cylinder: half |r_z| +
    radius sqrt(1 - r_z^2)), which holds for MuJoCo's conventions of size and axis.
    """
    size, kind = model.geom_size[geoms], model.geom_type[geoms]
    round_end = np.isin(kind, (SPHERE, CAPSULE))
    axial = np.isin(kind, (CAPSULE, CYLINDER))
    box = kind == BOX
    fixed = np.where(round_end, size[:, 0], 0.0)
    linear = np.where(box[:, None], size, 0.0)
    linear[axial, 2] = size[axial, 1]
    ring = np.where(kind == CYLINDER, size[:, 0], 0.0)
    return fixed, linear, ring


def lowest(distance, height, row):
    """Heights [..., G] (m) of the geoms' lowest points, for NumPy and JAX.

    `distance` is `floor_distance` of the geoms, `height` [..., G] that of their centres, `row`
    [..., G, 3] the third row of each rotation matrix; spheres do not need it.
    """
    fixed, linear, ring = distance
    if not linear.any() and not ring.any():
        return height - fixed
    xp = height.__array_namespace__()
    drop = fixed + (linear * xp.abs(row)).sum(-1)
    return height - (drop + ring * xp.sqrt(xp.maximum(1 - row[..., 2] ** 2, 0)))


class Probes(NamedTuple):
    """Spheres in the geoms, P of them: what of a geom is asked for its distance from ground that is not flat.

    On flat ground the lowest of a geom's is its lowest point: the ends of a capsule, the corners of a box,
    the lowest points of a cylinder's two rims.
    """

    geom: np.ndarray  # [P] the geom's number, ascending
    place: np.ndarray  # [P, 3] m, in its frame
    radius: np.ndarray  # [P] m
    ring: np.ndarray  # [P] m, a cylinder's radius: the probe is so far down its disc


PROBE_SPACING = 0.2  # m, at most, between neighbours along an edge: less than a stair is deep


def probes(model: mujoco.MjModel, geoms: np.ndarray, between: bool = True) -> Probes:
    """Of `geoms`. With more `between` the ends of each, or a stair's edge would pass there unseen."""
    rows = []
    for number, geom in enumerate(geoms):
        kind, size = int(model.geom_type[geom]), model.geom_size[geom]
        if kind == SPHERE:
            rows.append([number, 0, 0, 0, size[0], 0])
        elif kind == BOX:
            ways = [_along(half, between) for half in size]
            for at in np.stack(np.meshgrid(*ways, indexing="ij"), -1).reshape(-1, 3):
                if (abs(at) >= size).any():  # on the surface
                    rows.append([number, *at, 0, 0])
        else:
            round_end = kind == CAPSULE
            for z in _along(size[1], between):
                rows.append([number, 0, 0, z, size[0] * round_end, size[0] * (not round_end)])
    rows = np.array(rows, float).reshape(-1, 6)
    return Probes(rows[:, 0].astype(int), rows[:, 1:4], rows[:, 4], rows[:, 5])


def _along(half: float, between: bool) -> np.ndarray:
    return np.linspace(-half, half, 2 + between * int(2 * half / PROBE_SPACING))


def probe_points(of: Probes, place, turn):
    """Where they are, [..., P, 3] (m), for the places [..., G, 3] and rotations [..., G, 3, 3] of their
    geoms; NumPy and JAX."""
    xp: Any = place.__array_namespace__()
    turn = turn[..., of.geom, :, :]
    found = place[..., of.geom, :] + (turn * of.place[:, None, :]).sum(-1)
    if not of.ring.any():
        return found
    axis = turn[..., 2]
    up = xp.asarray([0.0, 0.0, 1.0], dtype=axis.dtype) - axis[..., 2:] * axis
    size = xp.sqrt(xp.maximum((up * up).sum(-1, keepdims=True), 1e-12))
    return found - of.ring[:, None] * up / size


def of_each_foot(foot_of: np.ndarray) -> np.ndarray:
    """[F, K]: the numbers of the shapes of each foot, K of them: of those that have fewer, the last is
    repeated. `foot_of` [S] is the foot of each shape, in ascending order."""
    shapes = [np.flatnonzero(foot_of == foot) for foot in range(foot_of[-1] + 1)]
    most = max(map(len, shapes))
    return np.array([np.pad(ids, (0, most - len(ids)), "edge") for ids in shapes])
