"""Tiles crossed, and falls, over simulator steps, `best` beside PPO: crossed.png; a tail's errors: scan.png.

    python experiments/28_rough/plot.py

From results/fresh.csv.xz and results/tuning.csv.xz. Lines are means over seeds, bands their 95 % t interval;
runs of two seeds have no band. Steps are logarithmic. scan.png: results/scan.csv, of `scan.py`.
"""

import csv
import importlib
from itertools import groupby
from pathlib import Path

import numpy as np

from experiments import pictures

table = importlib.import_module("experiments.28_rough.table")

LOOKS = {  # end of a run's name -> label, colour, dashes, mark
    "best": ("best (ten seeds)", pictures.BEST, "-", ""),
    "ppo-4096": ("PPO, 4096 robots (three)", pictures.PPO, "-", ""),
    "ppo-gamma": ("PPO, gamma 0.99 (two)", pictures.PPO, (0, (5, 1.2, 1, 1.2)), "D"),
    "ppo-kl1": ("PPO, KL 0.01 (two)", pictures.PPO, "-", "o"),
    "ppo-late": ("PPO, KL 0.006 from 88 M on (two)", pictures.PPO, (0, (1, 0.8)), "^"),
    "ppo-2048": ("PPO, 2048 robots (two)", pictures.PPO, (0, (2, 1)), ""),
    "ppo-1024": ("PPO, 1024 robots (two)", pictures.PPO, (0, (5, 2)), "s"),
}
PANELS = (  # robot, what of a row, title
    ("go2", "crossed", "Go2: all tiles"),
    ("anymal_c", "crossed", "ANYmal-C: all tiles"),
    ("anymal_c", "boxes", "ANYmal-C: boxes, middle rows"),
)


def main():
    crossed()
    scan()


def scan():
    """What a tail looked up less what physics had, over the seconds since its first row."""
    with (table.RESULTS / "scan.csv").open() as file:
        rows = [*csv.DictReader(file)]
    of = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    page, axes = pictures.figure(1, 2, 3.2)
    for name, label, colour in (
        ("scan", "looked up where the model says the robot is", pictures.BLUE),
        ("frozen", "kept as it was at the tail's start", pictures.VERMILION),
    ):
        axes[0, 0].plot(of["seconds"], 1e3 * of[name], color=colour, label=label)
        axes[0, 0].plot(of["seconds"], 1e3 * of[f"{name}_95"], color=colour, ls=(0, (4, 2)))
    axes[0, 0].set_title("scan: middle, and (dashed) 95 % of |error|", loc="left")
    axes[0, 1].plot(of["seconds"], 1e3 * of["position"], color=pictures.BLACK)
    axes[0, 1].set_title("position: root mean square", loc="left")
    pictures.outer(axes, "seconds of the tail", "error, mm")
    pictures.legend(page, axes[0, 0], 2)
    pictures.save(page, Path(__file__).with_name("scan"))


def crossed():
    runs = {name: [*some] for name, some in groupby(table.today(), lambda row: row["name"])}
    page, axes = pictures.figure(2, len(PANELS), 5.4, sharey="row")
    for (above, below), (robot, what, title) in zip(axes.T, PANELS, strict=True):
        for end, look in LOOKS.items():
            if f"{robot}-{end}" in runs:
                curve(above, runs[f"{robot}-{end}"], what, *look)
                if what == "crossed":  # falls are counted on all tiles together
                    curve(below, runs[f"{robot}-{end}"], "fell", *look)
        above.set_title(title, loc="left")
        pictures.falls(below)
        for axis in (above, below):
            axis.set_xlim(1, 150)
            pictures.log(axis, which="x")
    axes[0, 0].set(ylim=(0, 1), ylabel="share crossed")
    axes[1, 0].set_ylabel("tries with a fall, %")
    axes[0, -1].axhline(table.LEAST[1], color="0.4", lw=1, ls=":")
    axes[1, -1].set_visible(False)
    for axis in (*axes[1, :-1], axes[0, -1]):
        axis.set_xlabel("million simulator steps")
    text = f"Band: {pictures.covers([3, 10])}. Dotted: the level of boxes, and 1 % falls"
    pictures.head(page, text, fontsize=9.5)
    pictures.legend(page, axes[0, 0], 3)
    pictures.save(page, Path(__file__).with_name("crossed"))


def curve(axis, mine, what, label, colour, dash, mark):
    """The mean of a run's seeds over M steps, and a band from three seeds on."""
    seeds = [[*some] for _, some in groupby(mine, table.key)]
    steps = np.array([int(row["sim_steps"]) for row in seeds[0]]) / 1e6
    values = np.array([[share(row, what) for row in rows] for rows in seeds]).T
    if values.shape[1] < 3:
        values = values.mean(1, keepdims=True)
    pictures.band(axis, steps, values, colour, label, most=len(steps), dash=dash, mark=mark)


def share(row, what):
    """Of tries that crossed: of all, or of a kind as the level has it; or per cent of all that fell."""
    if what == "fell":
        return 100 * float(row[what])
    return float(row[what]) if what == "crossed" else table.shares(row)[what]


if __name__ == "__main__":
    main()
