"""What the folders share: runs as arrays, statistics, tables and figures; 10 to 18 the paper's tables too.

The numbers of "Learning to Walk With Less" are in paper/*.csv, as printed there. A run is what
`run.py` writes, NAME.csv.xz and NAME.json; where it is missing or has diverged, tables say so.
"""

from __future__ import annotations

import argparse
import csv
import json
import lzma
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.program import devices
from dynappo.train import curves

PAPER_SEEDS = 3
LIMIT = 30.5  # the return of Table VI
EVERY = 10  # iterations between two rows of the CSVs of 10_ablation
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
OURS = {"fast": "fast (4-step tail)", "best": "best (16 of 24)"}
COLOURS = {
    "ppo12": "#9a9a9a",
    "ppo16": "#2b2b2b",
    "dyna2": "#6aa5d8",
    "dyna4_noschedule": "#d9a05b",
    "dyna4": "#c8481f",
    "fast": "#3b8f5a",
    "best": "#7a4fa3",
}
# two CPU cores, minutes: shows that the scripts work, and nothing else
QUICK = (
    "rollout.num_envs=32 run.num_iterations=10 run.log_every=5 run.checkpoint_every=0 run.eval_envs=0 "
    "model.epochs=2 physics.iterations=1 physics.ls_iterations=4"
).split()


def variants(robot: str) -> tuple[str, ...]:
    """Of a robot's tables: the paper's and ours; `fast` was run on Go1 only."""
    return (*VARIANTS, *(name for name in OURS if name != "fast" or robot == "go1"))


class Run(NamedTuple):
    """A run that has ended; no columns if it diverged."""

    columns: dict[str, np.ndarray]  # [I, S]; NaN where a cell is empty
    summary: dict[str, Any]


def parser(about: str | None) -> argparse.ArgumentParser:
    """One that shows a script's docstring as it is."""
    return argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def options(folder: Path, about: str | None) -> argparse.Namespace:
    """A command line: `quick`; `out`, where results/, tables and figures go; `lock`, as of run.py."""
    of = parser(about)
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


def table(name: str) -> list[dict[str, Any]]:
    """Rows of paper/NAME.csv: numbers as floats, None for a dash, all else text."""
    with (Path(__file__).parent / "paper" / f"{name}.csv").open(newline="") as file:
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
        rows = list(csv.DictReader(file))
    seeds = len({row.get("seed") for row in rows})
    return {n: np.array([float(r[n] or "nan") for r in rows]).reshape(-1, seeds) for n in rows[0]}


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
    seems to get there earlier, so runs are to be compared at the same iterations.
    """
    rows = run.columns["iteration"][:, 0] % every == 0
    there = run.columns["episode_return"][rows] >= limit
    first, seeds = there.argmax(0), np.arange(there.shape[1])
    names = ("iteration", "sim_steps", "seconds")
    return {n: np.where(there.any(0), run.columns[n][rows][first, seeds], np.nan) for n in names}


def returns(run: Run) -> dict[str, Any]:
    """Cells of a table: best and final return and policy std, over seeds."""
    cells: dict[str, Any] = {"seeds": len(peak(run))}
    cells |= spread("max_reward", peak(run)) | spread("return", final(run))
    return cells | spread("policy_std", policy_std(run))


def effort(run: Run, limit: float, every: int = 1) -> dict[str, Any]:
    """Cells: how many seeds get to `limit`, and what it took those (`reached`)."""
    took = reached(run, limit, every)
    there = np.isfinite(took["iteration"])
    cells: dict[str, Any] = {"success_rate_pct": 100 * there.mean()}
    if there.any():
        cells |= spread("sim_steps_M", took["sim_steps"] / 1e6)
        cells |= spread("iterations", took["iteration"]) | spread("seconds", took["seconds"])
    return cells


def add_shares(rows: list[dict[str, Any]]) -> None:
    """To rows of one threshold: simulator steps as a share of PPO-16's."""
    base = pick(rows, variant="ppo16").get("sim_steps_M_mean", np.nan)
    for cells in rows:
        if "sim_steps_M_mean" in cells:
            cells["share_of_ppo16_pct"] = 100 * cells["sim_steps_M_mean"] / base


def sim_steps(spec: str, iteration: int) -> int:
    """Simulator steps of one seed after `iteration` iterations of a config, counted by its schedule."""
    config = config_lib.load(spec)
    config.run.num_iterations = max(iteration, config.run.num_iterations)
    return int(schedule.sim_steps(config)[iteration - 1])


