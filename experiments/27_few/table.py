"""Runs of 21_less/run.py with few robots: the return, with falls, after thousands of simulator steps.

    python experiments/27_few/table.py FOLDER_OR_PACKED_FILE [--batch fresh] [--at 10 15 20 27 43]
    python experiments/27_few/table.py experiments/27_few/results/gpu.csv.xz --fresh
    python experiments/27_few/table.py experiments/27_few/results/seconds.csv.xz --seconds [--pack FOLDER]

A row a job: means over its seeds, between two evaluations on a straight line, empty where runs have ended;
the first evaluation at the level (ANYmals 24, else 38), mean and last of the seeds that get there, in
thousands of steps; how many of the seeds walk at the end: from some evaluation on always at the level and
with falls in at most 1 % of the episodes. `--fresh`: of today's `few`, all seeds that no setting was tuned
on, a row a robot (`FRESH`).

`--seconds`: of runs of 30_row_cost/run.py, alone on a card, a row a job, by its number of robots, with its
config where the file has several: thousand steps and seconds to the level, seconds to a walk (mean, last); ms
of an iteration, and of its real rows, fit, tails and PPO, each measured by itself; steps and seconds of a
whole run. Of jobs `default-X` and `best-X` (and `default-X2` ..., more seeds) a line has the ratio of the
seconds to the level, with Fieller's 95 % interval. `--pack` first puts the CSVs that 30_row_cost/run.py wrote
into FOLDER into the file, in place of jobs of the same name.
"""

import csv
import importlib
import io
import lzma
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments import paper, stats

runs = importlib.import_module("experiments.21_less.table")
cost = importlib.import_module("experiments.30_row_cost.table")

# of results/gpu.csv.xz: batches in which today's `few` ran on fresh seeds, and what their jobs are called
FRESH = ("late", "fresh-late-"), ("more", "more-few-")
ROBOTS = runs.ROBOTS  # by the last letter of a job


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("path", type=Path)
    parser.add_argument("--batch", help="of a packed file, this one alone")
    parser.add_argument("--fresh", action="store_true", help="of a packed file, today's `few`")
    parser.add_argument("--at", type=float, nargs="+", default=[10.0, 15.0, 20.0, 27.0, 43.0])
    parser.add_argument("--seconds", action="store_true")
    parser.add_argument("--pack", type=Path, metavar="FOLDER", help="with --seconds")
    args = parser.parse_args()
    if args.pack and not args.seconds:
        parser.error("--pack is of --seconds; runs that share a card: 21_less/pack.py")
    if args.pack:
        pack(args.path, args.pack)
    if args.seconds:
        found = alone(args.path)
        print("\n\n".join([seconds(found), *ratios(found)]))
        return
    print(table(fresh(args.path) if args.fresh else read(args.path, args.batch), args.at))


def read(path: Path, batch: str | None = None) -> dict[str, list[dict]]:
    """`name -> rows`, as 21_less/table.py reads them; but a job of two batches is two, for `few` has changed
    between them: the later is called `NAME of batch K`."""
    jobs = {}
    for name, rows in runs.read(path).items():
        for one in dict.fromkeys(row.get("batch", "") for row in rows):
            if one == (batch or one):
                known = f"{name} of batch {one}" if name in jobs else name
                jobs[known] = [row for row in rows if row.get("batch", "") == one]
    return jobs


def fresh(path: Path) -> dict[str, list[dict]]:
    """`robot -> rows` of all fresh seeds of today's `few`, of every batch."""
    batches = [(read(path, batch), job) for batch, job in FRESH]
    return {
        robot: [row for jobs, job in batches for row in jobs[job + letter]]
        for letter, robot in ROBOTS.items()
    }


def table(jobs: dict[str, list[dict]], at: list[float]) -> str:
    """A line of Markdown for each job, those with the highest return at the end first."""
    heads = ["job", "seeds", *(f"{k:g} k" for k in at), "first at the level (last)", "walk"]
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
                left=np.nan,
                right=np.nan,
            )
            for rows in seeds
        ]
        return float(np.mean(values))

    reached = runs.reached(seeds, level_of(seeds[0]))
    there = reached.level[~np.isnan(reached.level)] / 1e3
    when = f"{there.mean():.1f} ({there.max():.1f})" if len(there) else ""
    never = f"{len(seeds) - len(there)} never" if len(there) < len(seeds) else ""
    returns = [mean("return", k) for k in at]
    points = [
        "" if np.isnan(r) else f"{r:.1f}, {100 * mean('fall_rate', k):.0f} %"
        for k, r in zip(at, returns, strict=True)
    ]
    walk = int((~np.isnan(reached.walks)).sum())
    last = [r for r in returns if not np.isnan(r)]
    cells = [name, str(len(seeds)), *points, ", ".join(filter(None, [when, never])), str(walk)]
    return last[-1] if last else np.nan, cells


def level_of(rows: list[dict]) -> int:
    """The return at which a run's robot follows commands."""
    return 24 if rows[0]["job"].startswith("anymal") else 38


# ---- seconds


