"""Do four synthetic rows stand in for four real ones where these matter? cliff.csv and cliff.png.

    python experiments/17_regimes/cliff.py

The paper's cliff lies between 12 and 16 rows of 4096 robots, ours between 12 and 20 of 1024.
So the paper's tails there, in rollouts of 16, 20 and 24 rows, beside PPO with all rows
simulated and PPO without the rows that a tail writes. A tail's columns: its best and its evaluated return
less those of PPO with four rows fewer ("fewer_"), with all rows simulated ("all_") and of the tail with a
ramp ("ramp_"), p by Welch and of equality within 1.0 of return (`stats.MARGIN`), both by Holm over the tails
of a batch, and the verdict. The batch "first" had fewer epochs of fitting and MuJoCo Warp's physics
(`table.first`).
"""

from functools import partial
from pathlib import Path

import numpy as np
import table

from experiments import paper, pictures, stats

TAIL, ENVS, ROWS = 4, 1024, (16, 20, 24)
PPO_ROWS = (12, 16, 20, 24)
BEST = (8, 24)  # real rows, all rows
LINE: dict = {"color": pictures.COLOURS["ppo16"], "linewidth": 1.3}
KINDS = ("best", "evaluated")
PREFIXES = [f"{other}_{kind}_" for other in ("fewer", "all", "ramp") for kind in KINDS]
COLUMNS = (
    "batch rows variant status seeds best_mean best_low best_high evaluated_mean evaluated_low "
    "evaluated_high falls_pct_mean limit success_rate_pct sim_steps_M_mean "
    "share_of_all_pct share_of_all_low share_of_all_high share_of_all_bound p_steps_rank"
).split()


def main():
    make(Path(__file__).parent)


def make(out: Path, robots=table.ROBOTS) -> None:
    rows = build(out / "results")
    paper.write(out / "cliff.csv", rows)
    paper.show(rows, COLUMNS)
    for prefix in PREFIXES:
        names = [f"{prefix}{name}" for name in stats.COMPARED]
        paper.show(
            [row for row in rows if f"{prefix}p" in row], ["batch", "rows", "variant", *names]
        )
    draw(out / "results", robots, out / "cliff")


def run(find, envs: int, variant: str, rows: int) -> paper.Run | None:
    """A tail, or "ppo", in rollouts of so many rows; `find` as `table.first`."""
    if variant == "ppo":
        variant = {n: name for name, n in table.PPO.items()}.get(rows, "ppo16")
    return find(table.Regime("", envs), variant, rows)


def build(folder: Path) -> list[dict]:
    """Four rows a length and batch: PPO with fewer rows, the tails, PPO with all rows."""
    batches, out = {"second": partial(table.found, folder), "first": table.first}, []
    for batch, find in batches.items():
        usual = find(table.Regime("", 4096), "ppo16")
        limit = 0.8 * float(paper.peak(usual).mean()) if usual and usual.columns else None
        some = [
            {"batch": batch} | cells(find, name, rows, limit)
            for rows in ROWS
            for name in (f"ppo{rows - TAIL}", *table.TAILS, f"ppo{rows}")
        ]
        for prefix in PREFIXES:
            stats.correct(some, prefix)
        out += some
    return out


def cells(find, name: str, rows: int, limit: float | None) -> dict:
    """What PPO or a tail came to; a tail's returns against PPO's with fewer and with all rows."""
    fewer, every = (run(find, ENVS, "ppo", n) for n in (rows - TAIL, rows))
    is_tail, known = name in table.TAILS, {f"ppo{rows - TAIL}": fewer, f"ppo{rows}": every}
    found = run(find, ENVS, name, rows) if is_tail else known[name]
    others = {"fewer": fewer, "all": every} if is_tail else {}
    if name == "dyna4_noschedule":
        others["ramp"] = run(find, ENVS, "dyna4", rows)
    out = {"envs": ENVS, "rows": rows, "variant": name, "status": paper.status(found)}
    if not (found and found.columns):
        return out
    out["seeds"] = len(paper.peak(found))
    for kind, mine in table.values(found).items():
        out |= stats.spread(kind, mine)
        for other, base in others.items():
            if kind in (theirs := table.values(base)):
                out |= stats.compare(mine, theirs[kind], stats.MARGIN["go1"], f"{other}_{kind}_")
    if evaluation := found.summary.get("evaluation"):
        out |= stats.spread("falls_pct", 100 * np.array(evaluation["fall_rate"]))
    if limit is not None:
        how = paper.reached if len(found.columns["iteration"]) > 100 else paper.tenth
        out |= {"limit": limit} | paper.effort(found, limit, how)
        if is_tail and every and every.columns:
            some = paper.against(found, every, limit, how).items()
            out |= {n.replace("ppo16", "all"): v for n, v in some if "share_of" in n or "rank" in n}
    return out


