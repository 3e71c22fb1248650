"""What rules that were written before their runs say of these: the numbers that they ask for, and a verdict.

    python experiments/27_few/rules.py

Of results/gpu.csv.xz: batch `default`, whether 256 robots become the default (README.md; its seconds:
`table.py --seconds`); `more`, whether spread commands become part of `few`; `recent`, whether fresh seeds
shall decide on rows that weigh less with age (parts.md). A rule is open until all of its runs are there, at
one commit.
"""

import csv
import importlib
from pathlib import Path

import numpy as np

from dynappo.run import learning_curves as curves
from experiments import paper

few = importlib.import_module("experiments.27_few.table")
runs = few.runs

ROBOTS = {"g": "go1", "h": "go2", "c": "anymal_c", "d": "anymal_d"}
RUNS = Path(__file__).parent / "results/gpu.csv.xz"
HEADLINE = Path(__file__).parents[1] / "21_less/results/headline.csv.xz"
NUMBERS = Path(__file__).parents[2] / "docs/numbers.csv"
LAST = 4  # evaluations at the end
QUARTER, WALK, SEEDS = 1 / 4, 38, 10  # of `best`'s steps to the level; seeds of all; of a robot
MARGINS = {45: 1.0, 30: 0.7}  # of return, by the best possible one
FALLS, ERROR = 0.005, 0.02  # share of episodes; m/s


def main():
    paper.parser(__doc__).parse_args()
    with NUMBERS.open(newline="") as file:
        numbers = {row["name"]: row["value"] for row in csv.DictReader(file)}
    more, recent = few.read(RUNS, "more"), few.read(RUNS, "recent")
    print(*default(few.read(RUNS, "default"), runs.read(HEADLINE), numbers), "", sep="\n")
    print(*pairs(more, "more-spread", "more-few", fewer_falls, 60, walking=True), "", sep="\n")
    print(*pairs(recent, "control-recent", "part-whole", sooner, 20), sep="\n")


def default(jobs: dict, headline: dict, numbers: dict[str, str]) -> list[str]:
    """Rules 1 to 3 of "256 robots: the next default?"; `numbers` are those of docs/numbers.csv."""
    lines, met, walking, there = ["256 robots as the default:"], [], 0, True
    for letter, robot in ROBOTS.items():
        name = f"default-{letter}"
        if name not in jobs:
            lines.append(f"  {robot}: no {name}, so the rule is open")
            there = False
            continue
        mine, level = runs.seeds(jobs[name]), few.level_of(jobs[name])
        found = runs.reached(mine, level)
        most = QUARTER * 1e6 * float(numbers[f"{robot} first at {level}"])
        broken = sum(any(lost(row) for row in run) for run in mine)
        back, fell, error = ends(mine)
        best = ends(runs.seeds(headline[f"best-{letter}"]))
        margin = MARGINS[runs.best(jobs[name])]
        whole = len(mine) == SEEDS and np.isfinite(found.level).all() and not broken
        one = bool(whole and found.level.mean() <= most)
        three = bool(back >= best[0] - margin and fell <= FALLS and error <= best[2] + ERROR)
        met += [one, three]
        walking += int(np.isfinite(found.walks).sum())
        lines += [
            f"  {robot}, {len(mine)} seeds: first at {level} after {thousand(found.level)}, at most "
            f"{most / 1e3:.1f}; {broken} not finite: rule 1 is {word(one)}",
            f"    walk: {thousand(found.walks)}",
            f"    end: return {back:.2f} (`best` {best[0]:.2f}, margin {margin}), falls "
            f"{100 * fell:.2f} % (at most {100 * FALLS:g}), error {error:.3f} m/s (`best` {best[2]:.3f}, "
            f"margin {ERROR}): rule 3 is {word(three)}",
        ]
    if there:
        met.append(walking >= WALK)
        lines.append(f"  {walking} of {SEEDS * len(ROBOTS)} walk: rule 2 is {word(met[-1])}")
        lines.append(f"  rules 1 to 3 are {'all met' if all(met) else 'not all met'}")
    return lines


