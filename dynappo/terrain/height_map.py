"""Ground that is not flat: heights on a grid, two triangles a cell, and where the ground is from a point.

A cell is split along the diagonal from its corner (i, j) to (i + 1, j + 1), as MuJoCo splits that of a
height field (mjc_ConvexHField: strips of triangles (r + 1, c), (r, c), (r + 1, c + 1), ...). Outside the map
the height is that of its nearest edge; MuJoCo has 2 m of that at most (physics/ground.py).

`normal` is what tests and experiments/28_rough compare with; the package asks for the others.

All functions but `needed` and `triangles` are for NumPy and JAX alike, `map_array` [X, Y] being a map's
`heights`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class HeightMap(NamedTuple):
    """Heights over a rectangle of the world's x and y."""

    heights: (
        np.ndarray
    )  # [X, Y] float32, m; [i, j] at x = corner[0] + i cell, y = corner[1] + j cell
    cell: float  # m
    corner: tuple[float, float]  # m, of heights[0, 0]


def needed(rows: np.ndarray) -> np.ndarray:
    """The numbers of the rows [X, Y] that differ from one beside them, and of the first and the last: without
    the others the surface is the same."""
    changes = (np.diff(rows, axis=0) != 0).any(1)
    return np.flatnonzero(np.append(True, changes) | np.append(changes, True))


