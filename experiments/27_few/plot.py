"""Returns and falls of few robots over simulator steps, and when they are at the level: by what is set, by
how many they are, and beside other methods: curves.png.

    python experiments/27_few/plot.py

From results/ and the files of other pages; the bands are 95 % t intervals, the bars reach from the first seed
to the last.
"""

import importlib
from pathlib import Path

import numpy as np

from experiments import pictures

table = importlib.import_module("experiments.27_few.table")
peers = importlib.import_module("experiments.27_few.peers_table")
others = importlib.import_module("experiments.24_off_policy.plot")
HERE = Path(__file__).parent
COLOURS = {  # by the last letter of a job
    "g": pictures.GREEN,
    "h": pictures.ORANGE,
    "c": pictures.PURPLE,
    "d": pictures.BLACK,
}
DASHES = {"h": (0, (3, 1.2)), "d": (0, (1, 1))}
METHODS = {"few": COLOURS["g"], "best": pictures.BEST, "PPO alone": pictures.PPO}  # others are grey
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
    page, axes = pictures.figure(2, 3, 5.4)
    (over_steps, by_imagined, by_simulated), (falls, in_seconds, beside) = axes
    for letter, robot in table.ROBOTS.items():
        colour, dash = COLOURS[letter], DASHES.get(letter, "-")
        curve(over_steps, fresh[robot], robot, colour, dash)
        curve(falls, fresh[robot], robot, colour, dash, falls=True)
        for count, name in IMAGINED:
            if name.format(letter) in jobs:
                bar(by_imagined, count, jobs[name.format(letter)], colour)
    for letter, aside in (("g", 0.94), ("c", 1.06)):
        for count in SIMULATED:
            name = "default" if count == 256 else f"robots-{count}"
            job = fresh[table.ROBOTS[letter]] if count == 64 else jobs[f"{name}-{letter}"]
            bar(by_simulated, aside * count, job, COLOURS[letter])
    bar(by_simulated, 1024, jobs["best-g"], METHODS["best"])
    few, best = timed()
    for count, level in few.items():
        whisker(in_seconds, count, level[:, 2], METHODS["few"])
    whisker(in_seconds, 1.15 * 1024, best[:, 2], METHODS["best"])
    methods(beside, level_of_each(fresh["Go1"], jobs["default-g"], few[4][:, 1]))
    over_steps.axhline(1, color="0.4", lw=1, ls=":")
    over_steps.set(xlim=(0, 50), ylim=(0, None))
    over_steps.set_title("return, in levels", loc="left")
    over_steps.legend(frameon=False, loc="lower right")
    pictures.falls(falls)
    falls.set(xlabel="thousand simulator steps", xlim=(0, 50))
    falls.set_title("episodes with a fall, %", loc="left")
    for axis, what, count in (
        (by_imagined, "imagined robots for a real one", (1, 4, 16, 64, 256)),
        (by_simulated, "real robots", SIMULATED),
        (in_seconds, "real robots, Go1", SIMULATED),
    ):
        axis.set(xlabel=what, xscale="log")
        axis.set_title("thousand steps to the level", loc="left")
        pictures.log(axis)
        ticks(axis, count)
    in_seconds.set_title("seconds to the level", loc="left")
    pictures.save(page, HERE / "curves")


def timed():
    """Of runs alone on a card, iteration, steps and seconds at the level `[S, 3]`: `few` by the number of
    robots, and `best`."""
    few: dict[int, list] = {}
    best = []
    for file in ("seconds", "default"):
        for one in table.alone(HERE / "results" / f"{file}.csv.xz"):
            mine = best if "best" in one.config else few.setdefault(one.robots, [])
            mine.append(one.level)
    return {count: np.concatenate(some) for count, some in few.items()}, np.concatenate(best)


def level_of_each(fresh, many, four):
    """`(method and robots, thousand steps of each seed to 38)` on a Go1, those that need fewest first. Of a
    seed of SAC that ran twice the mean counts."""
    jobs = others.read() | {"few": fresh, "256": many}

    def of(name):
        first = lambda run: table.runs.first(run, 38)  # noqa: E731
        return others.by_seed(jobs[name], first)

    found = [
        ("few, 4 robots", four),
        ("few, 64", of("few")),
        ("few, 256", of("256")),
        ("CrossQ, symmetric, 64", peers.fresh()["crossq-64-symmetric"].level),
        ("CrossQ, symmetric, 256", of("crossq-symmetric")),
        ("best, 1024", of("best-g")),
        ("SAC, symmetric, 256", of("sac-twice")),
        ("PPO alone, 128", of("ppo-level-g")),
    ]
    return [(name, steps / 1e3) for name, steps in found]


def methods(axis, found):
    for place, (name, steps) in enumerate(found):
        colour = METHODS.get(name.partition(",")[0], pictures.GREY)
        axis.plot([steps.min(), steps.max()], [place, place], color=colour, lw=1.2)
        axis.plot(steps.mean(), place, "o", color=colour, ms=5)
    axis.set_yticks(range(len(found)), [name for name, _ in found])
    axis.invert_yaxis()
    axis.set(xlabel="thousand steps to 38 (Go1)")
    pictures.log(axis, subs=(1,), which="x")


def curve(axis, job, robot, colour, dash, falls=False):
    """The mean return of a job's seeds, in levels of its robot; or their falls, in per cent."""
    seeds = table.runs.seeds(job)
    steps = np.array([row["sim_steps"] for row in seeds[0]]) / 1e3
    what, unit = ("fall_rate", 0.01) if falls else ("return", table.level_of(job))
    values = np.array([[row[what] for row in rows] for rows in seeds]).T
    pictures.band(axis, steps, values / unit, colour, robot, most=len(steps), dash=dash)


def bar(axis, at, job, colour):
    """When the seeds of a job are first at the level; a cross above where none is."""
    seeds = table.runs.seeds(job)
    first = table.runs.reached(seeds, table.level_of(job)).level / 1e3
    if np.isnan(first).all():
        axis.plot(at, 1e-3 * seeds[0][-1]["sim_steps"], "x", color=colour)
        return
    whisker(axis, at, first, colour)


def whisker(axis, at, values, colour):
    axis.plot([at, at], [np.nanmin(values), np.nanmax(values)], color=colour, lw=1.2)
    axis.plot(at, np.nanmean(values), "o", color=colour, ms=5)


def ticks(axis, at):
    axis.set_xticks(at, [f"{tick:g}" for tick in at])
    axis.set_xticks([], minor=True)


if __name__ == "__main__":
    main()
