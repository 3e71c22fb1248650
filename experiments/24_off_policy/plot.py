"""Evaluated return and falls over simulator steps, Go1: peers.png, and the tables of README.md.

    python experiments/24_off_policy/plot.py

Left are means over five seeds (FastTD3: three) with their 95 % t interval, of the task of before 2026-11-25;
runs that were cut off end where the shortest does. In the middle is the task since then: CrossQ with
symmetric networks (five seeds) and with mirrored batches (eight, three of which are shorter), and SAC with
and without symmetric networks (three each), beside ten of 21_less. Right are the five settings of SAC, one
seed each.
"""

import functools
import importlib
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from experiments import paper, pictures, stats

less = importlib.import_module("experiments.21_less.plot")

HERE = Path(__file__).parent
RUNS = {  # name in the results -> label, colour, dashes
    "new-g": ("best", pictures.BEST, "-"),
    "mbpo-g": ("MBPO-like, ours", pictures.GREEN, (0, (7, 1.5))),
    "sac": ("SAC", pictures.ORANGE, (0, (3, 1.2))),
    "fasttd3": ("FastTD3, three seeds", pictures.PURPLE, (0, (5, 1.2, 1, 1.2))),
    "ppo-kl3-g": ("PPO, tuned (256 robots)", pictures.PPO, (0, (1, 0.8))),
    "ppo16-g": ("PPO-16, 4096 robots", pictures.BLACK, (0, (5, 1.2))),
}
TODAY = {  # the same, of the task since 2026-11-25
    "best-g": ("best", pictures.BEST, "-"),
    "crossq-symmetric": ("CrossQ, symmetric networks", pictures.PURPLE, "-"),
    "crossq": ("CrossQ, mirrored batches", pictures.PURPLE, (0, (3, 1.2))),
    "sac-symmetric": ("SAC, symmetric networks", pictures.ORANGE, "-"),
    "sac-today": ("SAC", pictures.ORANGE, (0, (3, 1.2))),
    "ppo-level-g": ("PPO, to the level", pictures.PPO, (0, (1, 0.8))),
}
SETTINGS = {  # of SAC; by their gain of actions
    "a": ("a: gain 3", pictures.GREY, (0, (1, 1))),
    "c": ("c: gain 2", pictures.SKY, "-"),
    "d": ("d: gain 2, 1024 robots", pictures.SKY, (0, (3, 1.2))),
    "b": ("b: gain 1.5", pictures.ORANGE, (0, (3, 1.2))),
    "e": ("e: gain 1.5 (chosen)", pictures.ORANGE, "-"),
}
LEVEL = walks.level(45)
WINDOW = (2.2e6, 2.5e6)  # steps: the last that SAC has
WINDOW_EARLY = (0.53e6, 0.62e6)  # the last that CrossQ has
WINDOW_TODAY = (0.9e6, 1.25e6)  # the last that the first try of symmetric SAC has
WINDOW_LATE = (1.75e6, 2.05e6)  # the last that SAC has
PAIRS = [  # of today's task; "sac-twice" has both tries of symmetric SAC, "sac-symmetric" the whole one
    *(("crossq-symmetric", name, WINDOW_EARLY) for name in ("best-g", "crossq", "sac-twice")),
    *(("sac-symmetric", name, WINDOW_LATE) for name in ("sac-today", "ppo-level-g", "best-g")),
    *(("sac-twice", name, WINDOW_TODAY) for name in ("sac-today", "ppo-level-g", "best-g")),
]


