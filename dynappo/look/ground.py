"""A picture of the ground that a config trains on, from above: heights, and where each kind of tile is.

matplotlib is imported only here, and may be absent.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dynappo.config import shell
from dynappo.terrain import tiles as tiles_lib
from dynappo.terrain.height_map import HeightMap

SUN = 315.0, 35.0  # degrees: from where, how high
STEEPER = 3.0  # times, for the shadows alone


def write(tiles: Any, ground: HeightMap, out: Path) -> str:
    """Write the picture `out` of the group `task.tiles` and its map; "", or a line that says why not."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return f"no picture: matplotlib is not installed; {shell.install('video')}"
    figure = draw(tiles, ground)
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=120)
    return ""


def words(tiles: Any, ground: HeightMap) -> str:
    """How large the ground is; of a map of one's own, how high and how steep, too."""
    size = f"{tiles.rows} x {tiles.columns} tiles of {tiles.size:g} m"
    if not tiles.map:
        return size
    heights = ground.heights
    x, y = (ground.cell * (count - 1) for count in heights.shape)
    steepest = max(float(np.abs(np.diff(heights, axis=axis)).max()) for axis in (0, 1))
    return (
        f"{x:g} x {y:g} m, {heights.min():.3g} to {heights.max():.3g} m high, two points at most "
        f"{steepest:.3g} m apart in height, {size}"
    )


def draw(tiles: Any, ground: HeightMap):
    """The picture as a matplotlib Figure: the columns side by side, the hardest row on top."""
    from matplotlib.colors import LightSource
    from matplotlib.figure import Figure

    heights = np.asarray(ground.heights, float)
    (x, y), (nx, ny) = ground.corner, heights.shape
    figure = Figure(figsize=(12, 1.2 + 10 * nx / ny), layout="constrained")
    panel, top = figure.subplots(), max(float(np.abs(heights).max()), 1e-3)
    shown: dict[str, Any] = dict(cmap=_colours(), vmin=-top, vmax=top)
    cells: dict[str, Any] = dict(dx=ground.cell, dy=ground.cell, vert_exag=STEEPER)
    shaded = LightSource(*SUN).shade(heights, blend_mode="soft", **shown, **cells)
    extent = y, y + ground.cell * (ny - 1), x, x + ground.cell * (nx - 1)
    image = panel.imshow(shaded, origin="lower", extent=extent)
    image.set_cmap(_colours())
    image.set_clim(-top, top)
    if tiles.map:  # no rows, no kinds
        panel.set(xticks=[], yticks=[])
    else:
        _name_tiles(panel, tiles)
    panel.tick_params(length=0)
    panel.spines[:].set_visible(False)
    bar = figure.colorbar(image, ax=panel, pad=0.01, aspect=30, shrink=0.9)
    bar.set_label("height (m)")
    bar.outline.set_visible(False)
    return figure


def _name_tiles(panel, tiles: Any) -> None:
    middles, kinds = tiles_lib.centres(tiles), tiles_lib.kinds(tiles)
    panel.set_yticks(middles[:, 0, 0], [f"{hard:.2f}" for hard in tiles_lib.difficulty(tiles)])
    groups = [kind for kind in range(len(tiles_lib.KINDS)) if (kinds == kind).any()]
    places = [middles[0, kinds == kind, 1].mean() for kind in groups]
    panel.set_xticks(places, [tiles_lib.KINDS[kind].replace("_", " ") for kind in groups])
    panel.set_ylabel("difficulty")


def _colours():
    import matplotlib

    return matplotlib.colormaps["BrBG_r"]
