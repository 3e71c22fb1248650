"""The tables of this folder's pages, from the files in results/.

    python experiments/25_humanoid/table.py

Fresh (tuning.csv.xz): seeds that chose no setting. Alone (alone.csv): one run on a card, in seconds. How they
walk (gait.csv.xz, of `gait.py`): a row a policy. Then a row a job of tuning.csv.xz, batch by batch: when its
seeds walk (`dynappo/policy/walks.py`, by tracking), in millions of simulator steps; and the last evaluation,
in the mean: errors and falls.
"""

import csv
import lzma
import re
from itertools import groupby
from pathlib import Path

import numpy as np

from experiments import stats

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
SHOULDERS = re.compile(r"task.posture_std=\S+")
CLOCK = (  # what `configs/g1.py` has had since
    "task.gait_frequency=(1.25,1.5) task.weights.feet_phase=1.0 task.weights.feet_air_time_biped=0.0"
)
SMOOTH = "task.weights.foot_slip=-0.5 task.weights.action_rate=-0.03"


# what is under one heading: batches of tuning.csv.xz
PARTS = {
    "What each part is worth": ("ablation",),
    "What the model is worth": ("control",),
    "PPO's settings": ("ppo-grid", "ppo-grid2", "ppo-grid3", "ppo-grid4"),
    "Settings for seconds": ("seconds", "seconds2"),
    "For hardware": ("deploy", "deploy2", "deploy3", "deploy-fresh"),
}


def main():
    fresh()
    alone()
    errors()
    gait()
    rows = [row for row in read("tuning.csv.xz") if not row["batch"].startswith("fresh")]
    for heading, batches in PARTS.items():
        print(heading + "\n")
        jobs([row for row in rows if row["batch"] in batches])
    print("What was tried before\n")
    jobs([row for row in rows if row["batch"] not in sum(PARTS.values(), ())])


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


def evaluations(rows):
    """`(M steps, m/s, rad/s, falls)`, each [evaluation, seed]."""
    seeds = sorted({row["seed"] for row in rows})
    of = [[row for row in rows if row["seed"] == seed] for seed in seeds]
    names = "sim_steps", "tracking_error", "yaw_error", "fall_rate"
    return [np.array([[float(row[name]) for row in seed] for seed in of]).T for name in names]


def fresh():
    """Ten seeds that chose no setting, of `best` and of PPO; and of earlier settings."""
    print(
        "| batch | | walks: M steps, mean | last | within the errors, mean | last | in all | m/s | "
        "rad/s | falls |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    rows = [row for row in read("tuning.csv.xz") if row["batch"].startswith("fresh")]
    rows.sort(key=lambda row: row["batch"])
    for (batch, name), some in groupby(rows, lambda r: (r["batch"], r["name"].split("-")[0])):
        steps, *errors = evaluations([*some])
        found = stats.reached_by_tracking(steps, *errors)
        cells = []
        for each in (found.walks / 1e6, found.level / 1e6):
            never = np.isnan(each).sum()
            cells.append(f"{np.nanmean(each):.2f}")
            cells.append(f"{np.nanmax(each):.2f}" + (f", {never} never" if never else ""))
        cells.append(f"{steps[-1, 0] / 1e6:.2f}")
        cells += [f"{error[-1].mean():.3f}" for error in errors[:2]]
        falls = f"{100 * errors[2][-1].mean():.1f} %"
        print(f"| {batch} | `{name}` |", " | ".join(cells), f"| {falls} |")
    print()


def alone():
    """One run at a time on a card: where it walks, and what an iteration took."""
    print("| engine | robots | seed | walks: M steps | seconds | ms an iteration |")
    print("|---|---|---|---|---|---|")
    for engine, robots, some in runs_alone():
        steps, *errors = evaluations(some)
        walks = stats.reached_by_tracking(steps, *errors).walks
        seconds = np.array([float(row["seconds"]) for row in some])
        at = f"{seconds[steps[:, 0] == walks][0]:.1f}" if np.isfinite(walks[0]) else "-"
        mean = 1e3 * seconds[-1] / float(some[-1]["iteration"])
        walked = f"{walks[0] / 1e6:.2f}" if np.isfinite(walks[0]) else "never"
        print(f"| {engine} | {robots} | {some[0]['seed']} | {walked} | {at} | {mean:.1f} |")
    print()


def runs_alone():
    """`(engine, "best" or PPO's robots, rows)` of each run of alone.csv."""
    with (RESULTS / "alone.csv").open() as file:
        rows = [*csv.DictReader(file)]
    for (engine, job, _), some in groupby(rows, lambda r: (r["engine"], r["job"], r["seed"])):
        fields = dict(field.split("=", 1) for field in job.split()[1:])
        robots = fields.get("rollout.num_envs", "512")  # that of `g1:ppo` in commit e047394
        rows = fields.get("rollout.horizon", "24")
        ppo = f"PPO, {robots}" + (f" x {rows}" if rows != "24" else "")
        name = "best" if job.startswith("g1:best") else ppo
        batches = fields.get("ppo.minibatches", "4")
        name += f", {batches} minibatches" if name == "best" and batches != "4" else ""
        name += f", {fields['ppo.epochs']} epochs" if "ppo.epochs" in fields else ""
        yield engine, name, [*some]


def errors():
    """Shares of the spread, of one, four and twenty predictions in a row, by iteration."""
    with (RESULTS / "errors.csv").open() as file:
        rows = [*csv.DictReader(file)]
    at = [*dict.fromkeys(row["iteration"] for row in rows)]
    print("| 1, 4, 20 predictions in a row |", " | ".join(f"iteration {i}" for i in at), "|")
    print("|---|" + "---|" * len(at))
    for group in dict.fromkeys(row["group"] for row in rows):
        cells = [
            ", ".join(
                f"{100 * float(row['share']):.0f}"
                for row in rows
                if (row["group"], row["iteration"]) == (group, i)
            )
            for i in at
        ]
        print(f"| {group} |", " | ".join(f"{cell} %" for cell in cells), "|")
    print()


def jobs(rows):
    print("| run | what differs | walks, M steps | M steps in all | m/s | rad/s | falls |")
    print("|---|---|---|---|---|---|---|")
    for name, some in groupby(rows, lambda row: row["name"]):
        some = [*some]
        steps, error, yaw, falls = evaluations(some)
        found = stats.reached_by_tracking(steps, error, yaw, falls).walks / 1e6
        said = ", ".join("never" if np.isnan(x) else f"{x:.2f}" for x in found)
        job = SHOULDERS.sub("task.shoulders=0.5", some[0]["job"])
        job = job.replace(CLOCK, "task.clock=on").replace(SMOOTH, "task.smooth=on")
        robot, *fields = job.split()
        last = dict(field.split("=", 1) for field in fields if not field.startswith(OF_ALL))
        differs = " ".join(f"{k.split('.', 1)[-1]}={v}" for k, v in last.items())
        print(
            f"| {name} | {robot.split(':')[1]} {differs} | {said} | {steps[-1, 0] / 1e6:.2f} | "
            f"{error[-1].mean():.3f} | {yaw[-1].mean():.3f} | {100 * falls[-1].mean():.1f} % |"
        )
    print()


if __name__ == "__main__":
    main()
