"""Simulator steps to fixed evaluated returns, and where runs end, of what run.py wrote.

    python experiments/21_less/table.py FOLDER [NAME ...]
    python experiments/21_less/table.py experiments/21_less/results/tuning.csv.xz [NAME ...]
    python experiments/21_less/table.py experiments/21_less/results/ablation.csv.xz --parts
    python experiments/21_less/table.py experiments/21_less/results/fresh.csv.xz new-g ppo-kl3-g --falls

`--falls`: steps until a robot first reaches its level, the falls then, and steps until it does with few
falls, or stays there with few falls at every later evaluation.

`--parts`: a line a part that was taken out, a column a robot: steps until it walks, then return and
falls at the end.

Mean over seeds of the first evaluation that reaches a level, and in brackets the last seed's; a seed that
never does is counted as missing. The end is the mean of a seed's last three evaluations. Intervals are
Student's t, 95 %. A return of 10 s (run.eval_steps=500) counts twice.
"""

import csv
import lzma
from pathlib import Path

import numpy as np

from dynappo.train import curves
from experiments import paper

TEXT = ("job", "name", "batch")
END = ("return", "fall_rate", "tracking_error")
LEVELS = {45: (20, 30, 35, 38, 40), 30: (15, 20, 22, 24, 25)}  # of the best possible return


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("path", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--parts", action="store_true")
    parser.add_argument("--falls", action="store_true")
    args = parser.parse_args()
    jobs = read(args.path)
    jobs = {name: jobs[name] for name in args.names or jobs}
    if args.parts:
        print(parts(jobs))
        return
    if args.falls:
        print(falls(jobs))
        return
    for top in LEVELS:
        mine = {name: job for name, job in jobs.items() if top == best(job)}
        if mine:
            print(table(mine, LEVELS[top]), end="\n\n")


def read(path: Path) -> dict[str, list[dict]]:
    """`name -> rows`, numbers as such: of a folder of NAME.csv, or of one packed file."""
    if path.is_dir():
        return {file.stem: rows(file.open(newline="")) for file in sorted(path.glob("*.csv"))}
    jobs = {}
    for row in rows(lzma.open(path, "rt", newline="")):
        jobs.setdefault(row["name"], []).append(row)
    return jobs


def rows(file) -> list[dict]:
    """The rows of an open CSV."""
    with file:
        found = list(csv.DictReader(file))
    found = [{k: v if k in TEXT else float(v) for k, v in row.items()} for row in found]
    for row in found:
        row["return"] *= 2 if "run.eval_steps=500" in row["job"] else 1
    return found


def best(job) -> int:
    """The best possible return of a job's robot; those of 23_untuned have ANYmal's weights."""
    return 45 if any(word.startswith("go") for word in job[0]["job"].split()) else 30


def seeds(job) -> list[list[dict]]:
    """The rows of each seed, in order."""
    return [[r for r in job if r["seed"] == s] for s in sorted({r["seed"] for r in job})]


def first(run: list[dict], level: float, name: str = "sim_steps") -> float:
    """`name` at the first evaluation of a seed that is at least `level`; NaN if none is."""
    return next((row[name] for row in run if row["return"] >= level), np.nan)


def stays(run: list[dict], level: float, most: float) -> float:
    """Steps from which on every evaluation of a seed is at least `level`, with a share of at most `most` of
    episodes with a fall; NaN if there is no such evaluation."""
    good = [row["return"] >= level and row["fall_rate"] <= most + 1e-9 for row in run]
    last = max((i for i, fine in enumerate(good) if not fine), default=-1)
    return run[last + 1]["sim_steps"] if last + 1 < len(run) else np.nan


def falls(jobs) -> str:
    """In Markdown, a line a job: million steps until it walks by several meanings of that word."""
    head = ["", "first at the level", "falls then", "first with <= 1 %"]
    head += ["stays", "stays, <= 3 %", "stays, <= 1 %"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name, mine in jobs.items():
        runs, level = seeds(mine), LEVELS[best(mine)][3]
        then = [first(run, level, "fall_rate") for run in runs]
        few = [first([r for r in run if r["fall_rate"] <= 0.01 + 1e-9], level) for run in runs]
        found = [[first(run, level) for run in runs], few]
        found += [[stays(run, level, most) for run in runs] for most in (1, 0.03, 0.01)]
        cells = [reached(np.array(steps) / 1e6) for steps in found]
        then = f"{100 * np.nanmean(then):.1f} % (up to {100 * np.nanmax(then):.0f} %)"
        lines.append("| " + " | ".join([name, cells[0], then, *cells[1:]]) + " |")
    return "\n".join(lines)


def reached(steps) -> str:
    """Mean over seeds, the last seed, and how many never did."""
    gone = int(np.isnan(steps).sum())
    some = f"{np.nanmean(steps):.2f} ({np.nanmax(steps):.2f})" if gone < len(steps) else "-"
    return some + (f", {gone} never" if gone else "")


def spread(values, digits: int = 1) -> str:
    """Mean and half of its interval."""
    return f"{np.mean(values):.{digits}f} ± {curves.half_width(values):.{digits}f}"


def table(jobs, levels) -> str:
    """In Markdown, a line a job."""
    head = [
        "",
        "seeds",
        *(f"{level}: M steps" for level in levels),
        "M steps in all",
        "at the end",
        "falls",
        "error, m/s",
    ]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name, mine in jobs.items():
        runs = seeds(mine)
        cells = [name, str(len(runs))]
        for level in levels:
            cells.append(reached(np.array([first(run, level) / 1e6 for run in runs])))
        ends = [{k: np.mean([row[k] for row in run[-3:]]) for k in END} for run in runs]
        cells.append(f"{runs[0][-1]['sim_steps'] / 1e6:.1f}")
        cells += [spread([end["return"] for end in ends])]
        cells += [f"{100 * np.mean([end['fall_rate'] for end in ends]):.1f} %"]
        cells += [f"{np.mean([end['tracking_error'] for end in ends]):.3f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def parts(jobs) -> str:
    """In Markdown, a line for the jobs `NAME-g`, `-h`, `-c` and `-d`: Go1, Go2, ANYmal-C and -D."""
    head = ["", "Go1", "Go2", "ANYmal-C", "ANYmal-D"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name in dict.fromkeys(name[:-2] for name in jobs):
        cells = [
            part(jobs[f"{name}-{robot}"]) if f"{name}-{robot}" in jobs else "" for robot in "ghcd"
        ]
        lines.append("| " + " | ".join([name, *cells]) + " |")
    return "\n".join(lines)


def part(job) -> str:
    """Million steps until the mean seed walks, those that never did; return and falls at the end."""
    runs = seeds(job)
    steps = np.array([first(run, LEVELS[best(job)][3]) / 1e6 for run in runs])
    gone = int(np.isnan(steps).sum())
    some = f"{np.nanmean(steps):.2f}" if gone < len(steps) else ""
    some += f" ({gone} never)" if 0 < gone < len(steps) else "never" * (gone > 0)
    last = [row for run in runs for row in run[-3:]]
    total, falls = (np.mean([row[name] for row in last]) for name in ("return", "fall_rate"))
    return f"**{some}**; {total:.1f}, {100 * falls:.1f} %"


if __name__ == "__main__":
    main()
