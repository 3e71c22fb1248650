"""Simulator steps that a tail saves, against PPO-16: a table, and the curves as PNG and SVG.

    python experiments/20_tail/compare.py [RUN ...] [--robot go1]

Reads results/ROBOT_RUN.csv of `experiments/run.py` (a row an iteration and seed). The threshold is 80 %
of the mean over seeds of PPO-16's best return; a seed that never reaches it counts as none.
"""

import argparse
import csv
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from dynappo import curves

HERE = Path(__file__).parent
RUNS = "ppo16 tail4of16 tail12of16 tail16of24".split()
COLOURS = dict(zip(RUNS, ("0.35", "#7a9cc6", "#d08a3c", "#1f4e79"), strict=True))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("runs", nargs="*", default=RUNS)
    parser.add_argument("--robot", default="go1")
    args = parser.parse_args()
    runs = {name: load(HERE / "results" / f"{args.robot}_{name}.csv") for name in args.runs}
    best = np.nanmax(runs["ppo16"]["episode_return"], 0).mean()
    limits = {"80 %": 0.8 * best, "34": 34.0}
    print("threshold", {name: round(limit, 2) for name, limit in limits.items()})
    base = {}
    for name, run in runs.items():
        final = run["episode_return"][-10:].mean(0)
        low, high = curves.interval(final)
        text = f"{name:12s} return {final.mean():6.2f} ({low:5.2f} to {high:5.2f})"
        for label, limit in limits.items():
            steps = steps_to(run, limit)
            base.setdefault(label, np.nanmean(steps))
            low, high = curves.interval(steps[np.isfinite(steps)])
            share = np.nanmean(steps) / base[label]
            text += (
                f" | to {label}: {np.nanmean(steps):5.2f} M ({low:5.2f} to {high:5.2f}), {share:4.0%}, "
                f"{np.isfinite(steps).sum()}/{len(steps)} seeds"
            )
        print(text)
    draw(runs, limits["80 %"], HERE / f"{args.robot}.png")


def load(path):
    """Columns `[I, S]`."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    seeds = 1 + max(int(row["seed"]) for row in rows)
    return {
        name: np.array([float(row[name] or "nan") for row in rows]).reshape(-1, seeds)
        for name in rows[0]
    }


def steps_to(run, limit):
    """M simulator steps of each seed until its return is `limit`; NaN if never."""
    there = run["episode_return"] >= limit
    first = run["sim_steps"][there.argmax(0), 0] / 1e6
    return np.where(there.any(0), first, np.nan)


def draw(runs, limit, path):
    figure, axis = plt.subplots(figsize=(9, 4.8), layout="constrained")
    for name, run in runs.items():
        steps, returns = run["sim_steps"][:, 0] / 1e6, run["episode_return"]
        low, high = curves.interval(returns.T)
        axis.fill_between(steps, low, high, color=COLOURS.get(name), alpha=0.18, linewidth=0)
        axis.plot(steps, returns.mean(1), color=COLOURS.get(name), linewidth=2)
        end = (steps[-1], returns[-10:].mean())
        axis.annotate(
            name, end, (6, 0), textcoords="offset points", va="center", color=COLOURS.get(name)
        )
    axis.axhline(limit, color="0.6", linewidth=0.8, linestyle="--")
    axis.set(xlabel="simulator steps (M)", ylabel="episode return", xlim=(0, 38))
    axis.set_title("mean of 5 seeds, its 95 % interval; dashed: 80 % of PPO-16's best", loc="left")
    axis.grid(alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    figure.savefig(path.with_suffix(".svg"))


if __name__ == "__main__":
    main()
