"""Where a robot is on its ground, and what it sees of it: the pose, the height scan, the ground at its feet.

The pose in the world and its rate are known in a tail: they follow from what the model predicts anyway. With
v the velocity of the base's origin and w its angular velocity, both in the base, r the world's up in the base
(minus the direction of gravity), T the rotation from the base to the frame that is turned with its yaw alone:

    T = rows (b x r, b, r),   b = (0, r_z, -r_y) / |(r_y, r_z)|
    rate = (Rz(yaw) T v, (w_y r_y + w_z r_z) / (r_y^2 + r_z^2))
    pose' = pose + dt (1 - s) rate + dt s rate',   s = (n + 1) / 2n

because a physics step moves by the velocity after it, and n of them with an even acceleration have this mean
(n = 4: s = 0.625; exact for the position, and for the yaw of a base that keeps its tilt).

The scan (Isaac Lab's height_scan): points of a grid around the base, turned with its yaw,

    clip(z_base - ground - 0.5, -1, 1)

At each foot: how high its middle is above the ground under it, and above four points `AROUND` it (m), ahead,
behind, left, right, in the same frame; clipped to +-1 m. The code works with NumPy and jax.numpy.
"""

from __future__ import annotations

from typing import Any

import numpy as np

SIZE, SPACING = (17, 11), 0.1  # points along x and y; m between two
BELOW, CLIP = 0.5, 1.0  # m
AROUND = 0.1  # m
AT_FOOT = np.array([[0, 0], [AROUND, 0], [-AROUND, 0], [0, AROUND], [0, -AROUND]])  # [5, 2]
POSE = 4  # x, y, z of the base's origin (m), yaw (rad)
FLAT = 1e-2  # of |(r_y, r_z)|: a base that points up has no yaw


def sizes(feet: int, has_scan: bool, heading: bool) -> dict[str, int]:
    """Numbers of each part of the surroundings (tasks/velocity/surroundings.py) of a robot with so many feet,
    in their order; `heading`: of commands that turn to one."""
    return dict(
        pose=POSE,
        rate=POSE,
        goal=2 * heading,
        shift=3 * has_scan,
        feet=len(AT_FOOT) * feet,
        scan=SIZE[0] * SIZE[1] * has_scan,
    )


def points() -> np.ndarray:
    """The scan's points [S, 2] (m), x ahead and y left of the base; the first x first, from right to left."""
    x, y = ((np.arange(n) - (n - 1) / 2) * SPACING for n in SIZE)
    return np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)


def mirror() -> np.ndarray:
    """[S] the number of each point's image, left for right."""
    return np.arange(SIZE[0] * SIZE[1]).reshape(SIZE)[:, ::-1].ravel()


def upright(gravity) -> Any:
    """T [3, 3], from the base to the frame turned by yaw alone; `gravity` [3] is a direction there."""
    xp = gravity.__array_namespace__()
    r = -gravity / xp.sqrt((gravity**2).sum())
    c = xp.clip(xp.sqrt(r[1] ** 2 + r[2] ** 2), FLAT, None)
    b = xp.stack([r[0] * 0, r[2] / c, -r[1] / c])
    a = xp.stack([b[1] * r[2] - b[2] * r[1], b[2] * r[0] - b[0] * r[2], b[0] * r[1] - b[1] * r[0]])
    return xp.stack([a, b, r])


def turned(xy, yaw) -> Any:
    """Points or vectors [..., 2] turned by `yaw` (rad)."""
    xp = xy.__array_namespace__()
    s, c = xp.sin(yaw), xp.cos(yaw)
    return xp.stack([c * xy[..., 0] - s * xy[..., 1], s * xy[..., 0] + c * xy[..., 1]], axis=-1)


def yaw_rate(gravity, angular) -> Any:
    """rad/s, of the base's heading, from its angular velocity [3] in the base."""
    xp = gravity.__array_namespace__()
    r = -gravity / xp.sqrt((gravity**2).sum())
    flat = r[1] ** 2 + r[2] ** 2
    return (angular[1] * r[1] + angular[2] * r[2]) / xp.clip(flat, FLAT**2, None)


def rate(yaw, gravity, linear, angular) -> Any:
    """[4] change of the pose (m/s, m/s, m/s, rad/s); `linear` [3] is the velocity of the base's origin."""
    xp = gravity.__array_namespace__()
    level = (upright(gravity) * linear).sum(-1)
    return xp.concat([turned(level[:2], yaw), level[2:], yaw_rate(gravity, angular)[None]], axis=-1)


def moved(pose, before, gravity, linear, angular, dt: float, substeps: int) -> tuple[Any, Any]:
    """`(pose, rate)` [4] a control step of `dt` s later: the last three are those after it.

    `before` is the rate before it. The yaw comes first: the rate after it is in the new heading.
    """
    share = (substeps + 1) / (2 * substeps)
    yaw = pose[3] + dt * ((1 - share) * before[3] + share * yaw_rate(gravity, angular))
    after = rate(yaw, gravity, linear, angular)
    return pose + dt * ((1 - share) * before + share * after), after


def scan(height, pose, shift) -> Any:
    """[S] what a robot sees of the ground; `height(x, y)` is its height at world points.

    `shift` [3] (m) is by how much its map is off: points are read so far ahead, left (of the base), and
    stand so much lower in the scan.
    """
    xp = pose.__array_namespace__()
    at = turned(xp.asarray(points(), dtype=pose.dtype) + shift[:2], pose[3]) + pose[:2]
    return xp.clip(pose[2] - height(at[..., 0], at[..., 1]) - BELOW + shift[2], -CLIP, CLIP)


def in_world(pose, gravity, points) -> Any:
    """[P, 3] (m) in the world of `points` [P, 3] in the base."""
    xp = pose.__array_namespace__()
    level = (upright(gravity) * points[:, None]).sum(-1)
    flat = turned(level[:, :2], pose[3]) + pose[:2]
    return xp.concat([flat, pose[2] + level[:, 2:]], axis=-1)


def at_feet(height, pose, gravity, feet) -> Any:
    """[F * 5] how high each foot is above the ground at `AT_FOOT`; `feet` [F, 3] (m) in the base."""
    xp = pose.__array_namespace__()
    level = (upright(gravity) * feet[:, None]).sum(-1)  # [F, 3]
    around = level[:, None, :2] + xp.asarray(AT_FOOT, dtype=pose.dtype)
    at = turned(around, pose[3]) + pose[:2]
    above = pose[2] + level[:, 2:] - height(at[..., 0], at[..., 1])
    return xp.clip(above, -CLIP, CLIP).reshape(-1)
