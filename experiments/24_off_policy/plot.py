"""Evaluated return and falls over simulator steps, Go1: peers.png, and the table of README.md.

    python experiments/24_off_policy/plot.py

Left are means over five seeds (FastTD3: three) with their 95 % t interval; runs that were cut off end where
the shortest does.
Right are the five settings of SAC, one seed each.
"""

import importlib
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from experiments import paper, pictures, stats

less = importlib.import_module("experiments.21_less.plot")

HERE = Path(__file__).parent
RUNS = {  # name in the results -> label, colour, dashes
    "new-g": ("best", pictures.BLUE, "-"),
    "mbpo-g": ("MBPO-like, ours", pictures.GREEN, (0, (3, 1.2))),
    "sac": ("SAC", pictures.VERMILION, "-"),
    "fasttd3": ("FastTD3, three seeds", pictures.PURPLE, (0, (5, 1.2, 1, 1.2))),
    "ppo-kl3-g": ("PPO, tuned (256 robots)", pictures.ORANGE, (0, (1, 1))),
    "ppo16-g": ("PPO-16, 4096 robots", pictures.BLACK, (0, (5, 1.2))),
}
SETTINGS = {  # of SAC; by their gain of actions
    "a": ("a: gain 3", pictures.BLACK, "-"),
    "c": ("c: gain 2", pictures.SKY, "-"),
    "d": ("d: gain 2, 1024 robots", pictures.SKY, (0, (3, 1.2))),
    "b": ("b: gain 1.5", pictures.VERMILION, (0, (3, 1.2))),
    "e": ("e: gain 1.5 (chosen)", pictures.VERMILION, "-"),
}
LEVEL = walks.level(45)
WINDOW = (2.2e6, 2.5e6)  # steps: the last that SAC has


def main():
    paper.parser(__doc__).parse_args()
    results = HERE / "results"
    jobs = less.table.read(HERE.parent / "21_less/results/fresh.csv.xz")
    jobs |= less.table.read(results / "mbpo.csv.xz") | less.table.read(results)
    fig, (axes, falls) = pictures.figure(2, 2, 6.4, sharex="col")
    axes[0].set_xscale("log")
    columns = RUNS, {f"sac_tuning_{name}": look for name, look in SETTINGS.items()}
    for above, below, looks in zip(axes, falls, columns, strict=True):
        for name, look in looks.items():
            less.curve(above, jobs[name], *look)
            less.curve(below, jobs[name], *look, what="fall_rate", scale=100)
        above.axhline(LEVEL, color="0.4", lw=1, ls=":")
        above.set_ylim(0, 45)
        pictures.falls(below)
        where = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.24), "ncols": 2}
        below.legend(frameon=False, columnspacing=1.2, handlelength=2.4, **where)
    axes[0].set_ylabel("evaluated return")
    falls[0].set(xlabel="simulator steps (logarithmic)", ylabel="episodes with a fall, %")
    axes[0].set_title("Peers, five seeds each but FastTD3", loc="left")
    falls[1].set_xlabel("million simulator steps")
    falls[1].xaxis.set_major_formatter(lambda steps, _: f"{steps / 1e6:g}")
    axes[1].set_title("Settings of SAC, one seed", loc="left")
    pictures.head(
        fig, f"Go1. Band: {pictures.covers([3, 5])}. Dotted: the level, and 1 % falls", fontsize=9.5
    )
    pictures.save(fig, HERE / "peers")
    print(less.table.table({name: jobs[name] for name in RUNS}, 45))
    print(equal_steps(jobs["sac"], jobs["ppo-kl3-g"]))


def equal_steps(one, other) -> str:
    """How much more `one` returns than `other` in `WINDOW`, a seed with the mean of its evaluations there."""
    means = []
    for job in (one, other):
        runs = [
            [r["return"] for r in run if WINDOW[0] <= r["sim_steps"] <= WINDOW[1]]
            for run in less.table.seeds(job)
        ]
        means.append([np.mean(returns) for returns in runs])
    found = stats.difference(*means)
    text = f"{WINDOW[0] / 1e6} to {WINDOW[1] / 1e6} M steps: {found.value:.1f} "
    text += f"({found.low:.1f} to {found.high:.1f}), p {stats.welch_of(*means):.0e}; "
    return text + f"{np.mean(means[1]):.1f}"


if __name__ == "__main__":
    main()
