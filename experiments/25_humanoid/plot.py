"""Errors and falls of a G1 over simulator steps, and over seconds on a card alone: curves.png.

    python experiments/25_humanoid/plot.py

From results/tuning.csv.xz (batch `fresh`: ten seeds each) and results/alone.csv. Lines are means, bands their
95 % t interval; of a setting that ran alone with one or two seeds, each seed is a thin line. Steps and
seconds are logarithmic.
"""

import importlib
from itertools import groupby
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from experiments import pictures

table = importlib.import_module("experiments.25_humanoid.table")

PANELS = (  # what `table.evaluations` gives: its name, the level, the most that is drawn
    ("tracking error, m/s", walks.MOST_ERRORS[0], 1.6),
    ("yaw rate error, rad/s", walks.MOST_ERRORS[1], 1.05),
    ("episodes with a fall, %", np.nan, 100),  # `pictures.falls` draws its level
)
COLUMNS = ("tracking_error", 1), ("yaw_error", 1), ("fall_rate", 100)
LOOKS = {  # what runs -> label, colour, dashes, mark
    "best": ("best", pictures.BEST, "-", ""),
    "PPO, 256": ("PPO, 256 robots", pictures.PPO, "-", ""),
    "PPO, 512": ("PPO, 512 robots", pictures.PPO, (0, (5, 1.2, 1, 1.2)), "D"),
    "PPO, 1024": ("PPO, 1024 robots", pictures.PPO, (0, (5, 1.5)), ""),
    "PPO, 4096": ("PPO, 4096 robots", pictures.PPO, (0, (5, 1.5)), "s"),
    "PPO, 1024 x 12": ("PPO, 1024 robots, 12 rows", pictures.PPO, (0, (1, 0.8)), ""),
    "PPO, 2048 x 12": ("PPO, 2048 robots, 12 rows", pictures.PPO, (0, (1, 0.8)), "^"),
}
FRESH = {"best": "best", "ppo": "PPO, 256"}  # the same in the batch `fresh`
MANY = 3  # seeds of a setting that have a mean


def main():
    fig, axes = pictures.figure(2, 3, 6.6)
    over_steps(axes[0])
    counts = over_seconds(axes[1])
    for row, xlim, ticks, words in zip(
        axes,
        ((0.1, 6), (0.3, 14)),
        ((0.1, 0.3, 1, 3), (0.3, 1, 3, 10)),
        ("million simulator steps", "seconds of training, a card alone"),
        strict=True,
    ):
        for axis, (title, level, most) in zip(row, PANELS, strict=True):
            axis.set_title(title, loc="left")
            axis.set(xscale="log", xlim=xlim, xlabel=words, ylim=(0, most))
            axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            axis.set_xticks([], minor=True)
            axis.axhline(level, color="0.4", lw=1, ls=":")
        pictures.falls(row[-1])
    many = " or ".join(map(str, sorted({count for count in counts if count >= MANY})))
    text = f"Band: {pictures.covers([10])}, below {many}; thin: one seed. Dotted: the level"
    pictures.head(fig, text, fontsize=9.5)
    for label, colour, dash, mark in LOOKS.values():
        look = {"color": colour, "ls": dash, "lw": 1.6} | pictures.marked(mark)
        axes[0, 0].plot([], [], label=label, **look)
    pictures.legend(fig, axes[0, 0], 3)
    pictures.save(fig, Path(__file__).with_name("curves"))


def over_steps(axes) -> None:
    """The fresh seeds."""
    fresh = [row for row in table.read("tuning.csv.xz") if row["batch"] == "fresh"]
    for name, some in groupby(fresh, lambda row: row["name"].split("-")[0]):
        _, colour, dash, _ = LOOKS[FRESH[name]]
        steps, error, yaw, falls = table.evaluations([*some])
        for axis, values in zip(axes, (error, yaw, 100 * falls), strict=True):
            pictures.band(axis, steps[:, 0] / 1e6, values, colour, most=len(steps), dash=dash)


def over_seconds(axes) -> list[int]:
    """The runs that were alone: of each setting, how many seeds."""
    found = alone()
    for name, seeds in found.items():
        _, colour, dash, mark = LOOKS[name]
        for axis, (column, scale) in zip(axes, COLUMNS, strict=True):
            runs = [
                np.array([[float(row["seconds"]), scale * float(row[column])] for row in rows]).T
                for rows in seeds
            ]
            if len(runs) >= MANY:
                first, last = (f(run[0][i] for run in runs) for f, i in ((max, 0), (min, -1)))
                grid = np.geomspace(first, last, 60)
                values = np.array([np.interp(np.log(grid), np.log(x), y) for x, y in runs]).T
                pictures.band(axis, grid, values, colour, most=60, dash=dash, mark=mark)
                continue
            for x, y in runs:
                axis.plot(x, y, color=colour, ls=dash, lw=0.9, **pictures.marked(mark))
    return [*map(len, found.values())]


def alone() -> dict[str, list[list[dict]]]:
    """Of each setting of `LOOKS` with our kernel its seeds, as in the table of seconds.md: PPO with 256
    robots has 4 minibatches, with which it was chosen."""
    found: dict[str, list] = {name: [] for name in LOOKS}
    for engine, name, rows in table.runs_alone():
        other = name == "PPO, 256" and "ppo.minibatches=8" in rows[0]["job"]
        if engine == "kernel" and name in LOOKS and not other:
            found[name].append(rows)
    return found


if __name__ == "__main__":
    main()
