"""How far runs on rough ground get: the tables of README.md and the pages beside it, from results/*.csv.xz.

    python experiments/28_rough/table.py [results/FILE.csv.xz | OUT_FOLDER] [--robots] [--batch NAME] [--to M]
    python experiments/28_rough/table.py --ppo
    python experiments/28_rough/table.py results/fresh.csv.xz --batch fresh --rows

Without a name the runs of results/tuning.csv.xz; a folder is one of `run.py` (NAME.csv). A line a seed: after
the last evaluation, the share of tries that crossed their tile, of all; of stairs with steps up to `HIGH` of
the robot, up (a pit) and down (a pyramid); of the other kinds in the two middle rows; M steps from which on
90 % cross such stairs and 95 % each other kind (`level`). `--robots`: a line a run, means over its seeds with
the worst seed in brackets; of those that get to the level, the mean and the last, and how many they are.
`--to`: as if runs had ended after so many M steps.
`--ppo`: M steps that today's PPO needs beside `best`, and how many times as many. `--rows`: a line a run and
kind, the share that crossed in each row of difficulty, in the mean over seeds.
"""

import argparse
import csv
import lzma
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments import stats

RESULTS = Path(__file__).parent / "results"
HIGH = {"go1": 0.10, "go2": 0.10, "anymal_c": 0.18, "anymal_d": 0.18, "g1": 0.10}  # m
STEPS = np.linspace(0.05, 0.23, 10)  # m, of the rows
STEPS_OF = {"g1": np.linspace(0.0, 0.15, 10)}  # where they are others
STAIRS, OTHERS = ("pit_stairs", "pyramid_stairs"), ("boxes", "random", "pyramid_slope", "pit_slope")
LEAST = 0.90, 0.95
KINDS = ["up", "down", *(kind.replace("_", " ") for kind in OTHERS)]
# PPO -> its `best`
PPO = {
    "go2-ppo-1024": "go2-best",
    "go2-ppo-2048": "go2-best",
    "go2-ppo-4096": "go2-best",
    "go2-ppo-gamma": "go2-best",
    "go2-ppo-kl1": "go2-best",
    "go2-ppo-late": "go2-best",
    "anymal_c-ppo-2048": "anymal_c-best",
    "anymal_c-ppo-4096": "anymal_c-best",
    "anymal_c-ppo-kl1": "anymal_c-best",
}
# runs with the same settings until the second one's smaller KL, and M steps of then
ONE, OTHER, UNTIL = "go2-ppo-4096", "go2-ppo-late", 88.5
# batches at today's settings
TODAY = ("fresh", "fresh-ppo", "one-commit-4", "one-commit-5", "one-commit-6")
CROSSED = (0.7, 0.8, 0.9)  # of all tiles
WHEN = [*(f"{share:.0%} of tiles".replace("%", " %") for share in CROSSED), "at the level", "kept"]


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
    parser.add_argument("--to", type=float, default=np.inf, metavar="M", help="only up to M steps")
    parser.add_argument("--ppo", action="store_true", help="steps of PPO beside those of `best`")
    parser.add_argument("--rows", action="store_true", help="a line a run and kind, by row")
    args = parser.parse_args()
    if args.ppo:
        print("\n".join(beside_ppo(paces())))
        return
    asked = [row for row in rows(args.what) if args.batch in (None, row.get("batch"))]
    asked = [row for row in asked if int(row["sim_steps"]) <= 1e6 * args.to]
    if args.rows:
        print("\n".join(by_row(asked)))
        return
    found = [*runs(asked)]
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


def by_row(asked: list[dict[str, str]]) -> list[str]:
    """The lines of a table with one a run and kind: shares of tries that crossed, of each row, at the end."""
    lines = head("run", "kind", *map(str, range(len(STEPS))))
    for name, some in groupby(asked, lambda row: row["name"]):
        last = {row["seed"]: row for row in some}.values()
        for kind in (*STAIRS, *OTHERS):
            each = np.array([row[kind].split() for row in last], float)
            shares = (f"{x:.2f}" for x in np.nanmean(each, 0))
            lines.append(line(name, kind.replace("_", " "), *shares))
    return lines


class Pace(NamedTuple):
    """When the seeds of a run get how far: M steps, NaN for never."""

    name: str
    robots: str
    when: np.ndarray  # [seeds, WHEN]
    steps: float  # M, of the whole run


def paces() -> dict[str, Pace]:
    """Of today's PPO and its `best`, by name."""
    asked = {*PPO, *PPO.values()}
    runs = groupby(today(), lambda row: row["name"])
    return {name: pace(name, [*some]) for name, some in runs if name in asked}


def today() -> list[dict[str, str]]:
    """The rows of runs at today's settings, run by run and seed by seed."""
    both = [*rows(str(RESULTS / "fresh.csv.xz")), *rows()]
    return [row for row in both if row["batch"] in TODAY]


