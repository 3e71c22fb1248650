"""The tables in README.md, from results/tuning.csv.xz and results/gait.csv.xz (of `gait.py`).

    python experiments/25_humanoid/table.py

How they walk: a row a policy. What was tried: a row a job, of its seeds: when they walk
(`dynappo/policy/walks.py`, by tracking), in millions of simulator steps, each seed; and the last evaluation,
in the mean: errors and falls.
"""

import csv
import lzma
from itertools import groupby
from pathlib import Path

import numpy as np

from dynappo.policy import walks

RESULTS = Path(__file__).parent / "results"
GAIT = (  # heading, measure, command, format
    ("strides /s", "stride_frequency", "0.5 ahead", "{:.1f}"),
    ("at 1 m/s", "stride_frequency", "1 ahead", "{:.1f}"),
    ("clearance, cm", "clearance", "0.5 ahead", "{:.1f}"),
    ("at 1 m/s", "clearance", "1 ahead", "{:.1f}"),
    ("slip, m/s", "slip", "0.5 ahead", "{:.2f}"),
    ("at 1 m/s", "slip", "1 ahead", "{:.2f}"),
    ("in the air", "flight", "0.5 ahead", "{:.0%}"),
    ("at 1 m/s", "flight", "1 ahead", "{:.0%}"),
    ("0.5 m/s back", "flight", "0.5 back", "{:.0%}"),
    ("duty factor", "duty_factor", "0.5 ahead", "{:.2f}"),
    ("torque", "torque_share", "1 ahead", "{:.0%}"),
    ("arms, rad", "arm_swing", "1 ahead", "{:.2f}"),
    ("torso, rad", "torso_tilt", "1 ahead", "{:.2f}"),
    ("stands, rad/s", "joint_speed", "stand", "{:.2f}"),
    ("turns 0.5", "yaw_error", "turn 0.5", "{:.2f}"),
    ("-0.5", "yaw_error", "turn -0.5", "{:.2f}"),
)
OF_ALL = "run."  # fields that say how it was run, not what was tried


def main():
    gait()
    tuning()


def read(name):
    text = lzma.decompress((RESULTS / name).read_bytes()).decode()
    return [*csv.DictReader(text.splitlines())]


def gait():
    print("| policy |", " | ".join(heading for heading, *_ in GAIT), "|")
    print("|---|" + "---|" * len(GAIT))
    for name, some in groupby(read("gait.csv.xz"), lambda row: row["policy"]):
        found = {row["asked"]: row for row in some}
        cells = []
        for _, measure, asked, text in GAIT:
            value = found[asked][measure]
            scale = 100 if measure == "clearance" else 1
            cells.append(text.format(scale * float(value)) if value else "-")
        print(f"| {name} |", " | ".join(cells), "|")
    print()


def tuning():
    rows = read("tuning.csv.xz")
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