def draw(folder: Path, robots, path: Path) -> None:
    """Evaluated return and falls over simulated rows, a column for each R; a thin line to all rows, synthetic
    ones too.

    Runs that were not evaluated are left out: PPO's of 20 rows, but for 1024 robots.
    """
    page, axes = pictures.figure(2, len(robots), 5.8, sharey="row", sharex=True)
    names = paper.VARIANTS | {"ppo": "PPO"}
    names["best"] = "best at c27cee7: 8 simulated rows, 16 of the model"
    seeds, find = [], partial(table.found, folder)
    for column, envs in zip(axes.T, robots, strict=True):
        for axis, what in zip(column, ("evaluated", "fell"), strict=True):
            seeds += panel(axis, find, envs, what)
            axis.set(xticks=(8, *PPO_ROWS), xlim=(7, 25))
        column[0].set_title(f"{envs} robots", loc="left")
        column[0].set_ylim(0, 46)
        pictures.falls(column[1])
    pictures.outer(axes, "simulated rows")
    axes[0, 0].set_ylabel("evaluated return")
    axes[1, 0].set_ylabel("episodes with a fall, %")
    for name, variant in (("ppo", "ppo16"), *((name, name) for name in (*table.TAILS, "best"))):
        style = pictures.mark(variant) | {"linestyle": "-" if name == "ppo" else ""}
        axes[0, 0].plot([], [], label=names[name], markersize=5, **style)
    text = "Go1. A thin line goes from the simulated rows to all rows, the model's too: where it meets PPO's,"
    text += "\nthey do what simulated rows would. Best has MuJoCo Warp's physics, all else our kernel's. PPO"
    text += "\nof 20 rows, tails of 20 and 24: 1024 robots only. Dotted: 1 % falls."
    if seeds:
        text += f"\nBar: {pictures.covers(seeds)}"
    pictures.head(page, text, fontsize=9.5)
    pictures.legend(page, axes[0, 0], 2)
    pictures.save(page, path)


def panel(axis, find, envs: int, what: str) -> list[int]:
    """All variants of one R; `what` as in `evaluated`. Returns how many seeds each point has."""
    some = evaluated(find, envs, "ppo", PPO_ROWS, what)
    seeds = points(axis, some, "ppo16")
    axis.plot([n for n, _ in some], [np.mean(values) for _, values in some], **LINE)
    for name, shift in zip(table.TAILS, (-0.3, 0.3), strict=True):  # beside each other
        some = [(n - TAIL, values) for n, values in evaluated(find, envs, name, ROWS, what)]
        seeds += points(axis, some, name, TAIL, shift)
    some = [(BEST[0], values) for _, values in evaluated(find, envs, "best", BEST[1:], what)]
    return seeds + points(axis, some, "best", BEST[1] - BEST[0])


def evaluated(find, envs: int, variant: str, every, what: str) -> list[tuple[int, np.ndarray]]:
    """Rows of a rollout and, where there was an evaluation, its seeds' returns ("evaluated") or per cent of
    episodes with a fall ("fell").
    """
    out = []
    for n in every:
        found = run(find, envs, variant, n)
        values = table.values(found)
        if found and "evaluated" in values:
            falls = 100 * np.array(found.summary["evaluation"]["fall_rate"])
            out.append((n, falls if what == "fell" else values["evaluated"]))
    return out


def points(axis, some, variant: str, synthetic: int = 0, shift: float = 0.0) -> list[int]:
    """Means of `some` (rows, a number a seed) with intervals, moved by `shift`, and a line over the
    `synthetic` rows. Returns how many seeds each has.
    """
    style = pictures.mark(variant)
    for n, values in some:
        cells = stats.spread("x", values)
        axis.vlines(
            n + shift, max(cells["x_low"], 0), cells["x_high"], style["color"], linewidth=1.3
        )
        axis.hlines(cells["x_mean"], n + shift, n + synthetic, style["color"], linewidth=0.9)
        axis.plot(n + shift, cells["x_mean"], markersize=5, **style)
    return [len(values) for _, values in some]


if __name__ == "__main__":
    main()
