"""How a robot's primitives touch the floor: how far each reaches down, how many contacts it can have.

Contacts are counted as in MuJoCo Warp, which must allocate room for all of them
(mujoco_warp/_src/collision_primitive_core.py).
"""

import mujoco
import numpy as np

BOX, SPHERE, CAPSULE, CYLINDER = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("BOX", "SPHERE", "CAPSULE", "CYLINDER")
)
MOST = {SPHERE: 1, CAPSULE: 2, CYLINDER: 4, BOX: 8}  # against the floor
MOST_OF_PAIR = 8, 50  # of two primitives; of a mesh with anything (mjMAXCONPAIR)
ROWS_PER_CONTACT = 4  # constraint rows of a pyramidal cone with sliding friction
ROWS_PER_EQUALITY = 6  # of a weld, which has the most


def most(model) -> tuple[int, int]:
    """`(contacts, constraint rows)` that one robot of a compiled model can have at most."""
    kinds = model.geom_type[model.geom_conaffinity > 0]
    contacts = sum(MOST[int(kind)] for kind in kinds)
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


def of_each_foot(foot_of: np.ndarray) -> np.ndarray:
    """[F, K]: the numbers of the shapes of each foot, K of them: of those that have fewer, the last is
    repeated. `foot_of` [S] is the foot of each shape, in ascending order."""
    shapes = [np.flatnonzero(foot_of == foot) for foot in range(foot_of[-1] + 1)]
    most = max(map(len, shapes))
    return np.array([np.pad(ids, (0, most - len(ids)), "edge") for ids in shapes])
