"""Evaluated return and falls over simulator steps, four robots: curves.png.

    cd experiments/21_less
    python plot.py results/headline.csv.xz results/fresh.csv.xz

Lines are means over ten seeds, of PPO-16 and PPO-24 five, which are older; bands their 95 % t interval; steps
are logarithmic.
"""

import importlib
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from experiments import paper, pictures

table = importlib.import_module("experiments.21_less.table")

ROBOTS = {"g": "Go1", "h": "Go2", "c": "ANYmal-C", "d": "ANYmal-D"}
RUNS = {  # name in the results -> label, colour, dashes
    "best": ("best", pictures.BEST, "-"),
    "ppo-level": ("PPO alone, for the level", pictures.PPO, "-"),
    "ppo-walk": ("PPO alone, to walk", pictures.PPO, (0, (3, 1.5))),
    "ppo24": ("PPO-24, 4096 robots (older)", pictures.GREY, (0, (5, 2))),
    "ppo16": ("PPO-16, 4096 robots (older)", pictures.BLACK, "-"),
}
LEVEL = {robot: walks.level(45 if robot in "gh" else 30) for robot in ROBOTS}


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("paths", type=Path, nargs="+")
    jobs = {}
    for path in parser.parse_args().paths:
        jobs |= table.read(path)
    fig, axes = pictures.figure(2, 4, 5.2, sharex=True)
    for (above, below), (robot, title) in zip(axes.T, ROBOTS.items(), strict=True):
        for name, look in RUNS.items():
            if f"{name}-{robot}" in jobs:
                curve(above, jobs[f"{name}-{robot}"], *look)
                curve(below, jobs[f"{name}-{robot}"], *look, what="fall_rate", scale=100)
        above.axhline(LEVEL[robot], color="0.4", lw=1, ls=":")
        above.set_title(title, loc="left")
        above.set(xscale="log", ylim=(0, None))
        pictures.falls(below)
    pictures.outer(axes, "simulator steps")
    axes[0, 0].set_ylabel("evaluated return")
    axes[1, 0].set_ylabel("episodes with a fall, %")
    pictures.head(
        fig,
        f"Band: {pictures.covers([5, 10])}. Dotted: follows its commands (38; 24), and 1 % falls",
        fontsize=9.5,
    )
    pictures.legend(fig, axes[0, 0], 3)
    pictures.save(fig, Path(__file__).with_name("curves"))


def curve(axis, job, label, colour, dash, what="return", scale=1):
    """One run of several seeds, as far as the shortest goes; without an evaluation before the first step."""
    runs = [[row for row in run if row["sim_steps"]] for run in table.seeds(job)]
    count = min(map(len, runs))
    steps = np.array([row["sim_steps"] for row in runs[0][:count]])
    values = scale * np.array([[row[what] for row in run[:count]] for run in runs])
    pictures.band(axis, steps, values.T, colour, label, most=count, dash=dash)


if __name__ == "__main__":
    main()
