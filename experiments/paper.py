"""What the folders share: runs as arrays and tables; 10 to 18 the paper's tables too.

The numbers of "Learning to Walk With Less" are in paper/*.csv, as printed there. A run is what
`run.py` writes, NAME.csv.xz and NAME.json; where it is missing or has diverged, tables say so.
"""

from __future__ import annotations

import argparse
import csv
import json
import lzma
import os
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.program import devices
from experiments import stats

PAPER_SEEDS = 3
LIMIT = 30.5  # the return of Table VI
EVERY = 10  # iterations between two rows of the CSVs of 10_ablation
# iterations whose policies 16_gaits looks at: the paper's last three, and while robots begin to walk
CHECKPOINTS = (100, 150, 200, 250, 300, 400, 500)
ROBOTS = {
    "go1": "Unitree Go1",
    "go2": "Unitree Go2",
    "anymal_c": "ANYmal-C",
    "anymal_d": "ANYmal-D",
}
VARIANTS = {  # the paper's five
    "ppo12": "PPO, 12 steps",
    "ppo16": "PPO, 16 steps",
    "dyna2": "2-step tail, no ramp",
    "dyna4_noschedule": "4-step tail, no ramp",
    "dyna4": "4-step tail",
}
# of the paper's tails: Isaac Lab's train.py allows TF32 (allow_tf32 = True), and the paper's A40 has it
TAILS = ("model.precision=tf32",)
OURS = {"fast": "fast (4-step tail)", "best": "best (16 of 24)"}
# two CPU cores, minutes: shows that the scripts work, and nothing else
QUICK = (
    "rollout.num_envs=32 run.num_iterations=10 run.log_every=5 run.checkpoint_every=0 run.eval_envs=0 "
    "model.epochs=2 physics.iterations=1 physics.ls_iterations=4"
).split()


def variants(robot: str) -> tuple[str, ...]:
    """Of a robot's tables: the paper's, and `fast`, which was run on Go1 only."""
    return (*VARIANTS, *(["fast"] if robot == "go1" else []))


class Run(NamedTuple):
    """A run that has ended; no columns if it diverged."""

    columns: dict[str, np.ndarray]  # [I, S]; NaN where a cell is empty
    summary: dict[str, Any]


def parser(about: str | None) -> argparse.ArgumentParser:
    """One that shows a script's docstring as it is."""
    return argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def options(folder: Path, of: argparse.ArgumentParser) -> argparse.Namespace:
    """A command line, of `parser` and a script's own flags: `quick`; `out`, where results/, tables and
    figures go; `lock`, as of run.py."""
    of.add_argument("--quick", action="store_true", help="tiny, on two CPU cores, in minutes")
    of.add_argument("--out", type=Path, help=f"default: {folder.name}, or runs/quick/ of it")
    of.add_argument("--lock", type=Path, help="a file that one process holds while it trains")
    args = of.parse_args()
    devices.own_process()
    args.out = args.out or (Path("runs/quick") / folder.name if args.quick else folder)
    if args.quick:  # half of its time would be LLVM's optimisation of programs that run for seconds
        os.environ["XLA_FLAGS"] = (
            os.environ.get("XLA_FLAGS", "") + " --xla_backend_optimization_level=0"
        )
    return args


def jobs(path: Path) -> dict[str, str]:
    """`name -> the rest of its line` of a file of jobs; empty lines are left out. SystemExit without
    a file."""
    if not path.is_file():
        raise SystemExit(
            f"{path}: there is no such file; expected lines of NAME ROBOT:VARIANT [FIELD=VALUE ...]"
        )
    lines = path.read_text().splitlines()
    return dict(line.split(maxsplit=1) for line in lines if line.strip())


def chosen(jobs: Iterable[str], names: Sequence[str]) -> list[str]:
    """The jobs that `names` ask for, in their order: the one of that very name, else all that begin so. All
    without names; SystemExit where there is none."""
    jobs = list(jobs)
    if not names:
        return jobs
    asked = [
        [name] if name in jobs else [job for job in jobs if job.startswith(name)] for name in names
    ]
    for name, found in zip(names, asked, strict=True):
        if not found:
            raise SystemExit(f"{name}: no job is named, or begins, so")
    return list(dict.fromkeys(job for found in asked for job in found))