def spread(prefix: str, values) -> dict[str, Any]:
    """Mean, sample standard deviation and bootstrap 95 % interval of the mean over seeds, as cells."""
    values = np.asarray(values, float)
    values = values[np.isfinite(values)]
    low, high = curves.interval(values)
    mean, sd = _moments(values)
    cells = {"mean": mean, "sd": sd, "low": float(low), "high": float(high)}
    return {f"{prefix}_{name}": value for name, value in cells.items()}


def _moments(values):
    """`(mean, sample sd)`; NaN where there are too few."""
    n = len(values)
    return values.mean() if n else np.nan, values.std(ddof=1) if n > 1 else np.nan


def welch(one, other) -> tuple[float, float, float]:
    """Welch's test of two means, each `(mean, sample sd, number)`: t, degrees of freedom, p (two-sided)."""
    from scipy import special  # comes with JAX

    (mean, sd, n), (mean_, sd_, n_) = one, other
    if min(n, n_) < 2 or not sd + sd_ > 0:
        return np.nan, np.nan, np.nan
    a, b = sd**2 / n, sd_**2 / n_
    t = (mean - mean_) / np.sqrt(a + b)
    df = (a + b) ** 2 / (a**2 / (n - 1) + b**2 / (n_ - 1))
    return float(t), float(df), float(2 * special.stdtr(df, -abs(t)))


def welch_of(one, other) -> float:
    """p of two lists of numbers, one a seed."""
    return welch(*((*_moments(x), len(x)) for x in map(np.asarray, (one, other))))[2]


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
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    for row in rows:
        print("| " + " | ".join(text(row.get(name)) for name in columns) + " |")


def figure(rows: int, columns: int, size: tuple[float, float], **more):
    """A Figure and its axes `[rows, columns]`, plain."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"font.size": 9, "axes.axisbelow": True})
    page, axes = plt.subplots(
        rows, columns, figsize=size, layout="constrained", squeeze=False, **more
    )
    for axis in axes.flat:
        axis.grid(alpha=0.25, linewidth=0.7)
        axis.spines[["top", "right"]].set_visible(False)
    return page, axes


def missing(axis, what: str = "not run yet") -> None:
    """Say in the picture that there is nothing to draw."""
    axis.text(
        0.5, 0.5, what, transform=axis.transAxes, ha="center", va="center", color="0.6", fontsize=11
    )


def log(axis) -> None:
    """A logarithmic y axis with plain numbers."""
    axis.set_yscale("log")
    axis.yaxis.get_major_locator().set_params(subs=(1, 2, 5))
    axis.yaxis.set_major_formatter("{x:g}")
    axis.minorticks_off()


def head(page, text: str, **more) -> None:
    """A line above the whole picture."""
    page.suptitle(text, x=0.01, ha="left", **{"fontsize": 10} | more)


def legend(page, axis, columns: int) -> None:
    """One legend below the whole picture, of the lines of `axis`; none without lines."""
    handles, labels = axis.get_legend_handles_labels()
    if handles:
        page.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)


def save(page, path: Path, dpi: int = 130) -> None:
    """As PNG; the same numbers give the same file."""
    path = path.with_suffix(".png")
    path.parent.mkdir(parents=True, exist_ok=True)
    page.savefig(path, dpi=dpi)
    palette(path)
    print(path)


def palette(path: Path) -> None:
    """Write a PNG anew in 256 colours of its own: to the eye the same, and a third of the size."""
    from PIL import Image

    picture = Image.open(path).convert("RGB")
    few = picture.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=4, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


def band(axis, x, values, colour: str, label: str = "", most: int = 50) -> None:
    """The mean over seeds of `values` [I, S] and its 95 % interval, at `most` points of `x` [I].

    Rows with an empty cell are left out: before the first episodes end, and where a CSV is thin.
    """
    whole = np.flatnonzero(np.isfinite(values).all(1))
    if not len(whole):
        return
    rows = whole[np.unique(np.linspace(0, len(whole) - 1, most).round().astype(int))]
    if values.shape[1] > 1:
        low, high = curves.interval(values[rows].T)
        axis.fill_between(x[rows], low, high, color=colour, alpha=0.18, linewidth=0)
    axis.plot(x[rows], values[rows].mean(1), color=colour, linewidth=1.6, label=label)
