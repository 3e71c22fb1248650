"""How a run learned: curves over iterations of one seed or several, and the interval of a mean.

For notebooks and experiments too:

    metrics = log.read_csv(Path("runs/go1/metrics.csv"), seeds=5)
    learning_curves.draw(metrics, Path("curves.png"), "Go1, dyna4")
    low, high = learning_curves.interval(metrics["episode_return"][-10:].mean(0))
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dynappo.config import shell
from dynappo.run import log

LEVEL = 0.95
BLUE, GREY = "#1f4e79", "0.45"
MOST_NAMED = 10  # seeds with a label of their own
WIDEST = 9  # characters of a number
NUMBERS = "numbers: last {} iterations"
LINES = "thin: each seed    thick: their mean    band: its 95 % t interval    "
NO_PICTURE = "no curves.png: matplotlib is not installed; "


class Panel(NamedTuple):
    """One picture of the page."""

    metric: str
    title: str  # with its unit
    number: str  # format of what it comes to
    axis: str = "from 0"


PANELS = (
    Panel("episode_return", "episode return", "{:.1f}", "free"),
    Panel("episode_length", "episode length (control steps)", "{:.0f}"),
    Panel("velocity_error", "velocity error (m/s)", "{:.2f}"),
    Panel("policy_std", "policy std (units of action)", "{:.2f}"),
    Panel("model_loss", "model loss (Huber)", "{:.2g}", "log"),
)


def half_width(values) -> np.ndarray:
    """Half of Student's 95 % interval of the mean over the first axis (seeds): t(0.975, S - 1) sd / sqrt(S).

    `values` is `[S]` or `[S, ...]`. NaN with one seed, which says nothing about the next, and where a
    seed is NaN. Of normal numbers it holds the true mean in 95 % of cases with any number of seeds.
    """
    values = np.asarray(values, float)
    count = len(values)
    if count < 2:
        return np.full(values.shape[1:], np.nan)
    from scipy import special  # importing it takes as long as all else of a command

    quantile = special.stdtrit(count - 1, 0.5 + LEVEL / 2)
    return quantile * values.std(0, ddof=1) / count**0.5


def interval(values) -> tuple[np.ndarray, np.ndarray]:
    """`(low, high)`: Student's 95 % interval of the mean over the first axis (seeds), as `half_width`."""
    values = np.asarray(values, float)
    half = half_width(values)
    mean = values.mean(0) if len(values) else half
    return mean - half, mean + half


def draw(metrics: dict[str, np.ndarray], path: Path, title: str = "") -> str:
    """Write `figure(metrics, title)` as a PNG; returns "", or one line that says what is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return NO_PICTURE + shell.install("video")
    content = io.BytesIO()
    figure(metrics, title).savefig(content, format="png", dpi=150)
    path.write_bytes(content.getvalue())
    return ""


def figure(metrics: dict[str, np.ndarray], title: str = "") -> Any:
    """The return, and below it what explains it, as a matplotlib Figure; metrics `[I]` or `[I, S]`.

    Of several seeds: the mean, its 95 % t interval as a band, and each seed as a thin line. The mean
    begins where every seed has a number: after an episode of each has ended.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    iteration = np.asarray(metrics["iteration"])
    shown = [panel for panel in PANELS if panel.metric in metrics]
    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1, hspace=0.05, wspace=0.02)
    page = Figure(figsize=(12, 7.5), layout=layout)
    grid = page.add_gridspec(2, max(1, len(shown) - 1), height_ratios=(1.5, 1))
    for i, panel in enumerate(shown):
        axes = page.add_subplot(grid[0, :] if i == 0 else grid[1, i - 1])
        values = np.asarray(metrics[panel.metric], float).reshape(len(iteration), -1)
        _style(axes, panel, iteration, large=i == 0)
        _lines(axes, iteration, values, thick=2.4 if i == 0 else 1.8)
        if panel.axis == "from 0":
            axes.set_ylim(bottom=0)
        _labels(axes, panel, values, named=i == 0)
    page.suptitle(title, x=0.015, ha="left", fontsize=16, fontweight="bold")
    return page


def _style(axes, panel: Panel, iteration, large: bool) -> None:
    axes.set_title(panel.title, loc="left", fontsize=13 if large else 10.5, color="0.2", pad=8)
    axes.set_xlabel("iteration", fontsize=10, color=GREY)
    axes.set_xlim(min(iteration[0], 1) - 1, iteration[-1])
    if panel.axis == "log":
        axes.set_yscale("log")
        axes.yaxis.get_major_locator().set_params(subs=(1, 2, 5))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
    axes.grid(color="0.92", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(length=0, labelsize=10 if large else 9, labelcolor=GREY)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.spines["bottom"].set_color("0.8")


def _lines(axes, iteration, values, thick: float) -> None:
    """The seeds, the band and the mean of `values` `[I, S]`; of one seed its line alone."""
    if values.shape[1] > 1:
        low, high = interval(values.T)
        axes.fill_between(iteration, low, high, color=BLUE, alpha=0.16, linewidth=0, label="band")
        for s, line in enumerate(values.T):
            axes.plot(iteration, line, color=BLUE, alpha=0.4, linewidth=0.8, label=f"seed {s}")
    axes.plot(iteration, values.mean(1), color=BLUE, linewidth=thick, label="mean")


def _labels(axes, panel: Panel, values, named: bool) -> None:
    """What is at the end of the lines: the mean of the last rows, and, where `named`, of each seed."""
    ends = log.at_the_end(values)
    texts = {_written(panel, ends.mean()): ends.mean()}
    if named:
        last = NUMBERS.format(min(len(values), log.RETURN_ROWS))
        said = LINES * (ends.size > 1) + last
        axes.set_title(said, loc="right", fontsize=9.5, color=GREY, pad=8)
    if named and ends.size > 1:
        texts = {f"mean {text}": end for text, end in texts.items()}
        for s, end in enumerate(ends[: MOST_NAMED if ends.size <= MOST_NAMED else 0]):
            texts[f"seed {s}   {_written(panel, end)}"] = end
    texts = {text: end for text, end in texts.items() if np.isfinite(end)}
    if not texts:
        return
    axes.autoscale_view()
    scaled = axes.transScale + axes.transLimits  # data to shares of the axes
    # inside, also of a number that is not: 0 is infinitely far down a log axis, and no room is left for that
    heights = np.clip([scaled.transform((1, end))[1] for end in texts.values()], 0, 1)
    strong: dict[str, Any] = dict(fontsize=11.5, fontweight="bold", color=BLUE)
    weak: dict[str, Any] = dict(fontsize=9.5, color=GREY)
    for i, (text, height) in enumerate(zip(texts, _apart(heights, 0.06), strict=True)):
        at: dict[str, Any] = dict(xy=(1, height), xycoords="axes fraction", va="center")
        axes.annotate(
            text, xytext=(8, 0), textcoords="offset points", **at, **(weak if i else strong)
        )


def _written(panel: Panel, number: float) -> str:
    """A number as the panel writes it, or shorter if a wide one would leave the panel no room."""
    text = panel.number.format(number)
    return text if len(text) <= WIDEST else f"{number:.2g}"


def _apart(heights, gap: float) -> np.ndarray:
    """`heights`, from the highest down each at least `gap` below the one before; none below 0."""
    moved, above = np.array(heights, float), np.inf
    for i in np.argsort(-moved, kind="stable"):
        above = moved[i] = min(moved[i], above - gap)
    return moved + max(0.0, -moved.min())
