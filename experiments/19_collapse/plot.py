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
CURVES = {
    "ppo16": ("PPO-16", pictures.BLACK, (0, (5, 1.2)), "o"),
    "tail": ("the paper's tail", pictures.BLUE, "-", "s"),
    "unanchored": ("no anchors", pictures.GREEN, (0, (3, 1.2)), "^"),
    "burn16": ("begins 16 steps behind", pictures.PURPLE, (0, (5, 1.2, 1, 1.2)), "P"),
    "cold": ("new weights in each fit", pictures.VERMILION, "-", "X"),
    "cold-ramp": ("new weights, and the ramp", pictures.ORANGE, (0, (1, 1)), "v"),
    "cold-epochs": ("new weights, and 100 epochs", pictures.SKY, (0, (3, 1, 1, 1)), "D"),
}


def main():
    paper.parser(__doc__).parse_args()
    runs = table.read(table.HERE / "results/gpu.csv.xz")
    page, axes = pictures.figure(2, 4, 5.0, sharex="col")
    for column, robot in enumerate("gc"):
        doses(axes[:, column], runs, robot)
        curves(axes[:, column + 2], runs, robot)
        for axis, which, what in (
            (column, "1024 robots", "rows of the tail, of 24"),
            (column + 2, "4 of 16 rows", "iteration"),
        ):
            axes[0, axis].set_title(f"{table.ROBOTS[robot]}, {which}", loc="left")
            axes[0, axis].set_ylim(-1, {"g": 45, "c": 30}[robot])
            axes[1, axis].set_ylim(-3, 103)
            axes[1, axis].set_xlabel(what)
        axes[1, column].set_xticks([0, *table.DOSES])
        axes[1, column + 2].set_xticks([100, 200, 300])
    axes[0, 0].set_ylabel("evaluated return")
    axes[1, 0].set_ylabel("episodes with a fall, %")
    for column, side, many in ((0, "left", 1), (2, "right", 2)):
        handles = axes[0, column].get_legend_handles_labels()
        place = {"loc": f"outside lower {side}", "ncols": many}
        page.legend(*handles, frameon=False, handlelength=2.4, **place)
    pictures.save(page, table.HERE / "collapse")


def curves(axes, runs, robot: str) -> None:
    """The paper's tail, and with one thing otherwise, every 100 iterations; eight seeds where they ran."""
    for name, look in CURVES.items():
        job = f"eight-{name}-{robot}" if f"eight-{name}-{robot}" in runs else f"{name}-{robot}"
        some = [k for k in sorted(runs[job]) if k % 100 == 0 and k <= 300]
        draw(axes, some, [(runs, job, k) for k in some], look)


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
