"""Where the feet are at given joint angles, without a physics call: `legs(robot)`, then `feet_in_base`.

A foot's shapes are points with radii: a sphere's middle, the two ends of a capsule, the eight corners of
a box, the middles of a cylinder's two rims. Each point moves with the hinges between it and the base. Axes
and offsets are taken in the base's frame with all joints at their `ref`, so frames may be turned (Lynch and
Park, Modern Robotics 4.1, the product of exponentials):

    x <- o_i + exp([a_i] (q_i - ref_i)) x        from the last joint to the first
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from dynappo.description import contacts
from dynappo.description.rotation import matrix


class Legs(NamedTuple):
    """The hinges between the base and each point of a foot: `P` points, chains of up to `L` joints.

    Shorter chains begin with joints that do not exist: `real` is 0, the axis and the offset are 0.
    """

    joints: np.ndarray  # [P, L] numbers of the joints, from the base to the foot
    offsets: np.ndarray  # [P, L + 1, 3] m: each joint in the one before, then the point
    axes: np.ndarray  # [P, L, 3]
    ref: np.ndarray  # [P, L] rad, of the joints
    real: np.ndarray  # [P, L] 1, or 0 where a chain is shorter
    radius: np.ndarray  # [P] m: of a ball around the point
    rim: np.ndarray  # [P] m: of a disc around it, across the line to the point `other`
    other: np.ndarray  # [P] the number of another point


def legs(model: mujoco.MjModel, feet: np.ndarray) -> Legs:
    """The chains that move the points of the geoms `feet`, in their order."""
    rows, others = [], []
    for geom in feet:
        first = len(rows)
        points, radius, rim = _points(model, geom)
        others += [first + (i ^ 1 if len(points) > 1 else 0) for i in range(len(points))]
        rows += [(_chain(model, model.geom_bodyid[geom], point), radius, rim) for point in points]
    return _of_chains(model, rows, others)


def _of_chains(model: mujoco.MjModel, rows: list, others: list[int]) -> Legs:
    """`Legs` of the chain, radius and rim of each point."""
    length = max(len(joints) for (joints, *_), _, _ in rows)

    def padded(values, width=()):
        values = np.reshape(np.array(values, float), (-1, *width))
        return np.concatenate([np.zeros((length - len(values), *width)), values])

    chains = [chain for chain, _, _ in rows]
    joints = np.array([padded(joints) for joints, *_ in chains], int)
    offsets = np.array([[*padded(o[:-1], (3,)), o[-1]] for _, o, _ in chains])
    return Legs(
        joints=joints,
        offsets=offsets,
        axes=np.array([padded(axes, (3,)) for *_, axes in chains]),
        ref=np.array([padded(model.qpos0[7 + np.array(j, int)]) for j, *_ in chains]),
        real=np.array([padded(np.ones(len(joints))) for joints, *_ in chains]),
        radius=np.array([radius for _, radius, _ in rows]),
        rim=np.array([rim for *_, rim in rows]),
        other=np.array(others),
    )


def middles(model: mujoco.MjModel, feet: np.ndarray, foot_of: np.ndarray) -> Legs:
    """As `legs`, of one point a foot: the middle of all points of its shapes."""
    chains = []
    for foot in range(foot_of.max() + 1):
        shapes = feet[foot_of == foot]
        body = model.geom_bodyid[shapes[0]]
        points = np.concatenate([_points(model, geom)[0] for geom in shapes])
        chains.append((_chain(model, body, points.mean(0)), 0.0, 0.0))
    return _of_chains(model, chains, list(range(len(chains))))


def probed(model: mujoco.MjModel, geoms: np.ndarray) -> Legs:
    """As `legs`, of the probes of `geoms` (contacts.py); `other` is a neighbour along a cylinder's axis."""
    of = contacts.probes(model, geoms)
    rows, others = [], []
    for k, number in enumerate(of.geom):
        geom = geoms[number]
        point = model.geom_pos[geom] + matrix(model.geom_quat[geom]) @ of.place[k]
        rows.append((_chain(model, model.geom_bodyid[geom], point), of.radius[k], of.ring[k]))
        same = np.flatnonzero(of.geom == number)
        others.append(int(same[-1] if k == same[0] else same[0]) if of.ring[k] else k)
    return _of_chains(model, rows, others)