def table(name: str) -> list[dict[str, Any]]:
    """Rows of paper/NAME.csv."""
    return rows(Path(__file__).parent / "paper" / f"{name}.csv")


def rows(path: Path) -> list[dict[str, Any]]:
    """Of a CSV: numbers as floats, None for an empty cell, all else text; [] if it is not there."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return [{key: _cell(text) for key, text in row.items()} for row in csv.DictReader(file)]


def _cell(text: str):
    try:
        return float(text) if text else None
    except ValueError:
        return text


def pick(rows, /, **wanted) -> dict[str, Any]:
    """The first row with these values, or {}."""
    return next((row for row in rows if wanted.items() <= row.items()), {})


def load(folder: Path, name: str) -> Run | None:
    """The run NAME of `folder`; None if it has not ended."""
    path = folder / f"{name}.json"
    if not path.exists():
        return None
    summary = json.loads(path.read_text())
    return Run({} if "diverged" in summary else read(folder / f"{name}.csv.xz"), summary)


def read(path: Path) -> dict[str, np.ndarray]:
    """Columns `[I, S]` of a CSV, packed by xz or not, with a row an iteration and seed."""
    with (lzma.open if path.suffix == ".xz" else open)(path, "rt", newline="") as file:
        names, *rows = csv.reader(file)
    columns = dict(zip(names, zip(*rows, strict=True), strict=True))
    seeds = len(set(columns.get("seed", [""])))
    numbers = {name: [float(text or "nan") for text in column] for name, column in columns.items()}
    return {name: np.array(column).reshape(-1, seeds) for name, column in numbers.items()}


def read_one(path: Path) -> dict[str, np.ndarray]:
    """Columns `[I]` of a CSV of one seed."""
    return {name: column[:, 0] for name, column in read(path).items()}


def status(run: Run | None) -> str:
    """In words for a table."""
    return "not run" if run is None else "" if run.columns else "diverged"


def peak(run: Run) -> np.ndarray:
    """The best return of each seed, of all iterations: the paper's "max reward"."""
    return _per_seed(run, "return_max")


def final(run: Run) -> np.ndarray:
    """The return of each seed: mean of its last ten iterations."""
    return _per_seed(run, "return")


def _per_seed(run, name):
    return np.atleast_1d(np.array(run.summary[name], float))


def policy_std(run: Run) -> np.ndarray:
    """Of each seed, mean of the last ten iterations (of runs before it was in the JSON: of the CSV)."""
    if "policy_std" in run.summary:
        return _per_seed(run, "policy_std")
    last = run.columns["iteration"][:, 0] > run.columns["iteration"][-1, 0] - 10
    return np.nanmean(run.columns["policy_std"][last], 0)


def reached(run: Run, limit: float, every: int = 1) -> dict[str, np.ndarray]:
    """Iteration, simulator steps and seconds at which each seed's return first is `limit`; or NaN.

    Looked at in every `every`-th iteration: returns are noisy, and a run that is looked at more often
    seems to get there earlier, so runs are to be compared at the same iterations. "with_setup" are
    seconds with those before the first iteration, mostly compilation.
    """
    rows = run.columns["iteration"][:, 0] % every == 0
    there = run.columns["episode_return"][rows] >= limit
    first, seeds = there.argmax(0), np.arange(there.shape[1])
    names = ("iteration", "sim_steps", "seconds")
    took = {n: np.where(there.any(0), run.columns[n][rows][first, seeds], np.nan) for n in names}
    return took | {"with_setup": took["seconds"] + run.summary.get("compile_seconds", np.nan)}


tenth = partial(reached, every=EVERY)  # as `reached`


