"""How the experiments' pictures look: one size, one palette, one way to say what a band is.

A README shows a picture 830 pixels wide, which is `WIDE` inches: nothing is drawn wider, so letters keep
their size. Colours are Okabe and Ito's, safe for the colour-blind. The paper's PPO is black and grey, tails
have hues; of our own methods `best` is blue and PPO alone vermilion in all pictures that have them. (The
paper's tail of four is vermilion, too; no picture has both.)
Lines differ by dash and marks by shape too, so that a picture can be read without colour.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dynappo.policy import walks
from dynappo.run import learning_curves
from experiments import paper

WIDE, DPI = 8.6, 150  # inches, pixels an inch
ORANGE, SKY, GREEN, BLUE = "#E69F00", "#56B4E9", "#009E73", "#0072B2"
VERMILION, PURPLE, BLACK, GREY = "#D55E00", "#CC79A7", "#222222", "#8c8c8c"
BEST, PPO = BLUE, VERMILION  # ours; several settings of PPO differ by dashes and marks
SHADES = (
    "#9ccbe8",
    "#56a3d4",
    "#0072B2",
    "#064b80",
    "#062744",
)  # of one hue, for a number that grows
COLOURS = {
    "ppo12": GREY,
    "ppo16": BLACK,
    "ppo24": "#5f5f5f",
    "dyna2": SKY,
    "dyna4_noschedule": ORANGE,
    "dyna4": VERMILION,
    "fast": GREEN,
    "best": BEST,
}
DASHES: dict[str, Any] = {
    "ppo12": (0, (1, 1)),
    "ppo24": (0, (5, 2)),
    "dyna2": (0, (3, 1.2)),
    "dyna4_noschedule": (0, (5, 1.2, 1, 1.2)),
    "fast": (0, (1, 1)),
}
MARKS = {
    "ppo12": "v",
    "ppo24": "^",
    "dyna2": "s",
    "dyna4_noschedule": "D",
    "dyna4": "P",
    "fast": "X",
}


def line(variant: str) -> dict[str, Any]:
    """How a variant's line is drawn."""
    return {"color": COLOURS[variant], "linestyle": DASHES.get(variant, "-")}


def mark(variant: str) -> dict[str, Any]:
    """How a variant's points are drawn."""
    return {"color": COLOURS[variant], "marker": MARKS.get(variant, "o")}


def covers(seeds) -> str:
    """What a band or bar is, by the numbers of seeds."""
    some = sorted({int(n) for n in seeds})
    counts = f"{some[0]} to {some[-1]}" if len(some) > 2 else " or ".join(map(str, some))
    return f"95 % t interval of the mean over {counts} seeds"