def triangles(field: HeightMap) -> tuple[np.ndarray, np.ndarray]:
    """`(points [P, 3] in m, faces [F, 3])`, counterclockwise from above: the map's own surface, exactly.

    A row or column of heights that are those on both of its sides is left out.
    """
    rows = needed(field.heights)
    columns = needed(field.heights[rows].T)
    x, y = (c + field.cell * i for c, i in zip(field.corner, (rows, columns), strict=True))
    points = np.empty((len(rows), len(columns), 3), np.float32)
    points[..., 0], points[..., 1] = x[:, None], y
    points[..., 2] = field.heights[np.ix_(rows, columns)]
    number = np.arange(len(rows) * len(columns), dtype=np.uint32).reshape(len(rows), -1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.stack([a, b, c, a, c, d], -1)  # of a cell the diagonal from (i, j)
    return points.reshape(-1, 3), faces.reshape(-1, 3)


def height(map_array, cell: float, corner: tuple[float, float], x, y):
    """Heights [...] (m) of the ground at `x`, `y` [...] (m)."""
    z, slope, s, t = _under(map_array, cell, corner, x, y)
    return z + cell * (slope[0] * s + slope[1] * t)


def normal(map_array, cell: float, corner: tuple[float, float], x, y):
    """Unit normals [..., 3] of the ground at `x`, `y` [...] (m); on an edge, one of its triangles'."""
    _, slope, *_ = _under(map_array, cell, corner, x, y)
    xp, (high_x, high_y) = x.__array_namespace__(), _far(map_array, cell, corner)
    flat = (x < corner[0]) | (x > high_x), (y < corner[1]) | (y > high_y)
    across = [xp.where(f, 0.0, -g) for f, g in zip(flat, slope, strict=True)]
    found = xp.stack([*across, xp.ones_like(across[0])], -1)
    return found / xp.sqrt((found * found).sum(-1, keepdims=True))


def gap(map_array, cell: float, corner: tuple[float, float], point, radius):
    """Distances [...] (m) of spheres around `point` [..., 3] from the plane of the triangle below, negative
    inside: the vertical distance times the normal's z. Exact on a slope; no look at the triangles around."""
    z, slope, s, t = _under(map_array, cell, corner, point[..., 0], point[..., 1])
    z = z + cell * (slope[0] * s + slope[1] * t)
    xp = point.__array_namespace__()
    return (point[..., 2] - z) / xp.sqrt(1 + slope[0] ** 2 + slope[1] ** 2) - radius


def nearest(map_array, cell: float, corner: tuple[float, float], point, radius):
    """`(distance [...], normal [..., 3])` of the ground's nearest point from `point` [..., 3].

    The distance (m) is negative under the ground. The normal is from there to the point, or of the triangle
    if it is on one, and not on an edge. Looked at are the triangles of the cells that a sphere of `radius`
    [...] around the point is over, so it is the nearest of all where that sphere touches. `radius`
    is NumPy's, a constant.
    """
    xp = point.__array_namespace__()
    heights, far = xp.asarray(map_array), _far(map_array, cell, corner)
    above = point[..., 2] >= height(heights, cell, corner, point[..., 0], point[..., 1])
    sign = xp.where(above, 1.0, -1.0)[..., None]
    # the cells [..., C] below; on the last ones again where there are fewer
    count = 1 + int(np.ceil(2 * np.max(radius) / cell))
    steps = np.stack(np.meshgrid(*[np.arange(count)] * 2, indexing="ij"), -1).reshape(-1, 2)
    at, seen = [], []
    for k, size in enumerate(heights.shape):
        within = xp.clip(point[..., k], corner[k], far[k]) - corner[k]
        first, last = (
            xp.clip(xp.floor((within + d) / cell).astype(int), 0, size - 2)[..., None]
            for d in (-radius, radius)
        )
        at.append(xp.minimum(first + steps[:, k], last))
        seen.append(at[-1] * cell - within[..., None])
    # all that can be nearest, [..., C, 7]: arrays, not a chain of comparisons, which XLA would fuse for hours
    (i, j), (x, y), z = at, seen, point[..., 2:]
    v00, v10, v11, v01 = (  # the cells' corners, seen from the point
        xp.stack([x + m * cell, y + n * cell, heights[i + m, j + n] - z], -1)
        for m, n in ((0, 0), (1, 0), (1, 1), (0, 1))
    )
    one, other = xp.stack([v10, v11], -2), xp.stack([v11, v01], -2)
    on_plane = _on_plane(v00[..., None, :], one, other, cell, np.array([False, True]))
    start, end = xp.stack([v00, v10, v00, v00, v01], -2), xp.stack([v10, v11, v11, v01, v11], -2)
    on_edge = _on_edge(start, end, sign[..., None])
    distance, way = (
        xp.concatenate([p, e], point.ndim) for p, e in zip(on_plane, on_edge, strict=True)
    )
    distance = distance.reshape(*point.shape[:-1], -1)
    way = way.reshape(*distance.shape, 3)
    best = xp.argmin(abs(distance), -1)[..., None]
    return (
        xp.take_along_axis(distance, best, -1)[..., 0],
        xp.take_along_axis(way, best[..., None], -2)[..., 0, :],
    )


def _under(map_array, cell, corner, x, y):
    """Of the triangle below: the height (m) at its cell's first corner, its slopes along x and y, and where
    in the cell, as shares s and t of it."""
    xp = x.__array_namespace__()
    heights = xp.asarray(map_array)
    at, share = [], []
    for value, first, count in zip((x, y), corner, heights.shape, strict=True):
        place = xp.clip((value - first) / cell, 0, count - 1)
        at.append(xp.minimum(xp.floor(place).astype(int), count - 2))
        share.append(place - at[-1])
    (i, j), (s, t) = at, share
    h00, h10 = heights[i, j], heights[i + 1, j]
    h01, h11 = heights[i, j + 1], heights[i + 1, j + 1]
    low = s >= t
    slope = xp.where(low, h10 - h00, h11 - h01) / cell, xp.where(low, h11 - h10, h01 - h00) / cell
    return h00, slope, s, t


def _far(map_array, cell, corner) -> tuple[float, ...]:
    """x and y of the last corner (m)."""
    return tuple(c + cell * (n - 1) for c, n in zip(corner, map_array.shape, strict=True))


def _on_plane(a, b, c, cell, upper):
    """Signed distance of the origin from a triangle's plane, and its normal; infinite where the nearest
    point of the plane is not in the triangle. `upper`: of the two of a cell that with the corner (0, 1)."""
    xp = a.__array_namespace__()
    e, f = b - a, c - a
    n = xp.stack(
        [
            e[..., 1] * f[..., 2] - e[..., 2] * f[..., 1],
            e[..., 2] * f[..., 0] - e[..., 0] * f[..., 2],
            e[..., 0] * f[..., 1] - e[..., 1] * f[..., 0],
        ],
        -1,
    )
    n = n / xp.sqrt((n * n).sum(-1, keepdims=True))
    distance = -(n * a).sum(-1)
    u, v = -(distance * n[..., 0] + a[..., 0]), -(distance * n[..., 1] + a[..., 1])
    low, high = xp.where(upper, u, v), xp.where(upper, v, u)
    inside = (low >= 0) & (low <= high) & (high <= cell)
    return xp.where(inside, distance, xp.inf), n


def _on_edge(a, b, sign):
    """Distance of the origin from the line from a to b, with the `sign`, and the normal there."""
    xp = a.__array_namespace__()
    e = b - a
    t = xp.clip(-(a * e).sum(-1) / (e * e).sum(-1), 0, 1)
    q = a + t[..., None] * e
    distance = xp.sqrt((q * q).sum(-1))
    return sign * distance, -q * (sign / xp.maximum(distance, 1e-9))[..., None]
