"""Errors and falls of a G1 over simulator steps, and over seconds on a card alone: curves.png.

    python experiments/25_humanoid/plot.py

From results/tuning.csv.xz (batch `fresh`: ten seeds each, 95 % t intervals) and results/alone.csv (a seed a
line). Steps and seconds are logarithmic.
"""

import importlib
from itertools import groupby
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from experiments import pictures

table = importlib.import_module("experiments.25_humanoid.table")

PANELS = (  # what `table.evaluations` gives, its name, the level
    ("tracking error, m/s", walks.MOST_ERRORS[0]),
    ("yaw rate error, rad/s", walks.MOST_ERRORS[1]),
    ("% of episodes with a fall", 100 * walks.MOST_FALLS),
)
LOOKS = {
    "best": ("best", pictures.BLUE, "-"),
    "ppo": ("PPO, 256 robots", pictures.ORANGE, "-"),
}
ALONE = {  # what runs -> colour, dashes
    "best": (pictures.BLUE, "-"),
    "PPO, 256": (pictures.ORANGE, "-"),
    "PPO, 512": (pictures.VERMILION, "-"),
    "PPO, 1024": (pictures.VERMILION, (0, (5, 2))),
    "PPO, 1024 x 12": (pictures.PURPLE, "-"),
    "PPO, 2048 x 12": (pictures.GREY, (0, (5, 2))),
    "PPO, 4096": (pictures.GREEN, "-"),
}


def main():
    fig, axes = pictures.figure(2, 3, 5.6)
    fresh = [row for row in table.read("tuning.csv.xz") if row["batch"] == "fresh"]
    for name, some in groupby(fresh, lambda row: row["name"].split("-")[0]):
        steps, error, yaw, falls = table.evaluations([*some])
        for axis, values in zip(axes[0], (error, yaw, 100 * falls), strict=True):
            label, colour, _ = LOOKS[name]
            pictures.band(axis, steps[:, 0] / 1e6, values, colour, label, most=len(steps))
    for engine, name, rows in table.runs_alone():
        slow = (name, rows[0]["seed"]) == ("PPO, 256", "900")  # 32 ms an iteration, others 17
        if engine != "kernel" or name not in ALONE or slow:
            continue
        colour, dash = ALONE[name]
        seconds = [float(row["seconds"]) for row in rows]
        columns = ("tracking_error", 1), ("yaw_error", 1), ("fall_rate", 100)
        for axis, (column, scale) in zip(axes[1], columns, strict=True):
            values = [scale * float(row[column]) for row in rows]
            axis.plot(seconds, values, color=colour, ls=dash, lw=1.2, label=name)
    for axis, (title, level) in zip(np.ravel(axes), PANELS * 2, strict=True):
        axis.axhline(level, color="0.4", lw=1, ls=":")
        axis.set_title(title, loc="left")
        axis.set(xscale="log", ylim=(0, None))
    for row, ticks, words in zip(
        axes,
        ((0.1, 0.3, 1, 3), (0.3, 1, 3, 10)),
        ("million simulator steps", "seconds of training, a card alone"),
        strict=True,
    ):
        for axis in row:
            axis.set_xlabel(words)
            axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            axis.set_xticks([], minor=True)
    for axis in axes[:, 2]:
        axis.set_ylim(0, 40)
    for row in axes:
        handles = dict(zip(*row[0].get_legend_handles_labels()[::-1], strict=True))
        row[2].legend(handles.values(), handles, fontsize=7.5, frameon=False)
    pictures.head(
        fig,
        "Above: ten fresh seeds, 95 % t intervals. Below: one run a line. Dotted: the level",
        fontsize=9.5,
    )
    pictures.save(fig, Path(__file__).with_name("curves"))


if __name__ == "__main__":
    main()
