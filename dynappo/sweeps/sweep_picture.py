"""A sweep as one picture: how every combination learned, and where it ended."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from dynappo.config import shell
from dynappo.run import learning_curves, log
from dynappo.sweeps import grid

MOST_NAMED = 24  # combinations with a label
NO_PICTURE = "no sweep.png: matplotlib is not installed; "


def draw(workdir: Path, table: list[dict[str, Any]], swept: list[str]) -> str:
    """Write `figure` as workdir/sweep.png; returns "", or one line that says what is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return NO_PICTURE + shell.install("video")
    content = io.BytesIO()
    figure(workdir, table, swept).savefig(content, format="png", dpi=150)
    (workdir / "sweep.png").write_bytes(content.getvalue())
    return ""


def figure(workdir: Path, table: list[dict[str, Any]], swept: list[str]) -> Any:
    """The rows of `table.rows` as a matplotlib Figure, the best on top and darkest where they can
    be ranked.

    Left the return while training over simulator steps, the mean of the seeds; right the return at the end,
    each seed a dot, their mean and its 95 % interval a bar. Combinations without an end are left out.
    """
    import matplotlib
    from matplotlib.figure import Figure

    shown = [one for one in table if not one["note"] and one["return_mean"] is not None]
    height = 2.2 + 0.32 * min(max(len(shown), 8), 3 * MOST_NAMED)
    page = Figure(figsize=(13, height), layout="constrained")
    left, right = page.subplots(1, 2, width_ratios=(1.6, 1))
    shades = matplotlib.colormaps["viridis"](np.linspace(0, 0.88, max(len(shown), 1)))
    most = max((one["sim_steps"] for one in shown), default=0)
    scale, unit = (1e6, "million simulator steps") if most >= 1e5 else (1, "simulator steps")
    for rank, (one, color) in enumerate(zip(shown, shades, strict=True)):
        steps, returns = _curve(workdir / one["folder"] / "metrics.csv", one["seeds"])
        best: dict[str, Any] = dict(color=color, zorder=len(shown) - rank)
        left.plot(steps / scale, returns, lw=2 if rank == 0 else 1.3, **best)
        ends = np.array(one["returns"].split(), float)
        right.scatter(ends, np.full(len(ends), rank), s=34, edgecolors="white", **best)
        right.plot(one["return_mean"], rank, "|", ms=15, mew=2.4, **best)
        if one["return_low"] is not None:
            right.plot([one["return_low"], one["return_high"]], [rank, rank], lw=1.4, **best)
    for axes, title in (
        (left, "episode return while training, mean of the seeds"),
        (right, f"{_ends(shown)} at the end"),
    ):
        axes.set_title(title, loc="left", fontsize=10.5, color="0.2", pad=8)
        axes.grid(color="0.92", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.tick_params(length=0, labelsize=9, labelcolor=learning_curves.GREY)
        axes.spines[["top", "right", "left"]].set_visible(False)
    left.set_xlabel(f"{unit} of each seed", fontsize=9.5, color=learning_curves.GREY)
    marks = "dots: seeds    tick: their mean    line: its 95 % interval"
    right.set_xlabel(marks, fontsize=9.5, color=learning_curves.GREY)
    named = shown if len(shown) <= 3 * MOST_NAMED else shown[:MOST_NAMED]
    labels = [", ".join(str(one[field]) for field in swept) for one in named]
    right.set_yticks(range(len(named)), labels, fontsize=9.5, color="0.2")
    right.set_ylim(max(len(shown), 1) - 0.4, -0.6)
    by = table[0]["ranked_by"]
    ranked = {grid.BY_RETURN: "", "": " (not ranked)"}.get(by, f" (ranked by {by})")
    page.suptitle(", ".join(swept) + ranked, x=0.01, ha="left", fontsize=15, fontweight="bold")
    return page


def _curve(path: Path, seeds: int) -> tuple[np.ndarray, np.ndarray]:
    """Simulator steps and the mean return of the seeds in a metrics.csv; empty where its rows are lost or
    damaged."""
    try:
        metrics = log.read_csv(path, seeds)
        steps, returns = metrics["sim_steps"], metrics["episode_return"]
        return steps, np.reshape(returns, (len(steps), -1)).mean(1)
    except (KeyError, ValueError):
        return np.zeros(0), np.zeros(0)


def _ends(shown: list[dict[str, Any]]) -> str:
    evaluated = all(one["return_of"] == "evaluation" for one in shown)
    return "evaluated return" if evaluated else "return"