class Alone(NamedTuple):
    """Seeds of a job that had a card alone, one after the other."""

    name: str
    config: str  # ROBOT:VARIANT
    robots: int
    level: np.ndarray  # [S, 3]: iteration, simulator steps, seconds; NaN: never
    walks: np.ndarray
    parts: tuple[float, ...]  # ms of an iteration: real rows, fit, tails, PPO
    end: np.ndarray  # [S, 3]: those of the whole run


def pack(path: Path, folder: Path) -> None:
    """The CSVs of a folder into a packed file, in place of jobs of the same name."""
    files = sorted(folder.glob("*.csv"))
    if not files:
        raise SystemExit(f"{folder} has no NAME.csv of 30_row_cost/run.py")
    rows = []
    if path.exists():
        with lzma.open(path, "rt", newline="") as file:
            again = {one.stem for one in files}
            rows = [row for row in csv.DictReader(file) if row["name"] not in again]
    for one in files:
        with one.open(newline="") as file:
            rows += [{"name": one.stem} | row for row in csv.DictReader(file)]
    text = io.StringIO(newline="")
    columns = dict.fromkeys(name for row in rows for name in row)
    writer = csv.DictWriter(text, [*columns], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    path.write_bytes(lzma.compress(text.getvalue().encode(), preset=9))


def alone(path: Path) -> list[Alone]:
    """The jobs of a packed file, those with the fewest robots first."""
    jobs = {}
    with lzma.open(path, "rt", newline="") as file:
        for row in csv.DictReader(file):
            jobs.setdefault(row["name"], {}).setdefault(row["seed"], []).append(row)
    found = [alone_of(name, [*job.values()]) for name, job in jobs.items()]
    return sorted(found, key=lambda x: x.robots)


def alone_of(name: str, each: list[list[dict]]) -> Alone:
    measure = importlib.import_module("experiments.30_row_cost.run")  # with JAX
    first, run = each[0][0], cost.of_job("", "", each)
    job, *fields = first["job"].split()
    config = measure.read(job, fields).config
    tail, rounds = config.schedule.end_steps, config.schedule.rounds
    counts = (config.rollout.horizon - tail, 1, rounds * tail, rounds)
    ms = [float(first[name]) for name in ("row_ms", "fit_ms", "tail_ms", "ppo_ms")]
    parts = tuple(n * x for n, x in zip(counts, ms, strict=True))
    end = np.array([[float(rows[-1][name]) for name in cost.COUNTED] for rows in each])
    return Alone(name, job, config.rollout.num_envs, run.level, run.walks, parts, end)


def seconds(found: list[Alone]) -> str:
    several = len({one.config for one in found}) > 1
    heads = ["config"] * several + [
        "robots",
        "thousand steps to the level",
        "seconds to the level",
        "seconds to a walk",
    ]
    heads += [
        "ms an iteration",
        "real rows + fit + tails + PPO, ms",
        "whole run: thousand steps, s",
    ]
    lines = []
    for one in found:
        ms, whole = 1e3 * one.end[:, 2] / one.end[:, 0], one.end.mean(0)
        cells = [one.config] * several + [
            f"{one.robots}",
            last(one.level[:, 1] / 1e3, 1),
            last(one.level[:, 2], 2),
        ]
        cells += [last(one.walks[:, 2], 1), f"{ms.mean():.1f}"]
        cells += [
            " + ".join(f"{x:.1f}" for x in one.parts),
            f"{whole[1] / 1e3:.1f}, {whole[2]:.1f}",
        ]
        lines.append(cells)
    return paper.markdown(heads, lines)


def ratios(found: list[Alone]) -> list[str]:
    """A line for each X of `default-X` and `best-X`: seconds to the level of one by those of the other. Jobs
    `default-X`, `default-X2`, ... are more seeds of one X. A seed of `best` that does not get there counts
    with all of its run."""
    each: dict[tuple[str, ...], list] = {}
    for one in found:
        if name := re.fullmatch(r"(default|best)-(.*?)\d*", one.name):
            seconds = one.level[:, 2]
            if name[1] == "best":  # one that does not get there, with all of its run
                seconds = np.where(np.isfinite(seconds), seconds, one.end[:, 2])
            each.setdefault(name.groups(), []).append(seconds)
    lines = []
    for kind, x in each:
        if kind != "default" or ("best", x) not in each:
            continue
        both = [np.concatenate(each[kind, x]) for kind in ("default", "best")]
        there = [np.isfinite(seconds) for seconds in both]
        if all(some.all() for some in there):
            ratio = stats.ratio(*both)
            told = f"{ratio.value:.2f} ({ratio.low:.2f} to {ratio.high:.2f})"
        else:  # a mean of those that get there would be too low
            told = " and ".join(f"{some.sum()} of {len(some)} seeds get there" for some in there)
        seeds = " and ".join(str(len(some)) for some in there)
        lines.append(f"seconds to the level, default-{x} by best-{x}, {seeds} seeds: {told}")
    return lines


def last(values, digits: int) -> str:
    """Mean and last seed of those that get there, and how many do where not all."""
    some = values[np.isfinite(values)]
    few = f", {len(some)} of {len(values)}" if len(some) < len(values) else ""
    return f"{some.mean():.{digits}f} ({some.max():.{digits}f}){few}" if len(some) else "never"


if __name__ == "__main__":
    main()
