"""Seconds and simulator steps to the level and to a walk over the cost of a simulated row, `best` beside PPO:
row_cost.png.

    python experiments/30_row_cost/plot.py

Points are measured, lines computed from the runs of Go1 with our kernel (table.py). All axes are
logarithmic. Marks of places whose rows cost nearly the same would cover each other, so they stand a little
aside (`apart`).
"""

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from experiments import pictures, stats

table = importlib.import_module("experiments.30_row_cost.table")

LABELS = {  # place -> words
    "go1.kernel": "Go1, our kernel",
    "go1.fine16": "Go1, our kernel, 16 physics steps",
    "go1.fine32": "Go1, our kernel, 32 physics steps",
    "go1.fine64": "Go1, our kernel, 64 physics steps",
    "go1.warp": "Go1, MuJoCo Warp",
    "go1.exact": "Go1, exact task, MuJoCo Warp",
    "anymal_c.exact": "ANYmal-C, exact task, MuJoCo Warp",
    "go1.jax": "Go1, MJX-JAX",
    "g1.kernel": "G1, our kernel",
    "g1.warp": "G1, MuJoCo Warp",
    "go2.rough": "Go2 on rough ground, our kernel",
    "go1.laptop": "Go1, C MuJoCo",
}
LOOKS = {"best": (pictures.BEST, "o", "best"), "ppo": (pictures.PPO, "s", "PPO")}
QUICK: dict[str, Any] = {"color": pictures.SKY, "marker": "^", "ms": 6, "mec": pictures.BEST}
OTHER: dict[str, Any] = {"color": pictures.PPO, "marker": "d", "mfc": "none", "ms": 5}
NONE: dict[str, Any] = {"marker": r"$\uparrow$", "ls": "", "ms": 9, "mew": 0.3}
DASHES = {"a GPU": "-", "two cores": (0, (4, 2))}
APART = 1.25  # marks of two places stand at costs with this ratio, or a larger one
TEXT = {"fontsize": 8, "color": "0.25", "linespacing": 1.1}
GOALS = {"level": "to the level", "walks": "to a walk"}  # of a Run
BESIDE = {  # where how many seeds walk would cover a mark: points from its own
    ("go1.exact", "best"): (-7, 0),
    ("anymal_c.exact", "ppo"): (0, 9),
    ("go1.laptop", "best"): (-7, 0),
}
ASIDE = {"g1.warp": -3, "go1.jax": 4}  # points of a number from its mark, where two would touch


def main():
    found = table.runs()
    page, axes = pictures.figure(2, 2, 7.6, sharex=True, sharey="col")
    pairs = [table.settings(found, place) for place in dict.fromkeys(run.place for run in found)]
    pairs = [both for both in pairs if both]
    costs = apart([table.cost(found, best) for best, _ in pairs])
    places = {
        f"{LABELS.get(best.place, best.place)}, {best.batch.partition(',')[0]}": number
        for number, (best, _) in enumerate(pairs, 1)
    }
    for (goal, words), (seconds, steps) in zip(GOALS.items(), axes, strict=True):
        computed(seconds, found, goal)
        for number, (ms, (best, ppos)) in enumerate(zip(costs, pairs, strict=True), 1):
            if goal == "walks" and best.place in table.NO_WALKS:
                continue
            fast, few = table.fastest_beside(best, ppos), table.fewest(found, best, ppos)
            if goal == "walks":
                fast, few = (table.walking(run, ppos, k) for run, k in ((fast, 2), (few, 1)))
            pair(seconds, ms, best, fast, goal, 2, number)
            pair(steps, ms, best, few, goal, 1, number)
            least = getattr(fast, goal)[:, 1] / 1e6
            if fast.method != few.method and np.isfinite(least).all():
                steps.plot(1.04 * ms, least.mean(), ls="", zorder=2, **OTHER)
            quick = table.fastest(table.variants(found, best))
            if quick is not best and np.isfinite(getattr(quick, goal)).all():
                for axis, column, unit in ((seconds, 2, 1.0), (steps, 1, 1e6)):
                    one = stats.moments(getattr(quick, goal)[:, column] / unit)
                    axis.errorbar(
                        ms * 0.84, one.mean, stats.half_of(one), capsize=2, lw=1, zorder=3, **QUICK
                    )
        for axis, what in ((seconds, "seconds of training"), (steps, "million simulator steps")):
            axis.set_title(f"{what} {words}", loc="left")
    for axis in axes.flat:
        pictures.log(axis, which="x")
        pictures.log(axis)
    axes[0, 0].set(xlim=(0.12, 130), ylim=(0.17, 300))
    axes[0, 1].set_ylim(0.08, 100)
    pictures.outer(axes, "ms of a simulated row of 1024 robots")
    legend(page, places)
    pictures.save(page, Path(__file__).with_name("row_cost"))


