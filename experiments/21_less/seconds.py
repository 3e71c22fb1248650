"""Seconds and simulator steps until Go1 walks: `best`, and tuned PPO with 256 to 8192 robots.

    python experiments/21_less/seconds.py                        # the table of results/seconds.csv.xz
    python experiments/21_less/seconds.py --add GPU FOLDER ...   # adds or replaces runs: NAME_SEED[_N]

A run is a `dynappo train` of its own, alone on its GPU, with an evaluation every 10 iterations, whose time is
not counted, nor is the start (README.md has the commands). Counted is until the first evaluation at the
level, and until it walks (dynappo/policy/walks.py); the clock is the median of a seed's runs, of which all
but the clock is equal.
"""

import collections
import csv
import lzma
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from experiments import paper, stats

HERE = Path(__file__).parent
RESULTS, LEVEL = HERE / "results/seconds.csv.xz", walks.level(45)
COUNTED = ("iteration", "sim_steps", "seconds")
COLUMNS = "gpu name seed run iteration sim_steps seconds return fall_rate".split()


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--add", metavar="GPU")
    args = parser.parse_args()
    if args.add:
        new = [row for folder in args.folders for row in evaluations(folder, args.add)]
        again = {(row["gpu"], row["run"]) for row in new}
        write([row for row in read() if (row["gpu"], row["run"]) not in again] + new)
    for row in table(read()):
        print("| " + " | ".join(row) + " |")


def read() -> list[dict]:
    if not RESULTS.exists():
        return []
    with lzma.open(RESULTS, "rt", newline="") as file:
        return list(csv.DictReader(file))


def write(rows: list[dict]) -> None:
    with lzma.open(RESULTS, "wt", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)


def evaluations(folder: Path, gpu: str) -> list[dict]:
    """A row an evaluation of the run in `folder`."""
    name, seed = folder.name.split("_")[:2]
    rows = csv.DictReader((folder / "metrics.csv").read_text().splitlines())
    return [  # whole milliseconds
        {"gpu": gpu, "name": name, "seed": seed, "run": folder.name}
        | {"iteration": row["iteration"], "sim_steps": row["sim_steps"]}
        | {"seconds": f"{float(row['seconds']):.3f}"}
        | {"return": row["eval_return"], "fall_rate": row["eval_fall_rate"]}
        for row in rows
        if row["eval_return"]
    ]


def table(rows: list[dict]) -> list[list[str]]:
    """Of each GPU and name, twice: seeds; iterations, million steps and seconds.

    First until they are at the level, then until they walk. Means, with half of their t intervals.
    """
    runs = collections.defaultdict(list)
    for row in rows:
        runs[row["gpu"], row["name"], row["seed"], row["run"]].append(row)
    seeds = collections.defaultdict(list)
    for (gpu, name, seed, _), found in runs.items():
        seeds[gpu, name, seed].append(reached(found))
    lines = collections.defaultdict(list)
    for (gpu, name, _), again in seeds.items():
        lines[gpu, name].append(np.median(again, axis=0))
    head = ("seeds", "iterations", "M steps", "seconds")
    out = [["GPU", "", *(f"{name}: {what}" for name in ("level", "walks") for what in head)]]
    for (gpu, name), found in lines.items():
        level, walking = (np.array(found)[:, i] for i in range(2))
        out.append([gpu, name, *cells(level), *cells(walking)])
    return out


def cells(found) -> list[str]:
    """How many of the seeds `[S, 3]` got there; iterations, million steps and seconds of these."""
    iterations, steps, seconds = np.transpose(found)
    count = int(np.isfinite(seconds).sum())
    some = str(count) if count == len(found) else f"{count} of {len(found)}"
    if not count:
        return [some, "-", "-", "-"]
    return [some, f"{np.nanmean(iterations):.0f}", interval(steps / 1e6), interval(seconds)]


def reached(rows: list[dict]) -> np.ndarray:
    """`[2, 3]`: iteration, simulator steps and seconds to the level, and until it walks; NaN: never."""
    returns, falls = ([float(row[name]) for row in rows] for name in ("return", "fall_rate"))
    found = [
        stats.reached([float(row[name]) for row in rows], returns, falls, LEVEL) for name in COUNTED
    ]
    return np.array([[one.level for one in found], [one.walks for one in found]])


def interval(values) -> str:
    found = stats.moments(values)
    return f"{found.mean:.2f}" + (f" ± {stats.half_of(found):.2f}" if found.n > 1 else "")


if __name__ == "__main__":
    main()
