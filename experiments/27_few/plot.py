"""Returns and falls of few robots over simulator steps, and when they are at the level, by what is set:
curves.png.

    python experiments/27_few/plot.py

From results/gpu.csv.xz; the bands are 95 % t intervals, the bars reach from the first seed to the last.
"""

import importlib
from pathlib import Path

import numpy as np

from experiments import pictures

table = importlib.import_module("experiments.27_few.table")
HERE = Path(__file__).parent
COLOURS = {  # by the last letter of a job
    "g": pictures.BLUE,
    "h": pictures.SKY,
    "c": pictures.VERMILION,
    "d": pictures.ORANGE,
}
IMAGINED = (  # robots for each simulated one -> job, of those with 4 real rows and 16 imagined ones
    (1, "part-imagined-{}"),
    (4, "try-imagined4-{}"),
    (16, "few-{}"),
    (64, "try-imagined64-{}"),
    (64, "i64-{}"),
    (256, "i256-{}"),
)
SIMULATED = (1, 4, 16, 64, 256, 1024)  # real robots


def main():
    path = HERE / "results" / "gpu.csv.xz"
    jobs, fresh = table.read(path), table.fresh(path)
    page, axes = pictures.figure(2, 2, 5.6)
    (over_steps, by_imagined), (falls, by_simulated) = axes
    for letter, robot in table.ROBOTS.items():
        colour = COLOURS[letter]
        curve(over_steps, fresh[robot], robot, colour)
        curve(falls, fresh[robot], robot, colour, falls=True)
        for count, name in IMAGINED:
            if name.format(letter) in jobs:
                bar(by_imagined, count, jobs[name.format(letter)], colour)
    for letter, aside in (("g", 0.94), ("c", 1.06)):
        for count in SIMULATED:
            name = "default" if count == 256 else f"robots-{count}"
            job = fresh[table.ROBOTS[letter]] if count == 64 else jobs[f"{name}-{letter}"]
            bar(by_simulated, aside * count, job, COLOURS[letter])
    bar(by_simulated, 1024, jobs["best-g"], pictures.GREY)
    over_steps.axhline(1, color="0.4", lw=1, ls=":")
    over_steps.set(xlim=(0, 50), ylim=(0, None))
    over_steps.set_title("return, in levels", loc="left")
    over_steps.legend(frameon=False, loc="lower right")
    pictures.falls(falls)
    falls.set(xlabel="thousand simulator steps", xlim=(0, 50))
    falls.set_title("episodes with a fall, %", loc="left")
    for axis, what in (
        (by_imagined, "imagined robots for a real one"),
        (by_simulated, "real robots"),
    ):
        axis.set(xlabel=what, xscale="log")
        axis.set_title("thousand steps to the level", loc="left")
    pictures.log(by_imagined)
    pictures.log(by_simulated)
    ticks(by_imagined, (1, 4, 16, 64, 256))
    ticks(by_simulated, SIMULATED)
    pictures.save(page, HERE / "curves")


def curve(axis, job, robot, colour, falls=False):
    """The mean return of a job's seeds, in levels of its robot; or their falls, in per cent."""
    seeds = table.runs.seeds(job)
    steps = np.array([row["sim_steps"] for row in seeds[0]]) / 1e3
    what, unit = ("fall_rate", 0.01) if falls else ("return", table.level_of(job))
    values = np.array([[row[what] for row in rows] for rows in seeds]).T
    pictures.band(axis, steps, values / unit, colour, robot, most=len(steps))


def bar(axis, at, job, colour):
    """When the seeds of a job are first at the level; a cross above where none is."""
    seeds = table.runs.seeds(job)
    first = table.runs.reached(seeds, table.level_of(job)).level / 1e3
    if np.isnan(first).all():
        axis.plot(at, 1e-3 * seeds[0][-1]["sim_steps"], "x", color=colour)
        return
    axis.plot([at, at], [np.nanmin(first), np.nanmax(first)], color=colour, lw=1.2)
    axis.plot(at, np.nanmean(first), "o", color=colour, ms=5)


def ticks(axis, at):
    axis.set_xticks(at, [f"{tick:g}" for tick in at])
    axis.set_xticks([], minor=True)


if __name__ == "__main__":
    main()
