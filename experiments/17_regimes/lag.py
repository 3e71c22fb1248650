"""Does a motor's memory make the tail without a ramp collapse? lag.csv of the runs in results/lag*.

    python experiments/17_regimes/lag.py

A folder has runs of one lag, with the jobs' names: results/lag those of 20 ms, any other results/lag* those
of another. How long the lag is comes from the runs. Differences are to PPO-16 of the same robot and lag.
Holm's p are over all of the table's, of best and of evaluated returns each. "highest" is the highest
evaluation of any seed.
"""

from pathlib import Path

import numpy as np

from experiments import paper, stats

FIELD = "task.randomize.lag="
VARIANTS = ("ppo12", "dyna4_noschedule", "dyna4", "ppo16")
KINDS = ("best", "evaluated")
COLUMNS = (
    "lag_ms robot variant seeds best_mean best_low best_high best_difference best_difference_low "
    "best_difference_high best_p best_p_holm best_verdict evaluated_mean evaluated_low evaluated_high "
    "evaluated_difference evaluated_difference_low evaluated_difference_high evaluated_p "
    "evaluated_p_holm evaluated_verdict highest falls_pct_mean falls_pct_low falls_pct_high"
).split()


def main():
    make(Path(__file__).parent)


def make(out: Path) -> None:
    rows = build(out / "results")
    paper.write(out / "lag.csv", rows)
    paper.show(rows, COLUMNS)


def build(folder: Path) -> list[dict]:
    """A row a lag, robot and variant; short lags first."""
    rows = []
    for path in sorted(folder.glob("lag*")):
        for robot in paper.ROBOTS:
            runs = {name: paper.load(path, f"{robot}_{name}") for name in VARIANTS}
            runs = {name: one for name, one in runs.items() if one and one.columns}
            rows += [row(robot, name, one, runs.get("ppo16")) for name, one in runs.items()]
    rows.sort(key=lambda cells: cells["lag_ms"])
    for kind in KINDS:
        stats.correct(rows, f"{kind}_")
    return rows


def row(robot: str, variant: str, one: paper.Run, base: paper.Run | None) -> dict:
    """What a variant came to, and how far it is from PPO-16."""
    cells = {"lag_ms": lag(one), "robot": robot, "variant": variant, "seeds": len(paper.peak(one))}
    for kind, mine in zip(KINDS, values(one), strict=True):
        cells |= stats.spread(kind, mine)
        if base and one is not base:
            theirs = dict(zip(KINDS, values(base), strict=True))[kind]
            cells |= stats.compare(mine, theirs, stats.MARGIN[robot], f"{kind}_")
    cells["highest"] = float(np.nanmax(one.columns["eval_return"]))
    falls = 100 * np.array(one.summary["evaluation"]["fall_rate"])
    return cells | stats.spread("falls_pct", falls)


def values(one: paper.Run):
    """Of each seed: its best return, and its return in the last evaluation."""
    return paper.peak(one), one.summary["evaluation"]["return"]


def lag(one: paper.Run) -> float:
    """The time constant of a run's torques, in ms; both ends of its range are the same."""
    text = next(field for field in one.summary["set"] if field.startswith(FIELD))
    low, high = (float(end) for end in text.removeprefix(FIELD).strip("()").split(","))
    assert low == high, text
    return 1000 * low


if __name__ == "__main__":
    main()