def figure(rows: int, columns: int, high: float, **more):
    """A Figure `WIDE` across and `high` inches high, and its axes `[rows, columns]`, plain."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    sizes: Any = {"font.size": 9.5, "axes.titlesize": 10.5, "legend.fontsize": 9.5}
    plt.rcParams.update(sizes | {"axes.axisbelow": True})
    page, axes = plt.subplots(
        rows, columns, figsize=(WIDE, high), layout="constrained", squeeze=False, **more
    )
    for axis in axes.flat:
        axis.grid(alpha=0.25, linewidth=0.7)
        axis.spines[["top", "right"]].set_visible(False)
    return page, axes


def missing(axis, what: str = "not run yet") -> None:
    """Say in the picture that there is nothing to draw."""
    how = dict(ha="center", va="center", color="0.5", fontsize=11)
    axis.text(0.5, 0.5, what, transform=axis.transAxes, **how)


def log(axis, subs=(1, 2, 5), which="y") -> None:
    """A logarithmic axis, y or x, with plain numbers."""
    axis.set(**{f"{which}scale": "log"})
    along = {"x": axis.xaxis, "y": axis.yaxis}[which]
    along.get_major_locator().set_params(subs=subs)
    along.set_major_formatter("{x:g}")
    axis.minorticks_off()


def falls(axis) -> None:
    """Per cent of episodes with a fall: linear to 1 %, where a walk begins, logarithmic from there on."""
    axis.set_yscale("symlog", linthresh=1, linscale=0.6)
    axis.set(ylim=(0, 100), yticks=(0, 1, 10, 100), yticklabels=("0", "1", "10", "100"))
    axis.minorticks_off()
    axis.axhline(100 * walks.MOST_FALLS, color="0.4", lw=1, ls=":")


def head(page, text: str, **more) -> None:
    """A line above the whole picture."""
    page.suptitle(text, x=0.01, ha="left", **{"fontsize": 10} | more)


def outer(axes, x: str, y: str = "") -> None:
    """What is below the last row of axes, and beside the first column."""
    for axis in axes[-1]:
        axis.set_xlabel(x)
    for axis in axes[:, 0] if y else ():
        axis.set_ylabel(y)


def variants(axes, names: tuple[str, ...], most: float) -> None:
    """Variants by name, a row each from above, on all `axes` [rows, columns] from 0 to `most`."""
    labels = [(paper.VARIANTS | paper.OURS)[name] for name in names]
    for axis in axes.flat:
        axis.set(xlim=(0, most), ylim=(len(names) - 0.5, -0.6))
    for axis in axes[:, 0]:
        axis.set_yticks(range(len(names)), labels)


def legend(page, axis, columns: int) -> None:
    """One legend below the whole picture, of the lines of `axis`; none without lines."""
    handles, labels = axis.get_legend_handles_labels()
    if handles:
        page.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)


def save(page, path: Path, dpi: int = DPI) -> None:
    """As PNG; the same numbers give the same file."""
    path = path.with_suffix(".png")
    path.parent.mkdir(parents=True, exist_ok=True)
    page.savefig(path, dpi=dpi)
    palette(path)
    print(path)


def palette(path: Path) -> None:
    """Write a PNG anew in 256 colours of its own: to the eye the same, and a third of the size."""
    from PIL import Image

    picture = Image.open(path).convert("RGB")
    few = picture.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=4, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


def band(axis, x, values, colour: str, label="", most=50, dash: Any = "-", mark="") -> None:
    """The mean over seeds of `values` [I, S] and its 95 % t interval, at `most` points of `x` [I]; `mark`s
    stand along the line, at even distances.

    Rows with an empty cell are left out: before the first episodes end, and where a CSV is thin.
    """
    whole = np.flatnonzero(np.isfinite(values).all(1))
    if not len(whole):
        return
    rows = whole[np.unique(np.linspace(0, len(whole) - 1, most).round().astype(int))]
    if values.shape[1] > 1:
        low, high = learning_curves.interval(values[rows].T)
        axis.fill_between(x[rows], low, high, color=colour, alpha=0.18, linewidth=0)
    mean = values[rows].mean(1)
    how = marked(mark) | {"color": colour, "linestyle": dash, "label": label}
    axis.plot(x[rows], mean, linewidth=1.6, **how)


def marked(mark: str) -> dict[str, Any]:
    """How a line's marks are drawn, with a white rim; none without a `mark`."""
    look = {"marker": mark, "markersize": 5.5, "markeredgecolor": "white", "markevery": 0.12}
    return look | {"markeredgewidth": 0.7} if mark else {}


def bar(axis, cells, name: str, y: float, style: dict[str, Any]) -> None:
    """A mean at `y` and its interval, which ends at 0: `NAME_mean`, `NAME_low` and `NAME_high` of `cells`."""
    if f"{name}_mean" in cells:
        ends = [max(cells[f"{name}_low"], 0), cells[f"{name}_high"]]
        axis.plot(ends, [y, y], color=style["color"], linewidth=1.8)
        axis.plot(cells[f"{name}_mean"], y, clip_on=False, **{"markersize": 6} | style)


def poses(model, rows, size, *, distance, height, azimuth, elevation):
    """RGB pictures of a robot's `rows` [T, nq], of `size` (height, width) in pixels.

    The camera looks at a point `height` m above the floor, below the base, from `distance` m and from
    `azimuth` degrees to the heading.
    """
    model.vis.global_.offheight, model.vis.global_.offwidth = size
    data, view = mujoco.MjData(model), mujoco.MjvCamera()
    view.distance, view.elevation = distance, elevation
    with mujoco.Renderer(model, *size) as renderer:
        for qpos in rows:
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            w, x, y, z = qpos[3:7]
            heading = np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
            view.azimuth = azimuth + heading
            view.lookat[:] = [*qpos[:2], height]
            renderer.update_scene(data, camera=view)
            yield renderer.render().copy()
