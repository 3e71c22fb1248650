"""Evaluated return over simulator steps, four robots: curves.png.

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
    "best": ("best", pictures.BLUE, "-"),
    "ppo-level": ("PPO alone, for the level", pictures.VERMILION, "-"),
    "ppo-walk": ("PPO alone, to walk", pictures.VERMILION, (0, (3, 1.5))),
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
    fig, axes = pictures.figure(2, 2, 6.4, sharex=True)
    for axis, (robot, title) in zip(np.ravel(axes), ROBOTS.items(), strict=True):
        for name, look in RUNS.items():
            if f"{name}-{robot}" in jobs:
                curve(axis, jobs[f"{name}-{robot}"], *look)
        axis.axhline(LEVEL[robot], color="0.4", lw=1, ls=":")
        axis.set_title(title, loc="left")
        axis.set(xscale="log", ylim=(0, None))
    pictures.outer(axes, "simulator steps (logarithmic)", "evaluated return")
    pictures.head(
        fig,
        f"Band: {pictures.covers([5, 10])}. Dotted: follows its commands (38; 24)",
        fontsize=9.5,
    )
    pictures.legend(fig, axes[0, 0], 3)
    pictures.save(fig, Path(__file__).with_name("curves"))


def curve(axis, job, label, colour, dash):
    """One run of several seeds, as far as the shortest goes; without an evaluation before the first step."""
    runs = [[row for row in run if row["sim_steps"]] for run in table.seeds(job)]
    count = min(map(len, runs))
    steps = np.array([row["sim_steps"] for row in runs[0][:count]])
    values = np.array([[row["return"] for row in run[:count]] for run in runs])
    pictures.band(axis, steps, values.T, colour, label, most=count, dash=dash)


if __name__ == "__main__":
    main()
