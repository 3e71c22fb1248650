"""Seconds and simulator steps to the level over the cost of a simulated row, `best` beside PPO: row_cost.png.

    python experiments/30_row_cost/plot.py

Points are measured, lines computed from the runs of Go1 with our kernel (table.py). Both axes are
logarithmic. Marks of places whose rows cost nearly the same would cover each other, so they stand a little
aside (`apart`).
"""

import importlib
from pathlib import Path

import numpy as np

from experiments import pictures, stats

table = importlib.import_module("experiments.30_row_cost.table")

LABELS = {  # place -> words
    "go1.kernel": "Go1, our kernel",
    "go1.warp": "Go1, MuJoCo Warp",
    "go1.exact": "Go1, exact task, MuJoCo Warp",
    "anymal_c.exact": "ANYmal-C, exact task, MuJoCo Warp",
    "go1.jax": "Go1, MJX-JAX",
    "g1.kernel": "G1, our kernel",
    "g1.warp": "G1, MuJoCo Warp",
    "go2.rough": "Go2 on rough ground, our kernel",
    "go1.laptop": "Go1, C MuJoCo",
}
LOOKS = {"best": (pictures.BLUE, "o", "best"), "ppo": (pictures.BLACK, "s", "PPO")}
DASHES = {"a GPU": "-", "two cores": (0, (4, 2))}
APART = 1.25  # marks of two places stand at costs with this ratio, or a larger one
TEXT = {"fontsize": 8, "color": "0.25", "linespacing": 1.1}


def main():
    found = table.runs()
    page, ((seconds, steps),) = pictures.figure(1, 2, 4.6)
    computed(seconds, found)
    places = {}
    pairs = [table.settings(found, place) for place in dict.fromkeys(run.place for run in found)]
    pairs = [both for both in pairs if both]
    costs = apart([table.cost(found, best) for best, _ in pairs])
    for number, (ms, (best, ppos)) in enumerate(zip(costs, pairs, strict=True), 1):
        fast, few = table.fastest_beside(best, ppos), table.sparing(ppos)
        places[f"{LABELS.get(best.place, best.place)}, {best.batch.partition(',')[0]}"] = number
        pair(seconds, ms, best.level[:, 2], fast.level[:, 2], number)
        pair(steps, ms, table.steps(best) / 1e6, table.steps(few) / 1e6, number)
        least = fast.level[:, 1].mean() / 1e6
        if fast.method != few.method:
            steps.plot(1.04 * ms, least, "s", color=pictures.GREY, ms=4.5, mfc="none", zorder=2)
    for axis, words in ((seconds, "seconds of training"), (steps, "million simulator steps")):
        pictures.log(axis, which="x")
        pictures.log(axis)
        axis.set(xlim=(0.1, 100), xlabel="ms of a simulated row of 1024 robots")
        axis.set_title(f"{words} to the level", loc="left")
    seconds.set_ylim(0.25, 300)
    steps.set_ylim(0.1, None)
    drawn = [
        run
        for best, ppos in pairs
        for run in (best, table.fastest_beside(best, ppos), table.sparing(ppos))
    ]
    legend(page, places, any(len(run.level) < table.OFTEN for run in drawn))
    pictures.save(page, Path(__file__).with_name("row_cost"))