def main():
    paper.parser(__doc__).parse_args()
    jobs = read()
    fig, (axes, falls) = pictures.figure(2, 3, 7.2, sharex="col")
    columns = RUNS, TODAY, {f"sac_tuning_{name}": look for name, look in SETTINGS.items()}
    for above, below, looks in zip(axes, falls, columns, strict=True):
        for name, look in looks.items():
            less.curve(above, jobs[name], *look)
            less.curve(below, jobs[name], *look, what="fall_rate", scale=100)
        above.axhline(LEVEL, color="0.4", lw=1, ls=":")
        above.set_ylim(0, 45)
        pictures.falls(below)
        where = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.24)}
        below.legend(frameon=False, handlelength=2.4, **where)
    axes[0].set_ylabel("evaluated return")
    falls[0].set_ylabel("episodes with a fall, %")
    axes[0].set_xscale("log")
    axes[0].set_title("Earlier task", loc="left")
    axes[1].set_title("Today's task", loc="left")
    axes[1].set(xscale="log", xlim=(2.5e4, 8e6))
    axes[2].set_title("Earlier task: settings of SAC", loc="left")
    for axis in falls[:2]:
        axis.set_xlabel("simulator steps (logarithmic)")
    falls[2].set_xlabel("million simulator steps")
    falls[2].xaxis.set_major_formatter(lambda steps, _: f"{steps / 1e6:g}")
    pictures.head(
        fig,
        f"Go1. Band: {pictures.covers([3, 5, 10])}; right one seed. Dotted: the level, and 1 % falls",
        fontsize=9.5,
    )
    pictures.save(fig, HERE / "peers")
    print(less.table.table({name: jobs[name] for name in RUNS}, 45))
    print(equal_steps(jobs["sac"], jobs["ppo-kl3-g"], WINDOW))
    print(less.table.table({name: jobs[name] for name in TODAY}, 45))
    for one, other, window in PAIRS:
        print(f"{one} and {other}: {beside(jobs[one], jobs[other], window)}")


def read() -> dict[str, list[dict]]:
    """All jobs by name; SAC of today's task is "sac-today", and "crossq" has all seeds of mirrored batches,
    the longer first. What was cut off is apart, but "sac-twice" has all runs of symmetric SAC: of each seed
    two."""
    results, fewer = HERE / "results", HERE.parent / "21_less/results"
    jobs = less.table.read(fewer / "fresh.csv.xz") | less.table.read(fewer / "headline.csv.xz")
    jobs |= less.table.read(results / "mbpo.csv.xz") | less.table.read(results)
    for row in jobs.pop("sac_symmetric"):
        jobs.setdefault("sac-today" if row["name"] == "sac" else row["name"], []).append(row)
    later = less.table.read(results / "fresh")
    jobs["crossq-symmetric"] = later["crossq-256-symmetric-103-107"]
    jobs["crossq"] = later["crossq-256-103-107"] + before(jobs["crossq"])
    cut = [row for row in jobs["sac_symmetric_cut"] if row["name"] == "sac-symmetric"]
    return jobs | {"sac-twice": jobs["sac-symmetric"] + before(cut)}


def before(job) -> list[dict]:
    """Rows of an earlier batch: a table has its seeds after the others."""
    return [row | {"batch": "before"} for row in job]


def by_seed(job, of) -> np.ndarray:
    """`of` of each seed's run, `[S]`; of a seed that ran twice, the mean of both."""
    found = {}
    for run in less.table.seeds(job):
        found.setdefault(run[0]["seed"], []).append(of(run))
    return np.array([np.mean(values) for values in found.values()])


def beside(one, other, window) -> str:
    """Steps to 30, 35 and 38 of `one` less those of `other`, and its return less that in `window`."""
    parts = []
    for level in (30, 35, LEVEL):
        first = functools.partial(less.table.first, level=level)
        pair = [by_seed(job, first) for job in (one, other)]
        if np.isfinite(np.concatenate(pair)).all() and max(map(np.ptp, pair)) > 0:
            gap = stats.difference(*(steps / 1e6 for steps in pair))
            text = f"{gap.value:.2f} M ({gap.low:.2f} to {gap.high:.2f})"
            text += f", {stats.ratio(*pair).value:.2f} times"
            parts.append(f"to {level:g} {text}, p {stats.welch_of(*pair):.2g}")
    return "; ".join([*parts, equal_steps(one, other, window)])


def equal_steps(one, other, window) -> str:
    """How much more `one` returns than `other` in a window, a seed with the mean of its evaluations there;
    one that has none is left out."""

    def inside(run):
        found = [r["return"] for r in run if window[0] <= r["sim_steps"] <= window[1]]
        return np.mean(found or [np.nan])

    means = [by_seed(job, inside) for job in (one, other)]
    found = stats.difference(*means)
    text = f"{window[0] / 1e6} to {window[1] / 1e6} M steps: {found.value:.1f} "
    text += f"({found.low:.1f} to {found.high:.1f}), p {stats.welch_of(*means):.0e}; "
    return text + f"{np.nanmean(means[1]):.1f}"


if __name__ == "__main__":
    main()
