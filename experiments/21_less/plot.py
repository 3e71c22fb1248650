"""Evaluated return over simulator steps, four robots: curves.png.

    python experiments/21_less/plot.py experiments/21_less/results/fresh.csv.xz

Lines are means over five seeds, bands the lowest and the highest; steps are logarithmic.
"""

from pathlib import Path

import numpy as np
import table

from experiments import paper, pictures

ROBOTS = {"g": "Go1", "h": "Go2", "c": "ANYmal-C", "d": "ANYmal-D"}
RUNS = {  # name in the results -> label, colour (Okabe and Ito's, safe for the colour-blind)
    "new": ("best", "#D55E00"),
    "old-best": ("best until 2026-11-22", "#E69F00"),
    "ppo-1024x24": ("PPO, 1024 robots, 24 rows", "#0072B2"),
    "ppo24": ("PPO-24, 4096 robots", "#56B4E9"),
    "ppo16": ("PPO-16, 4096 robots", "#999999"),
}
WALKS = {"g": 38, "h": 38, "c": 24, "d": 24}


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("path", type=Path)
    jobs = table.read(parser.parse_args().path)
    fig, axes = pictures.figure(1, 4, (13, 3.5), sharex=True)
    for axis, (robot, title) in zip(np.ravel(axes), ROBOTS.items(), strict=True):
        for name, (label, colour) in RUNS.items():
            if f"{name}-{robot}" in jobs:
                curve(axis, jobs[f"{name}-{robot}"], label, colour)
        axis.axhline(WALKS[robot], color="0.6", lw=0.8, ls=":")
        axis.set(title=title, xscale="log", xlabel="simulator steps", ylim=(0, None))
    axes = np.ravel(axes)
    axes[0].set_ylabel("evaluated return")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    fig.savefig(Path(__file__).with_name("curves.png"), dpi=110)


def curve(axis, job, label, colour):
    """One run of several seeds."""
    runs = table.seeds(job)
    steps = [row["sim_steps"] for row in runs[0]]
    values = np.array([[row["return"] for row in run] for run in runs])
    axis.plot(steps, values.mean(0), color=colour, label=label, lw=1.6)
    axis.fill_between(steps, values.min(0), values.max(0), color=colour, alpha=0.2, lw=0)


if __name__ == "__main__":
    main()
