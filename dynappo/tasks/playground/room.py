"""How many constraints and contacts a robot may have in MuJoCo Warp, from its model.

Warp's room for them is set before, and tasks ask for what C MuJoCo's robots have. But Warp makes other
contacts: up to 8 of a box and a plane, where C MuJoCo has 4. Measured (experiments/05_playground/room.py: an
untrained policy's actions, half of the robots dropped as they may lie): 99 constraints of a G1, which asks
for 90, 79 of an Apollo (64), 77 of a Berkeley (60), 123 of a T1 on rough ground (80), 148 of an OP3 (144).
"""

from __future__ import annotations

import itertools

import mujoco

# contacts of two shapes at most, in MuJoCo Warp 3.17
POINTS = {
    ("PLANE", "CAPSULE"): 2,
    ("PLANE", "ELLIPSOID"): 1,
    ("PLANE", "CYLINDER"): 4,
    ("PLANE", "MESH"): 4,
    ("CAPSULE", "CAPSULE"): 2,
    ("CAPSULE", "BOX"): 2,
}
OTHERS, ON_HFIELD, OF_SPHERE = 8, 4, 1
# What a robot gets at most, if its task asks for less. Where its shapes could need more (OP3, the tasks of
# whole bodies on the ground), they never touch all at once: 148 and 80 constraints are the most that we saw,
# and 7.1 contacts in the mean of all robots, for which their room is
MOST_CONSTRAINTS, MOST_CONTACTS = 200, 16


def needed(model: mujoco.MjModel) -> tuple[int, int]:
    """`(constraints, contacts)` for which a robot has room: those it has if all that may touch touches, with
    every point, and each joint is at a limit, or the numbers above."""
    touching = [(_points(model, a, b), dim) for a, b, dim in pairs(model)]
    rows = (model.dof_frictionloss > 0).sum() + (model.tendon_frictionloss > 0).sum()
    rows += model.jnt_limited.sum() + model.tendon_limited.sum()
    # the tasks' cones are pyramids
    rows += sum(count * max(2 * (dim - 1), 1) for count, dim in touching)
    contacts = sum(count for count, _ in touching)
    return min(int(rows), MOST_CONSTRAINTS), min(contacts, MOST_CONTACTS)


def pairs(model: mujoco.MjModel) -> list[tuple[int, int, int]]:
    """`(shape, shape, condim)` of all that may touch: the model's pairs, and what MuJoCo's filters leave."""
    found = {
        (min(a, b), max(a, b)): dim
        for a, b, dim in zip(
            model.pair_geom1.tolist(),
            model.pair_geom2.tolist(),
            model.pair_dim.tolist(),
            strict=True,
        )
    }
    of = model.geom_bodyid
    body = model.body_weldid[of]
    parent = model.body_weldid[model.body_parentid[body]]
    excluded = set(model.exclude_signature.tolist())
    for a, b in itertools.combinations(range(model.ngeom), 2):
        kinds = model.geom_contype[a] & model.geom_conaffinity[b]
        kinds |= model.geom_contype[b] & model.geom_conaffinity[a]
        near = parent[a] == body[b] or parent[b] == body[a]
        near = body[a] == body[b] or (near and body[a] != 0 and body[b] != 0)
        signature = (min(of[a], of[b]) << 16) + max(of[a], of[b])
        if kinds and not near and signature not in excluded:
            found.setdefault((a, b), int(max(model.geom_condim[a], model.geom_condim[b])))
    return [(a, b, dim) for (a, b), dim in found.items()]


def _points(model: mujoco.MjModel, a: int, b: int) -> int:
    kinds = sorted(int(model.geom_type[i]) for i in (a, b))
    one, other = (mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_") for kind in kinds)
    if one == "HFIELD":
        return ON_HFIELD
    return OF_SPHERE if "SPHERE" in (one, other) else POINTS.get((one, other), OTHERS)
