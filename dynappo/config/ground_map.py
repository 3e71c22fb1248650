"""`task.tiles.map` of a config: where its file is and what is in it, so that a run's own config says so."""

from __future__ import annotations

import os

from dynappo.config.fields import ConfigError, check
from dynappo.terrain import map_file
from dynappo.terrain.height_map import HeightMap

MOST = 100  # rows and columns, those in the middle of the map


def settle(config, again: bool) -> None:
    """Make the path of `task.tiles.map` whole, and set what follows from the file: `map_hash`, `rows` and
    `columns`, as many tiles as fit. `again`: also where that has been done."""
    tiles = config.task.tiles
    if not tiles.map:
        tiles.map_hash = ""
        return
    if tiles.map_hash and not again:
        return
    for name in ("map_level", "cell", "size"):
        check(f"task.tiles.{name}", tiles[name])
    tiles.map = os.path.abspath(tiles.map)
    try:
        tiles.map_hash = map_file.digest(tiles.map)
        ground = map_file.load(tiles.map, tiles.map_level, tiles.cell, tiles.map_hash)
    except map_file.BadMap as error:
        raise ConfigError(f"task.tiles.map: {error}") from None
    tiles.rows, tiles.columns = (min(MOST, n) for n in room(tiles, ground, tiles.map))


def room(tiles, ground: HeightMap, path: str) -> tuple[int, int]:
    """How many tiles fit on the map of the file `path`, along x and y; ConfigError where none does."""
    sides = [tiles.cell * (count - 1) for count in ground.heights.shape]
    rows, columns = (int(side / tiles.size + 1e-6) for side in sides)
    if not rows or not columns:
        raise ConfigError(
            f"task.tiles.size is {tiles.size:g}, expected at most {min(sides):g}: {path} has "
            f"{sides[0]:g} x {sides[1]:g} m where task.tiles.cell is {tiles.cell:g} m"
        )
    return rows, columns
