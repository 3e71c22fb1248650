"""What each job of this folder has at its end, and whether it differs from its pair: the tables of README.md.

    python experiments/19_collapse/table.py [FILE.csv.xz]

A cell is the return and the episodes with a fall, in the mean of a job's seeds. Differences are of the return
at the end, with Welch's 95 % interval; p is Welch's by Holm over the table, in which a pair that has not run
counts, too. The verdict is by the rules of README.md, written before the runs.
"""

import csv
import lzma
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments import paper, stats

HERE = Path(__file__).parent
ALPHA, COLLAPSED = 0.05, 0.65  # of PPO-16
NEAR = {"g": 2.0, "h": 2.0, "c": 1.3, "d": 1.3}  # a difference that does not matter, of 45 and 30
ROBOTS = {"g": "Go1", "h": "Go2", "c": "ANYmal-C", "d": "ANYmal-D"}
TAILS = "dyna4", "dyna4-noschedule"


class Pair(NamedTuple):
    """A job beside another one at an iteration; `whole` is the PPO-16 of its setting, if there is one."""

    robot: str
    job: str
    beside: str
    whole: str
    end: int


def pairs(robots, jobs, beside, whole="ppo16", end=300) -> list[Pair]:
    return [Pair(robot, job, beside, whole, end) for job in jobs for robot in robots]


ONE = "raw", "unscaled", "raw-unscaled", "cold", "unmasked", "bootstrap-real", "unanchored"
COLD = "cold-ramp", "cold-epochs"  # came when `cold` had been seen: a table of their own
DOSES = {4: 20, 8: 16, 12: 12, 16: 8}  # a tail's rows, and the real ones of 24
TABLES = {
    "One thing otherwise, beside `tail` (the exact task: PPO-16)": [
        *pairs("gc", ONE, "tail"),
        *pairs("gc", ["exact-tail"], "exact-ppo16", "exact-ppo16"),
    ],
    "New weights in each fit, beside `tail` and `cold`": [
        *pairs("gc", COLD, "tail"),
        *pairs("gc", COLD, "cold"),
    ],
    "New weights in each fit, on eight fresh seeds": [
        *pairs("gc", ["eight-cold", "eight-cold-ramp"], "eight-tail"),
        *pairs("gc", ["eight-cold-ramp"], "eight-cold"),
    ],
    "Anchoring": [
        *pairs("gc", ["rebuilt"], "tail"),
        *pairs("gc", ["unanchored"], "rebuilt"),
        *pairs("gc", ["burn4", "burn16", "burn64", "clean"], "tail"),
        *pairs("gc", ["clean-unanchored"], "clean"),
        *pairs("gc", ["best-rebuilt"], "best-anchored", whole="", end=500),
        *pairs("gc", ["best-unanchored"], "best-rebuilt", whole="", end=500),
    ],
    "Anchors on an ANYmal-D, once more, on five fresh seeds": [  # a rule of its own, alone
        *pairs("d", ["five-unanchored"], "five-rebuilt", whole=""),
    ],
    "Anchors on other robots, beside robots made anew": [
        *pairs("hd", ["unanchored"], "rebuilt", whole=""),
        *pairs("c", ["five-unanchored"], "five-rebuilt", whole=""),
    ],
    "Branching, and its advantages alone": [
        *pairs("gc", ["branch"], "cut"),
        *pairs("gc", ["cut"], "tail"),
    ],
    "How long a tail may be, beside its real rows alone": [
        Pair(robot, f"dose{tail}", f"rows{real}", "rows16", 500)
        for tail, real in DOSES.items()
        for robot in "gc"
    ],
    "16 rows with an idea of `best`, beside its real rows alone": [
        Pair("g", f"dose16-{idea}", "rows8", "rows16", 500) for idea in ("falls", "clean", "both")
    ],
    "ANYmals below the cliff, beside PPO-12": [
        Pair(robot, f"{place}-{tail}", f"{place}-ppo12", f"{place}-ppo16", end)
        for place, end in (("robots1024", 500), ("robots2048", 500), ("own", 300))
        for tail in TAILS
        for robot in "cd"
    ],
}


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("path", type=Path, nargs="?", default=HERE / "results/gpu.csv.xz")
    runs = read(parser.parse_args().path)
    for title, table in TABLES.items():
        print(f"\n### {title}\n\n{shown(runs, table)}")


