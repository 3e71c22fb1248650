"""The table of the tuning runs in README.md, from results/tuning.csv.xz.

    python experiments/25_humanoid/table.py

A row a job, of its seeds: when they walk (`dynappo/policy/walks.py`, by tracking), in millions of simulator
steps, each seed; and the last evaluation, in the mean: errors and falls.
"""

import csv
import lzma
from itertools import groupby
from pathlib import Path

import numpy as np

from dynappo.policy import walks

FILE = Path(__file__).parent / "results" / "tuning.csv.xz"
OF_ALL = "run."  # fields that say how it was run, not what was tried


def main():
    with lzma.open(FILE, "rt") as file:
        rows = [*csv.DictReader(file)]
    print("| run | what differs | walks, M steps | M steps in all | m/s | rad/s | falls |")
    print("|---|---|---|---|---|---|---|")
    for name, some in groupby(rows, lambda row: row["name"]):
        some = [*some]
        seeds = sorted({row["seed"] for row in some})
        of = [[row for row in some if row["seed"] == seed] for seed in seeds]

        def column(key, of=of):
            return np.array([[float(row[key]) for row in seed] for seed in of]).T

        steps, error, yaw, falls = map(
            column, ("sim_steps", "tracking_error", "yaw_error", "fall_rate")
        )
        found = walks.reached_by_tracking(steps, error, yaw, falls).walks / 1e6
        said = ", ".join("never" if np.isnan(x) else f"{x:.2f}" for x in found)
        robot, *fields = some[0]["job"].split()
        last = dict(field.split("=", 1) for field in fields if not field.startswith(OF_ALL))
        differs = " ".join(f"{k.split('.', 1)[1]}={v}" for k, v in last.items())
        print(
            f"| {name} | {robot.split(':')[1]} {differs} | {said} | {steps[-1, 0] / 1e6:.2f} | "
            f"{error[-1].mean():.3f} | {yaw[-1].mean():.3f} | {100 * falls[-1].mean():.1f} % |"
        )


if __name__ == "__main__":
    main()
