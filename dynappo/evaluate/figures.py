"""Pictures of a policy's evaluation: errors over commands, and when which foot is on the ground.

They draw what `trials.run` returns; `command.py` writes them to files, a notebook shows them.
matplotlib is imported only here, and may be absent.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dynappo.config import files, shell
from dynappo.evaluate.foot_motion import intervals

WINDOW = 2.0  # s of a gait diagram
PALE = 0.3  # m/s, the least error that has the darkest colour
LARGE_YAW = 0.2  # rad/s, an error that is shown in red
NO_PICTURES = "no pictures: matplotlib is not installed; "


def tracking(title: str, numbers: dict[str, Any]):
    """Two maps of the errors over the commands of `trials.run`, as a matplotlib Figure."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    rows, grid = numbers["commands"], numbers["axes"]
    top = max([PALE, *(row["tracking_error"] for row in rows if not unmeasured(row))])
    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12, wspace=0.03)
    figure = Figure(figsize=(11, 6), layout=layout)
    panels = figure.subplots(1, 2, sharey=True, width_ratios=[len(grid["vy"]), len(grid["wz"])])
    image: Any = None
    for panel, (held, label, across, ahead, cells) in zip(panels, maps(numbers), strict=True):
        values = [
            [np.nan if unmeasured(c) else c["tracking_error"] for c in line] for line in cells
        ]
        image = panel.imshow(values, "YlGnBu", vmin=0, vmax=top, origin="lower", aspect="auto")
        for i, line in enumerate(cells):
            for j, cell in enumerate(line):
                _cell(panel, j, i, cell, top)
        panel.set_xticks(range(len(across)), [f"{value:g}" for value in across])
        panel.set_yticks(range(len(ahead)), [f"{value:g}" for value in ahead])
        panel.set_xticks(np.arange(len(across) - 1) + 0.5, minor=True)
        panel.set_yticks(np.arange(len(ahead) - 1) + 0.5, minor=True)
        panel.grid(which="minor", color="white", linewidth=2)
        panel.tick_params(which="both", length=0, labelsize=10)
        panel.spines[:].set_visible(False)
        panel.set_xlabel(label, fontsize=11, labelpad=8)
        panel.set_title(held, fontsize=11, color="0.35", pad=8)
    panels[0].set_ylabel("velocity ahead asked for (m/s)", fontsize=11, labelpad=8)
    bar = figure.colorbar(image, ax=panels, pad=0.02, aspect=28)
    bar.set_label("velocity error (m/s); small in the cells: yaw rate error (rad/s)", labelpad=10)
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=0)
    figure.suptitle(title, fontsize=14, fontweight="bold")
    return figure


def maps(numbers: dict[str, Any]) -> Iterator[tuple]:
    """`(title, label, across, ahead, cells)` of two maps: `cells[i][j]` is the row of `commands` at
    `ahead[i]` (m/s) and `across[j]` (`label` says what that is)."""
    grid, held = numbers["axes"], numbers["held"]
    sides = ("vy", 1, "wz", 2, "sideways velocity asked for (m/s)", "at a yaw rate of {:g} rad/s")
    turns = ("wz", 2, "vy", 1, "yaw rate asked for (rad/s)", "at a sideways velocity of {:g} m/s")
    # the axis across and its column of a command; the axis that is held and its column; texts
    for name, column, other, fixed, label, title in (sides, turns):
        found = {
            (row["command"][0], row["command"][column]): row
            for row in numbers["commands"]
            if row["command"][fixed] == held[other]
        }
        cells = [[found[x, c] for c in grid[name]] for x in grid["vx"]]
        yield title.format(held[other]), label, grid[name], grid["vx"], cells


def unmeasured(row: dict[str, Any]) -> bool:
    """Whether a command of `trials.run` has no errors: the robot fell, or the episode was too short."""
    return row["fall"] is not None or row["tracking_error"] is None


