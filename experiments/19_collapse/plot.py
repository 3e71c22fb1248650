"""How long a tail may be, and which of the paper's tails collapse: collapse.png.

    python experiments/19_collapse/plot.py

Return above, episodes with a fall below; a dot is a seed, a line their mean.
"""

import importlib

import numpy as np

from experiments import paper, pictures

table = importlib.import_module("experiments.19_collapse.table")

REAL = "real rows alone", pictures.GREY, (0, (1, 1)), "v"
TAIL = "with the tail", pictures.BLUE, "-", "o"
IDEA = "with the tail, and falls", pictures.ORANGE, "none", "D"
CURVES = {  # of Go1
    "ppo16": ("PPO-16", pictures.BLACK, (0, (5, 1.2)), "o"),
    "tail": ("the paper's tail", pictures.BLUE, "-", "s"),
    "unanchored": ("no anchors", pictures.GREEN, (0, (3, 1.2)), "^"),
    "cold": ("new weights in each fit", pictures.VERMILION, "-", "X"),
    "burn16": ("begins 16 steps behind", pictures.PURPLE, (0, (5, 1.2, 1, 1.2)), "P"),
}


def main():
    paper.parser(__doc__).parse_args()
    runs = table.read(table.HERE / "results/gpu.csv.xz")
    fig, axes = pictures.figure(2, 3, 5.0, sharex="col")
    for column, robot in enumerate("gc"):
        doses(axes[:, column], runs, robot)
        axes[0, column].set_title(f"{table.ROBOTS[robot]}, 1024 robots, 24 rows", loc="left")
        axes[1, column].set_xlabel("rows of the tail, of 24")
        axes[1, column].set_xticks([0, *table.DOSES])
    for name, look in CURVES.items():
        job = f"{name}-g"
        some = [k for k in sorted(runs[job]) if k % 100 == 0 and k <= 300]
        draw(axes[:, 2], some, [(runs, job, k) for k in some], look)
    axes[0, 2].set_title("Go1, 4096 robots, 4 of 16", loc="left")
    axes[1, 2].set_xlabel("iteration")
    axes[1, 2].set_xticks([100, 200, 300])
    axes[0, 0].set_ylabel("evaluated return")
    axes[1, 0].set_ylabel("episodes with a fall, %")
    for column, most in enumerate((45, 30, 45)):
        axes[0, column].set_ylim(-1, most)
        axes[1, column].set_ylim(-3, 103)
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.32), "ncols": 1}
        axes[1, column].legend(frameon=False, handlelength=2.4, **below)
    pictures.save(fig, table.HERE / "collapse")


def doses(axes, runs, robot: str) -> None:
    """After 500 iterations, by the rows that the model writes; without any, PPO with all 24."""
    tails = [0, *table.DOSES]
    real = ["rows24", *(f"rows{rows}" for rows in table.DOSES.values())]
    imagined = ["rows24", *(f"dose{rows}" for rows in table.DOSES)]
    for jobs, look in ((real, REAL), (imagined, TAIL)):
        draw(axes, tails, [(runs, f"{job}-{robot}", 500) for job in jobs], look)
    if f"dose16-falls-{robot}" in runs:
        draw(axes, [16], [(runs, f"dose16-falls-{robot}", 500)], IDEA)


def draw(axes, xs, found, look) -> None:
    """Return and falls: seeds, and their mean."""
    label, colour, dashes, mark = look
    for axis, column, scale in zip(axes, ("return", "fall_rate"), (1, 100), strict=True):
        seeds = [scale * np.array(table.values(*one, column)) for one in found]
        for x, some in zip(xs, seeds, strict=True):
            axis.plot([x] * len(some), some, ".", color=colour, ms=4, alpha=0.5)
        means = [some.mean() for some in seeds]
        axis.plot(xs, means, color=colour, ls=dashes, marker=mark, ms=5, label=label)


if __name__ == "__main__":
    main()
