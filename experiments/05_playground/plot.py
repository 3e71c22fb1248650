"""Returns over simulator steps, and over seconds of training: curves.png, a row of panels a task.

    python experiments/05_playground/plot.py

From results/*.csv; thin lines are seeds, thick ones the mean of `table.py`. Dotted: its reference. Steps and
seconds are logarithmic.
"""

import importlib
from pathlib import Path

import numpy as np

from experiments import pictures

table = importlib.import_module("experiments.05_playground.table")
LOOKS = {"brax": pictures.BLACK, "ppo": pictures.ORANGE, "best": pictures.BLUE}


def main():
    found = table.runs()
    names = table.tasks(found)
    if not names:
        print(f"nothing was run: no CSV in {table.RESULTS}")
        return
    page, axes = pictures.figure(len(names), 2, 0.5 + 2.2 * len(names))
    for row, task in zip(axes, names, strict=True):
        for unit, axis in enumerate(row):
            panel(axis, found, task, unit)
        row[0].set_ylabel("return")
        row[0].set_title(task, loc="left")
    axes[-1, 0].set_xlabel("million simulator steps")
    axes[-1, 1].set_xlabel("seconds of training, a card alone")
    of_most = max(axes[:, 0], key=lambda axis: len(axis.get_legend_handles_labels()[0]))
    pictures.legend(page, of_most, len(LOOKS))
    pictures.save(page, Path(__file__).with_name("curves"))


def panel(axis, found, task, unit):
    for kind, colour in LOOKS.items():
        some = found.get((task, kind), [])
        curves = [
            (np.array([table.when(row)[unit] for row in rows]), returns(rows)) for rows in some
        ]
        for at, back in curves:
            axis.plot(at, back, color=colour, lw=0.7, alpha=0.5)
        if curves:
            mean = table.mean(some)
            axis.plot(
                mean[:, unit], mean[:, 2], color=colour, lw=1.8, label=table.KINDS[kind].strip("`")
            )
    level = table.reference(found, task)
    if np.isfinite(level):
        axis.axhline(level, color="0.4", lw=1, ls=":")
    pictures.log(axis, which="x")


def returns(rows):
    return np.array([float(row["return"]) for row in rows])


if __name__ == "__main__":
    main()