def computed(axis, found) -> None:
    """What the runs of Go1 with our kernel would take if a row cost more; where they break even."""
    best, ppos = table.settings(found, "go1.kernel")
    ppos = [run for run in ppos if len(run.level) >= table.MANY]
    before = table.cost(found, best)
    costs = table.COSTS[(table.COSTS >= before) & (table.COSTS <= 60)]
    mine = [stats.moments(column) for column in table.later(best, before, costs, 0.0).T]
    mean, half = (np.array([f(one) for one in mine]) for f in (lambda one: one.mean, stats.half_of))
    axis.fill_between(costs, mean - half, mean + half, color=pictures.BLUE, alpha=0.15, lw=0)
    axis.plot(costs, mean, color=pictures.BLUE, lw=1.4)
    for name, power in table.POWERS.items():
        every = [table.later(run, before, costs, power).mean(0) for run in ppos]
        axis.plot(costs, np.min(every, 0), color=pictures.BLACK, lw=1.4, ls=DASHES[name])
    even, low, high = table.break_even(best, ppos, before, table.POWERS["a GPU"])
    there = float(np.interp(even, costs, mean))
    axis.vlines(even, there, 300, color="0.5", lw=0.8, ls=":", zorder=0)
    words = f"Go1 breaks even:\n{even:.2g} ms ({low:.2g} to {high:.2g})"
    axis.annotate(
        words, (even, 0.98), (5, 0), axis.get_xaxis_transform(), "offset points", va="top", **TEXT
    )


def apart(costs: list[float]) -> np.ndarray:
    """Where marks stand: costs, in order, moved until neighbours have a ratio of `APART` or more."""
    where, least = np.log(costs), np.log(APART)
    for _ in range(200):
        short = np.maximum(least - np.diff(where), 0) / 2
        where[:-1] -= short
        where[1:] += short
    return np.exp(where)


def pair(axis, ms: float, best, ppo, number: int) -> None:
    """`best` and PPO at a place, joined by a line, with t intervals where there are `table.OFTEN` seeds;
    below them its number."""
    from matplotlib.patheffects import withStroke

    means, ends = [], []
    for values, (colour, mark, _), beside in zip(
        (best, ppo), LOOKS.values(), (0.96, 1.04), strict=True
    ):
        one = stats.moments(values)
        means.append(one.mean)
        often = one.n >= table.OFTEN
        look = {"color": colour, "mfc": colour if often else "white", "ms": 6, "zorder": 4}
        bar = stats.half_of(one) if often else None
        ends.append(one.mean - (bar or 0.0))
        axis.errorbar(ms * beside, one.mean, bar, fmt=mark, capsize=2.5, lw=1.2, **look)
    axis.plot([ms, ms], means, color="0.6", lw=0.8, zorder=1)
    how = dict(textcoords="offset points", ha="center", va="top", fontsize=9, fontweight="bold")
    rim = [withStroke(linewidth=2, foreground="white")]  # where a computed line goes by
    axis.annotate(f"{number}", (ms, min(ends)), (0, -6), path_effects=rim, zorder=5, **how)


def legend(page, places: dict[str, int], seldom: bool) -> None:
    """Above what the numbers are, below what marks and lines are; `seldom`: some have few seeds."""
    from matplotlib.lines import Line2D

    def line(colour, dash):
        return Line2D([], [], color=colour, lw=1.4, ls=dash)

    def mark(colour, shape, **more):
        return Line2D([], [], color=colour, marker=shape, ls="", ms=6, **more)

    colour, other = pictures.BLUE, pictures.BLACK
    keys = {words: mark(colour, shape) for colour, shape, words in LOOKS.values()}
    if seldom:
        keys["fewer than five seeds"] = mark(other, "s", mfc="white")
    keys["steps of the PPO on the left"] = mark(pictures.GREY, "s", mfc="none")
    keys["computed: Go1, best"] = line(colour, "-")
    keys["computed: PPO; a row of 4096 costs 1.35 times"] = line(other, DASHES["a GPU"])
    keys["computed: PPO; a row costs as its robots"] = line(other, DASHES["two cores"])
    numbers = [mark(other, f"${number}$", mew=0.3) for number in places.values()]
    above = dict(
        loc="outside upper left", ncols=4 if len(places) < 5 else 3, frameon=False, fontsize=8.5
    )
    page.legend(numbers, places, handletextpad=0.1, columnspacing=1.2, **above)
    how = dict(ncols=3, frameon=False, fontsize=8.5, columnspacing=1.6)
    page.legend(keys.values(), keys.keys(), loc="outside lower center", **how)


if __name__ == "__main__":
    main()
