"""Pictures of a robot from its side without OpenGL: its shapes as small faces, the farthest drawn first."""

import mujoco
import numpy as np

AROUND, LIGHT = 16, np.array([0.25, -0.6, 0.75])  # faces around a shape; where light comes from
VISIBLE = 2  # the group of shapes that are there to be seen


def faces(model: mujoco.MjModel, qpos) -> tuple[np.ndarray, np.ndarray]:
    """`(corners [Q, 4, 3] in the world, colours [Q, 3])` of a robot in a pose."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    corners, colours = [], []
    for g in np.flatnonzero(model.geom_group == VISIBLE):
        turn = data.geom_xmat[g].reshape(3, 3)
        some = surface(int(model.geom_type[g]), model.geom_size[g]) @ turn.T + data.geom_xpos[g]
        material = model.geom_matid[g]
        colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[g]
        corners.append(some)
        colours.append(np.tile(colour[:3], (len(some), 1)))
    return np.concatenate(corners), np.concatenate(colours)


def surface(kind: int, size) -> np.ndarray:
    """The faces [Q, 4, 3] of a shape of MuJoCo, about its own middle."""
    kinds = mujoco.mjtGeom
    arc = np.linspace(-np.pi / 2, np.pi / 2, 7)
    if kind == kinds.mjGEOM_BOX:
        return box(size)
    if kind == kinds.mjGEOM_CYLINDER:
        return turned([0, size[0], size[0], 0], [-size[1], -size[1], size[1], size[1]])
    if kind == kinds.mjGEOM_CAPSULE:
        ends = np.where(np.arange(8) < 4, -size[1], size[1])
        arc = np.r_[arc[:4], arc[3:]]
        return turned(size[0] * np.cos(arc), size[0] * np.sin(arc) + ends)
    radii = size if kind == kinds.mjGEOM_ELLIPSOID else np.repeat(size[0], 3)
    return turned(np.cos(arc), np.sin(arc)) * radii


def turned(radius, height) -> np.ndarray:
    """The faces of a profile turned about the z axis."""
    angle = np.linspace(0, 2 * np.pi, AROUND + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], -1)  # [A, 2]
    points = np.concatenate(
        [
            np.asarray(radius)[:, None, None] * ring,
            np.tile(np.reshape(height, (-1, 1, 1)), (AROUND + 1, 1)),
        ],
        -1,
    )
    four = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    return np.stack(four, 2).reshape(-1, 4, 3)


def box(size) -> np.ndarray:
    """The six faces of a box of these half sizes."""
    square = np.array([(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)], float)
    turns = [np.roll(square * [1, 1, end], k, axis=1) for k in range(3) for end in (-1, 1)]
    return np.array(turns) * np.asarray(size)


def draw(axis, model: mujoco.MjModel, qpos, origin, heading: float) -> None:
    """The robot in metres ahead of `origin` [2] and above the floor, seen from its right side."""
    from matplotlib.collections import PolyCollection

    corners, colours = faces(model, qpos)
    corners = corners - [*origin, 0]
    ahead = np.array([np.cos(heading), np.sin(heading), 0])
    left = np.array([-np.sin(heading), np.cos(heading), 0])
    depth = (corners @ left).mean(1)  # the camera is on the right
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    normal = np.stack([normal @ ahead, normal @ left, normal[:, 2]], 1)
    normal *= -np.sign(normal[:, 1:2] + 1e-12)  # towards the camera
    shade = 0.62 + 0.38 * np.clip(normal @ LIGHT, 0, 1)
    fill = np.clip((0.12 + 0.88 * colours) * shade[:, None], 0, 1)
    order = np.argsort(-depth)
    flat = np.stack([corners @ ahead, corners[..., 2]], -1)[order]
    axis.add_collection(
        PolyCollection(list(flat), facecolors=fill[order], edgecolors=fill[order], linewidths=0.3)
    )
