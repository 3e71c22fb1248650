"""What five seeds of logs.py gained from a log: returns before, and after so many iterations of the policy.

    python experiments/27_few/logs_table.py                       # the table of logs.md, of logs/seeds.csv
    python experiments/27_few/logs_table.py --pack FOLDER ...     # makes that file of what logs.py wrote

A row a case, length of log and noise on the readings: means over seeds of return and falls, and the lowest
and highest return. Returns after iterations are beside the one before: the difference, with a 95 % t interval
over seeds. All seeds are evaluated in the same 64 episodes, so before they are equal.
"""

import csv
from pathlib import Path

import numpy as np

from experiments import paper, stats

SEEDS = Path(__file__).parent / "logs/seeds.csv"
FITTED = 10  # iterations in which the model is fitted and the policy stays


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("--pack", type=Path, nargs="+", metavar="FOLDER")
    args = parser.parse_args()
    if args.pack:
        pack(args.pack)
    print(table(SEEDS))


def pack(folders: list[Path]) -> None:
    rows = []
    for path in sorted(path for folder in folders for path in folder.glob("*.csv")):
        with path.open(newline="") as file:
            rows += csv.DictReader(file)
    with SEEDS.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def table(path: Path) -> str:
    """Markdown."""
    with path.open(newline="") as file:
        rows = [*csv.DictReader(file)]
    keys = ("case", "log_seconds", "sensors")
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    lasts = sorted({int(row["iteration"]) for row in rows if int(row["iteration"]) > FITTED})
    heads = ["case", "log", "noise on readings", "seeds", "before"]
    heads += [f"after {last - FITTED}: return (range), falls; gained" for last in lasts]
    lines = [heads, ["---"] * len(heads)]
    order = ["payload", "motors", "friction"]
    for (case, seconds, sensors), some in sorted(
        groups.items(), key=lambda x: (order.index(x[0][0]), -float(x[0][1]), x[0][2])
    ):
        before = at(some, 0)
        assert len({*map(tuple, before)}) == 1, "seeds have other episodes"
        cells = [case, f"{float(seconds):.0f} s", sensors, str(len(before)), shown(before)]
        for last in lasts:
            after = at(some, last)
            gained = after[:, 0] - before[:, 0]
            half = stats.half_of(stats.moments(gained))
            span = f" ({after[:, 0].min():.1f} to {after[:, 0].max():.1f})"
            returns, falls = shown(after).split(", ")
            cells.append(f"{returns}{span}, {falls}; {gained.mean():+.1f} ± {half:.1f}")
        lines.append(cells)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def at(rows: list[dict], iteration: int) -> np.ndarray:
    """`[S, 2]` return and share of falls of the seeds after so many iterations."""
    some = [row for row in rows if int(row["iteration"]) == iteration]
    return np.array([[float(row["return"]), float(row["fall_rate"])] for row in some])


def shown(values: np.ndarray) -> str:
    returns, falls = values.mean(0)
    return f"{returns:.1f}, {100 * falls:.0f} %"


if __name__ == "__main__":
    main()