def lost(row: dict) -> bool:
    """Whether a seed's numbers were no longer finite: its robots fall then, and their return is a number."""
    return not all(np.isfinite(row.get(name, 0.0)) for name in ("return", "policy_std", "kl"))


def ends(seeds: list) -> np.ndarray:
    """Means of the seeds' last evaluations: return, share of falls, error in m/s."""
    names = ("return", "fall_rate", "tracking_error")
    return np.array([np.mean([[r[n] for r in run[-LAST:]] for run in seeds]) for n in names])


def pairs(jobs: dict, one: str, base: str, measure, count: int, walking: bool = False) -> list[str]:
    """`one` less `base`, a pair a seed, by robot and over all that have both; `measure(with, without)` is
    what a pair differs by, and what that is called. The rule is of `count` pairs; with `walking` no fewer
    seeds may walk."""
    lines, every, walk = [f"{one} beside {base}:"], [], np.zeros(2, int)
    for letter, robot in ROBOTS.items():
        names = f"{one}-{letter}", f"{base}-{letter}"
        if missing := [name for name in names if name not in jobs]:
            lines.append(f"  {robot}: left out, no {' and no '.join(missing)}")
            continue
        both = [runs.seeds(jobs[name]) for name in names]
        for what in ("seed", "commit"):
            found = [[run[0].get(what, "") for run in some] for some in both]
            if found[0] != found[1]:
                raise SystemExit(f"{' and '.join(names)} have another {what}, expected pairs")
        differ, what = measure(*both)
        level = few.level_of(jobs[names[0]])
        walks = [int(np.isfinite(runs.reached(some, level).walks).sum()) for some in both]
        every.append(differ)
        walk += walks
        lines.append(f"  {robot}: {around(differ)} {what}; {walks[0]} and {walks[1]} walk")
    if every:
        differ = np.concatenate(every)
        low, high = curves.interval(differ)
        kept = bool(high < 0 and not (walking and walk[0] < walk[1]))
        there = len(differ) == count
        lines.append(f"  all: {around(differ)} {what}; {walk[0]} and {walk[1]} walk")
        verdict = "" if high < 0 else " not"
        rule = word(kept) if there else f"open, with {len(differ)} of {count} pairs"
        lines.append(f"  a difference below 0 is{verdict} shown: the rule is {rule}")
    return lines


def fewer_falls(one: list, base: list) -> tuple[np.ndarray, str]:
    """Points of per cent of episodes with a fall, last evaluations."""
    fell = [
        [np.mean([r["fall_rate"] for r in run[-LAST:]]) for run in some] for some in (one, base)
    ]
    return 100 * np.subtract(*fell), "points of falls"


def sooner(one: list, base: list) -> tuple[np.ndarray, str]:
    """Thousand steps to the level; a seed that never gets there counts with all of its run."""
    steps = []
    for some in (one, base):
        level = runs.reached(some, few.level_of(some[0])).level
        steps.append(np.where(np.isfinite(level), level, [run[-1]["sim_steps"] for run in some]))
    return np.subtract(*steps) / 1e3, "thousand steps to the level"


def around(differ: np.ndarray) -> str:
    low, high = curves.interval(differ)
    return f"{differ.mean():+.2f} ({low:.2f} to {high:.2f}, {len(differ)} pairs)"


def thousand(steps: np.ndarray) -> str:
    """Mean and last of the seeds that get there, and how many never do."""
    some, gone = steps[np.isfinite(steps)] / 1e3, int(np.isnan(steps).sum())
    told = f"{some.mean():.1f} k (last {some.max():.1f})" if len(some) else "never"
    return told + f", {gone} never" * bool(gone and len(some))


def word(met: bool) -> str:
    return "met" if met else "not met"


if __name__ == "__main__":
    main()
