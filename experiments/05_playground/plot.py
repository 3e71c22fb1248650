"""Returns over simulator steps and over seconds of training, two panels a task: curves.png; falls: falls.png.

    python experiments/05_playground/plot.py

From results/*.csv; thin lines are seeds, thick ones the mean of `table.py`. Dotted: its reference, of falls
1 %. Steps and seconds are logarithmic. Marks: returns that others have published, read from FlashSAC's
curves. A fall is an episode that the task ends before its time; Getup ends none.
"""

import importlib
from pathlib import Path

import numpy as np

from experiments import pictures

table = importlib.import_module("experiments.05_playground.table")
LOOKS = {  # variant -> colour, dashes of its mean
    "brax": (pictures.BLACK, "-"),
    "brax1": (pictures.GREY, (0, (4, 1))),
    "brax10": (pictures.PURPLE, (0, (5, 1.2, 1, 1.2))),
    "ppo": (pictures.PPO, (0, (2, 0.8))),
    "best": (pictures.BEST, "-"),
}
MARKS = {"o": "brax's PPO", "D": "FlashSAC"}
PUBLISHED = {  # at so many M steps: brax's PPO at 202, FlashSAC at 50
    "G1JoystickFlatTerrain": (23.4, 39.9),
    "T1JoystickFlatTerrain": (34.4, 38.5),
}


def main():
    found = table.runs()
    names = table.tasks(found)
    if not names:
        print(f"nothing was run: no CSV in {table.RESULTS}")
        return
    fallen(found, names)
    rows = -(-len(names) // 2)
    page, axes = pictures.figure(rows, 4, 0.5 + 2.0 * rows)
    pairs = axes.reshape(2 * rows, 2)  # two tasks a row
    for pair, task in zip(pairs, names, strict=False):
        for unit, axis in enumerate(pair):
            panel(axis, found, task, unit)
        pair[0].set_title(task.removesuffix("Terrain"), loc="left")
    for axis in axes.flat:
        axis.set_visible(bool(axis.lines))
    for axis in axes[:, 0]:
        axis.set_ylabel("return")
    for axis, unit in zip(axes[-1], ("million steps", "seconds") * 2, strict=True):
        axis.set_xlabel(unit)
    name_all(axes[0, 0], found)
    for mark, name in MARKS.items():
        axes[0, 0].plot([], [], mark, color=pictures.BLACK, mfc="none", label=f"published: {name}")
    pictures.legend(page, axes[0, 0], 3)
    pictures.save(page, Path(__file__).with_name("curves"))


def name_all(axis, found) -> None:
    """For the legend: no task has all of them."""
    for kind, (colour, dash) in LOOKS.items():
        if any(of == kind for _, of in found):
            axis.plot([], [], color=colour, ls=dash, lw=1.8, label=table.KINDS[kind].strip("`"))


def fallen(found, names) -> None:
    """Per cent of episodes with a fall over million steps, a panel a task, as `panel` draws returns."""
    rows = -(-len(names) // 4)
    page, axes = pictures.figure(rows, 4, 0.7 + 1.9 * rows, sharey=True)
    for axis, task in zip(axes.flat, names, strict=False):
        for kind, (colour, dash) in LOOKS.items():
            some = found.get((task, kind), [])
            for each in some:
                at = [table.when(row)[0] for row in each]
                falls = [100 * float(row["fall_rate"]) for row in each]
                axis.plot(at, falls, color=colour, lw=0.7, alpha=0.5)
            if some:
                mean = table.mean(some, kind != "best")
                axis.plot(mean[:, 0], 100 * mean[:, 3], color=colour, ls=dash, lw=1.8)
        name = task.removesuffix("Terrain").replace("Humanoid", "")
        axis.set_title(name, loc="left", fontsize=9.5)
        pictures.log(axis, subs=(1, 3), which="x")
        pictures.falls(axis)
    for axis in axes.flat:
        axis.set_visible(bool(axis.lines))
    pictures.outer(axes, "million steps", "falls, %")
    name_all(axes[0, 0], found)
    pictures.legend(page, axes[0, 0], 3)
    pictures.save(page, Path(__file__).with_name("falls"))


def panel(axis, found, task, unit):
    for kind, (colour, dash) in LOOKS.items():
        some = found.get((task, kind), [])
        curves = [
            (np.array([table.when(row)[unit] for row in rows]), returns(rows)) for rows in some
        ]
        curves = [(at, back) for at, back in curves if np.isfinite(at).any()]
        for at, back in curves:
            axis.plot(at, back, color=colour, lw=0.7, alpha=0.5)
        if curves:
            mean = table.mean(some, kind != "best")
            axis.plot(mean[:, unit], mean[:, 2], color=colour, ls=dash, lw=1.8)
    if unit == 0 and task in PUBLISHED:
        for at, back, mark in zip((202, 50), PUBLISHED[task], MARKS, strict=True):
            axis.plot([at], [back], mark, color=pictures.BLACK, mfc="none")
    level = table.reference(found, task)
    if np.isfinite(level):
        axis.axhline(level, color="0.4", lw=1, ls=":")
    pictures.log(axis, subs=(1, 3), which="x")


def returns(rows):
    return np.array([float(row["return"]) for row in rows])


if __name__ == "__main__":
    main()