def _cell(panel, j: int, i: int, row: dict[str, Any], top: float) -> None:
    """The numbers of one command; a fall is hatched."""
    from matplotlib.patches import Rectangle

    middle = dict(ha="center", va="center")
    if unmeasured(row):
        style: dict[str, Any] = dict(facecolor="0.95", edgecolor="0.8", hatch="///", linewidth=0)
        panel.add_patch(Rectangle((j - 0.5, i - 0.5), 1, 1, **style))
        text = "too short" if row["fall"] is None else f"fell after\n{row['fall']:.1f} s"
        clear = dict(facecolor="0.95", edgecolor="none", pad=3)
        panel.text(j, i, text, fontsize=10, color="#b2182b", bbox=clear, **middle)
        return
    dark = row["tracking_error"] > 0.55 * top
    style = middle | {"color": "white" if dark else "0.12"}
    panel.text(j, i + 0.06, f"{row['tracking_error']:.2f}", fontsize=14, **style)
    yaw = row["yaw_error"]
    loud = {"color": "#b2182b", "fontweight": "bold"} if yaw > LARGE_YAW else {"alpha": 0.75}
    panel.text(j, i - 0.27, f"{yaw:.2f}", fontsize=8.5, **style | loud)


def gait(title: str, numbers: dict[str, Any], recordings, timestep: float):
    """Hildebrand's diagram of `trials.run` at each speed ahead: a bar where a foot is on the ground.

    `timestep` (s) is that of the physics. The last `WINDOW` seconds are shown, or what there is.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12, hspace=0.04)
    figure = Figure(figsize=(11, 1.2 + 2.4 * len(numbers["ahead"])), layout=layout)
    panels = np.ravel(figure.subplots(len(numbers["ahead"]), 1, sharex=True))
    for panel, row in zip(panels, numbers["ahead"], strict=True):
        shown = recordings[tuple(row["command"])]["contact"][-round(WINDOW / timestep) :]
        for j, foot in enumerate(row["feet"].values()):
            on, off = intervals(shown[:, j])
            bars = [(a * timestep, (b - a) * timestep) for a, b in zip(on, off, strict=True)]
            # left and right, front to back: the two diagonals of four feet, the two tripods of six
            color = "#d9822b" if (j + j // 2) % 2 else "#1f4e79"
            panel.broken_barh([(0, WINDOW)], (j - 0.36, 0.72), facecolor="0.955")
            panel.broken_barh(bars, (j - 0.36, 0.72), facecolor=color)
            duty = "" if foot["duty_factor"] is None else f"{foot['duty_factor']:.2f}"
            panel.text(1.012 * WINDOW, j, duty, va="center", fontsize=11, color=color)
        names = list(row["feet"])
        panel.text(1.012 * WINDOW, -0.8, "duty\nfactor", va="bottom", fontsize=9, color="0.4")
        panel.set_yticks(range(len(names)), names, fontsize=11)
        panel.set_ylim(len(names) - 0.5, -0.6)
        panel.set_xlim(0, WINDOW)
        panel.tick_params(length=0)
        panel.spines[:].set_visible(False)
        panel.set_title(_gait_title(row), loc="left", fontsize=11.5, color="0.2", pad=8)
    panels[-1].set_xlabel("time (s)", fontsize=11, labelpad=8)
    figure.suptitle(title, fontsize=14, fontweight="bold")
    return figure


def _gait_title(row: dict[str, Any]) -> str:
    """Commanded and measured: speed, strides, duty factor."""
    formats = (
        ("fall", "fell after {:.1f} s"),
        ("speed", "moves at {:.2f} m/s"),
        ("stride_frequency", "{:.2f} strides/s"),
        ("duty_factor", "duty factor {:.2f}"),
    )
    said = [text.format(row[name]) for name, text in formats if row[name] is not None]
    return "  \u00b7  ".join([f"asked for {row['command'][0]:g} m/s", *said])


def write(out: Path, name: str, numbers: dict[str, Any], recordings, timestep: float) -> str:
    """Write tracking.png and gait.png into `out`; returns "", or one line that says what is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return NO_PICTURES + shell.install("video")
    for file, figure in (
        ("tracking.png", tracking(f"{name}: how well it does what it is asked", numbers)),
        ("gait.png", gait(f"{name}: feet on the ground", numbers, recordings, timestep)),
    ):
        with files.replacing(out / file) as part:
            part.write_bytes(png(figure))
    return ""


def png(figure) -> bytes:
    """The picture of a matplotlib Figure."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=150)
    return content.getvalue()
