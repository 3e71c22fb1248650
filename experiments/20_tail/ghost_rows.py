"""Rows after a predicted fall weighed down, and true epochs: the default before and after.

    python experiments/20_tail/ghost_rows.py OUT.csv go1:best anymal_c:best --label after
    python experiments/20_tail/ghost_rows.py OUT.csv anymal_c:best --label after --seed 105
    python experiments/20_tail/ghost_rows.py OUT.csv go1:best --label "true epochs alone" --weights one
    PYTHONPATH=CHECKOUT_OF_4b8027e python experiments/20_tail/ghost_rows.py OUT.csv go1:best --label before
    python experiments/20_tail/ghost_rows.py OUT.csv --show

Five seeds at once, from 100 on, 500 iterations, an evaluation of 200 episodes a seed every 20. OUT.csv gets
a row an evaluation and seed; runs that are there are skipped. It uses only what both commits share:
`config.load`, `train.train` and the columns of metrics.csv.
"""

import argparse
import csv
import functools
import time
from pathlib import Path

import numpy as np

LEVELS = {45: (20, 25, 30, 35, 38), 30: (15, 20, 22, 24)}  # of the best possible return
FIELDS = "label job seed iteration sim_steps return fall_rate tracking_error seconds".split()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("jobs", nargs="*", metavar="ROBOT:VARIANT")
    parser.add_argument("--label", default="after")
    parser.add_argument("--seed", type=int, default=100, help="the first of five")
    parser.add_argument("--iterations", type=int, default=500)
    parser.add_argument("--weights", choices=("lived", "one", "half"), help="default: the code's")
    parser.add_argument("--show", action="store_true")
    args = parser.parse_args()
    rows = read(args.out)
    if args.weights:
        from dynappo import algorithm

        algorithm.presence = functools.partial(presence, args.weights)
    for job in args.jobs:
        run_of = args.label, job, str(args.seed)
        if not any((row["label"], row["job"], row["seed"]) == run_of for row in rows):
            append(args.out, run(args.label, job, args.seed, args.iterations))
    if args.show:
        show(read(args.out))


def presence(kind: str, buffer, real):
    """The weight of each row: the probability that it is lived, 1, or 1 while that is above a half."""
    import jax.numpy as jnp

    lived = jnp.cumprod(jnp.where(real, 1.0, buffer.discount), axis=0)
    lived = jnp.roll(lived, 1, axis=0).at[0].set(1.0)
    return {"lived": lived, "one": buffer.valid * 0 + 1, "half": (lived > 0.5) * 1.0}[kind]


def run(label: str, job: str, seed: int, iterations: int) -> list[dict]:
    """Train five seeds and return a row an evaluation and seed."""
    from dynappo import config, train

    robot, _, variant = job.partition(":")
    settings = config.load(f"configs/{robot}.py:{variant}")
    settings.run.update(seed=seed, num_seeds=5, num_iterations=iterations, log_every=20)
    settings.run.update(eval_every=20, eval_envs=200, checkpoint_every=0)
    began = time.perf_counter()
    _, metrics = train.train(settings)
    print(label, job, f"{time.perf_counter() - began:.0f} s", flush=True)
    rows = []
    for i in np.flatnonzero(np.isfinite(metrics["eval_return"]).all(1)):
        for s in range(5):
            told = {name: float(metrics[f"eval_{name}"][i, s]) for name in FIELDS[5:8]}
            when = {name: int(metrics[name][i]) for name in ("iteration", "sim_steps")}
            about = {"label": label, "job": job, "seed": seed + s}
            rows.append(about | when | told | {"seconds": float(metrics["seconds"][i])})
    return rows


def read(path: Path) -> list[dict]:
    """The rows of OUT.csv."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def append(path: Path, rows: list[dict]) -> None:
    """Add rows to OUT.csv, four digits each."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
        if new:
            writer.writeheader()
        for row in rows:
            writer.writerow({n: f"{v:.4g}" if isinstance(v, float) else v for n, v in row.items()})


def show(rows: list[dict]) -> None:
    """Steps (M) to each level, and the last evaluation: mean over seeds and its 95 % t interval."""
    for job in dict.fromkeys(row["job"] for row in rows):
        for label in dict.fromkeys(row["label"] for row in rows if row["job"] == job):
            mine = [row for row in rows if (row["job"], row["label"]) == (job, label)]
            runs = [
                [r for r in mine if r["seed"] == s] for s in dict.fromkeys(r["seed"] for r in mine)
            ]
            levels = LEVELS[30 if job.startswith("anymal") else 45]
            first = [[reached(run, level) for run in runs] for level in levels]
            cells = [
                f"{level}: {spread(steps)}" for level, steps in zip(levels, first, strict=True)
            ]
            last = {n: spread([float(run[-1][n]) for run in runs]) for n in ("return", "fall_rate")}
            print(job, label, "| M steps to", ", ".join(cells), "| at the end", last)


def reached(run: list[dict], level: float) -> float:
    """Simulator steps (M) at the first evaluation that is at least `level`; NaN if none is."""
    steps = [int(row["sim_steps"]) / 1e6 for row in run if float(row["return"]) >= level]
    return steps[0] if steps else np.nan


def spread(values) -> str:
    """`mean +- half width` of the 95 % t interval of the mean over seeds."""
    from scipy import special

    values = np.asarray(values, float)
    n = np.isfinite(values).sum()
    if n < len(values):
        return f"{n} of {len(values)} seeds"
    half = special.stdtrit(n - 1, 0.975) * values.std(ddof=1) / n**0.5
    return f"{values.mean():.3g} +- {half:.2g}"


if __name__ == "__main__":
    main()
