"""How far runs on rough ground get: README.md's tables, from results/*.csv.xz.

    python experiments/28_rough/table.py [results/FILE.csv.xz | OUT_FOLDER] [--robots] [--batch NAME]

Without a name the runs of results/tuning.csv.xz; a folder is one of `run.py` (NAME.csv). A line a seed: after
the last evaluation, the share of tries that crossed their tile, of all; of stairs with steps up to `HIGH` of
the robot, up (a pit) and down (a pyramid); of the other kinds in the two middle rows; M steps from which on
90 % cross such stairs and 95 % each other kind (`level`). `--robots`: a line a run, means over its seeds with
the worst seed in brackets; of those that get to the level, the mean and the last, and how many they are.
"""

import argparse
import csv
import lzma
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

RESULTS = Path(__file__).parent / "results"
HIGH = {"go1": 0.10, "go2": 0.10, "anymal_c": 0.18, "anymal_d": 0.18}  # m
STEPS = np.linspace(0.05, 0.23, 10)  # m, of the rows
STAIRS, OTHERS = ("pit_stairs", "pyramid_stairs"), ("boxes", "random", "pyramid_slope", "pit_slope")
LEAST = 0.90, 0.95
KINDS = ["up", "down", *(kind.replace("_", " ") for kind in OTHERS)]


class Run(NamedTuple):
    """One seed of a run: what it could at its end, and when it got to the level."""

    name: str
    seed: str
    robots: str
    steps: float  # M
    shares: np.ndarray  # crossed of all, fell of all, crossed of KINDS
    level: float  # M steps; infinite: never


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("what", nargs="?", default="")
    parser.add_argument("--robots", action="store_true", help="a line a run, means and worst seeds")
    parser.add_argument("--batch", help="of the file: only this")
    args = parser.parse_args()
    found = [*runs([row for row in rows(args.what) if args.batch in (None, row.get("batch"))])]
    print("\n".join(by_robot(found) if args.robots else by_seed(found)))


def by_seed(found: list[Run]) -> list[str]:
    """The lines of a table with one a seed."""
    lines = head("run", "seed", "robots", "M steps", "all", "falls", *KINDS, "level")
    for run in found:
        level = f"{run.level:.1f}" if run.level < np.inf else "never"
        numbers = [f"{run.steps:.1f}", *(f"{x:.2f}" for x in run.shares), level]
        lines.append(line(run.name, run.seed, run.robots, *numbers))
    return lines


def by_robot(found: list[Run]) -> list[str]:
    """The lines of a table with one a run: means over seeds, and in brackets the worst."""
    lines = head("run", "seeds", "all", "falls", *KINDS, "level: mean (last)", "get there")
    for name, some in groupby(found, lambda run: run.name):
        some = [*some]
        shares = np.array([run.shares for run in some])
        worst = np.where(np.arange(shares.shape[1]) == 1, shares.max(0), shares.min(0))
        cells = [f"{x:.2f} ({y:.2f})" for x, y in zip(shares.mean(0), worst, strict=True)]
        levels = [run.level for run in some if run.level < np.inf]
        level = f"{np.mean(levels):.1f} ({max(levels):.1f})" if levels else "never"
        lines.append(line(name, len(some), *cells, level, f"{len(levels)} of {len(some)}"))
    return lines


def head(*names: str) -> list[str]:
    return [line(*names), "|---" * len(names) + "|"]


def line(*cells) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def runs(rows: list[dict[str, str]]) -> Iterator[Run]:
    """The seeds of the runs, by name."""
    for (_, name, seed), some in groupby(rows, key):
        some = [*some]
        found, last = [shares(row) for row in some], some[-1]
        good = [at_level(each) for each in found]
        since = next((i for i in range(len(good)) if all(good[i:])), None)
        fields = dict(field.split("=", 1) for field in last["job"].split()[1:])
        yield Run(
            name,
            seed,
            fields.get("rollout.num_envs", "2048"),
            int(last["sim_steps"]) / 1e6,
            np.array([float(last["crossed"]), float(last["fell"]), *found[-1].values()]),
            np.inf if since is None else int(some[since]["sim_steps"]) / 1e6,
        )


def key(row: dict[str, str]) -> tuple[str, str, str]:
    """What the rows of one seed have in common; a name may be in two batches."""
    return row.get("batch", ""), row["name"], row["seed"]


def rows(what: str = "") -> list[dict[str, str]]:
    """Of a folder or a packed file, without a name of results/tuning.csv.xz, run by run and seed by seed."""
    file = Path(what) if what else RESULTS / "tuning.csv.xz"
    if file.is_dir():
        paths = sorted(file.glob("*.csv"))
        found = [{"name": p.stem} | row for p in paths for row in csv.DictReader(p.open())]
    else:
        text = lzma.decompress(file.read_bytes()).decode()
        found = [*csv.DictReader(text.splitlines())]
    return sorted(found, key=key)


def shares(row: dict[str, str]) -> dict[str, float]:
    """Of tries that crossed: up and down stairs of at most `HIGH`, and other kinds in the middle rows."""
    low = HIGH[row["job"].split(":")[0]] + 1e-6 >= STEPS
    each = {kind: np.array(row[kind].split(), float) for kind in STAIRS + OTHERS}
    stairs = {way: each[kind][low].mean() for way, kind in zip(("up", "down"), STAIRS, strict=True)}
    return stairs | {kind: each[kind][4:6].mean() for kind in OTHERS}


def at_level(found: dict[str, float]) -> bool:
    stairs, others = LEAST
    return all(x >= (stairs if name in ("up", "down") else others) for name, x in found.items())


if __name__ == "__main__":
    main()
