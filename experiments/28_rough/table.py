"""How far runs on rough ground get, from results/tuning.csv.xz: README.md's table.

    python experiments/28_rough/table.py [OUT_FOLDER]

Without a folder of `run.py` (NAME.csv): all runs that are kept. A line a seed: after the last evaluation, the
share of tries that crossed their tile, of all; of stairs with steps up to `HIGH` of the robot, up (a pit) and
down (a pyramid); of the other kinds in the two middle rows; and M steps from which on 90 % cross such stairs
and 95 % each other kind (`level`).
"""

import csv
import lzma
import sys
from itertools import groupby
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).parent / "results"
HIGH = {"go1": 0.10, "go2": 0.10, "anymal_c": 0.18, "anymal_d": 0.18}  # m
STEPS = np.linspace(0.05, 0.23, 10)  # m, of the rows
STAIRS, OTHERS = ("pit_stairs", "pyramid_stairs"), ("boxes", "random", "pyramid_slope", "pit_slope")
LEAST = 0.90, 0.95


def main(folder: str = "") -> None:
    heads = "run seed robots M_steps all falls up down boxes random pyramid_slope pit_slope level"
    print("|", " | ".join(heads.split()).replace("_", " "), "|")
    print("|---" * len(heads.split()) + "|")
    for (name, seed), some in groupby(rows(folder), lambda row: (row["name"], row["seed"])):
        some = [*some]
        robot, found = some[0]["job"].split(":")[0], [shares(row) for row in some]
        good = [at_level(each) for each in found]
        since = next((i for i in range(len(good)) if all(good[i:])), None)
        at = "never" if since is None else f"{int(some[since]['sim_steps']) / 1e6:.1f}"
        last, fields = some[-1], dict(f.split("=", 1) for f in some[0]["job"].split()[1:])
        cells = [name, seed, fields.get("rollout.num_envs", "2048")]
        cells += [f"{int(last['sim_steps']) / 1e6:.1f}", f"{float(last['crossed']):.2f}"]
        cells += [f"{float(last['fell']):.2f}", *(f"{x:.2f}" for x in found[-1].values()), at]
        assert robot in HIGH, robot
        print("|", " | ".join(cells), "|")


def rows(folder: str) -> list[dict[str, str]]:
    """Of a folder, or those that are kept, run by run and seed by seed."""
    if folder:
        paths = sorted(Path(folder).glob("*.csv"))
        found = [{"name": p.stem} | row for p in paths for row in csv.DictReader(p.open())]
    else:
        text = lzma.decompress((RESULTS / "tuning.csv.xz").read_bytes()).decode()
        found = [*csv.DictReader(text.splitlines())]
    return sorted(found, key=lambda row: (row["name"], row["seed"]))


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
    main(*sys.argv[1:])
