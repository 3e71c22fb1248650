"""Which tile of the ground a robot gets: `start`, and `move` where it starts anew. Isaac Lab's rule.

A robot begins in one of the first `task.tiles.start_rows` rows, in any column, which it keeps. When it starts
anew,

    `task.tiles.climb` rows harder:  it is farther from the middle of its tile than half of its side
    a row easier:  it is not, and is nearer than half of the way of its last command in an episode
    any row:       it would be harder than the last

On a map of one's own no row is harder than another: it starts in any.

Its tile is part of its state, so a run that goes on has the same, and every seed its own
(isaaclab_tasks/.../velocity/mdp/curriculums.py, terrain_levels_vel; terrain_importer.py, update_env_origins).
"""

from __future__ import annotations

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int


class Tile(struct.PyTreeNode):
    """Where a robot is among the tiles."""

    row: Int[Array, "..."]  # how hard, from 0
    column: Int[Array, "..."]  # of which kind (tiles.kinds)


def start(tiles, draws: Float[Array, " 2"]) -> Tile:
    """The first tile of a robot; `draws` from 0 to 1."""
    rows = tiles.rows if tiles.map else min(tiles.start_rows, tiles.rows)
    counts = jnp.array([rows, tiles.columns])
    row, column = _whole(draws, counts)
    return Tile(row=row, column=column)


def move(tiles, tile: Tile, walked, asked, draw) -> Tile:
    """The next tile of a robot that starts anew.

    `walked` (m) is how far it is from the middle of its tile; `asked` (m) the way of its command in an
    episode; `draw`, from 0 to 1, chooses the row after the last.
    """
    if tiles.map:
        return tile.replace(row=_whole(draw, tiles.rows).astype(jnp.int32))
    harder = walked > tiles.size / 2
    easier = ~harder & (walked < asked / 2)
    row = tile.row + tiles.climb * harder - easier
    row = jnp.where(row >= tiles.rows, _whole(draw, tiles.rows), jnp.maximum(row, 0))
    return tile.replace(row=row.astype(jnp.int32))


def _whole(draw, count):
    """Of numbers from 0 to 1 whole ones below `count`."""
    return jnp.minimum(jnp.floor(draw * count), count - 1).astype(jnp.int32)