def returns(run: Run) -> dict[str, Any]:
    """Cells of a table: best and final return and policy std, over seeds."""
    cells: dict[str, Any] = {"seeds": len(peak(run))}
    cells |= stats.spread("max_reward", peak(run)) | stats.spread("return", final(run))
    return cells | stats.spread("policy_std", policy_std(run))


def evaluated(run: Run, level: float) -> dict[str, np.ndarray]:
    """As `reached`, by evaluation: where the line through a seed's evaluations first is at `level`."""
    names = ("iteration", "sim_steps", "seconds")
    values = run.columns.get("eval_return", np.full_like(run.columns["episode_return"], np.nan))
    rows = np.isfinite(values).all(1)
    values, took = values[rows], {n: np.full(values.shape[1], np.nan) for n in names}
    for s, ours in enumerate(values.T):
        for i in np.flatnonzero(ours >= level)[:1]:
            ends = ours[max(i - 1, 0) : i + 1]
            for n in names:
                took[n][s] = np.interp(level, ends, run.columns[n][rows][max(i - 1, 0) : i + 1, s])
    return took | {"with_setup": took["seconds"] + run.summary.get("compile_seconds", np.nan)}


def effort(run: Run, limit: float, how=reached) -> dict[str, Any]:
    """Cells: how many seeds get to `limit`, and what it took those; `how` says what counts."""
    took = how(run, limit)
    there = np.isfinite(took["iteration"])
    cells: dict[str, Any] = {"success_rate_pct": 100 * there.mean()}
    if there.any():
        cells |= stats.spread("sim_steps_M", took["sim_steps"] / 1e6)
        cells |= stats.spread("iterations", took["iteration"])
        cells |= stats.spread("seconds", took["seconds"])
        cells |= stats.spread("with_setup", took["with_setup"])
    return cells


def against(run: Run, base: Run, limit: float, how=reached) -> dict[str, Any]:
    """Cells: steps to `limit` as a share of `base`'s (`stats.share`), seconds too, and their tests.

    `p_steps` is Welch's, where all seeds of both get there; `p_steps_rank` counts "never" as the last.
    """
    ours, theirs = how(run, limit), how(base, limit)
    steps, steps_ = ours["sim_steps"], theirs["sim_steps"]
    most, most_ = (r.columns["sim_steps"][-1, 0] for r in (run, base))
    cells = {f"share_of_ppo16_{n}": v for n, v in stats.share(steps, steps_, most, most_).items()}
    if np.isfinite([*steps, *steps_]).all():
        cells["p_steps"] = stats.welch_of(steps, steps_)
        for name in ("seconds", "with_setup"):  # of the batches that had their GPU alone
            found = [stats.moments(took[name]).mean for took in (ours, theirs)]
            cells[f"{name}_share_pct"] = 100 * found[0] / found[1]
    return cells | {"p_steps_rank": stats.rank_sum(steps, steps_)}


def sim_steps(spec: str, iteration: int) -> int:
    """Simulator steps of one seed after `iteration` iterations of a config, counted by its schedule."""
    config = config_lib.load(spec)
    config.run.num_iterations = max(iteration, config.run.num_iterations)
    return int(schedule.sim_steps(config)[iteration - 1])


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    """A table as CSV: five digits, empty where there is no number."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows({n: text(v, 5) for n, v in row.items()} for row in rows)
    print(path)


def text(value, digits: int = 3) -> str:
    """A cell as text; "" for None and NaN."""
    if isinstance(value, (float, np.floating)):
        return "" if np.isnan(value) else f"{value:.{digits}g}"
    return "" if value is None else str(value)


def show(rows: list[dict[str, Any]], columns) -> None:
    """Print some columns in Markdown, to be put into a README."""
    print(markdown(columns, [[text(row.get(name)) for name in columns] for row in rows]))


def markdown(head, rows) -> str:
    """A table of texts."""
    lines = [" | ".join(cells) for cells in (head, *rows)]
    return "\n".join(
        [f"| {lines[0]} |", "|" + "---|" * len(head), *(f"| {x} |" for x in lines[1:])]
    )