def _points(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, float, float]:
    """`(points [K, 3] in the body's frame, radius, rim)` of a primitive."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    pos, quat = model.geom_pos[geom], model.geom_quat[geom]
    if kind == contacts.SPHERE:
        return pos[None], size[0], 0.0
    if kind == contacts.BOX:
        own = np.stack(np.meshgrid(*[[-s, s] for s in size]), -1).reshape(-1, 3)
        return pos + own @ matrix(quat).T, 0.0, 0.0
    ends = pos + np.outer([-size[1], size[1]], matrix(quat)[:, 2])
    capsule = kind == contacts.CAPSULE
    return ends, size[0] * capsule, size[0] * (not capsule)


def joints_to(model: mujoco.MjModel, body: int) -> list[int]:
    """The numbers of the joints between the base and `body`, from the base on."""
    return _chain(model, body, np.zeros(3))[0]


def _chain(model: mujoco.MjModel, body: int, point: np.ndarray) -> tuple[list, list, list]:
    """`(joints, offsets, axes)` from the base to a `point` of a body.

    Aligned frames, and joints at their body's origin, give the file's own numbers to the last digit.
    """
    path = []
    while model.body_parentid[body] != 0:
        path.insert(0, int(body))
        body = model.body_parentid[body]
    joints, offsets, axes = [], [], []
    turn, here = (
        np.eye(3),
        np.zeros(3),
    )  # of the body in the base, and from the last joint to its origin
    for body in path:
        here = here + turn @ model.body_pos[body]
        turn = turn @ matrix(model.body_quat[body])
        first = model.body_jntadr[body]
        for joint in range(first, first + model.body_jntnum[body]):
            place = turn @ model.jnt_pos[joint]
            joints.append(joint - 1)
            offsets.append(here + place)
            axes.append(turn @ model.jnt_axis[joint])
            here = -place
    return joints, [*offsets, here + turn @ point], axes


def feet_in_base(legs: Legs, joints):
    """The feet's points [P, 3] (m) in the base's frame at joint angles [A]."""
    xp = joints.__array_namespace__()
    offsets, axes = (xp.asarray(x, dtype=joints.dtype) for x in (legs.offsets, legs.axes))
    angles, count = joints[legs.joints], legs.joints.shape[1]
    if legs.ref.any():
        angles = angles - xp.asarray(legs.ref, dtype=joints.dtype)
    if not legs.real.all():
        angles = angles * xp.asarray(legs.real, dtype=joints.dtype)
    angles = angles[..., None]
    position = offsets[:, count]
    for i in reversed(range(count)):  # from the foot up to the hip: rotate, add the offset
        axis, angle = axes[:, i], angles[:, i]
        turned = xp.linalg.cross(axis, position)
        position = (
            position * xp.cos(angle)
            + turned * xp.sin(angle)
            + axis * (axis * position).sum(-1, keepdims=True) * (1 - xp.cos(angle))
        )
        position = offsets[:, i] + position
    return position


def lowest(legs: Legs, joints):
    """How high (m) the lowest point of all feet is above the base's origin, the base being upright."""
    points = feet_in_base(legs, joints)
    heights = points[:, 2] - legs.radius
    if legs.rim.any():  # of cylinders, as in contacts.floor_distance
        xp = joints.__array_namespace__()
        axis = points - points[legs.other]
        length = np.maximum(
            np.linalg.norm(legs.offsets[:, -1] - legs.offsets[legs.other, -1], axis=-1), 1e-9
        )
        slope = axis[:, 2] / xp.asarray(length, dtype=joints.dtype)
        rim = xp.asarray(legs.rim, dtype=joints.dtype)
        heights = heights - rim * xp.sqrt(xp.clip(1 - slope**2, 0, None))
    return heights.min()
