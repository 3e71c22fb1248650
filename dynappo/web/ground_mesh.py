"""The rough ground that the page draws: a few triangles instead of a height for each cell.

mjviser would send a tile with the floor around it, 320 x 320 cells, as a mesh of 4 MB.
"""

from __future__ import annotations

import numpy as np

from dynappo.terrain import height_map
from dynappo.terrain.height_map import HeightMap, triangles

REACH = 20.0  # m from the middle: no more of a large map is simulated and drawn
WALL = 0.6  # rise over run of what is called a wall: more than a slope has, also across its folds


def near(field: HeightMap) -> HeightMap:
    """The part of the map within `REACH` of the origin in x and y."""
    first = [max(0, int(np.ceil((-REACH - c) / field.cell - 1e-6))) for c in field.corner]
    last = [int(np.floor((REACH - c) / field.cell + 1e-6)) for c in field.corner]
    heights = field.heights[first[0] : last[0] + 1, first[1] : last[1] + 1]
    x, y = (c + field.cell * i for c, i in zip(field.corner, first, strict=True))
    return HeightMap(np.ascontiguousarray(heights), field.cell, (x, y))


def lines(field: HeightMap) -> np.ndarray:
    """[N, 2, 3] m, from where to where: along the ground every metre in x and y, and at the edges of walls.

    From a camera above, the stairs that lead away from it show no wall.
    """
    x, y = (
        c + field.cell * np.arange(n)
        for c, n in zip(field.corner, field.heights.shape, strict=True)
    )
    along_y = _every_metre(x, y, field.heights)
    along_x = _every_metre(y, x, field.heights.T)[..., [1, 0, 2]]
    return np.concatenate([along_y, along_x, _edges(field)]).astype(np.float32)


def _every_metre(x: np.ndarray, y: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Lines along y, at the points nearest to whole metres of x."""
    whole = np.arange(np.ceil(x[0] - 1e-6), x[-1] + 1e-6)
    found = [np.zeros((0, 2, 3))]
    for i in sorted({int(abs(x - metre).argmin()) for metre in whole}):
        j = height_map.needed(heights[i][:, None])
        line = np.stack([np.full(len(j), x[i]), y[j], heights[i, j]], -1)
        found.append(np.stack([line[:-1], line[1:]], 1))
    return np.concatenate(found)


def _edges(field: HeightMap) -> np.ndarray:
    """The sides that a wall's triangle shares with one that is none."""
    points, faces = triangles(field)
    a, b, c = points[faces].swapaxes(0, 1)
    normal = np.cross(b - a, c - a)
    wall = np.hypot(normal[:, 0], normal[:, 1]) > WALL * normal[:, 2]
    sides = np.sort(np.stack([faces, np.roll(faces, -1, 1)], -1), -1).reshape(-1, 2)
    sides, which, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    walls = np.bincount(which.ravel(), np.repeat(wall, 3), len(sides))
    return points[sides[(walls == 1) & (count == 2)]]
