"""A rough ground for training: a grid of tiles, from easy to hard, made from a seed and `task.tiles`.

As Isaac Lab's rough tasks have it (isaaclab/terrains/config/rough.py): along x the rows, from the easiest to
the hardest; along y the columns, each of one kind. A robot begins in the middle of a tile. Around all tiles
the ground is flat, at height 0, where every tile begins too.

| kind             | from the middle outwards       | its size, from the first row to the last      |
|------------------|--------------------------------|-----------------------------------------------|
| `pyramid_stairs` | stairs down, from a platform   | `stairs`: height of a step, m                 |
| `pit_stairs`     | stairs up, out of a pit        | the same                                      |
| `boxes`          | square columns                 | `boxes`: m, that they may be higher or lower  |
| `random`         | a height drawn for each point  | `random`: from low to high in every row, m    |
| `pyramid_slope`  | a slope down, from a platform  | `slope`: rise over run                        |
| `pit_slope`      | a slope up                     | the same                                      |

With `task.tiles.map` the ground is that file's; tiles are places on it, of no kind.

What differs from Isaac Lab: the rows' difficulties are even, 0 to 1, where there each tile draws its own
between two such; walls are a cell wide, where there stairs and boxes have vertical ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynappo.terrain import map_file
from dynappo.terrain.height_map import HeightMap

KINDS = ("pyramid_stairs", "pit_stairs", "boxes", "random", "pyramid_slope", "pit_slope")


def kinds(tiles: Any) -> np.ndarray:
    """The kind of each column [columns], a number of `KINDS`: columns by `tiles.shares`, in that order."""
    shares = np.cumsum(np.array(tiles.shares, float)) / np.sum(tiles.shares)
    middles = (np.arange(tiles.columns) + 0.5) / tiles.columns
    return np.searchsorted(shares, middles)


def difficulty(tiles: Any) -> np.ndarray:
    """Of each row, [rows], from 0 to 1; 0 of a single one."""
    return np.arange(tiles.rows) / max(1, tiles.rows - 1)


def centres(tiles: Any) -> np.ndarray:
    """World x and y (m) of the tiles' middles, [rows, columns, 2]; the middle of all is the origin."""
    counts = np.array([tiles.rows, tiles.columns])
    x, y = ((np.arange(count) + 0.5 - count / 2) * tiles.size for count in counts)
    return np.stack(np.meshgrid(x, y, indexing="ij"), -1)


def make(tiles: Any) -> HeightMap:
    """The ground of the config's group `task.tiles`; map_file.BadMap where its file is not there."""
    if tiles.map:
        return map_file.load(tiles.map, tiles.map_level, tiles.cell, tiles.map_hash)
    width, border = cells(tiles), round(tiles.border / tiles.cell)
    shape = np.array([tiles.rows, tiles.columns]) * width + 2 * border + 1
    heights = np.zeros(shape, np.float32)
    of_column = kinds(tiles)
    for row, hard in enumerate(difficulty(tiles)):
        for column in range(tiles.columns):
            # a tile is the same however many there are
            rng = np.random.default_rng((tiles.seed, row, column))
            one = tile(tiles, KINDS[of_column[column]], float(hard), rng)
            i, j = border + row * width, border + column * width
            heights[i : i + width + 1, j : j + width + 1] = one
    corner = -(np.array([tiles.rows, tiles.columns]) * tiles.size / 2 + border * tiles.cell)
    return HeightMap(heights, float(tiles.cell), (float(corner[0]), float(corner[1])))


def single(tiles: Any, kind: str, hard: float, seed: int = 0, around: float = 12.0) -> HeightMap:
    """One tile of this kind and difficulty, its middle the origin; `around` (m) it the ground is flat, so far
    that nobody reaches its end in a film."""
    border, rng = round(around / tiles.cell), np.random.default_rng((seed, 0, 0))
    heights = np.pad(tile(tiles, kind, hard, rng), border).astype(np.float32)
    corner = -(tiles.size / 2 + border * tiles.cell)
    return HeightMap(heights, float(tiles.cell), (corner, corner))


def cells(tiles: Any) -> int:
    """Cells along a tile."""
    return round(tiles.size / tiles.cell)


def tile(tiles: Any, kind: str, hard: float, rng: np.random.Generator) -> np.ndarray:
    """Heights (m) [cells + 1, cells + 1] of one tile of this kind and difficulty, 0 at its edges."""
    count = cells(tiles)
    along = np.minimum(np.arange(count + 1), count - np.arange(count + 1))
    # m from the nearest edge, a little more, so that a rounded quotient is not one less
    inside = np.minimum.outer(along, along) * tiles.cell + 1e-6
    no_edge = (
        np.minimum.outer(along, along) > 0
    )  # else without a margin walls would stand between tiles
    made = {
        "pyramid_stairs": lambda: stairs(tiles, inside, between(tiles.stairs, hard)),
        "pit_stairs": lambda: -stairs(tiles, inside, between(tiles.stairs, hard)),
        "boxes": lambda: boxes(tiles, inside, between(tiles.boxes, hard), rng),
        "random": lambda: random(tiles, inside, rng),
        "pyramid_slope": lambda: slope(tiles, inside, between(tiles.slope, hard)),
        "pit_slope": lambda: -slope(tiles, inside, between(tiles.slope, hard)),
    }[kind]()
    return np.round(made * no_edge / tiles.height_step) * tiles.height_step


def between(ends, share: float) -> float:
    """The number that lies at `share`, 0 to 1, between two."""
    low, high = ends
    return low + (high - low) * share


def stairs(tiles: Any, inside, step: float) -> np.ndarray:
    """Steps of the height `step` (m) around a platform at least `tiles.stairs_platform` wide."""
    run = tiles.size / 2 - tiles.stairs_border - tiles.stairs_platform / 2
    count = np.floor(run / tiles.tread + 1e-6) + 1
    return step * np.clip(np.floor((inside - tiles.stairs_border) / tiles.tread) + 1, 0, count)


def slope(tiles: Any, inside, rise: float) -> np.ndarray:
    """A slope from the margin to a platform in the middle."""
    run = tiles.size / 2 - tiles.platform / 2 - tiles.margin
    return rise * np.clip(inside - tiles.margin, 0, run)


def boxes(tiles: Any, inside, size: float, rng: np.random.Generator) -> np.ndarray:
    """Columns of `tiles.box_width` (m), each up to `size` higher or lower; the platform is so high."""
    count = inside.shape[0]
    which = np.floor((np.arange(count) * tiles.cell + 1e-6) / tiles.box_width).astype(int)
    height = rng.uniform(-size, size, (which[-1] + 1, which[-1] + 1))[np.ix_(which, which)]
    platform = inside >= tiles.size / 2 - tiles.platform / 2
    return np.where(platform, size, height) * (inside > tiles.margin)


def random(tiles: Any, inside, rng: np.random.Generator) -> np.ndarray:
    """Each point at one of the heights low, low + random_step, ... high."""
    low, high = tiles.random
    count = round((high - low) / tiles.random_step) + 1
    height = low + tiles.random_step * rng.integers(0, count, inside.shape)
    return height * (inside > tiles.margin)
