"""Simulator steps to fixed evaluated returns, and where runs end, of the CSVs of run.py.

    python experiments/21_less/table.py FOLDER [NAME ...]

Mean over seeds of the first evaluation that reaches a level, and in brackets the last seed's; a seed that
never does is counted as missing. Intervals are Student's t, 95 %.
"""

import csv
from pathlib import Path

import numpy as np
from scipy import stats

from experiments import paper

LEVELS = {45: (20, 30, 35, 38, 40), 30: (15, 20, 22, 24, 25)}  # of the best possible return


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*")
    args = parser.parse_args()
    names = args.names or sorted(path.stem for path in args.folder.glob("*.csv"))
    for top in LEVELS:
        mine = {name: read(args.folder / f"{name}.csv") for name in names}
        mine = {name: rows for name, rows in mine.items() if top == best(rows)}
        if mine:
            print(table(mine, LEVELS[top]), end="\n\n")


def read(path: Path) -> list[dict]:
    """Rows of a CSV, numbers as such."""
    with path.open(newline="") as file:
        return [
            {k: v if k == "job" else float(v) for k, v in row.items()}
            for row in csv.DictReader(file)
        ]


def best(rows) -> int:
    """The best possible return of a job's robot."""
    return 30 if rows[0]["job"].startswith("anymal") else 45


def seeds(rows) -> list[list[dict]]:
    """The rows of each seed, in order."""
    return [[r for r in rows if r["seed"] == s] for s in sorted({r["seed"] for r in rows})]


def first(run: list[dict], level: float, name: str = "sim_steps") -> float:
    """`name` at the first evaluation of a seed that is at least `level`; NaN if none is."""
    return next((row[name] for row in run if row["return"] >= level), np.nan)


def spread(values, digits: int = 1) -> str:
    """Mean and half of its interval."""
    half = stats.t.ppf(0.975, len(values) - 1) * stats.sem(values) if len(values) > 1 else np.nan
    return f"{np.mean(values):.{digits}f} ± {half:.{digits}f}"


def table(jobs: dict[str, list[dict]], levels) -> str:
    """In Markdown, a line a job."""
    head = [
        "",
        "seeds",
        *(f"{level}: M steps" for level in levels),
        "M steps in all",
        "at the end",
        "falls",
    ]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name, rows in jobs.items():
        runs = seeds(rows)
        cells = [name, str(len(runs))]
        for level in levels:
            steps = np.array([first(run, level) / 1e6 for run in runs])
            gone = int(np.isnan(steps).sum())
            some = f"{np.nanmean(steps):.2f} ({np.nanmax(steps):.2f})" if gone < len(steps) else "-"
            cells.append(some + (f", {gone} never" if gone else ""))
        last = [run[-1] for run in runs]
        cells.append(f"{last[0]['sim_steps'] / 1e6:.1f}")
        cells.append(spread([row["return"] for row in last]))
        cells.append(f"{100 * np.mean([row['fall_rate'] for row in last]):.1f} %")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