def pace(name: str, mine: list[dict[str, str]]) -> Pace:
    """Of one run's rows. The share of tiles is taken to grow along a straight line between two evaluations;
    the level counts from an evaluation on: the first that is there, and that from which on all are."""
    when = []
    for _, some in groupby(mine, key):
        some = [*some]
        steps = np.array([int(row["sim_steps"]) for row in some]) / 1e6
        crossed = np.array([float(row["crossed"]) for row in some])
        good = np.array([at_level(shares(row)) for row in some])
        kept = np.logical_and.accumulate(good[::-1])[::-1]
        levels = [steps[at.argmax()] if at.any() else np.nan for at in (good, kept)]
        when.append([*(first(steps, crossed, share) for share in CROSSED), *levels])
    return Pace(name, robots(mine[-1]), np.array(when), int(mine[-1]["sim_steps"]) / 1e6)


def first(steps: np.ndarray, crossed: np.ndarray, share: float) -> float:
    """Where `crossed` is first at `share`, on straight lines from 0 at 0 through all; NaN: never."""
    there = np.flatnonzero(crossed >= share)
    if not len(there):
        return np.nan
    i, steps, crossed = there[0], np.append(0, steps), np.append(0, crossed)
    return float(np.interp(share, crossed[i : i + 2], steps[i : i + 2]))


def beside_ppo(found: dict[str, Pace]) -> list[str]:
    """Two tables, a line a run of PPO: M steps as mean (first to last seed) of those that get there, beside
    `best`; and how many times those of `best`, with Fieller's 95 % interval (`stats.share`) where it is
    bounded and both have three seeds or more: that of two says nothing. The last line is of `together`."""
    names = list(dict.fromkeys(name for ppo, best in PPO.items() for name in (best, ppo)))
    lines = head("run", "robots", "M steps", *WHEN)
    for run in (found[name] for name in names):
        lines.append(line(run.name, run.robots, f"{run.steps:.1f}", *map(spread, run.when.T)))
    lines += ["", *head("times `best`", "seeds", *WHEN)]
    pairs = [(found[name], found[of]) for name, of in PPO.items()]
    if {ONE, OTHER} <= found.keys():
        pairs.append((together(found[ONE], found[OTHER]), found[PPO[ONE]]))
    for ppo, best in pairs:
        cells = [
            times(stats.share(one, other, ppo.steps, best.steps), min(len(one), len(other)))
            for one, other in zip(ppo.when.T, best.when.T, strict=True)
        ]
        lines.append(line(ppo.name, f"{len(ppo.when)} and {len(best.when)}", *cells))
    return lines


def together(one: Pace, other: Pace) -> Pace:
    """The seeds of both, as long as their settings were the same; what is kept is known at the end alone."""
    when = np.concatenate([one.when, other.when])
    assert np.nanmax(when[:, :-1]) < UNTIL
    when[:, -1] = np.nan
    return Pace(f"{one.name} and {other.name.rpartition('-')[2]}", one.robots, when, one.steps)


def spread(steps: np.ndarray) -> str:
    """`mean (first to last)` of the seeds that have a number, and of how many if not all have."""
    some = steps[np.isfinite(steps)]
    if not len(some):
        return "never"
    count = f"; {len(some)} of {len(steps)}" if len(some) < len(steps) else ""
    return f"{some.mean():.1f} ({some.min():.1f} to {some.max():.1f}{count})"


def times(cells: dict, seeds: int) -> str:
    """A cell of `stats.share`, per cent as a factor; the fewer `seeds` of the two runs."""
    if not cells:
        return "-"
    factor = f"{cells['pct'] / 100:.1f}"
    if "bound" in cells:
        return f"{cells['bound']} {factor}"
    ends = f" ({cells['low'] / 100:.1f} to {cells['high'] / 100:.1f})"
    return factor + (ends if seeds > 2 and np.isfinite(cells["low"]) else "")


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
        yield Run(
            name,
            seed,
            robots(last),
            int(last["sim_steps"]) / 1e6,
            np.array([float(last["crossed"]), float(last["fell"]), *found[-1].values()]),
            np.inf if since is None else int(some[since]["sim_steps"]) / 1e6,
        )


def robots(row: dict[str, str]) -> str:
    """How many its job has."""
    fields = dict(field.split("=", 1) for field in row["job"].split()[1:])
    return fields.get("rollout.num_envs", "2048")


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
    robot = row["job"].split(":")[0]
    low = HIGH[robot] + 1e-6 >= STEPS_OF.get(robot, STEPS)
    each = {kind: np.array(row[kind].split(), float) for kind in STAIRS + OTHERS}
    stairs = {way: each[kind][low].mean() for way, kind in zip(("up", "down"), STAIRS, strict=True)}
    return stairs | {kind: each[kind][4:6].mean() for kind in OTHERS}


def at_level(found: dict[str, float]) -> bool:
    stairs, others = LEAST
    return all(x >= (stairs if name in ("up", "down") else others) for name, x in found.items())


if __name__ == "__main__":
    main()
