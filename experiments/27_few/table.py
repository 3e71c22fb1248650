"""Runs of 21_less/run.py with few robots: the return, with falls, after thousands of simulator steps.

    python experiments/27_few/table.py FOLDER [--at 17.4 27.6 43]

A row a job: means over its seeds, between two evaluations on a straight line, empty where runs have ended;
the first evaluation at the level (ANYmals 24, else 38), mean over the seeds that get there; the seconds of
training.
"""

import importlib
from pathlib import Path

import numpy as np

from experiments import paper

runs = importlib.import_module("experiments.21_less.table")


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--at", type=float, nargs="+", default=[17.4, 27.6, 43.0])
    args = parser.parse_args()
    print(table(runs.read(args.folder), args.at))


def table(jobs: dict[str, list[dict]], at: list[float]) -> str:
    """A line of Markdown for each job, those with the highest return at the end first."""
    heads = ["job", "seeds", *(f"{k:g} k" for k in at), "first at the level, k", "s"]
    lines = [line(name, runs.seeds(rows), at) for name, rows in jobs.items()]
    lines.sort(key=lambda one: -one[0])
    return "\n".join(
        f"| {' | '.join(cells)} |"
        for cells in [heads, ["---"] * len(heads), *(x[1] for x in lines)]
    )


def line(name: str, seeds: list[list[dict]], at: list[float]) -> tuple[float, list[str]]:
    """`(the last return of the row, cells)` of a job."""

    def mean(column, k):
        values = [
            np.interp(
                1e3 * k,
                [r["sim_steps"] for r in rows],
                [r[column] for r in rows],
                right=np.nan,
            )
            for rows in seeds
        ]
        return float(np.mean(values))

    level = 24 if seeds[0][0]["job"].startswith("anymal") else 38
    first = [
        next((r["sim_steps"] / 1e3 for r in rows if r["return"] >= level), None) for rows in seeds
    ]
    there = [k for k in first if k is not None]
    never = f"{len(first) - len(there)} never" if len(there) < len(first) else ""
    reached = ", ".join(filter(None, [f"{np.mean(there):.1f}" if there else "", never]))
    returns = [mean("return", k) for k in at]
    points = [
        "" if np.isnan(r) else f"{r:.1f}, {100 * mean('fall_rate', k):.0f} %"
        for k, r in zip(at, returns, strict=True)
    ]
    seconds = np.mean([rows[-1]["seconds"] for rows in seeds])
    last = [r for r in returns if not np.isnan(r)]
    return last[-1], [name, str(len(seeds)), *points, reached, f"{seconds:.0f}"]


if __name__ == "__main__":
    main()
