"""The curves of a run, read from its metrics.csv while it trains."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import viser

GREEN, BLUE, GREY, ORANGE = "#1a9e4d", "#216bed", "#8b95a5", "#e0762f"
MOST = 400  # points of a curve
NEEDED = {"iteration", "sim_steps", "seconds"}  # columns of `line`
# title, and the lines in it: (column, name, colour)
PLOTS = (
    (
        "return of an episode",
        [("episode_return", "in training", BLUE), ("eval_return", "evaluated", ORANGE)],
    ),
    (
        "tracking error, m/s",
        [("velocity_error", "in training", BLUE), ("eval_velocity_error", "evaluated", ORANGE)],
    ),
    (
        "steps of an iteration",
        [("n_real", "real", BLUE), ("n_synthetic", "synthetic", GREEN)],
    ),
)


def read(path: Path) -> dict[str, np.ndarray]:
    """The columns of metrics.csv by name, `[I]`: means over seeds; {} while there is none, or a damaged one.

    NaN where a cell is empty. A line that is being written is left out.
    """
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
        rows = list(csv.reader(text[: text.rfind("\n") + 1].splitlines()))
    except (OSError, csv.Error):
        return {}
    names = rows[0] if rows else []
    table = [[_number(c) for c in row] for row in rows[1:] if len(row) == len(names)]
    if not table or not NEEDED <= set(names):
        return {}
    columns = dict(zip(names, np.array(table).T, strict=True))
    counted = np.isfinite(columns["iteration"])
    columns = {name: column[counted] for name, column in columns.items()}
    iterations, at = np.unique(columns["iteration"], return_inverse=True)
    means = {name: _means(column, at) for name, column in columns.items()}
    return means | {"iteration": iterations} if len(iterations) else {}


def _means(column: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Of the finite numbers of each group; `at` says in which each is. NaN where there are none."""
    good = np.isfinite(column)
    count, total = np.bincount(at, good), np.bincount(at, np.where(good, column, 0.0))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def thinned(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """At most about `MOST` rows: the mean of each few neighbours."""
    count = len(columns["iteration"])
    at = np.arange(count) * min(MOST, count) // count
    return {name: _means(column, at) for name, column in columns.items()}


def draw(server: viser.ViserServer, old: list, columns: dict[str, np.ndarray]) -> list:
    """The plots of the columns of `read`, in place of the `old` ones; in the panel that is open.

    A line without a number is left out: a plot would have no scale. Gaps are bridged.
    """
    few = thinned(columns)
    x, lines = few["iteration"], []
    for _, some in PLOTS:
        lines.append([line for line in some if np.isfinite(few.get(line[0], np.nan)).any()])
    tables = [(x, *(_bridged(x, few[name]) for name, _, _ in some)) for some in lines]
    if [len(h.series) for h in old] == [len(table) for table in tables]:
        for handle, table in zip(old, tables, strict=True):
            handle.data = table
        return old
    for handle in old:
        handle.remove()
    return [
        server.gui.add_uplot(
            table,
            (
                {"label": "iteration"},
                *({"label": name, "stroke": colour, "width": 2} for _, name, colour in some),
            ),
            title=title,
            height=170,
            scales={"x": {"time": False}},
        )
        for (title, _), some, table in zip(PLOTS, lines, tables, strict=True)
        if some
    ]


def _bridged(x, values):
    good = np.isfinite(values)
    return np.interp(x, x[good], values[good])


def line(columns: dict[str, np.ndarray]) -> str:
    """A line on the run's progress."""
    last = {name: column[-1] for name, column in columns.items()}
    return (
        f"iteration {last['iteration']:.0f}, {last['sim_steps'] / 1e6:.2f} M simulator steps, "
        f"{last['seconds']:.0f} s"
    )