def read(path: Path) -> dict[str, dict[int, list[dict[str, str]]]]:
    """Rows by job and iteration."""
    runs: dict = {}
    with lzma.open(path, "rt", newline="") as file:
        for row in csv.DictReader(file):
            runs.setdefault(row["name"], {}).setdefault(int(row["iteration"]), []).append(row)
    return runs


WORST = {"return": 0.0, "fall_rate": 1.0}  # of a seed whose numbers are not finite


def values(runs, job: str, iteration: int, column="return") -> list[float]:
    """A number a seed; where it is not finite, that of a robot that only falls."""
    found = [float(row[column]) for row in runs[job][iteration]]
    return [x if math.isfinite(x) else WORST.get(column, math.nan) for x in found]


def cell(runs, job: str, iteration: int) -> str:
    """Mean return and falls."""
    back, falls = (np.mean(values(runs, job, iteration, x)) for x in ("return", "fall_rate"))
    return f"{back:.1f}, {100 * falls:.0f} %"


class Found(NamedTuple):
    """Of a pair: the difference at the end, Holm's p, the share of PPO-16's return, and the verdict."""

    difference: stats.Around
    p: float
    share: float
    verdict: str


def found(runs, table: list[Pair]) -> dict[Pair, Found]:
    """Of the pairs that have run; the others count in Holm's correction."""
    ran = [
        pair
        for pair in table
        if all(pair.end in runs.get(f"{x}-{pair.robot}", {}) for x in pair[1:4] if x)
    ]
    ends = {
        pair: [values(runs, f"{x}-{pair.robot}", pair.end) if x else [] for x in pair[1:4]]
        for pair in ran
    }
    p = stats.holm([stats.welch_of(*ends[pair][:2]) if pair in ends else 1.0 for pair in table])
    out = {}
    for pair, holm in zip(table, p, strict=True):
        if pair in ends:
            job, beside, whole = ends[pair]
            difference = stats.difference(job, beside)
            share = float(np.mean(job) / np.mean(whole)) if whole else math.nan
            out[pair] = Found(difference, holm, share, verdict(pair, difference, holm, share))
    return out


def verdict(pair: Pair, difference: stats.Around, p: float, share: float) -> str:
    """By the rules of README.md; a job may be worse and have collapsed."""
    words = "open"
    if p < ALPHA:
        words = "better" if difference.value > 0 else "worse"
    elif max(-difference.low, difference.high) < NEAR[pair.robot]:
        words = "no difference"
    return f"{words}, **collapsed**" if share < COLLAPSED else words


def shown(runs, table: list[Pair]) -> str:
    """A row a pair that has run."""
    head = "job", "beside", "robot", "at 100", "at its end", "of PPO-16", "difference", "p", ""
    rows = []
    for pair, (difference, p, share, words) in found(runs, table).items():
        job, value = f"{pair.job}-{pair.robot}", "{:+.1f} ({:+.1f} to {:+.1f})"
        cells = [cell(runs, job, 100), cell(runs, job, pair.end), f"{share:.2f}".replace("nan", "")]
        rows.append(
            [f"`{pair.job}`", f"`{pair.beside}`", ROBOTS[pair.robot], *cells]
            + [value.format(*difference), f"{p:.2g}", words]
        )
    return paper.markdown(head, rows) + f"\n\nHolm over {len(table)}; ran: {len(rows)}."


if __name__ == "__main__":
    main()