def computed(axis, found, goal: str) -> None:
    """What the runs of Go1 with our kernel would take if a row cost more; where they break even."""
    best, ppos = table.settings(found, "go1.kernel")
    before = table.cost(found, best)
    if goal == "walks":
        best, *ppos = map(table.to_walk, (best, *ppos))
    ppos = [run for run in ppos if len(run.level) >= table.MANY and table.there(run) == 1]
    costs = table.COSTS[(table.COSTS >= before) & (table.COSTS <= 60)]
    mine = [stats.moments(column) for column in table.later(best, before, costs, 0.0).T]
    mean, half = (np.array([f(one) for one in mine]) for f in (lambda one: one.mean, stats.half_of))
    axis.fill_between(costs, mean - half, mean + half, color=pictures.BEST, alpha=0.15, lw=0)
    axis.plot(costs, mean, color=pictures.BEST, lw=1.4)
    for name, power in table.POWERS.items():
        every = [table.later(run, before, costs, power).mean(0) for run in ppos]
        axis.plot(costs, np.min(every, 0), color=pictures.PPO, lw=1.4, ls=DASHES[name])
    even, low, high = table.break_even(best, ppos, before, table.POWERS["a GPU"])
    there = float(np.interp(even, costs, mean))
    axis.vlines(even, there, 300, color="0.5", lw=0.8, ls=":", zorder=0)
    words = f"Go1 breaks even, computed:\n{even:.2g} ms ({low:.2g} to {high:.2g})"
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


def pair(axis, ms: float, best, ppo, goal: str, column: int, number: int) -> None:
    """`best` and PPO at a place, joined by a line, and below them its number (above, if an interval goes
    below 0). With t intervals where there are `table.OFTEN` seeds and all get to the goal; else open, with
    how many do, at their mean. An arrow stands where the runs of a setting end of which none does."""
    from matplotlib.patheffects import withStroke

    means, ends, tops = [], [], []
    rim = [withStroke(linewidth=2, foreground="white")]  # where a computed line goes by
    how: dict[str, Any] = {"textcoords": "offset points", "path_effects": rim, "zorder": 5}
    unit = 1e6 if column == 1 else 1.0
    for run, (name, (colour, mark, _)), aside in zip(
        (best, ppo), LOOKS.items(), (0.96, 1.04), strict=True
    ):
        values = (
            table.steps(run) if (goal, column) == ("level", 1) else getattr(run, goal)[:, column]
        )
        one = stats.moments(values / unit)
        if not one.n:
            end = run.end / unit if column == 1 else run.last
            axis.plot(ms * aside, end, color=colour, **NONE)
            means.append(end)
            continue
        often = one.n == len(values) >= table.OFTEN
        look: dict[str, Any] = {
            "color": colour,
            "mfc": colour if often else "white",
            "ms": 6,
            "zorder": 4,
        }
        bar = stats.half_of(one) if often else None
        axis.errorbar(ms * aside, one.mean, bar, fmt=mark, capsize=2.5, lw=1.2, **look)
        if one.n < len(values):
            x, y = BESIDE.get((run.place, name), (7, 0))
            where: dict[str, Any] = {
                "ha": "center" if y else "right" if x < 0 else "left",
                "va": "center",
            }
            words = f"{one.n} of {len(values)}"
            axis.annotate(
                words, (ms * aside, one.mean), (x, y), color=colour, fontsize=7, **where, **how
            )
        means.append(one.mean)
        ends.append(one.mean - (bar or 0.0))
        tops.append(one.mean + (bar or 0.0))
    axis.plot([ms, ms], means, color="0.6", lw=0.8, zorder=1)
    how |= {"ha": "center", "fontsize": 9, "fontweight": "bold"}
    at, side, more = (min(ends), "top", -6) if min(ends) > 0 else (max(tops), "bottom", 4)
    axis.annotate(f"{number}", (ms, at), (ASIDE.get(best.place, 0), more), va=side, **how)


def legend(page, places: dict[str, int]) -> None:
    """Above what the numbers are, below what marks and lines are."""
    from matplotlib.lines import Line2D

    def line(colour, dash):
        return Line2D([], [], color=colour, lw=1.4, ls=dash)

    def mark(colour, shape, ms=6.0, **more):
        return Line2D([], [], color=colour, marker=shape, ls="", ms=ms, **more)

    colour, other = pictures.BEST, pictures.PPO
    keys = {words: mark(colour, shape) for colour, shape, words in LOOKS.values()}
    keys["best for seconds"] = Line2D([], [], ls="", **QUICK)
    keys["open: mean of the seeds that walk"] = mark(other, "s", mfc="white")
    keys["no PPO walks by there"] = Line2D([], [], color=other, **NONE)
    keys["steps of the PPO on the left"] = Line2D([], [], ls="", **OTHER)
    keys["computed: Go1, best"] = line(colour, "-")
    keys["computed: PPO; a row of 2048 costs 1.16 times"] = line(other, DASHES["a GPU"])
    keys["computed: PPO; a row costs as its robots"] = line(other, DASHES["two cores"])
    numbers = [
        mark(pictures.BLACK, f"${number}$", 6 if number < 10 else 9, mew=0.3)
        for number in places.values()
    ]
    above = dict(
        loc="outside upper left", ncols=4 if len(places) < 5 else 3, frameon=False, fontsize=8.5
    )
    page.legend(numbers, places, handletextpad=0.1, columnspacing=1.2, **above)
    how = dict(ncols=3, frameon=False, fontsize=8.5, columnspacing=1.6)
    page.legend(keys.values(), keys.keys(), loc="outside lower center", **how)


if __name__ == "__main__":
    main()
